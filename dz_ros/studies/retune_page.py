# SPDX-License-Identifier: Apache-2.0
"""The tables of retuned laws, as Markdown: winners, one set of gains for all, errors, margins."""

from __future__ import annotations

from collections.abc import Sequence
import math

from dz_ros.studies.arena_page import NEAR, OURS, REFERENCE, where_better
from dz_ros.studies.retune import ALL, BAD, Found


def best_of(found: Sequence[Found]) -> dict[tuple[str, str], Found]:
    """Return (law, scenario) → the best of its seeds."""
    best: dict[tuple[str, str], Found] = {}
    for item in found:
        key = item.law, item.scenario
        if key not in best or item.score < best[key].score:
            best[key] = item
    return best


def within_limits(found: Sequence[Found], name: str) -> list[Found]:
    """Return the best of each law in a scenario, by error, those within the limits."""
    return sorted((item for (_, scenario), item in best_of(found).items()
                   if scenario == name and item.score < BAD), key=lambda item: item.error)


def table(found: Sequence[Found]) -> list[str]:
    """Return the winner of each scenario, by how much, effort and margins; then the next."""
    lines = ['| scenario | best | ours | max\\|x̃\\| | TV | peak | b m at delay 0, 1 | delay '
             f'| next | max\\|x̃\\| | TV | by | `{REFERENCE}` | TV | over the best | seeds |',
             f'|{"---|" * 16}']
    for name in dict.fromkeys(item.scenario for item in found):
        ranked = within_limits(found, name)
        if not ranked:
            lines.append(f'| {name} | none within the limits |' + ' |' * 14)
            continue
        first, second = ranked[0], ranked[1] if len(ranked) > 1 else None
        own = next((item for item in ranked if item.law == REFERENCE), None)
        asked = any(item.law == REFERENCE and item.scenario == name for item in found)
        seeds = len({item.seed for item in found if item.scenario == name
                     and item.law == first.law})
        lines.append('| ' + ' | '.join([
            name, f'**`{first.law}`**', 'yes' if first.law in OURS else 'no',
            f'{first.error:.3g}', f'{first.variation:.3g}', f'{first.peak:.3g}', *survived(first),
            f'`{second.law}`' if second else '', f'{second.error:.3g}' if second else '',
            f'{second.variation:.3g}' if second else '',
            f'{second.error / first.error:.2f}' if second else '',
            f'{own.error:.3g}' if own else 'beyond a limit' if asked else '',
            f'{own.variation:.3g}' if own else '',
            f'{own.error / first.error:.2f}' if own else '', str(seeds)]) + ' |')
    return lines


def survived(item: Found) -> tuple[str, str]:
    """Return the largest b m with a delay of 0 and 1, and the largest delay, as texts."""
    if not item.beta[0]:
        return 'not known', 'not known'
    return (f'{item.beta[0]:.2f}, {item.beta[1]:.2f}',
            str(item.delay) if item.delay >= 0 else 'none')


def summary(found: Sequence[Found]) -> list[str]:
    """Return where the recommended law has the smallest error: a sentence, then a table of others.

    Lines of Markdown.
    """
    names = [name for name in dict.fromkeys(item.scenario for item in found) if name != ALL]
    first, near, beaten = [], [], []
    for name in names:
        ranked = within_limits(found, name)
        own = next((item for item in ranked if item.law == REFERENCE), None)
        if own is not None and own is ranked[0]:
            first.append(name)
        elif own is not None and own.error <= NEAR * ranked[0].error:
            near.append(name)
        elif ranked:
            beaten.append((name, ranked[0].law, 'beyond a limit' if own is None
                           else f'{own.error / ranked[0].error:.2f}'))
    return where_better(f'With gains tuned for each scenario `{REFERENCE}`', len(names),
                        len(first), len(near), beaten)


def errors_table(found: Sequence[Found]) -> list[str]:
    """Return max|x̃| in each scenario with the one set of gains for all of them, law by law."""
    chosen = sorted((item for (_, name), item in best_of(found).items() if name == ALL),
                    key=lambda item: item.score)
    names = list(dict.fromkeys(name for item in chosen for name in item.errors))
    lines = ['| scenario | ' + ' | '.join(f'`{item.law}`' for item in chosen) + ' |',
             f'|{"---|" * (len(chosen) + 1)}']
    for name in names:
        least = min(item.errors[name] for item in chosen)
        cells = [f'**{item.errors[name]:.3g}**' if item.errors[name] == least
                 else f'{item.errors[name]:.3g}' if math.isfinite(item.errors[name]) else 'lost'
                 for item in chosen]
        lines.append(f'| {name} | ' + ' | '.join(cells) + ' |')
    return lines


def gains_table(found: Sequence[Found]) -> list[str]:
    """Return the gains tuned over all scenarios, with what each set survives."""
    lines = ['| law | ours | geometric mean of max\\|x̃\\| | peak | TV | b m at delay 0, 1 | '
             'delay | gains |', f'|{"---|" * 8}']
    chosen = [item for (_, name), item in best_of(found).items() if name == ALL]
    for item in sorted(chosen, key=lambda one: one.score):
        gains = ', '.join(f'`{key.partition(".")[2]}` {value:.3g}'
                          for key, value in item.gains.items())
        beyond = '' if item.score < BAD else ' (beyond a limit)'
        mean = f'{item.error:.3g}' if math.isfinite(item.error) else 'lost'
        numbers = ' | '.join(f'{value:.3g}' if math.isfinite(value) else 'lost'
                             for value in (item.peak, item.variation))
        lines.append(f'| `{item.law}` | {"yes" if item.law in OURS else "no"} | {mean}{beyond} '
                     f'| {numbers} | {" | ".join(survived(item))} | {gains} |')
    return lines


def margins_table(found: Sequence[Found]) -> list[str]:
    """Return what the best set of each law in each scenario survives; a star: beyond a limit."""
    best = best_of(found)
    laws = list(dict.fromkeys(law for law, _ in best))
    lines = ['| scenario | ' + ' | '.join(f'`{law}`' for law in laws) + ' |',
             f'|{"---|" * (len(laws) + 1)}']
    for name in dict.fromkeys(scenario for _, scenario in best):
        cells = []
        for law in laws:
            item = best.get((law, name))
            cells.append('' if item is None else '; '.join(dict.fromkeys(survived(item)))
                         + ('*' if item.score >= BAD else ''))
        lines.append(f'| {name} | ' + ' | '.join(cells) + ' |')
    return lines

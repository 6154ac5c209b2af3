# SPDX-License-Identifier: Apache-2.0
"""The comparison of laws for the documents: every law in every scenario, from fixed seeds.

    python benchmarks/arena.py            print the tables
    python benchmarks/arena.py --write    write docs/arena.md and its pictures
    python benchmarks/arena.py --write --retuned FILE
                                          with the table of `dz arena --retune FILE` too

The numbers do not depend on the machine or on the number of its cores.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
import sys

from dz_ros.core.laws.exact_inverse import ExactInverseGains
from dz_ros.core.loop.compiled import available
from dz_ros.studies.arena import Arena, Plan, run_arena
from dz_ros.studies.arena_page import (
    BEATEN,
    beaten,
    conditions,
    format_beaten,
    format_text,
    HEAD,
    NEAR,
    OURS,
    pictures,
    REFERENCE,
    tables,
    where_better,
)
from dz_ros.studies.entrants import IDEAL
from dz_ros.studies.retune import ALL, Found, read, VARIATION
from dz_ros.studies.retune_page import errors_table, gains_table, margins_table, summary, table
from dz_ros.studies.scenarios import scenarios

ROOT = Path(__file__).resolve().parent.parent

EXPECTED = {
    'nominal': {'pd': .37, 'pid': .125, 'adaptive': .052, 'sliding': .014,
                'sliding_integral': .005, 'exact_inverse k=2.5': .0053,
                'adaptive_inverse': .0070, 'fuzzy': .0042, 'neural': .0045, 'wang2004': .0084,
                'robust': .00062, 'robust_eso': .00030},
    'drift': {'wang2004': .0085, 'robust': .0006, 'robust_eso': .00033},
    'b=0.5': {'wang2004': .038, 'robust': .0018, 'robust_eso': .00032},
    'b=2': {'wang2004': .0065, 'robust': .0004, 'robust_eso': .00026},
    'noise': {'wang2004': .0091, 'robust': .0014, 'robust_eso': .00077},
    'saturation': {'wang2004': .0085, 'robust': .0006},
    'delay 1': {'wang2004': .0085, 'robust': .0006},
    'delay 2': {'wang2004': .0085, 'robust': .0007, 'robust_eso': .00032},
    'b=2, delay 1': {'wang2004': .0065, 'robust': .0004, 'robust_eso': .00028},
}
"""max|x̃| found when the laws were designed, by programs that share no code with this one."""
BEST_RIVAL = {'nominal': .0042, 'drift': .0052, 'b=0.5': .0058, 'b=2': .0045, 'noise': .0056,
              'saturation': .0045, 'delay 1': .0045}
"""The same of the best rival of each scenario."""
NOTE = (
    'Apart by more than 20 %: the best rival under drift, here `neural` with 0.0041. By '
    'experiment, one thing changed at a time: neither the integration (one RK4 step a sample '
    'instead of four: the same to 4 digits) nor the seed (0 to 11: 0.0040 to 0.0048) nor the '
    'initial guess of the dead-zone (0.0041) explains 0.0052. Two things move the number by '
    'as much. First the hidden layer, of which only "12 sigmoids" is known: spread over ±15, '
    '±17, ±20 instead of ±10 they give 0.0049, 0.0054, 0.0054, and ten instead of twelve of '
    'them 0.0049. Second the window: drift (0.9 and 0.7 rad/s) and the reference (1 rad/s) '
    'repeat together with periods of 63 and 21 s, so that the last 10 s are a matter of luck; '
    'over the eleven windows of 10 s from 10 to 120 s the largest error of `neural` is 0.0041 '
    'to 0.0058, in this one 0.0041, in the one before 0.0049; `exact_inverse k=2.5` has '
    '0.0047 to 0.0055, `fuzzy` 0.0049 to 0.0064. So the 0.0052 is most likely that of a net '
    'spread otherwise, and a ranking of these three under drift from one window means '
    'nothing. Spread over ±16.5 the net gives both 0.0052 here and 0.0045 in the nominal '
    'scenario, as was found then, but 0.0078 at b = 0.5 (then: 0.0058), so the very net is '
    'not recovered. The number in the table is right for the laws as they are in '
    '`dz_ros/core/laws/`.')


def main() -> int:
    """Compare all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--write', action='store_true', help='write documents and pictures')
    parser.add_argument('--retuned', type=Path, metavar='FILE',
                        help='searches of `dz arena --retune`, for the second table')
    parser.add_argument('-j', '--jobs', type=int, default=0, help='processes')
    arguments = parser.parse_args()
    if not available():
        print('numba is not installed: this takes an hour instead of minutes')
    arena = run_arena(Plan.of(), arguments.jobs,
                      progress=lambda done, total, name: print(f'{done}/{total} {name}',
                                                               file=sys.stderr, flush=True))
    print(format_text(arena), conditions(arena), format_beaten(arena), *expected(arena), sep='\n')
    if arguments.write:
        write(arena, arguments.retuned)
    return 0


def expected(arena: Arena) -> list[str]:
    """Return the Markdown table of designed for and found."""
    lines = ['| scenario | law | designed for | found | ratio |', '|---|---|---|---|---|']
    for scenario, laws in EXPECTED.items():
        for law, value in laws.items():
            lines.append(line(scenario, f'`{law}`', value,
                              arena.cells[law, scenario].mean('error_max')))
        if scenario in BEST_RIVAL:
            best = best_rival(arena, scenario)
            lines.append(line(scenario, f'best rival, here `{best}`', BEST_RIVAL[scenario],
                              arena.cells[best, scenario].mean('error_max')))
    return lines


def best_rival(arena: Arena, scenario: str) -> str:
    """Return the entrant with the smallest error that is neither ours nor the ideal."""
    return next(name for name in arena.ranking(scenario)
                if name not in (*OURS, 'wang2004') and not name.startswith(IDEAL))


def line(scenario: str, law: str, value: float, found: float | None) -> str:
    """Return a line of it; a ratio off by more than 20 % is bold."""
    ratio = (found or 0.0) / value
    shown = f'{ratio:.2f}' if 0.8 <= ratio <= 1.2 else f'**{ratio:.2f}**'
    return f'| {scenario} | {law} | {value:g} | {found or 0.0:.4g} | {shown} |'


def winners(arena: Arena) -> list[str]:
    """Return the table of the best law in each scenario as shipped, and by how much."""
    lines = ['| scenario | best | ours | max\\|x̃\\| | TV | next | max\\|x̃\\| | TV | by '
             f'| `{REFERENCE}` | TV | over the best |', f'|{"---|" * 12}']
    for name in arena.plan.scenarios:
        first, second = rivals(arena, name)[:2]
        cells = [name]
        for entrant in (first, second):
            cell = arena.cells[entrant, name]
            cells += [f'**`{entrant}`**' if entrant == first else f'`{entrant}`',
                      *(['yes' if entrant in OURS else 'no'] if entrant == first else []),
                      shown(cell.mean('error_max')), shown(cell.mean('v_variation'))]
        own = arena.cells[REFERENCE, name]
        cells += [over(arena, name, second, first), shown(own.mean('error_max')),
                  shown(own.mean('v_variation')), over(arena, name, REFERENCE, first)]
        lines.append('| ' + ' | '.join(cells) + ' |')
    return lines


def rivals(arena: Arena, scenario: str) -> list[str]:
    """Return the entrants by error, smallest first, without the ideal."""
    return [item for item in arena.ranking(scenario) if not item.startswith(IDEAL)]


def over(arena: Arena, scenario: str, entrant: str, best: str) -> str:
    """Return the error of an entrant over that of another, as text."""
    error, least = (arena.cells[name, scenario].mean('error_max') for name in (entrant, best))
    return f'{error / least:.2f}' if error and least else ''


def as_shipped(arena: Arena) -> list[str]:
    """Return where the recommended law has the smallest error as shipped, and where not."""
    first, near, behind = [], [], []
    for name in arena.plan.scenarios:
        best = rivals(arena, name)[0]
        ratio = over(arena, name, REFERENCE, best)
        if best == REFERENCE:
            first.append(name)
        elif ratio and float(ratio) <= NEAR:
            near.append(name)
        else:
            behind.append((name, best, ratio or 'lost'))
    return where_better(f'As shipped `{REFERENCE}`', len(arena.plan.scenarios), len(first),
                        len(near), behind)


def shown(value: float | None) -> str:
    """Return a number of a table; lost where there is none."""
    return 'lost' if value is None else f'{value:.3g}'


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return a table as Markdown; bars in its texts are escaped."""
    return ['| ' + ' | '.join(item.replace('|', '\\|') for item in row) + ' |'
            for row in (head, ['---'] * len(head), *rows)]


def retuned_part(path: Path | None) -> list[str]:
    """Return what the page has of the retuned laws."""
    if path is None:
        return ['Not run for this page.', '']
    found = list(read(path).values())
    complete = complete_scenarios(found)
    found = [item for item in found if item.scenario in complete]
    seeds = sorted({item.seed for item in found})
    each = {seed: len({item.scenario for item in found if item.seed == seed}) for seed in seeds}
    return [*summary(found), '',
            f'Budget: at most {max(item.budget for item in found)} sets of gains tried in each '
            f'search, {len(seeds)} seed{"s" * (len(seeds) > 1)} ('
            + ', '.join(f'seed {seed}: {count} searches' for seed, count in each.items()) + '); '
            'the same for every law. A budget favours laws with few free gains, and a larger one '
            'may change the order of laws that are close.', '',
            *table(found), '', '### One set of gains for all scenarios', '',
            *gains_table(found), '',
            'max|x̃| of each law in each scenario with that set, left the best law over all of '
            'them:', '', *errors_table(found), '', '### What each tuned set survives', '',
            'Of the best set of each law in each scenario, winner or not: the largest b m with a '
            'delay of 0 and of 1 sample; the largest delay at b m = 1.25. A star: the set is '
            'beyond a limit.', '', *margins_table(found), '']


def complete_scenarios(found: Sequence[Found]) -> set[str]:
    """Return the searches that are done for every law with at least one seed."""
    laws = {item.law for item in found if item.scenario == ALL}
    return {name for name in {item.scenario for item in found}
            if {item.law for item in found if item.scenario == name} == laws}


def write(arena: Arena, retuned: Path | None = None) -> None:
    """Write docs/arena.md and its pictures."""
    limit = scenarios()['saturation'].members[0]['controller.v_max']
    known = ExactInverseGains()
    lines = ['# Comparison of laws', '',
             'Written by `python benchmarks/arena.py --write --retuned benchmarks/retuned.jsonl`; '
             'the same tables, with a page of their own, come from `dz arena --out DIR`. '
             + conditions(arena), '', *as_shipped(arena), '',
             'No law is tuned for a scenario in the first table: gains are those of '
             '`dz_ros/core/laws/`, the same in every row but for the limit of the actuator, which '
             'laws with a place for it (`v_max` of `robust` and `robust_eso`, `v_clip` of '
             '`ladrc`, `disturbance_observer`, `super_twisting`, `l1`) have under saturation, '
             f'{limit:g}; where the reference or an observed velocity needs more than the '
             'example does, `v_clip` is off. `fuzzy`, `neural` and `adaptive_inverse` are rebuilt '
             f'after descriptions, not transcribed; `{IDEAL}` has the dead-zone of the example, '
             f'b_r = {known.b_r:g} and b_l = {known.b_l:g}, and is an ideal, not a rival; under '
             'drift it goes on with these two numbers while those of the plant change, so there '
             'it is no ideal either. Scenarios are defined in `dz_ros/studies/scenarios.py`. '
             f'Ours: {", ".join(f"`{name}`" for name in OURS)}.', '',
             '## The best law, as shipped', '',
             'Smallest max|x̃| and the next, each with the total variation of v beside it, '
             'without the ideal; by: the next over the best.', '', *winners(arena), '',
             '## The best law, retuned', '',
             'By `dz arena --retune FILE`: the free gains that each law declares, found by '
             "scipy's differential evolution for each scenario and once over all of them, with "
             'equal budgets and seeds for all. Hard limits: peak |v| at most that of the '
             f"paper's law in the same scenario, total variation at most {VARIATION:g} times its "
             'own (without the delay, where it chatters with it); beyond that a set does not '
             'count. Candidates run for 20 s; every number here is from a full run with the gains '
             'found. b m and delay: the largest that the loop with these gains survives, by the '
             'matrix of its layer; the delay at b m = 1.25.', '', *retuned_part(retuned)]
    for picture in pictures(arena):
        (ROOT / 'docs' / 'images' / f'arena_{picture.name}.png').write_bytes(picture.png())
        lines += [f'![{picture.alt}](images/arena_{picture.name}.png)', '', picture.caption, '']
    lines += ['## Where another law is better', '',
              f'As shipped, where a number of another law is smaller than that of `{REFERENCE}` '
              f'by at least {100 * (NEAR - 1):.0f} %: the smallest with its error, and the laws '
              'that are smaller as well.', '', *markdown(BEATEN, beaten(arena)), '',
              '## Scenarios', '']
    for name, summary_, rows in tables(arena):
        lines += [f'### {name}', '', f'{summary_}.', '', *markdown(HEAD, rows), '']
    lines += ['## Against what the laws were designed for', '',
              'Largest error, and what separate programs gave when the laws were designed; more '
              'than 20 % apart is bold.', '', *expected(arena), '', NOTE, '']

    (ROOT / 'docs' / 'images').mkdir(exist_ok=True)
    (ROOT / 'docs' / 'arena.md').write_text('\n'.join(lines), encoding='utf-8')


if __name__ == '__main__':
    sys.exit(main())

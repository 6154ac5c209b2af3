"""Pictures of the comparison: error against effort, and v of the best and the worst."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np

from dz_ros.analysis.measures import choose_window
from dz_ros.analysis.style import BLUE, CYCLE, GREY, new_figure, Picture, RED, styled
from dz_ros.core.compiled import simulate_fast
from dz_ros.core.configuration import Configuration
from dz_ros.studies.arena import Arena
from dz_ros.studies.scenarios import yardstick

MARKERS = ('o', 's', '^', 'D', 'v', 'P', 'X')


def scatter(arena: Arena) -> Picture | None:
    """Return max|x̃| against total variation, one panel a scenario; None where all are lost."""
    names = [name for name in arena.plan.scenarios
             if any(not cell.lost for cell in arena.column(name).values())]
    if not names:
        return None
    columns = min(3, len(names))
    lines = math.ceil(len(names) / columns)
    with styled():
        figure = new_figure(3.3 * columns + 1.0, 2.7 * lines + 1.2)
        axes = np.atleast_1d(figure.subplots(lines, columns, sharex=True, sharey=True)).ravel()
        for ax, name in zip(axes, names, strict=False):
            _panel(ax, arena, name)
        for ax in axes[len(names):]:
            ax.set_visible(False)
        handles, labels = axes[0].get_legend_handles_labels()
        for ax in axes[1:len(names)]:
            for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
                if label not in labels:
                    handles.append(handle)
                    labels.append(label)
        figure.legend(handles, labels, loc='outside upper center', ncols=min(5, len(labels)))
        figure.supxlabel('total variation of v per second  [1/s]', fontsize=9.0)
        figure.supylabel(r'max $|\tilde{x}|$  [1]', fontsize=9.0)
    return Picture(
        'error_effort', 'Error against effort',
        'Largest tracking error in the last 10 s against the total variation of the command, both '
        'logarithmic: left and low is good, right is chatter or noise passed on. Bars: smallest '
        'to largest over seeds or kicks. Dashed: |x̃| of Ω_ε, the same for all. Lost runs are '
        'left out.', 'One panel a scenario, one mark a law; the recommended law is lowest.'
        if _always_best(arena, 'robust') else 'One panel a scenario, one mark a law.', figure)


def _always_best(arena: Arena, name: str) -> bool:
    return name in arena.plan.entrants and all(
        arena.ranking(scenario)[0] == name for scenario in arena.plan.scenarios)


def _panel(ax: Any, arena: Arena, scenario: str) -> None:
    """Draw one scenario."""
    for place, (name, cell) in enumerate(arena.column(scenario).items()):
        x, y = cell.values('v_variation'), cell.values('error_max')
        if cell.lost or not x or not y or min(x) <= 0.0 or min(y) <= 0.0:
            continue
        middle = sum(x) / len(x), sum(y) / len(y)
        ax.errorbar(*middle, xerr=_reach(middle[0], x), yerr=_reach(middle[1], y),
                    fmt=MARKERS[(place // len(CYCLE)) % len(MARKERS)],
                    color=CYCLE[place % len(CYCLE)], ms=5.0, lw=0.9, capsize=2.0, label=name)
    ax.axhline(yardstick()[0], color=GREY, lw=0.8, ls=(0, (4, 2)))
    ax.set(title=scenario, xscale='log', yscale='log')


def _reach(middle: float, values: Sequence[float]) -> list[list[float]]:
    """Return how far values go below and above their mean, as error bars want it."""
    return [[max(middle - min(values), 0.0)], [max(max(values) - middle, 0.0)]]


def best_and_worst(arena: Arena) -> Picture | None:
    """Return v of the entrants with the smallest and the largest error, in the last 10 s.

    Of the first scenario; a run that was lost has no picture. None with fewer than two entrants.
    """
    scenario = next(iter(arena.plan.scenarios))
    order = [name for name in arena.ranking(scenario)
             if not arena.cells[name, scenario].lost]
    if len(order) < 2:
        return None
    flats = arena.plan.configurations()
    with styled():
        figure = new_figure(8.0, 4.2)
        for ax, name, colour in zip(figure.subplots(2, 1, sharex=True, sharey=True),
                                    (order[0], order[-1]), (BLUE, RED), strict=True):
            run = simulate_fast(Configuration.from_flat(flats[name, scenario, 0]))
            shown = run.t >= choose_window(run.t)[0]
            cell = arena.cells[name, scenario]
            ax.plot(run.t[shown], run.v[shown], color=colour, gid=name)
            ax.set(title=f'{name}: max |x̃| {cell.mean("error_max"):.4g}, '
                   f'total variation {cell.mean("v_variation"):.4g} per s', ylabel='$v$')
        ax.set_xlabel('time  [s]')
    return Picture('best_worst', f'Command of the best and the worst, {scenario}',
                   f'v of {order[0]} (smallest error) and of {order[-1]} (largest).',
                   'Two commands over time, one above the other.', figure)

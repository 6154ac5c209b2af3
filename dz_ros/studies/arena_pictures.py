# SPDX-License-Identifier: Apache-2.0
"""Pictures of the comparison: error against effort, and v of the best and the worst."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.compiled import simulate_fast
from dz_ros.report.style import BLACK, BLUE, GREY, new_figure, PALE, Picture, RED, styled
from dz_ros.runs.metrics import choose_window, window_length
from dz_ros.studies.arena import Arena
from dz_ros.studies.code_folder import keep_compiled
from dz_ros.studies.scenarios import yardstick

WIDTH = 2.0
"""A panel reaches at least from the middle divided by this to the middle times this."""
FEW = 8
"""Laws in a panel up to which all are named."""
SIZE = 7.5
"""Size of a name [pt]."""
RECOMMENDED = 'robust_eso'
"""The entrant that is drawn in a colour of its own."""


def overview(arena: Arena) -> Picture | None:
    """Return max|x̃| of every law in every scenario over the smallest there, as numbers in a grid.

    None with fewer than two laws, or where all runs are lost.
    """
    laws, names = list(arena.plan.entrants), list(arena.plan.scenarios)
    ratio = np.full((len(laws), len(names)), np.nan)
    for j, name in enumerate(names):
        column = arena.column(name)
        for i, law in enumerate(laws):
            error = column[law].mean('error_max')
            ratio[i, j] = math.nan if column[law].lost or error is None else error
        if np.isfinite(ratio[:, j]).any():
            ratio[:, j] /= np.nanmin(ratio[:, j])
    if len(laws) < 2 or not np.isfinite(ratio).any():
        return None
    means = [float(np.exp(np.mean(np.log(row)))) if np.isfinite(row).all() else math.inf
             for row in ratio]
    order = sorted(range(len(laws)), key=lambda i: (
        means[i], -int(np.isfinite(ratio[i]).sum())))
    with styled():
        figure = new_figure(0.46 * len(names) + 2.6, 0.27 * len(laws) + 1.9)
        ax = figure.subplots()
        # White where it is the smallest, darkest where it is 100 times that; lost is grey.
        shade = np.clip(np.log10(ratio[order]), 0.0, 2.0)
        ax.imshow(np.ma.masked_invalid(shade), cmap='Blues', vmin=0.0, vmax=2.6, aspect='auto')
        ax.set_facecolor(PALE)
        for i, place in enumerate(order):
            for j in range(len(names)):
                value = ratio[place, j]
                written = ('lost' if not math.isfinite(value) else '1' if value == 1.0
                           else f'{value:.2g}' if value < 9.95 else f'{value:.0f}')
                ax.text(j, i, written, ha='center', va='center', fontsize=7.0,
                        fontweight='bold' if value == 1.0 else 'normal',
                        color='white' if value > 40.0 else BLACK)
        ax.set_xticks(range(len(names)), names, rotation=50.0, ha='right', fontsize=8.0,
                      rotation_mode='anchor')
        ax.set_yticks(range(len(laws)), [laws[i] for i in order], fontsize=8.0)
        ax.get_yticklabels()[order.index(laws.index(RECOMMENDED))].set_fontweight(
            'bold') if RECOMMENDED in laws else None
        ax.grid(visible=False)
        ax.tick_params(length=0.0)
    return Picture(
        'overview', 'Every law in every scenario',
        'Largest tracking error over the smallest in the same scenario: 1 is the best law there, '
        'grey a lost run. Laws by the geometric mean, best first; those with a lost run last.',
        'A grid of numbers, a line for each law and a column for each scenario.', figure)


def scatter(arena: Arena) -> Picture | None:
    """Return max|x̃| against total variation, one panel a scenario; None where all are lost.

    Laws are named beside their mark, all where they are `FEW`, else where no other has less of
    both; the others are small marks.
    """
    names = [name for name in arena.plan.scenarios
             if any(not cell.lost for cell in arena.column(name).values())]
    if not names:
        return None
    columns = min(3, len(names))
    lines = math.ceil(len(names) / columns)
    with styled():
        figure = new_figure(3.6 * columns + 0.6, 2.8 * lines + 0.6)
        axes = np.atleast_1d(figure.subplots(lines, columns)).ravel()
        for ax, name in zip(axes, names, strict=False):
            _panel(ax, arena, name)
        for ax in axes[len(names):]:
            ax.set_visible(False)
        figure.supxlabel('total variation of v per second  [1/s]', fontsize=9.0)
        figure.supylabel(r'max $|\tilde{x}|$  [1]', fontsize=9.0)
    return Picture(
        'error_effort', 'Error against effort',
        f'Largest tracking error in the last {window_length(arena.plan.duration):g} s against the '
        'total variation of the command, both logarithmic: left and low is good, right is chatter '
        f'or noise passed on. Filled: {RECOMMENDED}. Named, of many: where no other law has less '
        'of both; small marks: the others. Bars: smallest to largest over seeds or pulses. '
        'Dashed: |x̃| of Ω_ε, the same for all. Lost runs are left out.',
        'One panel a scenario, one mark a law.', figure)


def _panel(ax: Any, arena: Arena, scenario: str) -> None:
    """Draw one scenario."""
    points: dict[str, tuple[float, float]] = {}
    for name, cell in arena.column(scenario).items():
        x, y = cell.values('v_variation'), cell.values('error_max')
        if cell.lost or not x or not y or min(x) <= 0.0 or min(y) <= 0.0:
            continue
        points[name] = sum(x) / len(x), sum(y) / len(y)
        own = name == RECOMMENDED
        if len(x) > 1:
            ax.errorbar(*points[name], xerr=_reach(points[name][0], x),
                        yerr=_reach(points[name][1], y), fmt='none', capsize=1.5, lw=0.7,
                        ecolor=BLUE if own else GREY)
        ax.plot(*points[name], 'o', ms=6.0 if own else 3.5, mec=BLUE if own else RED, mew=0.9,
                mfc=BLUE if own else 'white', gid=name, zorder=3.0)
    ax.axhline(yardstick()[0], color=GREY, lw=0.8, ls=(0, (4, 2)))
    ax.set(title=scenario, xscale='log', yscale='log')
    ax.margins(y=0.12)
    if points:
        _ticks(ax, [x for x, _ in points.values()])
    _name(ax, points)


def _name(ax: Any, points: Mapping[str, tuple[float, float]]) -> None:
    """Name marks beside them, where no other name or mark is: all where they are few."""
    named = points if len(points) <= FEW else unbeaten(points) | ({RECOMMENDED} & set(points))
    scale = 72.0 / ax.figure.dpi
    at = {name: scale * ax.transData.transform(point) for name, point in points.items()}
    taken = [(x - 2.0, y - 2.0, x + 2.0, y + 2.0) for x, y in at.values()]
    for name in sorted(named, key=lambda name: points[name]):
        wide, high = 0.56 * SIZE * len(name), SIZE
        boxes = []
        for right, up in ((5.0, 3.0), (5.0, -10.0), (5.0, -3.0), (-5.0 - wide, -3.0), (5.0, 13.0),
                          (5.0, -19.0), (5.0, 21.0)):
            x, y = at[name][0] + right, at[name][1] + up
            boxes.append((right, up, (x, y, x + wide, y + high)))
        right, up, box = min(boxes, key=lambda item: sum(_overlap(item[2], other)
                                                         for other in taken))
        taken.append(box)
        ax.annotate(name, points[name], (right, up), textcoords='offset points', fontsize=SIZE,
                    color=BLUE if name == RECOMMENDED else BLACK, annotation_clip=False)


def _overlap(one: Sequence[float], other: Sequence[float]) -> float:
    """Return the area that two boxes (left, low, right, high) share."""
    return (max(0.0, min(one[2], other[2]) - max(one[0], other[0]))
            * max(0.0, min(one[3], other[3]) - max(one[1], other[1])))


def _ticks(ax: Any, x: Sequence[float]) -> None:
    """Scale the horizontal axis to values and room for names, with plain numbers at its ticks."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    middle = math.sqrt(min(x) * max(x))
    half = max(1.6 * math.sqrt(max(x) / min(x)), WIDTH)
    ax.set_xlim(middle / half, middle * half * 1.3)
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0,) if half > 10.0 else (1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f'{value:g}'))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_minor_formatter(NullFormatter())


def unbeaten(points: Mapping[str, tuple[float, float]]) -> set[str]:
    """Return the names to which no other point is smaller in both numbers."""
    return {name for name, (x, y) in points.items()
            if not any(other[0] < x and other[1] < y for other in points.values())}


def _reach(middle: float, values: Sequence[float]) -> list[list[float]]:
    """Return how far values go below and above their mean, as error bars want it."""
    return [[max(middle - min(values), 0.0)], [max(max(values) - middle, 0.0)]]


def best_and_worst(arena: Arena) -> Picture | None:
    """Return v of the entrants with the smallest and the largest error, in the window.

    Of the first scenario; a run that was lost has no picture. None with fewer than two entrants.
    """
    scenario = next(iter(arena.plan.scenarios))
    order = [name for name in arena.ranking(scenario)
             if not arena.cells[name, scenario].lost]
    if len(order) < 2:
        return None
    flats = arena.plan.configurations()
    keep_compiled()
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

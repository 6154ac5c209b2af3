# SPDX-License-Identifier: Apache-2.0
"""Pictures of a run's timing: how long periods and answers took."""

from __future__ import annotations

from typing import Any

import numpy as np

from dz_ros.core.lateness import LATE_TEXT
from dz_ros.core.percentiles import percentile
from dz_ros.report.style import BLUE, GREY, new_figure, Picture, RED, styled
from dz_ros.report.view import View
from dz_ros.runs.timing import Spread, Timing, TopicTiming

BINS = 60
MARKS = {'p50': '-', 'p99': '--', 'max': ':'}
"""Marks of a histogram and how they are drawn."""
LATENCIES = (
    ('publish', 'state → command, publish to publish'),
    ('log', 'state → command, as recorded'),
    ('hold', 'controller held the state'),
    ('transport', 'transport, both ways'),
    ('round_trip', 'round trip at the plant'),
)
"""Latencies in the order of preference, with their titles."""


def shown_latencies(timing: Timing) -> list[tuple[str, str, Spread]]:
    """Return (key, title, spread) of the latencies to show.

    Publish to publish takes the place of the recorder's view, in which the command may come
    before the state that it answers.
    """
    return [(key, title, timing.latencies[key]) for key, title in LATENCIES
            if key in timing.latencies
            and not (key == 'log' and 'publish' in timing.latencies)]


def backwards(found: list[tuple[str, str, Spread]]) -> str:
    """Return why latencies are below zero, '' where none is."""
    log = next((spread for key, _, spread in found if key == 'log'), None)
    count = 0 if log is None else int(np.count_nonzero(log.values < 0.0))
    return '' if not count else (
        f' As recorded {count} are below zero: there the recorder received the command before the '
        'state, and the run has no publish times.')


def milliseconds(seconds: float | None) -> str:
    """Return a duration in ms for a sentence."""
    return 'unknown' if seconds is None else f'{1e3 * seconds:.3f} ms'


def _reach(spreads: list[Spread], centre: float) -> float:
    """Return how far from the centre [ms] to draw: one outlier must not squeeze the rest."""
    return 1.6 * max(percentile(np.sort(np.abs(1e3 * spread.values - centre)), 0.999)
                     for spread in spreads)


def _histogram(ax: Any, spread: Spread, name: str, low: float, high: float) -> None:
    """Draw durations [ms] on a logarithmic count; what lies beyond is counted, not drawn."""
    values = 1e3 * spread.values
    ax.hist(values, bins=np.linspace(low, high, BINS + 1), color=BLUE, log=True, gid=name)
    for label, value, dash in zip(MARKS, (spread.p50, spread.p99, spread.maximum),
                                  MARKS.values(), strict=True):
        if low <= 1e3 * value <= high:
            ax.axvline(1e3 * value, color=RED, lw=1.0, ls=dash, gid=f'{name}_{label}')
    beyond = int(np.count_nonzero((values < low) | (values > high)))
    if beyond:
        ax.text(0.99, 0.97, f'{beyond} beyond', transform=ax.transAxes, ha='right', va='top',
                color=GREY, fontsize=8)
    ax.set_xlim(low, high)
    ax.set_ylim(bottom=0.7)


def _grid(count: int) -> tuple[Any, Any]:
    """Return a figure of two columns and its axes; the spare one stays empty."""
    from matplotlib.lines import Line2D
    figure = new_figure(8.0, 2.2 * ((count + 1) // 2) + 0.2)
    grid = figure.subplots((count + 1) // 2, 2, squeeze=False).ravel()
    for ax in grid[count:]:
        ax.set_axis_off()
    figure.supylabel('messages', fontsize=9)
    figure.legend(handles=[Line2D([], [], color=RED, lw=1.0, ls=dash, label=label)
                           for label, dash in MARKS.items()], loc='outside lower right', ncols=3)
    return figure, grid


def _topic_title(name: str, topic: TopicTiming) -> str:
    """Return two lines: what, and the numbers."""
    late = '' if topic.late is None else f', late {topic.late}, too late {topic.too_late}'
    off = topic.deviation
    spread = '' if off is None else (
        f'|period − T| p99 {milliseconds(off.p99)}, max {milliseconds(off.maximum)}\n')
    return f'{name}: {spread}missing {topic.sequence.missing}{late}'


def periods(view: View, name: str = 'periods') -> Picture | None:
    """Return the histograms of the periods of every topic that was timed."""
    timing = view.timing
    timed = [(key, topic) for key, topic in timing.topics.items()
             if topic.period is not None and topic.deviation is not None]
    if not timed:
        return None
    with styled():
        figure, grid = _grid(len(timed))
        centre = 1e3 * (timing.period or 0.0)
        reach = max(_reach([topic.period for _, topic in timed if topic.period], centre), 0.5)
        for ax, (key, topic) in zip(grid, timed, strict=False):
            if topic.period is not None:
                _histogram(ax, topic.period, key, max(centre - reach, 0.0), centre + reach)
            ax.set_title(_topic_title(key, topic), fontsize=8.5)
            ax.set_xlabel('period  [ms]')
    worst = min((topic.within for _, topic in timed if topic.within is not None), default=None)
    share = '' if worst is None else (
        f' At least {100.0 * worst:.4g} % of the periods of every topic lie within '
        f'{LATE_TEXT} of T.')
    return Picture(name, 'Periods', f'T = {milliseconds(timing.period)}.{share}',
                   'Histograms of the periods of each topic.', figure)


def latencies(view: View, name: str = 'latencies') -> Picture | None:
    """Return the histograms of how long answers took."""
    found = shown_latencies(view.timing)
    if not found or not view.timing.judged:
        return None
    with styled():
        figure, grid = _grid(len(found))
        high = max(_reach([spread for _, _, spread in found], 0.0), 0.2)
        low = min(0.0, *(1e3 * spread.at(0.001) for _, _, spread in found))
        for ax, (key, title, spread) in zip(grid, found, strict=False):
            _histogram(ax, spread, key, low, high)
            ax.set_title(f'{title}\np50 {milliseconds(spread.p50)}, p99 '
                         f'{milliseconds(spread.p99)}, max {milliseconds(spread.maximum)}',
                         fontsize=8.5)
            ax.set_xlabel('latency  [ms]')
    late = view.timing.samples_late
    whole = sum(late.values())
    caption = backwards(found) + ('' if not whole else (
        f' The newest command was that of the sample before in {late.get(0, 0)} of {whole} '
        'samples.'))
    return Picture(name, 'Latency of the answer',
                   'How long a state waited for its command, by every clock there is.' + caption,
                   'Histograms of the latency from state to command.', figure)

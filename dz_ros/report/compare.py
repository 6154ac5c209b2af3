# SPDX-License-Identifier: Apache-2.0
"""Runs side by side: their metrics in one table, x̃, v and s/ε in one picture each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.dataset import RunData
from dz_ros.core.text import plain
from dz_ros.errors import ConfigurationError
from dz_ros.report import page, sections
from dz_ros.report.report import write_files
from dz_ros.report.style import (
    axis_label,
    CYCLE,
    fit_y,
    GREY,
    line,
    mark_gaps,
    new_figure,
    Picture,
    styled,
)
from dz_ros.report.view import View
from dz_ros.runs.axes import axis_name

Array = NDArray[np.float64]

PAGE = 'comparison.html'
"""File name of the page."""
QUANTITIES: tuple[tuple[str, str, str, str, Callable[[View], Array]], ...] = (
    ('error', 'Tracking error', r'$\tilde{x}$', 'x', lambda view: view.rows.error[:, 0]),
    ('command', 'Command', '$v$', 'v', lambda view: view.rows.v),
    ('layer', 'Filtered error over ε', r'$s/\varepsilon$', '1',
     lambda view: view.s / view.epsilon),
)
"""What is laid over each other: name, title, symbol, unit, values."""


@dataclass(frozen=True)
class Comparison:
    """Runs side by side.

    Attributes:
        views: Name → run, looked at, in the order given.
    """

    views: Mapping[str, View]

    def rows(self) -> list[list[str]]:
        """Return label and one text a run for every metric any run has, units included."""
        return [row[:-1] for row in sections.metric_rows(list(self.views.values()))]

    def to_dict(self) -> dict[str, Any]:
        """Return name → the run's numbers, ready for JSON."""
        return {name: view.to_dict() for name, view in self.views.items()}

    def differences(self) -> list[list[str]]:
        """Return key and one text a run for every key of the configurations that differs."""
        flats = [view.setting.flat for view in self.views.values()]
        keys = sorted({key for flat in flats for key in flat})
        texts = [[key, *(str(flat.get(key, '–')) for flat in flats)] for key in keys]
        return [row for row in texts if len(set(row[1:])) > 1]


def compare(runs: Mapping[str, RunData], *, window: tuple[float, float] | None = None,
            pulse: float | None = None, tolerance: float | None = None) -> Comparison:
    """Return at least two runs side by side; the arguments are those of `View.of`.

    `tolerance` is that of the first run where none is given, the same for all of them; of runs of
    different axes, whose units and ranges differ, that of the first run of each axis.

    Raises:
        ConfigurationError: Fewer than two runs, or a window that is not one in each of them.
        RecordingError: A run has no two states.
    """
    if len(runs) < 2:
        raise ConfigurationError('runs', list(runs), 'must be at least two to compare')
    several = len({axis_name(run) for run in runs.values()} - {''}) > 1
    views: dict[str, View] = {}
    first: dict[str, float] = {}
    for name, run in runs.items():
        axis = axis_name(run) if several else ''
        views[name] = View.of(run, window=window, pulse=pulse, tolerance=(
            first.get(axis) if tolerance is None else tolerance))
        first.setdefault(axis, views[name].metrics.tolerance)
    return Comparison(views)


def overlaid(comparison: Comparison) -> list[Picture]:
    """Return one picture for each of x̃, v and s/ε there is data for, every run a line."""
    found = []
    for name, title, symbol, unit, values in QUANTITIES:
        lines = {label: (view, values(view)) for label, view in comparison.views.items()}
        lines = {label: item for label, item in lines.items() if np.isfinite(item[1]).any()}
        if not lines:
            continue
        units = {view.setting.unit(unit) for view, _ in lines.values()}
        with styled():
            figure = _draw(name, axis_label(symbol, units.pop() if len(units) == 1 else ''), lines,
                           list(comparison.views))
        missing = [label for label in comparison.views if label not in lines]
        caption = f'{title} of {", ".join(lines)}.' + (
            f' Without it: {", ".join(missing)}.' if missing else '')
        found.append(Picture(f'compare_{name}', title, caption,
                             f'{title} over time, one line for each run.', figure))
    return found


def _draw(name: str, label: str, lines: Mapping[str, tuple[View, Array]],
          order: list[str]) -> Any:
    """Return a figure of whole runs above, windows below; each run keeps its colour."""
    views = [view for view, _ in lines.values()]
    whole = (min(float(view.rows.t[0]) for view in views),
             max(float(view.rows.t[-1]) for view in views))
    window = (min(view.metrics.window[0] for view in views),
              max(view.metrics.window[1] for view in views))
    figure = new_figure(8.0, 4.9)
    axes = figure.subplots(2, 1)
    for ax, title, (low, high) in zip(axes, ('whole runs', 'windows'), (whole, window),
                                      strict=True):
        drawn = []
        restless = sorted(lines, key=lambda key: -float(np.nansum(np.abs(np.diff(lines[key][1])))))
        for key, (view, y) in lines.items():
            t, place = view.rows.t, order.index(key)
            shown = (t >= low - 1e-9) & (t <= high + 1e-9)
            # Smooth lines lie over restless ones, which would hide them.
            line(ax, t[shown], y[shown], key, color=CYCLE[place % len(CYCLE)], label=plain(key),
                 lw=1.0, ls='-' if place < len(CYCLE) else '--',
                 zorder=2.0 + 0.01 * restless.index(key))
            mark_gaps(ax, t, view.setting.period)
            drawn.append(y[shown])
        if name == 'layer':
            for edge in (-1.0, 1.0):
                ax.axhline(edge, color=GREY, lw=0.8, ls=(0, (4, 2)), gid='layer')
        linear = 1.0 if name == 'layer' else _smallest_reach(drawn)
        if (name == 'layer' and ax is axes[0]) or (name == 'error' and ax is axes[1] and linear):
            ax.set_yscale('symlog', linthresh=linear)
        else:
            fit_y(ax, *drawn)
        ax.set(title=title, xlim=(low - 0.01 * (high - low), high + 0.01 * (high - low)),
               ylabel=label)
    axes[1].set_xlabel('time  [s]')
    handles = [item for item in axes[0].lines if item.get_gid() in lines]
    figure.legend(handles=handles, loc='outside upper right', ncols=min(4, len(handles)))
    return figure


def _smallest_reach(drawn: list[Array], ratio: float = 8.0) -> float:
    """Return the decade below the smallest line where the lines' sizes differ much, else 0."""
    reaches = [float(np.nanmax(np.abs(y))) for y in drawn if np.isfinite(y).any()]
    if not reaches or min(reaches) <= 0.0 or max(reaches) < ratio * min(reaches):
        return 0.0
    return float(10.0 ** np.floor(np.log10(min(reaches))))


def write_comparison(comparison: Comparison, out: Path, *, title: str = 'Comparison') -> Path:
    """Write one self-contained page and its pictures; return the path of the page.

    An older comparison in the directory `out` is replaced.

    Raises:
        ConfigurationError: `out` cannot be written.
        MissingDependencyError: matplotlib is not installed.
    """
    drawn = [(picture, picture.png()) for picture in overlaid(comparison)]
    names = list(comparison.views)
    table = page.table(
        ['quantity', *names, 'what it is'],
        [['window', *('{:.4g} to {:.4g} s'.format(*view.metrics.window)
                      for view in comparison.views.values()), 'what the numbers are about'],
         *sections.metric_rows(list(comparison.views.values()))], numbers=range(1, 1 + len(names)))
    lead = ''.join(page.paragraph(f'{name}: {sections.one_line(view)}', 'soft')
                   for name, view in comparison.views.items())
    differing = comparison.differences()
    html = page.page(title, lead, [
        ('Numbers', table + page.paragraph('– where a run has no data for it.', 'soft')),
        ('Pictures', ''.join(page.image(picture, data) for picture, data in drawn)),
        ('What differs', page.table(['key', *names], differing) if differing else
         page.paragraph('The configurations are the same.')),
    ])
    files = {f'{picture.name}.png': data for picture, data in drawn}
    write_files(out, {**files, PAGE: html.encode()},
                [f'compare_{item[0]}.png' for item in QUANTITIES
                 if f'compare_{item[0]}.png' not in files])
    return out / PAGE

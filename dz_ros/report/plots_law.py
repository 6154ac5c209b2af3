# SPDX-License-Identifier: Apache-2.0
"""Pictures of what goes on inside the law and the actuator: parts of v, estimates, dead-zone."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.signals import Role, Signal
from dz_ros.core.text import plain
from dz_ros.report.plots import name_axis, number, panels
from dz_ros.report.style import (
    axis_label,
    BLACK,
    BLUE,
    CYCLE,
    GREEN,
    GREY,
    legend,
    line,
    mark_gaps,
    mathtext,
    new_figure,
    ORANGE,
    Picture,
    RED,
    styled,
)
from dz_ros.report.view import View
from dz_ros.runs.metrics import while_active

Array = NDArray[np.float64]

MOST_PANELS, SHORT = 40, 60
"""Signals that get a panel of their own at most, and letters of their names: a recording may hold
any number of any length."""
PART_COLOURS = (BLUE, GREEN, ORANGE, RED, *CYCLE[4:])
"""Colours of the terms of v, in their order."""


def parts(view: View, name: str = 'parts') -> Picture | None:
    """Return the parts whose sum is v (14), over time."""
    rows = view.rows
    terms = [item for item in view.terms if item.role is Role.TERM]
    drawn = [(item, colour) for item, colour in zip(terms, cycle(PART_COLOURS), strict=False)
             if np.nan_to_num(rows.terms[item.name]).any()]
    if not drawn:
        return None
    with styled():
        figure, found = panels(view)
        for ax, shown in found:
            line(ax, rows.t[shown], rows.v[shown], 'command', color=BLACK, lw=0.8, label='$v$')
            for item, colour in drawn:
                y = rows.terms[item.name][shown]
                # Smooth lines lie over restless ones, which would hide them.
                restless = float(np.nansum(np.abs(np.diff(y))))
                line(ax, rows.t[shown], y, item.name, color=colour, label=item.label,
                     zorder=2.0 + 1.0 / (1.0 + restless))
        name_axis(found, axis_label('parts of $v$', view.setting.unit('v')))
        legend(found[0][0])
    names = ', '.join(item.label for item, _ in drawn)
    return Picture(name, 'Parts of the command', f'v (thin line) is the sum of: {names}.',
                   f'The command over time and its parts: {names}.', figure)


def signal_label(signal: Signal) -> str:
    """Return the mathtext of a signal's symbol, or its name as plain text."""
    return mathtext(signal.symbol) if signal.symbol else plain(signal.label, SHORT)


def estimates(view: View, name: str = 'estimates') -> Picture | None:
    """Return θ̂, φ̂ with their true values dashed where known; other signals in panels below.

    What is no estimate, since the law was inactive, is not drawn.
    """
    view = replace(view, rows=while_active(view.rows))
    rows = view.rows
    known = [item for item in view.signals if np.isfinite(rows.terms[item.name]).any()]
    estimated = [item for item in known if item.role is Role.ESTIMATE]
    others = [item for item in known if item not in estimated][:MOST_PANELS]
    groups = _alike(view, estimated) + [[item] for item in others]
    if not groups:
        return None
    travel = _travel(view, known)
    with_start = travel < 0.25 * rows.duration
    with styled():
        figure = new_figure(8.0, 2.6 + 1.5 * (len(groups) - 1))
        grid = figure.subplots(len(groups), 2 if with_start else 1, squeeze=False, sharex='col',
                               sharey='row', width_ratios=[1.0, 1.7] if with_start else None)
        for axes, group in zip(grid, groups, strict=True):
            for ax in axes:
                _signals(ax, view, group)
            symbol = 'estimate' if group[0] in estimated else signal_label(group[0])
            axes[0].set_ylabel(axis_label(symbol, view.setting.unit(group[0].unit)))
        for ax, span in zip(grid[0], (travel, rows.duration)[-len(grid[0]):], strict=True):
            ax.set_title(f'start, {span:.3g} s' if span < rows.duration else
                         f'whole run, {span:.4g} s')
            ax.set_xlim(rows.t[0] - 0.01 * span, rows.t[0] + 1.01 * span)
        for axes in grid:
            legend(axes[-1], columns=8)
        for ax in grid[-1]:
            ax.set_xlabel('time  [s]')
    dashed = ' Dashed: the true values a_i/(b m) and 1/(b m) of the simulated plant.' \
        if estimated and view.setting.true_signals else ''
    last = ', '.join(
        f'{item.name} = {number(_last(rows.terms[item.name]), view.setting.unit(item.unit))}'
        for item in estimated)
    return Picture(name, 'Estimates', (f'At the end {last}. ' if last else '') +
                   'Estimates need not reach the true values for x̃ to be small.' + dashed,
                   'Estimates of the law over time.', figure)


def _alike(view: View, signals: list[Signal], ratio: float = 6.0) -> list[list[Signal]]:
    """Return the estimates in groups of one unit whose sizes differ by no more than a ratio."""
    sizes = {item: max(float(np.nanmax(np.abs(view.rows.terms[item.name]))),
                       *view.setting.true_signals.get(item.name, ()), 1e-300) for item in signals}
    groups: list[list[Signal]] = []
    for signal in signals:
        for group in groups:
            both = [sizes[item] for item in (*group, signal)]
            if max(both) <= ratio * min(both) and (view.setting.unit(group[0].unit)
                                                   == view.setting.unit(signal.unit)):
                group.append(signal)
                break
        else:
            groups.append([signal])
    return groups


def _travel(view: View, signals: list[Signal]) -> float:
    """Return twice the time in which signals make 99 % of their changes [s]."""
    rows = view.rows
    total = np.zeros(len(rows.t) - 1)
    for item in signals:
        steps = np.abs(np.nan_to_num(np.diff(rows.terms[item.name])))
        total += steps / steps.sum() if steps.any() else 0.0
    made = np.cumsum(total)
    if not made[-1] > 0.0:
        return rows.duration
    place = int(np.searchsorted(made, 0.99 * made[-1]))
    return float(max(2.0 * (rows.t[place + 1] - rows.t[0]), 0.02 * rows.duration))


def _signals(ax: Any, view: View, group: list[Signal]) -> None:
    """Draw signals; the dashes of true values that coincide take turns."""
    rows, count = view.rows, len(group)
    for place, signal in enumerate(group):
        colour, key = CYCLE[place % len(CYCLE)], signal.name
        line(ax, rows.t, rows.terms[key], key, color=colour, label=signal_label(signal))
        for value in view.setting.true_signals.get(key, ()):
            ax.axhline(value, color=colour, lw=1.1, gid=f'{key}_true',
                       ls=(5 * place, (5, max(5 * (count - 1), 3))))
    mark_gaps(ax, rows.t, view.setting.period)


def _last(values: Array) -> float:
    """Return the last value that is a number."""
    return float(values[np.isfinite(values)][-1])


def applied_command(view: View) -> tuple[Array, str]:
    """Return what the actuator held, (w − d)/m by (2), and its label; m·v if m is unknown."""
    rows, configuration = view.rows, view.setting.configuration
    scaled = rows.truth['w'] - rows.truth['d']
    if configuration is None:
        return scaled, r'$m\,v = w - d$'
    zone = configuration.dead_zone
    slopes = [zone.history(name, rows.t, configuration.loop.schedule) for name in ('m_r', 'm_l')]
    return scaled / np.where(scaled >= 0.0, *slopes), '$v$, held by the actuator'


def dead_zone(view: View, name: str = 'dead_zone') -> Picture | None:
    """Return true w against v, coloured by time: the whole run and the band itself."""
    rows = view.rows
    if not {'w', 'd'} <= set(rows.truth) or not np.isfinite(rows.truth['w']).any():
        return None
    v, label = applied_command(view)
    w, unit = rows.truth['w'], view.setting.unit('v')
    configuration = view.setting.configuration
    zone = configuration.dead_zone if configuration is not None else None
    near = 1.0 if zone is None else 2.5 * max(zone.b_r, -zone.b_l, 0.1)
    step = max(1, len(v) // 20000)
    with styled():
        figure = new_figure(8.0, 3.7)
        axes = figure.subplots(1, 2)
        for ax, title in zip(axes, ('whole run', 'the band itself'), strict=True):
            ax.axhline(0.0, color=GREY, lw=0.6, zorder=1)
            ax.axvline(0.0, color=GREY, lw=0.6, zorder=1)
            points = ax.scatter(v[::step], w[::step], c=rows.t[::step], s=5, lw=0, cmap='viridis',
                                gid='dead_zone', zorder=3)
            ax.set_title(title)
            ax.set_xlabel(axis_label(label, unit))
        if zone is not None:
            for edge in (zone.b_l, zone.b_r):
                axes[1].axvline(edge, color=RED, lw=0.9, ls=(0, (4, 2)), zorder=2, gid='edge')
        axes[0].set_ylabel(axis_label('$w = D(v)$', unit))
        axes[1].set(xlim=(-near, near), ylim=(-near, near))
        bar = figure.colorbar(points, ax=axes, shrink=0.9, pad=0.02)
        bar.set_label('time  [s]')
        bar.outline.set_linewidth(0.5)
    caption = 'True output of the dead-zone against what the actuator held.'
    if configuration is not None and zone is not None:
        caption += f' Dashed: break points b_l = {zone.b_l:g}, b_r = {zone.b_r:g}'
        caption += (' (mean; they drift or follow another variable).'
                    if configuration.zone_numbers[0] else '.')
    return Picture(name, "The dead-zone's shape", caption,
                   'Scatter plot of w against v, flat between the break points.', figure)

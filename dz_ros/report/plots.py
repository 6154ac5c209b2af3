# SPDX-License-Identifier: Apache-2.0
"""The pictures of a run over time, after figures 2–6 of the paper.

Each function returns a `Picture`, or None where the run has no data for it. Panels: the whole run,
its start where it is much longer, and the window at its end, each with a scale of its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.tracking import guaranteed_bounds
from dz_ros.report.style import (
    axis_label,
    BLUE,
    derivative,
    fit_y,
    legend,
    line,
    mark_gaps,
    new_figure,
    ORANGE,
    PALE,
    Picture,
    RED,
    styled,
)
from dz_ros.report.view import View

Array = NDArray[np.float64]
Panel = tuple[Any, NDArray[np.bool_]]

ERROR = r'$\tilde{x} = x - x_d$'


def start_of(view: View) -> float:
    """Return how long the start of a run takes that deserves a panel of its own [s]."""
    settled = view.metrics.settling_time
    if settled is None:
        return 5.0
    return min(max(1.25 * (settled - float(view.rows.t[0])), 2.0), 10.0)


def panels(view: View) -> tuple[Any, list[Panel]]:
    """Return a figure and its axes over time, each with its rows; the window comes last."""
    t = view.rows.t
    begin, end = view.metrics.window
    first, last = float(t[0]), float(t[-1])
    span = start_of(view)
    with_start = span < 0.6 * (last - first)
    figure = new_figure(8.0, 4.6)
    axes = figure.subplot_mosaic([['whole', 'whole'], ['start' if with_start else 'window',
                                                       'window']], width_ratios=[1.0, 1.7])
    shown = [('whole', f'whole run, {last - first:.4g} s', first, last)]
    if with_start:
        shown.append(('start', f'start, {span:.3g} s', first, first + span))
    shown.append(('window', f'window, {begin:.4g} to {end:.4g} s', begin, end))
    found = []
    for key, title, low, high in shown:
        ax = axes[key]
        ax.set_title(title)
        margin = 0.01 * (high - low)
        ax.set_xlim(low - margin, high + margin)
        mark_gaps(ax, t, view.setting.period)
        if key != 'whole':
            ax.set_xlabel('time  [s]')
        found.append((ax, (t >= low - 1e-9) & (t <= high + 1e-9)))
    return figure, found


def name_axis(found: list[Panel], label: str) -> None:
    """Name the vertical axis of the panels at the left edge."""
    for ax, _ in (found if len(found) < 3 else found[:2]):
        ax.set_ylabel(label)


def number(value: float | None, unit: str = '') -> str:
    """Return a number for a sentence: four digits and its unit."""
    if value is None:
        return 'unknown'
    return f'{value:.4g}' + (f' {unit}' if unit not in ('', '1') else '')


def tracking(view: View, name: str = 'tracking') -> Picture | None:
    """Return x and x_d over time (the paper's Fig. 2)."""
    rows, settled = view.rows, view.metrics.settling_time
    unit = view.setting.unit('x')
    with styled():
        figure, found = panels(view)
        for ax, shown in found:
            line(ax, rows.t[shown], rows.x[shown, 0], 'x', color=BLUE, label='$x$, measured')
            line(ax, rows.t[shown], rows.x_d[shown, 0], 'x_d', color=ORANGE, ls=(0, (4, 2)),
                 label='$x_d$, desired')
        name_axis(found, axis_label('$x$', unit))
        legend(found[0][0])
    within = f'within {number(view.metrics.tolerance, unit)} of the desired motion'
    when = f'{within} for good after {number(settled, "s")}' if settled is not None else (
        f'never {within} for good')
    return Picture(name, 'Tracking', f'Measured output and desired motion: {when}.',
                   'Two lines over time: the measured output x and the desired motion x_d.',
                   figure)


def error(view: View, name: str = 'error', beside: View | None = None) -> Picture | None:
    """Return x̃ over time (Fig. 3; without dead-zone Fig. 5), `beside` another run in grey."""
    rows, m, setting = view.rows, view.metrics, view.setting
    if not np.isfinite(rows.error[:, 0]).any():
        return None
    bounds = omega(view)
    bound = None if bounds is None else bounds[0]
    with styled():
        figure, found = panels(view)
        for place, (ax, shown) in enumerate(found):
            other = _behind(ax, beside, 'error')
            line(ax, rows.t[shown], rows.error[shown, 0], 'error', color=BLUE, label=ERROR)
            ax.axhline(0.0, color=PALE, lw=0.6)
            fit_y(ax, rows.error[shown, 0], other)
            if place == len(found) - 1 and bound is not None:
                _bound(ax, bound, r'$\pm\lambda^{1-n}\varepsilon$')
                fit_y(ax, rows.error[shown, 0], other, include=(bound, -bound))
                ax.legend(handles=ax.lines[-2:-1], loc='lower right',
                          bbox_to_anchor=(1.0, 1.015))
        name_axis(found, axis_label(r'$\tilde{x}$', setting.unit('x')))
        legend(found[0][0])
    within = '' if bound is None else (
        f' Dashed: the bound of Ω_ε, {number(bound, setting.unit("x"))}.')
    return Picture(
        name, 'Tracking error', f'max |x̃| = {number(m.error_max, setting.unit("x"))}, RMS '
        f'{number(m.error_rms, setting.unit("x"))} in the window.{within}',
        'The tracking error over time, the whole run above and the window at its end below.',
        figure)


def omega(view: View) -> tuple[float, ...] | None:
    """Return the bounds of Ω_ε in the units of x, x', …; None where λ or ε is unknown."""
    if not view.has_layer or view.setting.lambda_ is None:
        return None
    return guaranteed_bounds(view.setting.lambda_, view.widest, view.setting.order)


def _bound(ax: Any, bound: float, label: str | None = None) -> None:
    """Draw ± a bound, dashed."""
    for sign in (1.0, -1.0):
        ax.axhline(sign * bound, color=RED, lw=0.9, ls=(0, (4, 2)), gid='bound',
                   label=label if sign > 0 else None)


def command(view: View, name: str = 'command', beside: View | None = None) -> Picture | None:
    """Return v over time (Fig. 4; without dead-zone Fig. 6), `beside` another run in grey."""
    rows, m = view.rows, view.metrics
    unit = view.setting.unit('v')
    if not np.isfinite(rows.v).any():
        return None
    with styled():
        figure, found = panels(view)
        for ax, shown in found:
            other = _behind(ax, beside, 'command')
            line(ax, rows.t[shown], rows.v[shown], 'command', color=BLUE, label='$v$')
            fit_y(ax, rows.v[shown], other)
        name_axis(found, axis_label('$v$', unit))
        legend(found[0][0])
    return Picture(
        name, 'Command', f'Command before the dead-zone: peak |v| {number(m.v_peak_run, unit)} in '
        f'the whole run, {number(m.v_peak, unit)} in the window; total variation '
        f'{number(m.v_variation, view.setting.unit("v/s"))}.',
        'The command v over time, the whole run above and the window at its end below.', figure)


def _behind(ax: Any, other: View | None, name: str) -> Array:
    """Draw another run's error or command in grey behind this one's; return what was drawn."""
    if other is None:
        return np.empty(0)
    low, high = ax.get_xlim()
    shown = (other.rows.t >= low) & (other.rows.t <= high)
    y: Array = (other.rows.error[:, 0] if name == 'error' else other.rows.v)[shown]
    line(ax, other.rows.t[shown], y, f'{name}_beside', color='#b5b5b5', lw=1.0,
         label='with dead-zone', zorder=1)
    return y


def filtered(view: View, name: str = 'filtered_error') -> Picture | None:
    """Return s inside ±ε; linear inside the layer, logarithmic outside, in the whole run."""
    rows = view.rows
    if not np.isfinite(view.s).any():
        return None
    unit = view.setting.unit('x^(n-1)')
    share = view.metrics.layer_share
    with styled():
        figure, found = panels(view)
        for place, (ax, shown) in enumerate(found):
            if view.has_layer:
                epsilon = view.epsilon[shown]
                _layer(ax, rows.t[shown], epsilon)
            line(ax, rows.t[shown], view.s[shown], 's', color=BLUE, label='$s$')
            if view.has_layer and place < len(found) - 1:
                ax.set_yscale('symlog', linthresh=view.widest, linscale=1.0)
            elif view.has_layer:
                known = epsilon[np.isfinite(epsilon)]       # none where the law was not active
                fit_y(ax, view.s[shown], include=(known.max(), -known.max()) if len(known) else ())
        name_axis(found, axis_label('$s$', unit))
        legend(found[0][0])
    idle = ' The law was not active in the window.' if view.has_layer else ''
    inside = idle if share is None else (
        f' In the window {100.0 * share:.4g} % of the samples lie inside the boundary layer, '
        f'max |s|/ε = {number(view.metrics.s_over_epsilon_max)}.')
    scale = ' The scale of the whole run is logarithmic outside the layer.' if view.has_layer \
        else ' This law has no boundary layer.'
    return Picture(name, 'Filtered error', f's = Λᵀx̃.{inside}{scale}',
                   'The filtered error s over time, with the boundary layer shaded.', figure)


def _layer(ax: Any, t: Array, epsilon: Array) -> None:
    """Shade the boundary layer and draw its edges over the data."""
    ax.fill_between(t, -epsilon, epsilon, color='#dcebf5', lw=0, zorder=0.5)
    for sign in (1.0, -1.0):
        line(ax, t, sign * epsilon, 'layer', color=RED, lw=0.9, ls=(0, (4, 2)), zorder=4,
             label=r'$\pm\varepsilon$' if sign > 0 else None)


def states(view: View, name: str = 'states') -> Picture | None:
    """Return the errors of x', …, x^(n−1) between their bounds of Ω_ε, a panel each."""
    rows, order, bounds = view.rows, view.setting.order, omega(view)
    if order < 2 or not np.isfinite(rows.error).any():
        return None
    with styled():
        figure = new_figure(8.0, 1.9 * (order - 1) + 0.3)
        grid = figure.subplots(order - 1, 2, squeeze=False, sharex='col')
        spans = ((float(rows.t[0]), float(rows.t[-1])), view.metrics.window)
        for i, axes in enumerate(grid, start=1):
            for ax, (low, high) in zip(axes, spans, strict=True):
                shown = (rows.t >= low - 1e-9) & (rows.t <= high + 1e-9)
                line(ax, rows.t[shown], rows.error[shown, i], f'error{i}', color=BLUE)
                ax.axhline(0.0, color=PALE, lw=0.6)
                fit_y(ax, rows.error[shown, i])
                if ax is axes[1] and bounds is not None:
                    _bound(ax, bounds[i])
                    fit_y(ax, rows.error[shown, i], include=(bounds[i], -bounds[i]))
                ax.set_xlim(low, high)
            symbol = derivative(r'\tilde{x}', i)
            axes[0].set_ylabel(axis_label(f'${symbol}$', view.setting.unit(f'x^({i})')))
        for ax, title in zip(grid[0], ('whole run', 'window'), strict=True):
            ax.set_title(title)
        for ax in grid[-1]:
            ax.set_xlabel('time  [s]')
    worst = ', '.join(
        f'max |x̃_{i + 1}| = {number(value, unit)}'
        f'{"" if bounds is None else f", bound {number(bounds[i], unit)}"}'
        for i, value in enumerate(view.metrics.state_error_max)
        if i and (unit := view.setting.unit(f'x^({i})')) is not None)
    dashed = '' if bounds is None else ' Dashed: the bounds of Ω_ε.'
    return Picture(name, 'Errors of the derivatives', f'In the window: {worst}.{dashed}',
                   'The errors of the derivatives of x over time.', figure)

"""Pictures of what goes on inside the law and the actuator: parts of v, estimates, dead-zone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.analysis.plots import name_axis, number, panels
from dz_ros.analysis.style import (
    axis_label,
    BLACK,
    BLUE,
    CYCLE,
    GREEN,
    GREY,
    legend,
    line,
    mark_gaps,
    new_figure,
    ORANGE,
    Picture,
    RED,
    styled,
)
from dz_ros.analysis.view import View

Array = NDArray[np.float64]

PARTS = (
    ('v_damping', 'damping', BLUE), ('v_feed_forward', 'feed-forward', GREEN),
    ('v_regressor', 'regressor', ORANGE), ('v_robust', 'robust', RED),
    ('v_extra', 'extra', CYCLE[4]),
)
"""Parts of v: term, name, colour."""


def parts(view: View, name: str = 'parts') -> Picture | None:
    """Return the parts whose sum is v (14), over time."""
    rows = view.rows
    drawn = [part for part in PARTS
             if part[0] in rows.terms and np.nan_to_num(rows.terms[part[0]]).any()]
    if not drawn:
        return None
    with styled():
        figure, found = panels(view)
        for ax, shown in found:
            line(ax, rows.t[shown], rows.v[shown], 'command', color=BLACK, lw=0.8, label='$v$')
            for key, label, colour in drawn:
                y = rows.terms[key][shown]
                # Smooth lines lie over restless ones, which would hide them.
                restless = float(np.nansum(np.abs(np.diff(y))))
                line(ax, rows.t[shown], y, key, color=colour, label=label,
                     zorder=2.0 + 1.0 / (1.0 + restless))
        name_axis(found, axis_label('parts of $v$', view.setting.unit('v')))
        legend(found[0][0])
    names = ', '.join(part[1] for part in drawn)
    return Picture(name, 'Parts of the command', f'v (black) is the sum of: {names}.',
                   f'The command over time and its parts: {names}.', figure)


def signal_label(name: str) -> str:
    """Return the mathtext of a law's signal: θ̂_i, φ̂, or its name as it is."""
    if name.startswith('theta') and name[5:].isdigit():
        return rf'$\hat{{\theta}}_{{{name[5:]}}}$'
    return r'$\hat{\varphi}$' if name == 'phi' else name.replace('_', ' ')


def estimates(view: View, name: str = 'estimates') -> Picture | None:
    """Return θ̂, φ̂ with their true values dashed where known; other signals in panels below."""
    rows = view.rows
    known = [key for key in view.signals if np.isfinite(rows.terms[key]).any()]
    estimated = [key for key in known if signal_label(key).startswith('$')]
    others = [key for key in known if key not in estimated]
    groups = _alike(view, estimated) + [[key] for key in others]
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
            axes[0].set_ylabel('estimate' if group[0] in estimated else signal_label(group[0]))
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
    last = ', '.join(f'{key} = {number(_last(rows.terms[key]))}' for key in estimated)
    return Picture(name, 'Estimates', (f'At the end {last}. ' if last else '') +
                   'Estimates need not reach the true values for x̃ to be small.' + dashed,
                   'Estimates of the law over time.', figure)


def _alike(view: View, names: list[str], ratio: float = 6.0) -> list[list[str]]:
    """Return the estimates in groups whose sizes differ by no more than a ratio, in order."""
    sizes = {name: max(float(np.nanmax(np.abs(view.rows.terms[name]))),
                       *view.setting.true_signals.get(name, ()), 1e-300) for name in names}
    groups: list[list[str]] = []
    for name in names:
        for group in groups:
            both = [sizes[item] for item in (*group, name)]
            if max(both) <= ratio * min(both):
                group.append(name)
                break
        else:
            groups.append([name])
    return groups


def _travel(view: View, names: list[str]) -> float:
    """Return twice the time in which signals make 99 % of their changes [s]."""
    rows = view.rows
    total = np.zeros(len(rows.t) - 1)
    for name in names:
        steps = np.abs(np.nan_to_num(np.diff(rows.terms[name])))
        total += steps / steps.sum() if steps.any() else 0.0
    made = np.cumsum(total)
    if not made[-1] > 0.0:
        return rows.duration
    place = int(np.searchsorted(made, 0.99 * made[-1]))
    return float(max(2.0 * (rows.t[place + 1] - rows.t[0]), 0.02 * rows.duration))


def _signals(ax: Any, view: View, group: list[str]) -> None:
    """Draw signals; the dashes of true values that coincide take turns."""
    rows, count = view.rows, len(group)
    for place, key in enumerate(group):
        colour = CYCLE[place % len(CYCLE)]
        line(ax, rows.t, rows.terms[key], key, color=colour, label=signal_label(key))
        for value in view.setting.true_signals.get(key, ()):
            ax.axhline(value, color=colour, lw=1.1, gid=f'{key}_true',
                       ls=(5 * place, (5, max(5 * (count - 1), 3))))
    mark_gaps(ax, rows.t, view.setting.period)


def _last(values: Array) -> float:
    """Return the last value that is a number."""
    return float(values[np.isfinite(values)][-1])


def applied_command(view: View) -> tuple[Array, str]:
    """Return what the actuator held, from (2), v = (w − d)/m, and its label; m·v if m is unknown.

    It may differ from the command of the same sample by delay, transport and limits.
    """
    rows, configuration = view.rows, view.setting.configuration
    scaled = rows.truth['w'] - rows.truth['d']
    if configuration is None:
        return scaled, r'$m\,v = w - d$'
    zone = configuration.dead_zone
    slopes = []
    for slope, drift in ((zone.m_r, zone.m_r_drift), (zone.m_l, zone.m_l_drift)):
        slopes.append(slope + drift[0] * np.sin(drift[1] * rows.t))
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
    if zone is not None:
        caption += f' Dashed: break points b_l = {zone.b_l:g}, b_r = {zone.b_r:g}'
        caption += ' (mean; they drift).' if zone.constants[0] else '.'
    return Picture(name, "The dead-zone's shape", caption,
                   'Scatter plot of w against v, flat between the break points.', figure)

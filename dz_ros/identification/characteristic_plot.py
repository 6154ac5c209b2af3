# SPDX-License-Identifier: Apache-2.0
"""Plot of an identified dead-zone: the characteristic, and its parameters over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.identification.estimation.bounds import Bound
from dz_ros.identification.estimation.pipeline import Identified
from dz_ros.report.style import (
    axis_label,
    BLUE,
    fit_y,
    GREY,
    legend,
    new_figure,
    PALE,
    Picture,
    RED,
    styled,
)

Array = NDArray[np.float64]

BLOCK = 0.1
"""A point of the characteristic is what is measured over this time [s]."""


def points(result: Identified, c: Configuration) -> tuple[Array, Array]:
    """Return commands and what reached the plant by measurement, w = (x^(n) + Σ a_i Y_i)/b.

    x^(n) is the slope of what was measured over a block in which the command changes little;
    where the velocity was not measured, its curvature over two blocks. There is none where the
    command changes much in every block.

    Args:
        result: The dead-zone; where it counts friction in, w does too.
        c: For b and T.
    """
    found, times, period = result.stretches, result.integrations, c.loop.period
    weights = np.append(result.a, result.disturbance)
    if result.friction_counted:
        weights[list(c.plant.friction)] = 0.0
    length = max(4, times * round(BLOCK / period))
    t = (np.arange(length) - 0.5 * (length - 1)) * period
    slope = np.linalg.pinv(np.vander(t, times + 2, increasing=True))[times] * times
    most = max(float(np.abs(item.v).max()) for item in found)
    v, w = [], []
    for item in found:
        for begin in range(0, len(item.v) - length + 1, length):
            part = slice(begin, begin + length)
            held = item.v[part]
            if np.ptp(held) > 0.1 * most:
                continue
            v.append(held.mean())
            passive = item.y[part].mean(axis=0) @ weights[:item.y.shape[1]]
            w.append((slope @ item.left[part] + passive) / c.plant.b)
    return np.array(v), np.array(w)


def draw(result: Identified, c: Configuration, breakaway: Sequence[float] = ()) -> Picture:
    """Return the picture.

    Args:
        result: The dead-zone.
        c: Units, b, T.
        breakaway: v at which motion began on each ramp.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    unit = c.plant.actuator_unit
    v, w = points(result, c)
    with styled():
        figure = new_figure(9.2, 6.4)
        grid = figure.add_gridspec(2, 2, width_ratios=(1.55, 1.0))
        ax = figure.add_subplot(grid[:, 0])
        _characteristic(ax, v, w, result, c.plant.b)
        for i, value in enumerate(breakaway):
            ax.axvline(value, ymin=0.0, ymax=0.03, color=RED, lw=0.8,
                       label='motion began' if i == 0 else None, gid='breakaway')
        ax.set_xlabel(axis_label('v', unit))
        ax.set_ylabel(axis_label('w = D(v)', unit))
        ax.set_title('Measured characteristic', pad=14.0)
        legend(ax, 2)
        for row, (names, label) in enumerate(((('b_r', 'b_l'), '|b|'),
                                              (('b·m_r', 'b·m_l'), 'm'))):
            lower = figure.add_subplot(grid[row, 1])
            scale = 1.0 if row == 0 else c.plant.b
            _over_time(lower, result, names, scale)
            lower.set_ylabel(axis_label(label, unit if row == 0 else '1'))
            lower.set_title('Break points' if row == 0 else 'Slopes', pad=14.0)
            if row:
                lower.set_xlabel('time  [s]')
            legend(lower, 2)
    b_r, b_l = result.bounds['b_r'], result.bounds['b_l']
    return Picture('characteristic', 'Dead-zone, identified',
                   f'b_r in [{b_r.low:.4g}, {b_r.high:.4g}] {unit}, b_l in [{b_l.low:.4g}, '
                   f'{b_l.high:.4g}] {unit}; points: {BLOCK:g} s of motion each.',
                   'what reached the plant over the command, with the fitted dead-zone and its '
                   'bounds; break points and slopes of each repeat over time', figure)


def _characteristic(ax: Any, v: Array, w: Array, result: Identified, b: float) -> None:
    b_r, b_l, right, left = result.bounds.values()
    most = 1.05 * max(float(np.abs(v).max(initial=0.0)), b_r.high, -b_l.low)
    x = np.linspace(-most, most, 401)

    def zone(r: float, low: float, m_r: float, m_l: float) -> Array:
        found: Array = (np.maximum(x - r, 0.0) * m_r + np.minimum(x - low, 0.0) * m_l) / b
        return found

    inner = zone(b_r.high, b_l.low, right.low, left.low)
    outer = zone(b_r.low, b_l.high, right.high, left.high)
    ax.fill_between(x, np.minimum(inner, outer), np.maximum(inner, outer), color=PALE, lw=0,
                    label='within the bounds', gid='bounds')
    if len(v):
        ax.plot(v, w, '.', ms=3.5, color=GREY, mew=0, label='measured', gid='measured')
    ax.plot(x, zone(b_r.value, b_l.value, right.value, left.value), color=BLUE, lw=1.4,
            label='mean of the repeats', gid='mean')
    fit_y(ax, inner, outer, *([np.quantile(w, [0.005, 0.995])] if len(w) else []))


def _over_time(ax: Any, result: Identified, names: Sequence[str], scale: float) -> None:
    shown = []
    for name, colour in zip(names, (BLUE, RED), strict=True):
        bound: Bound = result.bounds[name]
        sign = -1.0 if name == 'b_l' else 1.0
        values = sign * bound.values / scale
        label = name.replace('b·', '') if scale != 1.0 or 'm' in name else (
            '−b_l' if sign < 0.0 else name)
        ax.errorbar(result.times, values, yerr=2.0 * bound.noise / scale, fmt='o-', ms=3.0, lw=0.8,
                    color=colour, elinewidth=0.7, label=label)
        for end in (bound.low, bound.high):
            ax.axhline(sign * end / scale, color=colour, lw=0.8, ls='--')
            shown.append(sign * end / scale)
    fit_y(ax, np.array(shown))

# SPDX-License-Identifier: Apache-2.0
"""What the page draws beside the records: errors, bounds and bands that a configuration implies.

    error      x̃ = x − x_d
    omega      |x̃| of Ω_ε: 2^0 λ^(1−n) ε, the set that the theorem lets x̃ converge to
    s/ε        ±1 is the boundary layer
    band       the dead-zone that the estimates allow, in v. (2) and (4) bound |d/m| by ρ/m, and φ̂
               estimates 1/(b m), so with the known bounds (A4)
                   b φ̂ m_max b_l,min ≤ v ≤ b φ̂ m_max b_r,max,      b the largest one known
               a law without φ̂ has the known bounds alone (ours)
    zone       the true break points b_l(t), b_r(t) of a simulated plant
    interval   time between the publishing of a state and of the one before it

A configuration holds for the rows that were published after it was stated (ours: to the page,
unlike to an audit, a sample more or less is nothing). ε that the terms carry holds until the next
one: a sample whose terms are late, or whose law was not active, leaves Ω_ε where it was.
"""

from __future__ import annotations

from bisect import bisect_right
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.tracking import guaranteed_bounds
from dz_ros.live.columns import DERIVED, Layout
from dz_ros.runs.table import where_active

Array = NDArray[np.float64]


class Deriver:
    """Adds the derived columns to rows, batch by batch.

    Args:
        layout: The columns.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._times: list[float] = []
        self._stated: list[Configuration] = []
        self._before = (np.nan, np.nan)
        self._epsilon: tuple[Configuration | None, float] = (None, math.nan)

    def state(self, time: float, configuration: Configuration) -> None:
        """Add a configuration that holds from a time on [s since the epoch]."""
        at = bisect_right(self._times, time)
        self._times.insert(at, time)
        self._stated.insert(at, configuration)
        if len(self._times) > 1000:     # rows that old have long been worked out
            del self._times[0], self._stated[0]

    def complete(self, rows: Array) -> Array:
        """Return rows with the derived columns.

        Args:
            rows: Records' columns, shape (N, layout.base), in order.

        Returns:
            Shape (N, layout.width).
        """
        found = np.full((len(rows), self._layout.width), np.nan)
        found[:, :self._layout.base] = rows
        published = rows[:, 2]
        self._intervals(found)
        start = 0
        while start < len(rows):
            at = max(bisect_right(self._times, published[start]) - 1, 0)
            stop = len(rows)
            if at + 1 < len(self._times):
                later = np.flatnonzero(published[start:] >= self._times[at + 1])
                stop = start + max(int(later[0]), 1) if len(later) else stop
            self._span(found[start:stop], self._stated[at] if self._stated else None)
            start = stop
        return found

    def _intervals(self, rows: Array) -> None:
        """Write the time since the state before, where that is the one before."""
        seq = np.concatenate(([self._before[0]], rows[:, 0]))
        published = np.concatenate(([self._before[1]], rows[:, 2]))
        follows = np.diff(seq) == 1.0
        rows[:, self._layout.base] = np.where(follows, np.diff(published), np.nan)
        if len(rows):
            self._before = (float(rows[-1, 0]), float(rows[-1, 2]))

    def _span(self, rows: Array, c: Configuration | None) -> None:
        """Write what follows from one configuration."""
        place = {name: self._layout.base + i for i, name in enumerate(DERIVED)}
        x, x_d, s, phi, epsilon, w = (self._column(rows, name) for name in (
            'x0', 'xd0', 's', 'phi', 'epsilon', 'w'))
        if x is not None and x_d is not None:
            rows[:, place['error']] = x - x_d
        if c is None or c.plant.order != self._layout.order:
            return
        design, settings = c.law.design, c.controller_settings
        layer = None if epsilon is None else self._held(epsilon, c)
        if design is not None and design.epsilon > 0.0:     # of two runs, one may not have it
            layer = np.full(len(rows), design.epsilon) if layer is None else np.where(
                np.isnan(layer), design.epsilon, layer)
        if design is not None and layer is not None:
            if s is not None:
                status = self._column(rows, 'status')
                rows[:, place['s_over_epsilon']] = s / layer if status is None else np.where(
                    where_active(status), s / layer, np.nan)
            if design.target > 0.0 and design.epsilon > 0.0:
                unit = guaranteed_bounds(design.lambda_, 1.0, c.plant.order)[0]
                rows[:, place['omega']] = unit * layer * design.target / design.epsilon
        scale = 1.0 if phi is None else settings.b_bounds[1] * settings.m_bounds[1] * phi
        rows[:, place['band_low']] = scale * settings.b_l_bounds[0]
        rows[:, place['band_high']] = scale * settings.b_r_bounds[1]
        if w is not None:
            zone, stamp = c.dead_zone, rows[:, 1]
            for name, parameter in (('zone_low', 'b_l'), ('zone_high', 'b_r')):
                rows[:, place[name]] = zone.history(parameter, stamp, c.loop.schedule)

    def _held(self, epsilon: Array, c: Configuration) -> Array:
        """Return ε, as it was before where it is unknown or not positive; NaN = never known."""
        stated = self._epsilon[0]
        same = stated is not None and (stated is c or stated.law.gains == c.law.gains)
        before = self._epsilon[1] if same else math.nan
        known = np.concatenate(([before], np.where(epsilon > 0.0, epsilon, np.nan)))
        last = np.maximum.accumulate(np.where(np.isnan(known), 0, np.arange(len(known))))
        found = known[last]
        self._epsilon = (c, float(found[-1]))
        return found[1:]

    def _column(self, rows: Array, name: str) -> Array | None:
        """Return a column of the records, None where there is none."""
        at = self._layout.place(name)
        return None if at is None else rows[:, at]

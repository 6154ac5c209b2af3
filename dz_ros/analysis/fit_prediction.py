"""A log's segments as the plant's model predicts them, and how parameters move the prediction."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from dz_ros.analysis.fit_data import Segment, segments
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.integration import make_advance

Array = NDArray[np.float64]

STEPS = 2
"""RK4 steps in a sample interval."""


class Prediction:
    """The segments of a run, predicted for given parameters and initial states.

    Attributes:
        segments: The segments.
        order: Order n of the plant.
        measured: Measured states of each segment, shape (L + 1, n).
    """

    def __init__(self, run: RunData, c: Configuration) -> None:
        self.segments = segments(run, c)
        self.order = c.plant.order
        self._advance = make_advance(c.plant.regressors, c.plant.disturbance)
        self._rest = c.plant.extra
        self._b = c.plant.b
        self._count = c.plant.regressor_count
        self._period = c.loop.period
        self.measured = [item.x for item in self.segments]

    def __call__(self, p: Sequence[float], starts: Array) -> list[Array]:
        """Return the predicted states of each segment, shape (L + 1, n).

        Args:
            p: a_1 … a_r, b m, b_r, b_l.
            starts: Initial states, shape (G, n).
        """
        r = self._count
        plant = (self._b, *p[:r], *self._rest)
        m = p[r] / self._b
        zone = (0.0, m, m, p[r + 1], p[r + 2], *(0.0,) * 8)
        work = ([0.0] * r, *([0.0] * self.order for _ in range(4)))
        return [self._segment(item, start, plant, zone, work)
                for item, start in zip(self.segments, starts.tolist(), strict=True)]

    def _segment(self, segment: Segment, x: list[float], plant: Sequence[float],
                 zone: Sequence[float], work: tuple[list[float], ...]) -> Array:
        path = [tuple(x)]
        try:
            for pieces in segment.pieces:
                for begin, span, held in pieces:
                    steps = max(1, round(STEPS * span / self._period))
                    self._advance(x, held, begin, span / steps, steps, plant, zone, *work)
                path.append(tuple(x))
        except (OverflowError, ValueError):
            path += [(1e9,) * self.order] * (len(segment.pieces) + 1 - len(path))
        found: Array = np.clip(np.nan_to_num(np.array(path), nan=1e9), -1e9, 1e9)
        return found

    def residual(self, p: Sequence[float], starts: Array, weight: Array) -> list[Array]:
        """Return weighted measured minus predicted states of each segment, flat."""
        return [((x - found) * weight).ravel()
                for x, found in zip(self.measured, self(p, starts), strict=True)]

    def sensitivity(self, p: Array, starts: Array,
                    weight: Array) -> tuple[list[Array], list[Array]]:
        """Return d residual / d p and d residual / d start of each segment, by differences."""
        def columns(changed: Callable[[float], list[Array]], step: float) -> list[Array]:
            return [(up - down) / (2.0 * step)
                    for up, down in zip(changed(step), changed(-step), strict=True)]

        by_p, by_start = [], []
        for j in range(len(p)):
            def moved(step: float, j: int = j) -> list[Array]:
                q = p.copy()
                q[j] += step
                return self.residual(q.tolist(), starts, weight)
            by_p.append(columns(moved, 1e-5 * max(abs(p[j]), 0.1)))
        for i in range(self.order):
            def begun(step: float, i: int = i) -> list[Array]:
                other = starts.copy()
                other[:, i] += step
                return self.residual(p.tolist(), other, weight)
            by_start.append(columns(begun, 1e-5 * max(float(np.abs(starts[:, i]).max()), 0.1)))
        every = range(len(self.segments))
        return ([np.column_stack([column[g] for column in by_p]) for g in every],
                [np.column_stack([column[g] for column in by_start]) for g in every])

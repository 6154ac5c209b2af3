# SPDX-License-Identifier: Apache-2.0
"""The plant's equation over stretches of samples, integrated instead of differentiated (ours).

Over a stretch without a hole, of a second at most, the equation (6) is integrated as often as it
takes to reach what was measured. Where x^(n−1) is, once:

    x^(n−1)(t) = c_0 − Σ a_i ∫Y_i dt + b ∫D(v) dt + noise

and twice, with c_0 + c_1 t, where only x … x^(n−2) are. c is unknown in each stretch and
projected out. White noise of the measurement stays white, so that least squares weighs it right;
disturbances add to it. Y is taken of local polynomials through the measured states, past *and*
future, so that its noise is small against motion. v is held over each sample: its integrals are
exact. The disturbance of the plant's model, where it has one, stands beside the Y_i with a factor
of its own: its shape is taken from the model, not its size.

At order 2 and above `moving` takes motion alone, x' on one side of zero by a margin throughout:
how friction grows around rest is in no model. At order 1, where x is the speed, rest counts too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.errors import RecordingError
from dz_ros.identification.samples import Samples, SMOOTH

Array = NDArray[np.float64]

LONGEST, SHORTEST = 1.0, 0.15
"""Length of a stretch of motion [s]."""
PLENTY = 25
"""Fewer stretches of motion are cut half as long."""
LEAST_SAMPLES = 8
"""Samples that a stretch has at least."""
PIECES = 20
"""A run is cut into at least this number of stretches, if it is long enough."""


@dataclass(frozen=True)
class Stretch:
    """Consecutive samples.

    Attributes:
        left: What was measured last, x^(n−1) or x^(n−2), shape (L,).
        y: Y_i, and the disturbance where the model has one, shape (L, r) or (L, r + 1).
        v: Command that acts from each sample on, shape (L,).
        side: Sign of the motion; 0 = both.
        repeat: Repeat it belongs to, −1 = none.
        rows: Its first and last sample.
    """

    left: Array
    y: Array
    v: Array
    side: int
    repeat: int
    rows: tuple[int, int]


class Stack:
    """Stretches on top of each other, integrated and freed of their constants at once.

    Args:
        found: The stretches.
        period: T [s].
        times: How often to integrate, 1 or 2.
        without: Places of the Y_i to be left out.

    Attributes:
        v: Commands, shape (N,).
        side: Sign of the motion, shape (N,).
        left: What was measured, free of c, shape (N,).
        y: Integrals of the stretches' y, free of c, shape (N, r) or (N, r + 1).
        count: Number of stretches.
        owner: Number of the stretch that each sample belongs to, shape (N,).
    """

    def __init__(self, found: Sequence[Stretch], period: float, times: int,
                 without: Sequence[int] = ()) -> None:
        lengths = np.array([len(item.v) for item in found])
        self.count = len(found)
        self._times, self._period = times, period
        self._starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
        self.owner = np.repeat(np.arange(len(found)), lengths)
        self._lengths = lengths[:, np.newaxis]
        place = np.arange(len(self.owner)) - self._starts[self.owner]
        line = place - 0.5 * (lengths[self.owner] - 1.0)
        power = np.add.reduceat(line * line, self._starts)
        self._line = (line / np.sqrt(power)[self.owner])[:, np.newaxis]
        self.v = np.concatenate([item.v for item in found])
        self.side = np.array([item.side for item in found])[self.owner]
        left = np.concatenate([item.left for item in found])
        self.left = self.without_constants(left[:, np.newaxis])[:, 0]
        y = np.delete(np.concatenate([item.y for item in found]), list(without), axis=1)
        self.y = self.integral(0.5 * (y + np.vstack([y[1:], y[-1:]])))

    @property
    def edges(self) -> list[tuple[int, int]]:
        """First sample of each stretch and the first after it."""
        return list(pairwise([*self._starts.tolist(), len(self.v)]))

    def integral(self, held: Array) -> Array:
        """Return the integrals of what is held from each sample on, free of c.

        Args:
            held: Shape (N, columns).
        """
        once = self._sum(held)
        if self._times > 1:
            # Over a sample z grows evenly: its integral is T times the mean of both ends.
            following = np.vstack([once[1:], once[-1:]])
            once = self._sum(0.5 * (once + following))
        return self.without_constants(once)

    def without_constants(self, values: Array) -> Array:
        """Return values free of a constant, and of a straight line where integrated twice."""
        found = values - (np.add.reduceat(values, self._starts) / self._lengths)[self.owner]
        if self._times > 1:
            found = found - self._line * np.add.reduceat(found * self._line,
                                                         self._starts)[self.owner]
        cleared: Array = found
        return cleared

    def _sum(self, held: Array) -> Array:
        """Return T times the sum of all samples of the stretch before each."""
        before = np.cumsum(held, axis=0) - held
        found: Array = (before - before[self._starts][self.owner]) * self._period
        return found


class Cutter:
    """Stretches of samples, cut for any delay of the commands.

    Args:
        samples: Experiment or run.
        c: Model of the plant, for Y and the shape of the disturbance.
    """

    def __init__(self, samples: Samples, c: Configuration) -> None:
        self.samples = samples
        self._order, period = c.plant.order, samples.period
        self._joined = samples.joined
        half = max(2, round(SMOOTH / period))
        self._smooth = _smoothed(samples.x[:, :samples.measured], self._joined, half, self._order,
                                 period)
        # Near holes and ends there is no polynomial, but what was measured.
        states = np.where(np.isnan(self._smooth), samples.x, self._smooth) if (
            samples.measured == self._order) else self._smooth
        y = np.array([_regressors(c, t, row) for t, row in zip(
            samples.t.tolist(), states.tolist(), strict=True)])
        self._y = y if y[:, -1].any() else y[:, :-1]

    def moving(self, margin: float, delay: int = 0, least: int | None = None) -> list[Stretch]:
        """Return the stretches of motion.

        Args:
            margin: Speed that counts as motion, order 2 and above.
            delay: Samples after which a command acts.
            least: Number of stretches needed; None = what least squares takes.

        Raises:
            RecordingError: Too little motion.
        """
        known: NDArray[np.bool_] = np.asarray(np.isfinite(self._smooth).all(axis=1))
        side = np.ones(len(known))
        if self._order > 1:
            speed = self._smooth[:, 1]
            side = np.where(np.abs(speed) > margin, np.sign(speed), 0.0)
        side = np.where(known, side, 0.0)
        period = self.samples.period
        shortest = max(LEAST_SAMPLES, round(SHORTEST / period))
        found = list(self._cut(side, delay, shortest, LONGEST / period))
        if len(found) < PLENTY:
            found = list(self._cut(side, delay, shortest, 0.5 * LONGEST / period))
        least = 2 * (self._y.shape[1] + 4) if least is None else least
        if len(found) < least:
            raise RecordingError(f'nothing to identify: {len(found)} stretches of motion, longer '
                                 f'than {SHORTEST:g} s and faster than {margin:.3g}; {least} are '
                                 'needed')
        return found

    def everything(self, delay: int = 0) -> list[Stretch]:
        """Return stretches of all samples, rest and reversals too.

        Raises:
            RecordingError: Too few samples in a row.
        """
        longest = min(LONGEST / self.samples.period,
                      max(len(self._smooth) // PIECES, LEAST_SAMPLES))
        side = np.ones(len(self._smooth))
        found = list(self._cut(side, delay, LEAST_SAMPLES, longest))
        if not found:
            raise RecordingError('a plant cannot be identified: there are no '
                                 f'{LEAST_SAMPLES} states in a row')
        return found

    def _cut(self, side: Array, delay: int, shortest: int, longest: float) -> Iterator[Stretch]:
        samples, y, x = self.samples, self._y, self.samples.x[:, :self.samples.measured]
        whole = self._order == 1 or bool((side == 1.0).all())
        cuts = np.flatnonzero(~self._joined | (np.diff(side) != 0.0)
                              | (np.diff(samples.repeat) != 0)) + 1
        for low, high in pairwise([0, *cuts.tolist(), len(side)]):
            low = max(low, delay)
            if high - low < shortest or side[low] == 0.0:
                continue
            pieces = math.ceil((high - low) / longest)
            parts = np.linspace(low, high, pieces + 1).round().astype(int).tolist()
            for begin, end in pairwise(parts):
                yield Stretch(x[begin:end, -1], y[begin:end], samples.v[begin - delay:end - delay],
                              0 if whole else int(side[begin]), int(samples.repeat[begin]),
                              (begin, end - 1))


def _regressors(c: Configuration, t: float, x: list[float]) -> list[float]:
    """Return Y_i and the model's disturbance; zeros where the state is not known."""
    y = [0.0] * c.plant.regressor_count
    if any(map(math.isnan, x)):
        return [*y, 0.0]
    c.plant.regressors(x, c.plant.constants, y)
    return [*y, c.plant.disturbance(t, x, c.plant.constants)]


def _smoothed(x: Array, joined: NDArray[np.bool_], half: int, order: int,
              period: float) -> Array:
    """Return x, x' … x^(n−1), shape (K, n), by local polynomials; NaN near the ends of pieces."""
    found = np.full((len(x), order), np.nan)
    basis = np.vander(np.arange(-half, half + 1) * period, 5, increasing=True)
    value, slope = np.linalg.pinv(basis)[:2]
    edges = np.concatenate([[0], np.flatnonzero(~joined) + 1, [len(x)]])
    for low, high in pairwise(edges):
        if high - low <= 2 * half:
            continue
        inner = slice(low + half, high - half)
        for i in range(x.shape[1]):
            found[inner, i] = np.convolve(x[low:high, i], value[::-1], 'valid')
        if x.shape[1] < order:
            found[inner, -1] = np.convolve(x[low:high, -1], slope[::-1], 'valid')
    return found

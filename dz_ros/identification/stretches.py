"""The plant's equation over stretches of motion, integrated instead of differentiated (ours).

Over a stretch without a hole, of a second at most, the equation (6) is integrated as often as it
takes to reach what was measured. Where x^(n−1) is, once:

    x^(n−1)(t) = c_0 − Σ a_i ∫Y_i dt + b ∫D(v) dt + noise

and twice, with c_0 + c_1 t, where only x … x^(n−2) are. c is unknown in each stretch and projected
out. White noise of the measurement stays white, so that least squares weighs it right; what nobody
modelled (disturbances) adds to it. Y is taken of local polynomials through the measured states,
past *and* future, so that its noise is small against motion. v is held over each sample: its
integrals are exact. The disturbance of the plant's model, where it has one, stands beside the Y_i
with a factor of its own: its shape is taken from the model, not its size.

At order 2 and above only motion is used, x' on one side of zero by a margin throughout: how
friction grows around rest is nobody's model. At order 1, where x is the speed, rest counts too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.errors import RecordingError
from dz_ros.identification.session import Samples

Array = NDArray[np.float64]

LONGEST, SHORTEST = 1.0, 0.15
"""Length of a stretch [s]."""
SMOOTH = 0.05
"""Half-width of the local polynomials [s]."""


@dataclass(frozen=True)
class Stretch:
    """Consecutive samples of one motion.

    Attributes:
        left: What was measured, shape (L,).
        y: Y_i, and the disturbance where the model has one, shape (L, r) or (L, r + 1).
        v: Command that acts from each sample on, shape (L,).
        repeat: Repeat it belongs to, −1 = none.
        rows: Its first and last sample.
    """

    left: Array
    y: Array
    v: Array
    repeat: int
    rows: tuple[int, int]


class Stack:
    """Stretches on top of each other, to be integrated and freed of their constants at once.

    Args:
        found: The stretches.
        period: T [s].
        times: How often to integrate, 1 or 2.

    Attributes:
        v: Commands, shape (N,).
        left: What was measured, free of c, shape (N,).
        y: Integrals of the stretches' y, free of c, shape (N, r) or (N, r + 1).
        count: Number of stretches.
        owner: Number of the stretch that each sample belongs to, shape (N,).
    """

    def __init__(self, found: Sequence[Stretch], period: float, times: int) -> None:
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
        left = np.concatenate([item.left for item in found])
        self.left = self.without(left[:, np.newaxis])[:, 0]
        y = np.concatenate([item.y for item in found])
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
        return self.without(once)

    def without(self, values: Array) -> Array:
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


def stretches(samples: Samples, c: Configuration, margin: float, delay: int = 0) -> list[Stretch]:
    """Return the stretches of an experiment or a run.

    Args:
        samples: The run.
        c: Model of the plant, for Y and the shape of the disturbance.
        margin: Speed that counts as motion, order 2 and above.
        delay: Samples after which a command acts.

    Raises:
        RecordingError: Too little motion.
    """
    n, period, measured = c.plant.order, samples.period, samples.measured
    x = samples.x[:, :measured]
    good: NDArray[np.bool_] = np.asarray(np.isfinite(x).all(axis=1))
    joined = (np.diff(samples.seq) == 1) & good[1:] & good[:-1]
    half = max(2, round(SMOOTH / period))
    smooth = _smoothed(x, joined, half, n, period)
    known: NDArray[np.bool_] = np.asarray(np.isfinite(smooth).all(axis=1))
    side = np.ones(len(smooth))
    if n > 1:
        side = np.where(np.abs(smooth[:, 1]) > margin, np.sign(smooth[:, 1]), 0.0)
    side = np.where(known, side, 0.0)
    y = np.array([_regressors(c, t, row) for t, row in zip(samples.t.tolist(), smooth.tolist(),
                                                           strict=True)])
    if not y[:, -1].any():
        y = y[:, :-1]
    cuts = np.flatnonzero(~joined | (np.diff(side) != 0.0) | (np.diff(samples.repeat) != 0)) + 1
    edges = [0, *cuts.tolist(), len(side)]
    shortest = max(8, round(SHORTEST / period))
    found = []
    for low, high in pairwise(edges):
        low = max(low, delay)
        if high - low < shortest or side[low] == 0.0:
            continue
        pieces = math.ceil((high - low) * period / LONGEST)
        parts = np.linspace(low, high, pieces + 1).round().astype(int).tolist()
        found += [Stretch(x[begin:end, -1], y[begin:end], samples.v[begin - delay:end - delay],
                          int(samples.repeat[begin]), (begin, end - 1))
                  for begin, end in pairwise(parts)]
    least = 2 * (y.shape[1] + 4)
    if len(found) < least:
        raise RecordingError(f'nothing to identify: {len(found)} stretches of motion, longer than '
                             f'{SHORTEST:g} s and faster than {margin:.3g}; {least} are needed')
    return found


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

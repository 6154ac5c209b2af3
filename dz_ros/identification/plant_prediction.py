# SPDX-License-Identifier: Apache-2.0
"""What a configured plant predicts of a recording: simulated by its commands alone (ours).

The plant of a configuration, its dead-zone included, starts from what was measured and is driven
by the recorded commands as they arrived; nothing that is measured later corrects it. The share of
the variance of a measured state that it explains is

    1 − Σ (x_k − x̂_k)² / Σ (x_k − x̄)²

over all samples: 1 is a perfect prediction, 0 as good as the mean alone, below 0 worse. A part
begins behind each hole and, where a length is given, at the end of the part before: a long one
shows what adds up over time, a constant force above all, a short one the rest. An x^(n−1) that is
not measured begins with the slope of the samples beside the first.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.drivers.simulated import SAME_INSTANT, SimulatedActuator, SimulatedParameters
from dz_ros.errors import ConfigurationError, LoopError, RecordingError
from dz_ros.identification.estimation.consistency import check_log
from dz_ros.identification.estimation.long_simulation import constant_term, slope_at
from dz_ros.identification.estimation.physical_parameters import parameters_with
from dz_ros.identification.samples import arrivals, from_run, Samples

Array = NDArray[np.float64]

LEAST = 10
"""Samples that a part has at least."""
SEARCH = 8
"""Most simulations with derivative in a search for the constant term."""


@dataclass(frozen=True)
class Prediction:
    """Measured and predicted states, one row a sample.

    Attributes:
        t: Loop time [s], shape (K,).
        measured: x, x', … as far as measured, shape (K, m).
        predicted: The same, predicted; NaN where the plant diverged, shape (K, m).
        starts: Rows at which a part begins.
        lost: Samples beside holes, in parts too short to be predicted.
    """

    t: Array
    measured: Array
    predicted: Array
    starts: tuple[int, ...]
    lost: int

    @property
    def explained(self) -> tuple[float, ...]:
        """Share of each measured state's variance; −∞ = it diverged, NaN = it does not move."""
        span = np.ptp(self.measured, axis=0)
        moves = span > 0.0      # a variance is, by rounding, where nothing moves
        power = (self.measured / np.where(moves, span, 1.0)).var(axis=0)
        return tuple(1.0 - (rms / size) ** 2 / item if size else math.nan for rms, size, item
                     in zip(self.rms, span.tolist(), power.tolist(), strict=True))

    @property
    def rms(self) -> tuple[float, ...]:
        """RMS of the difference of each measured state [state units]; ∞ = it diverged."""
        with np.errstate(over='ignore'):
            found = np.sqrt(np.mean((self.measured - self.predicted) ** 2, axis=0))
        return tuple(item if math.isfinite(item) else math.inf for item in found.tolist())


def predict(run: RunData, c: Configuration, length: float = math.inf) -> Prediction:
    """Return what the plant of a configuration predicts of a recording.

    Args:
        run: The recording.
        c: Plant, dead-zone, loop.delay, rate.
        length: Of the parts [s].

    Raises:
        RecordingError: There are no states and commands, or they are of another plant or rate.
    """
    check_log(run, c.loop.period)
    samples = from_run(run, c)
    times, commands = arrivals(run, c, c.loop.delay)
    c = c.replace(**{'loop.delay': 0})      # counted in the times
    seq, first = np.unique(run.channels['state']['seq'], return_index=True)
    stamps = np.interp(samples.seq, seq, run.channels['state']['stamp'][first])
    parts = list(_parts(samples, length))
    if not parts:
        raise RecordingError(f'there are no {LEAST} states in a row to be predicted')
    paths = [_simulated(c, _start(samples, begin, end, c.plant.order), stamps[begin:end], times,
                        commands)[:, :samples.measured] for begin, end in parts]
    rows = np.concatenate([np.arange(begin, end) for begin, end in parts])
    starts = np.cumsum([0, *(end - begin for begin, end in parts[:-1])])
    return Prediction(stamps[rows], samples.x[rows, :samples.measured], np.concatenate(paths),
                      tuple(starts.tolist()), len(samples.seq) - len(rows))


def with_own_constant(run: RunData, c: Configuration) -> tuple[Configuration, int] | None:
    """Return the configuration whose constant term explains most of the first state.

    A constant force drifts from one recording to the next more than the rest of a plant, and over
    a long simulation nothing counts as much.

    Args:
        run: The recording.
        c: The plant.

    Returns:
        The configuration and the number i of a_i, from 1; None where the model has no such term,
        the simulation diverges, or no parameters of the model give a better one.
    """
    from scipy.optimize import least_squares

    place = constant_term(c.plant)
    if place is None:
        return None

    def other(value: float) -> Configuration:
        a = [*c.plant.a[:place], value, *c.plant.a[place + 1:]]
        return c.replace(**parameters_with(c.plant, a))

    def rest(value: Array) -> Array:
        found = predict(run, other(float(value[0])))
        return (found.predicted - found.measured)[:, 0]

    try:
        found = least_squares(rest, [c.plant.a[place]], max_nfev=SEARCH)
        return other(float(found.x[0])), place + 1
    except (ConfigurationError, ValueError):        # not allowed, or it diverged
        return None


def _parts(samples: Samples, length: float) -> Iterator[tuple[int, int]]:
    """Yield first row and the row after the last of each part."""
    longest = math.inf if math.isinf(length) else max(LEAST, round(length / samples.period))
    edges = [0, *(np.flatnonzero(~samples.joined) + 1).tolist(), len(samples.seq)]
    for low, high in pairwise(edges):
        begin = low
        while high - begin >= LEAST:
            end = high if high - begin < longest + LEAST else begin + int(longest)
            yield begin, end
            begin = end


def _start(samples: Samples, row: int, end: int, order: int) -> list[float]:
    """Return the state at a part's first row; the derivative of what is measured last by slope."""
    x = samples.x[row, :samples.measured].tolist()
    if samples.measured < order:
        half = LEAST // 2
        before = row >= half and samples.joined[row - half:row].all()   # none behind a hole
        begin = row - half if before else row
        near = samples.x[begin:min(begin + LEAST + 1, end), samples.measured - 1]
        x.append(slope_at(near, row - begin, samples.period))
    return [*x, *[0.0] * (order - len(x))]


def _simulated(c: Configuration, x: Sequence[float], stamps: Array, times: Sequence[float],
               commands: Sequence[float]) -> Array:
    """Return the simulated states at some instants, shape (K, n), NaN from where it diverged.

    Args:
        c: The plant.
        x: The state at the first instant.
        stamps: The instants [s], shape (K,).
        times: From which on commands act [s], ascending.
        commands: Those.
    """
    device = SimulatedActuator(SimulatedParameters(), c)
    path = np.full((len(stamps), c.plant.order), np.nan)
    place = bisect_right(times, float(stamps[0]) + SAME_INSTANT)
    device.x, device.t = list(x), float(stamps[0])
    if place:
        device.command(commands[place - 1], device.t)
    for row, t in enumerate(stamps.tolist()):
        while place < len(times) and times[place] < t - SAME_INSTANT:
            device.command(commands[place], times[place])
            place += 1
        try:
            device.advance(t, row)
        except LoopError:
            break
        path[row] = device.x
        if place < len(times) and times[place] <= t + SAME_INSTANT:
            device.command(commands[place], t)
            place += 1
    return path

# SPDX-License-Identifier: Apache-2.0
"""Whether what was recorded as the rate of a signal is it: unit, sign, offset, lag (ours).

    x_i(t + W) − x_i(t)  with  α ∫ x_{i+1} dt + β W     α = 1: unit and sign; β = 0: offset;
                                                       what is left: lag, another signal

A regression over windows of W that do not overlap; a deviation counts where it exceeds both a
share (`SCALE`, `OFFSET`) and `SIGMAS` standard errors, so that noise alone is no contradiction.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.errors import RecordingError
from dz_ros.identification.estimation.sensor import white_noise
from dz_ros.identification.samples import Samples

Array = NDArray[np.float64]

WINDOW = 0.5
"""W [s]."""
LEAST_WINDOWS = 8
"""Fewer windows show nothing."""
SCALE, OFFSET, REST = 0.02, 0.002, 0.05
"""Largest |α − 1|, |β| as a share of the largest speed, and share of the motion left over."""
SIGMAS = 4.0
BY_CHANCE = 2.0
"""Standard errors of α up to which it is taken for 1."""
LAGGING = 0.75
"""Delay between a signal and its rate from which on it is named [samples]; a difference of two
samples is half a sample late."""
CERTAIN = 16.0
"""Logarithm of the likelihood ratio, doubled, from which on a delay is no chance."""
LATEST = 0.25
"""Largest delay between a signal and its rate that is tried [s]."""
UNITS = {60.0 / (2.0 * math.pi): 'rpm in place of rad/s', 180.0 / math.pi: 'degrees in place of '
         'radians', 1000.0: 'thousandths (mm, mrad) in place of the unit', 100.0: 'cm in place of '
         'm', 2.0 * math.pi: 'rad in place of turns'}
"""Factor → what is often behind it."""


def windows(samples: Samples) -> list[tuple[int, int]]:
    """Return windows of W, first and last sample, without a hole and without overlap."""
    length = max(4, round(WINDOW / samples.period))
    edges = [0, *(np.flatnonzero(~samples.joined) + 1).tolist(), len(samples.seq)]
    return [(begin, begin + length) for low, high in pairwise(edges)
            for begin in range(low, high - length, length)]


def check_rate(slow: Array, fast: Array, pieces: Sequence[tuple[int, int]], period: float,
               slow_name: str, fast_name: str) -> float:
    """Compare the change of a signal with the integral of what is recorded as its rate.

    Args:
        slow: The signal, shape (N,).
        fast: Its rate, shape (N,).
        pieces: Windows, as of `windows`.
        period: T [s].
        slow_name: Name of the signal, with its unit.
        fast_name: Name of the rate, with its unit.

    Returns:
        How many times too large the rate is, by 9 % at most; 1 where chance explains it or
        nothing shows.

    Raises:
        RecordingError: It is another signal, of another unit or sign, late or has an offset.
    """
    if len(pieces) < LEAST_WINDOWS:
        return 1.0
    edges = np.array(pieces)
    change = slow[edges[:, 1]] - slow[edges[:, 0]]
    fits = {shift: _fit(change, integral, edges, period) for shift in (0, *_shifts(period))
            if (integral := _integral(fast, edges, shift, period)) is not None}
    found = fits[0]
    if found is None:
        return 1.0
    alpha, beta, left, errors = found
    moved = float(np.sqrt(np.mean(change ** 2)))
    noise = math.sqrt(2.0 * white_noise(slow) ** 2 + white_noise(fast) ** 2 * WINDOW * period)
    subject = f'{fast_name} is not the rate of {slow_name}: '
    if left > max(REST * moved, SIGMAS * noise):
        shift, best = min(((shift, fit[2]) for shift, fit in fits.items() if fit is not None),
                          key=lambda item: item[1])
        if shift and best < 0.3 * left:
            raise RecordingError(f'{subject}it is {abs(shift) * period * 1e3:.0f} ms '
                                 + ('late' if shift > 0 else 'early'))
        raise RecordingError(f'{subject}over {WINDOW:g} s they differ by {left:.3g}, where it '
                             f'moves by {moved:.3g}')
    if abs(alpha - 1.0) > max(SCALE, SIGMAS * errors[0]):
        raise RecordingError(subject + _factor(1.0 / alpha))
    largest = float(np.quantile(np.abs(fast[np.isfinite(fast)]), 0.99))
    if abs(beta) > max(OFFSET * largest, SIGMAS * errors[1]):
        raise RecordingError(f'{fast_name} has an offset of {-beta / alpha:.3g} against the rate '
                             f'of {slow_name}')
    shows = BY_CHANCE * errors[0] < abs(alpha - 1.0) and errors[0] < SCALE
    return 1.0 / alpha if shows else 1.0


def lag(slow: Array, fast: Array, pieces: Sequence[tuple[int, int]], period: float) -> float:
    """Return how much later than the rate of a signal another one is [s]; 0 where none shows."""
    if len(pieces) < LEAST_WINDOWS:
        return 0.0
    edges = np.array(pieces)
    change = slow[edges[:, 1]] - slow[edges[:, 0]]
    left = {shift: fit[2] ** 2 for shift in (0, *_shifts(period))
            if (integral := _integral(fast, edges, shift, period)) is not None
            and (fit := _fit(change, integral, edges, period)) is not None}
    best = min(left, key=lambda shift: left[shift], default=0)
    if not {best - 1, best, best + 1, 0} <= set(left) or not left[best] > 0.0:
        return 0.0
    before, least, after = (left[best + i] for i in (-1, 0, 1))
    shift = best + 0.5 * (before - after) / (before - 2.0 * least + after)
    sure = len(edges) * math.log(left[0] / least) > CERTAIN
    return shift * period if sure and abs(shift) > LAGGING else 0.0


def _shifts(period: float) -> list[int]:
    """Return the delays that are tried [samples]."""
    most = round(LATEST / period)
    return [shift for shift in range(-most, most + 1) if shift]


def _integral(fast: Array, edges: NDArray[np.int64], shift: int, period: float) -> Array | None:
    """Return the integral over each window, moved by samples; None where it is not known."""
    begin, end = edges[:, 0] + shift, edges[:, 1] + shift
    if begin.min() < 0 or end.max() >= len(fast):
        begin, end = begin.clip(0), end.clip(None, len(fast) - 1)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (fast[1:] + fast[:-1]))]) * period
    if not np.isfinite(total[end]).all():       # a hole: what comes after it is not known
        known = np.where(np.isfinite(fast), fast, 0.0)
        total = np.concatenate([[0.0], np.cumsum(0.5 * (known[1:] + known[:-1]))]) * period
    found: Array = total[end] - total[begin]
    return found


def _fit(change: Array, integral: Array, edges: NDArray[np.int64],
         period: float) -> tuple[float, float, float, tuple[float, float]] | None:
    """Return α, β, RMS of what is left, and the standard errors of α and β; None = blind."""
    span = float(edges[0, 1] - edges[0, 0]) * period
    design = np.column_stack([integral, np.full(len(edges), span)])
    gram = design.T @ design
    if not np.ptp(integral) > 0.0 or np.linalg.cond(gram) > 1e12:
        return None
    inverse = np.linalg.inv(gram)
    alpha, beta = (inverse @ (design.T @ change)).tolist()
    rest = change - design @ np.array([alpha, beta])
    variance = float(rest @ rest) / max(1, len(edges) - 2)
    errors = np.sqrt(variance * np.diag(inverse)).tolist()
    return alpha, beta, math.sqrt(variance), (errors[0], errors[1])


def _factor(factor: float) -> str:
    """Return what a wrong factor may be."""
    if abs(factor + 1.0) < SCALE:
        return 'it has the other sign'
    known = [words for number, words in UNITS.items() if abs(abs(factor) / number - 1.0) < 0.05]
    known += [f'the reverse of {words}' for number, words in UNITS.items()
              if abs(abs(factor) * number - 1.0) < 0.05]
    sign = ' with the other sign' if factor < 0.0 else ''
    return f'it is {abs(factor):.3g} times as large{sign}' + (f' ({known[0]}?)' if known else '')

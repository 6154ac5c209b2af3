# SPDX-License-Identifier: Apache-2.0
"""Contradictions within the samples of an experiment or a run, found before they are used.

Least squares returns an answer to any numbers. Bounds made from data that contradict themselves
exclude the truth without a sign of it, so these data are refused (ours). What is compared:

    share of samples that are missing or no numbers
    step between neighbouring values of a signal       rounding, against how far it moves
    x_i(t + W) − x_i(t)  with  α ∫ x_{i+1} dt + β W     α = 1: unit and sign; β = 0: offset;
                                                       what is left: lag, another signal

The last is a regression over windows of W that do not overlap; a deviation counts where
it exceeds both a share (`SCALE`, `OFFSET`) and `SIGMAS` standard errors, so that noise alone is no
contradiction. A smaller |α − 1| is a `Doubt`: no repeat differs by it, so the bounds of the slopes
are made wider by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.errors import RecordingError
from dz_ros.identification.estimation.sensor import resolution, white_noise
from dz_ros.identification.samples import Samples, state_and_command

Array = NDArray[np.float64]

WINDOW = 0.5
"""W [s]."""
LEAST_WINDOWS = 8
"""Fewer windows show nothing."""
LOST = 0.04
"""Largest share of samples that may be missing or no numbers."""
COARSE = 0.03
"""Largest step between neighbouring values, as a share of how far the signal moves."""
VISIBLE = 0.004
"""Steps above this share are named, with the bounds or with why there are none."""
SCALE, OFFSET, REST = 0.02, 0.002, 0.05
"""Largest |α − 1|, |β| as a share of the largest speed, and share of the motion left over."""
SIGMAS = 4.0
BY_CHANCE = 2.0
"""Standard errors of α up to which it is taken for 1."""
NAMED = 0.002
"""Share by which a rate has to be wrong to be named."""
LATEST = 0.25
"""Largest delay between a signal and its rate that is tried [s]."""
UNITS = {60.0 / (2.0 * math.pi): 'rpm in place of rad/s', 180.0 / math.pi: 'degrees in place of '
         'radians', 1000.0: 'thousandths (mm, mrad) in place of the unit', 100.0: 'cm in place of '
         'm', 2.0 * math.pi: 'rad in place of turns'}
"""Factor → what is often behind it."""


@dataclass(frozen=True)
class Doubt:
    """What samples that are used leave open, since every repeat has it alike.

    Attributes:
        scale: Share by which what was measured last may be too large or too small.
        notes: A line about each.
    """

    scale: float = 0.0
    notes: tuple[str, ...] = ()


def check_samples(samples: Samples, c: Configuration) -> Doubt:
    """Check what was measured for contradictions, and return the small ones.

    Raises:
        RecordingError: There is a large one; the text names signal, size and a likely cause.
    """
    names = _names(samples, c)
    x = samples.x[:, :samples.measured]
    _check_numbers(samples, x, names)
    for i, (name, values) in enumerate(zip(names, x.T, strict=True)):
        _check_steps(name, values[np.isfinite(values)], i,
                     i == samples.measured - 1)
    pieces = _pieces(samples)
    scale, notes = 0.0, []
    for i, (slow, fast) in enumerate(pairwise(names)):
        factor = _check_rate(x[:, i], x[:, i + 1], pieces, samples.period, slow, fast)
        scale += abs(factor - 1.0)
        if abs(factor - 1.0) > NAMED:
            notes.append(f'{fast} is {factor:.4g} times the rate of {slow}: the bounds of the '
                         'slopes are wider by that')
    coarse = rounding(samples, c)
    if coarse:
        notes.append(f'{coarse}: the bounds do not count what that hides')
    return Doubt(scale, tuple(notes))


def rounding(samples: Samples, c: Configuration) -> str:
    """Return that the last measured signal is rounded visibly; '' where it is not."""
    values = samples.x[:, samples.measured - 1]
    step, moved = _rounding(values[np.isfinite(values)])
    if not step > VISIBLE * moved:
        return ''
    return (f'{_names(samples, c)[-1]} is rounded to steps of {step:.3g} and moves over '
            f'{moved:.3g} only')


def check_log(run: RunData, period: float) -> None:
    """Check that a log has the commands, and the rate of the configuration.

    Args:
        run: The run, with states and commands.
        period: T of the configuration [s].

    Raises:
        RecordingError: Commands are no numbers or missing, or the run has another rate.
    """
    state, command = state_and_command(run)
    bad = float(np.mean(~np.isfinite(command['v'])))
    if bad > 0.0:
        raise RecordingError(f'the command is not a number in {bad:.0%} of the commands')
    acted = np.unique(state['echo_seq'][state['echo_seq'] >= 0.0])
    lost = float(np.mean(~np.isin(acted, command['seq']))) if len(acted) else 0.0
    if lost > LOST:
        raise RecordingError(f'{lost:.0%} of the commands that acted are lost: record every '
                             'command')
    steps, stamps = np.diff(state['seq']), np.diff(state['stamp'])
    steps, stamps = steps[steps > 0.0], stamps[steps > 0.0]
    if len(steps):
        between = float(np.median(stamps / steps))
        if not abs(between / period - 1.0) <= SCALE:
            raise RecordingError(f'the states are {between * 1e3:.4g} ms apart, loop.rate = '
                                 f'{1.0 / period:.6g} means {period * 1e3:.4g} ms')


def _names(samples: Samples, c: Configuration) -> list[str]:
    units = c.plant.state_units
    return [f'x{i} [{units[i]}]' for i in range(samples.measured)]


def _check_numbers(samples: Samples, x: Array, names: Sequence[str]) -> None:
    """Count what is missing."""
    if not len(samples.seq):
        raise RecordingError('nothing to identify: there is no sample')
    for i, name in enumerate(names):
        bad = float(np.mean(~np.isfinite(x[:, i])))
        if bad == 1.0:
            raise RecordingError(f'{name} is not a number in any sample{_unmeasured(i)}')
        if bad > LOST:
            raise RecordingError(f'{name} is not a number in {bad:.0%} of the samples: more than '
                                 f'{LOST:.0%} leave no motion without a hole')
    span = int(samples.seq[-1] - samples.seq[0]) + 1
    lost = 1.0 - len(samples.seq) / span
    if lost > LOST:
        raise RecordingError(f'{lost:.0%} of the states are lost: more than {LOST:.0%} leave no '
                             'motion without a hole; record every state')
    bad = float(np.mean(~np.isfinite(samples.v)))
    if bad > 0.0:
        raise RecordingError(f'the command is not a number in {bad:.0%} of the samples')
    if not np.ptp(samples.v) > 0.0:
        raise RecordingError(f'the command is {samples.v[0]:.4g} in every sample')


def _unmeasured(i: int) -> str:
    """Return what to do about a signal that is of no use; nothing can replace the first."""
    return f'; without a measurement of it set driver.measured to {i}' if i else ''


def _check_steps(name: str, values: Array, i: int, last: bool) -> None:
    """Refuse a signal that stands still or, the last one measured, is rounded coarsely."""
    levels = np.unique(values)
    if len(levels) < 2:
        raise RecordingError(f'{name} is {levels[0]:.4g} in every sample: it is not measured, or '
                             'nothing moves')
    step, moved = _rounding(values)
    if last and step > COARSE * moved:
        raise RecordingError(f'{name} is rounded to steps of {step:.3g} and moves over '
                             f'{moved:.3g} only: too coarse; record it with more digits or '
                             f'move it further{_unmeasured(i)}')


def _rounding(values: Array) -> tuple[float, float]:
    """Return the step a signal of several values is rounded to, 0 = none, and its motion."""
    moved = float(np.quantile(values, 0.99) - np.quantile(values, 0.01))
    return resolution(values), moved or float(np.ptp(values))


def _pieces(samples: Samples) -> list[tuple[int, int]]:
    """Return windows of W, first and last sample, without a hole and without overlap."""
    length = max(4, round(WINDOW / samples.period))
    edges = [0, *(np.flatnonzero(~samples.joined) + 1).tolist(), len(samples.seq)]
    return [(begin, begin + length) for low, high in pairwise(edges)
            for begin in range(low, high - length, length)]


def _check_rate(slow: Array, fast: Array, pieces: Sequence[tuple[int, int]], period: float,
                slow_name: str, fast_name: str) -> float:
    """Compare the change of a signal with the integral of what is recorded as its rate.

    Returns:
        How many times too large the rate is, by 9 % at most; 1 where chance explains it or
        nothing shows.
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

# SPDX-License-Identifier: Apache-2.0
"""Contradictions within the samples of an experiment or a run, found before they are used.

Least squares returns an answer to any numbers. Bounds made from data that contradict themselves
exclude the truth without a sign of it, so these data are refused (ours). What is compared:

    number of holes in which samples are missing or no numbers
    step between neighbouring values of a signal       rounding, against how far it moves
    the first state with its neighbours in time        jumps out of its own motion
    a signal with the integral of what was recorded as its rate      `rates`

A rate that is wrong by little is a `Doubt`: no repeat differs by it, so the bounds of the slopes
are made wider by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.text import counted
from dz_ros.errors import RecordingError
from dz_ros.identification.estimation.rates import check_rate, lag, SCALE, windows
from dz_ros.identification.estimation.sensor import resolution
from dz_ros.identification.samples import Samples, state_and_command

Array = NDArray[np.float64]

LOST = 0.04
"""Largest number of holes for each sample there is: a hole costs the window it is in, however long
it is."""
COARSE = 0.03
"""Largest step between neighbouring values, as a share of how far the signal moves."""
VISIBLE = 0.004
"""Steps above this share are named, with the bounds or with why there are none."""
NAMED = 0.002
"""Share by which a rate has to be wrong to be named."""
NOTED = 0.005
"""Share of states, or numbers of a signal, lost from which on it is a note."""
JUMP, FASTEST, LARGE, BESIDE = 20.0, 5.0, 0.1, 3
"""A change within a sample is a jump where it is JUMP times the median of the BESIDE changes
before and after it, FASTEST times that which one change in twenty exceeds, and LARGE of how far
the signal moves."""

_TOO_MANY = f'more than one hole in {1.0 / LOST:.0f} samples leaves no motion without one'


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
    jumped = _jumped(samples, names[0])
    pieces = windows(samples)
    scale, notes = 0.0, []
    for i, (slow, fast) in enumerate(pairwise(names)):
        try:
            factor = check_rate(x[:, i], x[:, i + 1], pieces, samples.period, slow, fast)
        except RecordingError as error:
            if i == 0 and jumped:
                raise RecordingError(f'{error}; {jumped}') from None
            raise
        scale += abs(factor - 1.0)
        if abs(factor - 1.0) > NAMED:
            notes.append(f'{fast} is {factor:.4g} times the rate of {slow}: the bounds of the '
                         'slopes are wider by that')
        late = lag(x[:, i], x[:, i + 1], pieces, samples.period)
        if late:
            way = 'behind' if late > 0.0 else 'before'
            notes.append(f'{fast} comes {abs(late) * 1e3:.3g} ms {way} '
                         f'the rate of {slow}, as behind a filter: the delay of the commands that '
                         'is found counts that as well')
    notes += [f'{name} is not a number in {bad:.3g} % of the samples: what happened then is not '
              'used' for name, values in zip(names, x.T, strict=True)
              if (bad := 100.0 * float(np.mean(~np.isfinite(values)))) > 100.0 * NOTED]
    if jumped:
        notes.append(jumped)
    lost = _lost(samples)
    if lost > NOTED:
        notes.append(f'{lost:.0%} of the states are lost: what happened then is not used')
    coarse = rounding(samples, c)
    if coarse:
        notes.append(f'{coarse}: the bounds do not count what that hides')
    return Doubt(scale, tuple(notes))


def _jumped(samples: Samples, name: str) -> str:
    """Return that the first state jumps; '' where it does not (ours)."""
    rows = jumps(samples.x[:, 0], samples.seq)
    if not len(rows):
        return ''
    size = samples.x[rows[0] + 1, 0] - samples.x[rows[0], 0]
    return (f'{name} jumps {counted(len(rows), "time")}, by {size:.4g} at '
            f'{samples.t[rows[0]]:.4g} s, out of its own motion: unwrap angles, leave out wrong '
            'values')


def jumps(values: Array, seq: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the rows after which a signal jumps out of its own motion.

    Args:
        values: The signal, shape (K,); NaN where it is missing.
        seq: Numbers of the samples, shape (K,).
    """
    change = np.where(np.diff(seq) == 1, np.abs(np.diff(values)), np.nan)
    moving = change[change > 0.0]
    if len(moving) < 100:
        return np.array([], dtype=np.int64)
    padded = np.pad(np.nan_to_num(change), BESIDE, mode='reflect')
    beside = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * BESIDE + 1), axis=1)
    least = max(FASTEST * float(np.quantile(moving, 0.95)),
                LARGE * float(np.nanmax(values) - np.nanmin(values)))
    return np.flatnonzero(change > np.maximum(JUMP * beside, least))


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
        missing = ~np.isfinite(x[:, i])
        bad = float(np.mean(missing))
        if bad == 1.0:
            raise RecordingError(f'{name} is not a number in any sample{_unmeasured(i)}')
        if int(np.count_nonzero(np.diff(missing) & missing[1:])) > LOST * (~missing).sum():
            raise RecordingError(f'{name} is not a number in {bad:.0%} of the samples: '
                                 f'{_TOO_MANY}')
    holes = int(np.count_nonzero(np.diff(samples.seq) > 1))
    if holes > LOST * len(samples.seq):
        raise RecordingError(f'{_lost(samples):.0%} of the states are lost: {_TOO_MANY}; record '
                             'every state')
    bad = float(np.mean(~np.isfinite(samples.v)))
    if bad > 0.0:
        raise RecordingError(f'the command is not a number in {bad:.0%} of the samples')
    if not np.ptp(samples.v) > 0.0:
        raise RecordingError(f'the command is {samples.v[0]:.4g} in every sample')


def _lost(samples: Samples) -> float:
    """Return the share of the states that are missing between the first and the last one."""
    return 1.0 - len(samples.seq) / (int(samples.seq[-1] - samples.seq[0]) + 1)


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

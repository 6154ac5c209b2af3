# SPDX-License-Identifier: Apache-2.0
"""Samples of an experiment or a run: the data that identification works on (ours).

An experiment is written as a run like any other: states, commands, and an event at the begin of
each repeat, so that it can be viewed and evaluated again. A run without such events is cut into
equal parts that take the place of repeats. A command acts from its arrival on: the stamp of the
state it answers, plus the round trip that a later state reports of it (0 offline and in lockstep),
plus a known delay in whole samples.

In an experiment every command is known, so a short hole in what was measured, as a busy machine
leaves, is filled by a cubic through its neighbours before anything is estimated; the recording
keeps the hole.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import Channel, own_period, RunData
from dz_ros.core.events import of_kind, RepeatEvent
from dz_ros.core.records import Command, State
from dz_ros.errors import DzRosError, RecordingError
from dz_ros.identification.experiment.plan import LEAST_REPEATS, MOVING, NOISE
from dz_ros.runs.sequence import readable
from dz_ros.runs.setting import state_columns

Array = NDArray[np.float64]
Piece = tuple[float, float, float]
"""Begin [s], span [s], command held."""

SMOOTH = 0.05
"""Half-width of the local polynomials that speeds are taken from [s]."""
MAX_PARTS, PART = 12, 5.0
"""Largest number of parts of a run without repeats, and the shortest of them [s]."""
HOLE = 0.02
"""Longest hole of an experiment that is filled [s]."""
LARGEST = 1e100
"""A state from here on is no measurement, and its square no number."""


@dataclass(frozen=True)
class Samples:
    """What was measured, one row a sample; rows without measurement are NaN.

    Attributes:
        seq: Number of the sample, ascending; a gap is a sample that was missed, shape (K,).
        x: x, x', …, as measured (and observed), shape (K, n).
        v: Command held from the sample on, its mean where it changes within, shape (K,).
        repeat: Repeat it belongs to, −1 = none, shape (K,).
        kinds: Part of the experiment.
        measured: How many of x, x', … the device measures.
        period: T [s].
        pieces: The commands held during each sample; None = v throughout.
        filled: How many of them are none of the device's, but fill holes.
        resolution: One step of x as the device states it [unit of x]; 0 = not known.
    """

    seq: NDArray[np.int64]
    x: Array
    v: Array
    repeat: NDArray[np.int64]
    kinds: tuple[str, ...]
    measured: int
    period: float
    pieces: tuple[tuple[Piece, ...], ...] | None = None
    filled: int = 0
    resolution: float = 0.0

    @property
    def t(self) -> Array:
        """Loop time [s]."""
        return np.asarray(self.seq * self.period, dtype=float)

    @property
    def joined(self) -> NDArray[np.bool_]:
        """Whether each sample but the last is measured and followed by the next."""
        x = self.x[:, :self.measured]
        good: NDArray[np.bool_] = np.asarray((np.abs(x) < LARGEST).all(axis=1))
        found: NDArray[np.bool_] = (np.diff(self.seq) == 1) & good[1:] & good[:-1]
        return found

    def without_short_holes(self) -> Samples:
        """Return an experiment with its holes of up to `HOLE` filled by their neighbours (ours).

        Each is filled by the cubic that is nearest to the measurements beside it, two on each side
        at least and as many in all as it lacks; the command held across a sample that was skipped
        is the one before.
        """
        good = (np.abs(self.x[:, :self.measured]) < LARGEST).all(axis=1)
        at, measured = self.seq[good], self.x[good]
        longest = int(HOLE / self.period + 1e-6)
        fit = np.polynomial.Polynomial.fit
        filled: dict[int, Array] = {}
        for place in (np.flatnonzero(np.diff(at) > 1) + 1).tolist():
            low, high = int(at[place - 1]) + 1, int(at[place])
            lacking = high - low
            side = max(2, lacking // 2)
            near = at[max(place - side, 0):place + side] - low
            if (lacking > longest or len(near) < 2 * side
                    or np.ptp(near) > 2 * (lacking + 2 * side)):
                continue
            found = [fit(near, column, 3)(np.arange(lacking))
                     for column in measured[place - side:place + side].T]
            filled |= zip(range(low, high), np.column_stack(found), strict=True)
        if not filled:
            return self
        seq = np.union1d(self.seq, np.array(list(filled)))
        rows = np.searchsorted(self.seq, seq, side='right') - 1
        x = self.x[rows]
        x[np.searchsorted(seq, list(filled))] = list(filled.values())
        return replace(self, seq=seq, x=x, v=self.v[rows], repeat=self.repeat[rows],
                       kinds=tuple(self.kinds[row] for row in rows.tolist()),
                       pieces=None, filled=len(filled))

    def held(self, row: int) -> tuple[Piece, ...]:
        """Return the commands held during a sample."""
        if self.pieces is not None:
            return self.pieces[row]
        return ((float(self.seq[row]) * self.period, self.period, float(self.v[row])),)


def to_run(samples: Samples, c: Configuration, start_ns: int) -> RunData:
    """Return an experiment as a run.

    Args:
        samples: The experiment.
        c: With which it was made.
        start_ns: When it began [ns since the epoch].
    """
    seq, t = samples.seq.astype(float), samples.t
    times = start_ns + np.round(t * 1e9).astype(np.int64)
    good = np.isfinite(samples.x).all(axis=1)
    sent = good.copy()      # without a measurement it holds the one before, but for the last,
    sent[-1:] = True        # which ends the moves
    before = np.concatenate([[-1.0], seq[good]])[:-1]       # none, where nothing was measured
    stamps = np.concatenate([[0.0], t[good]])[:-1]
    state = np.column_stack([seq[good], t[good], samples.x[good], before, stamps,
                             np.zeros(len(before))])
    command = np.column_stack([seq, t, samples.v, seq, t, np.zeros(len(seq))])[sent]
    begins = np.flatnonzero(np.diff(samples.repeat, prepend=-2) != 0).tolist()
    events = tuple((int(times[row]), 'identify', RepeatEvent(
        'identify', int(samples.repeat[row]), int(samples.seq[row])).to_json()) for row in begins)
    return RunData({'state': Channel(State.labels(c.plant.order), state, times[good], times[good]),
                    'command': Channel(Command.labels(), command, times[sent], times[sent])},
                   c.to_flat(), {'mode': 'identification'}, events)


def from_run(run: RunData, c: Configuration, delay: int = 0) -> Samples:
    """Return a run as samples.

    Args:
        run: The run.
        c: Order, rate, command limit, driver.
        delay: Whole samples after which a command acts, besides its round trip.

    Raises:
        RecordingError: No states or commands, or another order.
    """
    times, commands = arrivals(run, c, delay)
    state = run.channels['state']
    rows = np.flatnonzero(readable(state['seq']))
    if not times or not len(rows):
        raise RecordingError('the log has no commands whose time is known, or no states whose '
                             'seq is a count')
    seq, first = np.unique(state['seq'][rows].astype(np.int64), return_index=True)
    rows = rows[first]
    x = state.values[rows][:, state_columns(state.labels)]
    if x.shape[1] != c.plant.order:
        raise RecordingError(f'the run has {x.shape[1]} states, plant.model = {c.plant.name!r} '
                             f'has order {c.plant.order}')
    stamps = state['stamp'][rows]
    period = own_period(seq.astype(float), stamps, c.loop.period)
    found = Samples(seq, x, np.zeros(len(seq)), _repeats(run, seq, period), ('run',) * len(seq),
                    _measured(run, c), period)
    if next(of_kind(run.events, RepeatEvent), None) is not None:
        found = found.without_short_holes()     # what acts in a hole is known from the arrivals
        stamps, seq = np.interp(found.seq, seq, stamps), found.seq
    pieces = []
    for row, begin in enumerate(stamps.tolist()):
        end = float(stamps[row + 1]) if row + 1 < len(seq) else begin + period
        near = begin < end < begin + 5.0 * period and seq[min(row + 1, len(seq) - 1)] <= (
            seq[row] + 1)
        pieces.append(_pieces(begin, end if near else begin + period, times, commands))
    v = np.array([sum(span * held for _, span, held in item) / sum(item[1] for item in item)
                  if item else np.nan for item in pieces])
    return replace(found, v=v, pieces=tuple(pieces))


def state_and_command(run: RunData) -> tuple[Channel, Channel]:
    """Return the two channels that identification needs.

    Raises:
        RecordingError: One is missing or empty.
    """
    state, command = run.channels.get('state'), run.channels.get('command')
    if state is None or command is None or not len(state) or not len(command):
        raise RecordingError('a plant cannot be identified: the log needs states and commands')
    return state, command


def arrivals(run: RunData, c: Configuration, delay: int = 0) -> tuple[list[float], list[float]]:
    """Return the times from which commands act [s], ascending, and the commands.

    Raises:
        RecordingError: The log has no commands or no states.
    """
    state, command = state_and_command(run)
    seq, first = np.unique(command['seq'], return_index=True)
    stamp, v = command['echo_stamp'][first], command['v'][first]
    trip = np.full(len(seq), np.nan)
    echoed = np.searchsorted(seq, state['echo_seq'])
    known = (echoed < len(seq)) & (seq[np.minimum(echoed, len(seq) - 1)] == state['echo_seq'])
    trip[echoed[known]] = state['round_trip'][known]
    # A command overtaken by the next took as long as usual.
    usual = float(np.nanmedian(trip)) if np.isfinite(trip).any() else 0.0
    at = stamp + np.where(np.isfinite(trip), trip, usual)
    if delay:
        at = (np.round(at / c.loop.period) + delay) * c.loop.period
    if c.plant_settings.command_limit > 0.0:
        v = np.clip(v, -c.plant_settings.command_limit, c.plant_settings.command_limit)
    good = np.isfinite(at) & np.isfinite(v)
    order = np.argsort(at[good], kind='stable')
    return at[good][order].tolist(), v[good][order].tolist()


def _pieces(begin: float, end: float, times: list[float],
            commands: list[float]) -> tuple[Piece, ...]:
    """Return the commands held from one instant to another."""
    place = bisect_right(times, begin + 1e-9)
    found = []
    while begin < end:
        held = commands[place - 1] if place else 0.0
        until = times[place] if place < len(times) and times[place] < end - 1e-9 else end
        if until > begin:
            found.append((begin, until - begin, held))
        begin = until
        place += 1
    return tuple(found)


def _repeats(run: RunData, seq: NDArray[np.int64], period: float) -> NDArray[np.int64]:
    """Return the repeat of each sample: by the events, or parts of equal length."""
    begins = sorted((event.seq, event.repeat) for _, event in of_kind(run.events, RepeatEvent))
    if begins:
        place = np.searchsorted([item[0] for item in begins], seq, side='right')
        return np.array([-1, *(item[1] for item in begins)])[place]
    parts = max(1, min(MAX_PARTS, int(float(seq[-1] - seq[0] + 1) * period / PART)))
    edges = np.linspace(seq[0], seq[-1] + 1, parts + 1)
    return np.searchsorted(edges, seq, side='right') - 1


def check_length(samples: Samples) -> None:
    """Check that a run can be cut into parts that show drift.

    Raises:
        RecordingError: It is too short.
    """
    if len(np.unique(samples.repeat[samples.repeat >= 0])) < LEAST_REPEATS:
        span = float(samples.seq[-1] - samples.seq[0]) * samples.period
        there = len(samples.seq) * samples.period
        whole = f', of which {there:.3g} s are not lost' if there < 0.9 * span else ''
        raise RecordingError(f'the run is too short: {span:.3g} s{whole}; at least '
                             f'{LEAST_REPEATS * PART:g} s are needed to see whether the dead-zone '
                             'drifts; dz bag whatif --fit takes less and gives no bounds')


def _measured(run: RunData, c: Configuration) -> int:
    """Return how many states were measured: all the driver measures, but not those observed."""
    observed = [int(name.strip()[1:]) for name in run.info.get('observed', '').split(',')
                if name.strip()[1:].isdigit()]
    try:
        measured = int(c.make_driver().measured)
    except DzRosError:
        measured = c.plant.order
    return max(1, min([measured, *observed]))


def motion_speed(samples: Samples) -> float:
    """Return the speed that counts as motion: a share of the largest, above its noise.

    The noise of an observed speed is not counted: only its measured position is identified from.
    """
    if samples.x.shape[1] == 1:
        return 0.0
    speed = samples.x[:, 1][np.isfinite(samples.x[:, 1])]
    if len(speed) < 4:
        return 0.0
    share = MOVING * float(np.quantile(np.abs(speed), 0.99))
    if samples.measured == 1:
        return share
    noise = float(np.diff(speed, n=3).std()) / np.sqrt(20.0)
    filtered = noise / np.sqrt(max(1.0, SMOOTH / samples.period))
    return float(max(share, NOISE * filtered))

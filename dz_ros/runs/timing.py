# SPDX-License-Identifier: Apache-2.0
"""Timing of a run: periods, latencies, missing messages (ours).

Three kinds of evidence, none of which compares the clocks of two machines unless stated:

- **period**: distance of the publish times of neighbouring seq of one topic (log times where the
  recording has no publish times of its own). One sample late shows as one long and one short
  period. *within*: |period − T| ≤ 1 ms; *late*: more than 1 ms too long; *too late*: more than
  one whole period too long.
- **latency** of the answer, state → command, matched by the echoed seq: publish to publish, and
  as the recorder saw both (log to log). A message reaches the recorder after those in a hurry, the
  state a little later than the command by comparison, so log to log can be shorter than publish to
  publish and even a little below zero; the way through the loop is publish to publish.
- **in band**, from what the messages themselves carry: how long the controller held a state,
  the round trip by the plant's own clock, their difference, which is the transport both ways, and
  how many whole samples old the newest command was when a state was measured.

A latency is *late* beyond 1 ms and *too late* beyond one period.

A run that was computed offline has no timing; one in lockstep has no deadline to meet.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.lateness import LATE
from dz_ros.core.percentiles import percentile, SHARES
from dz_ros.runs.metrics import jsonable
from dz_ros.runs.sequence import count_sequence, first_of_each, longest_stretch, SequenceCount
from dz_ros.runs.setting import Setting

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

UNTIMED = {
    'offline': 'computed offline: samples have no time of their own, so there is no timing',
    'lockstep': 'made in lockstep: each step waits for the one before, so periods and latencies '
                'show the speed of the machine, and nothing can be late',
}
"""Mode → why its wall times are not judged."""


@dataclass(frozen=True)
class Spread:
    """How a duration is distributed, all in s.

    Attributes:
        count: Number of durations.
        p50, p99, p999: Percentiles.
        maximum: Largest.
        values: All of them, shape (count,).
    """

    count: int
    p50: float
    p99: float
    p999: float
    maximum: float
    values: Array = field(repr=False, compare=False)

    @classmethod
    def of(cls, values: NDArray[np.floating[Any]]) -> Spread | None:
        """Return the spread of the durations that are numbers; None without any."""
        known = np.asarray(values[np.isfinite(values)], dtype=np.float64)
        if not len(known):
            return None
        ordered = np.sort(known)
        p50, p99, p999 = (percentile(ordered, share) for share in SHARES.values())
        return cls(len(known), p50, p99, p999, float(ordered[-1]), known)

    def at(self, share: float) -> float:
        """Return the duration below which a share of them lies [s]."""
        return percentile(np.sort(self.values), share)

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers by name [s], without the values."""
        return {'count': self.count, 'p50': self.p50, 'p99': self.p99, 'p999': self.p999,
                'max': self.maximum}


@dataclass(frozen=True)
class TopicTiming:
    """One topic.

    Attributes:
        sequence: Lost, duplicated, reordered.
        clock: ``publish`` or ``log``: which times the periods are from.
        period: Distance of neighbouring seq [s]; None with fewer than two.
        deviation: |period − T| [s]; None where T is unknown or nothing is judged.
        within: Share of periods within 1 ms of T, 0 … 1.
        late: Periods more than 1 ms too long.
        too_late: Periods more than T too long.
    """

    sequence: SequenceCount
    clock: str
    period: Spread | None
    deviation: Spread | None
    within: float | None
    late: int | None
    too_late: int | None

    def to_dict(self) -> dict[str, Any]:
        """Return everything by name [s]."""
        return {**self.sequence.to_dict(), 'clock': self.clock,
                'period': self.period.to_dict() if self.period else None,
                'deviation': self.deviation.to_dict() if self.deviation else None,
                'within_1ms': self.within, 'late': self.late, 'too_late': self.too_late}


@dataclass(frozen=True)
class Timing:
    """A run's timing.

    Attributes:
        note: Why nothing is judged; '' where the timing of a real-time run is.
        period: Nominal T [s]; None = unknown.
        speed: Seconds of loop time per second of wall time; None offline.
        topics: Channel → its timing.
        latencies: What → how long [s]: ``publish``, ``log``, ``hold``, ``transport``,
            ``round_trip``.
        samples_late: d → states measured when the newest command was 1 + d samples old.
    """

    note: str
    period: float | None
    speed: float | None
    topics: Mapping[str, TopicTiming]
    latencies: Mapping[str, Spread]
    samples_late: Mapping[int, int]

    @property
    def judged(self) -> bool:
        """True where periods and latencies mean something."""
        return not self.note

    def to_dict(self) -> dict[str, Any]:
        """Return everything by name, ready for JSON, times in s."""
        found: dict[str, Any] = jsonable({
            'note': self.note, 'period': self.period, 'speed': self.speed,
            'samples_late': self.samples_late,
            'topics': {name: topic.to_dict() for name, topic in self.topics.items()},
            'latencies': {name: {**spread.to_dict(), **dict(zip(
                ('late', 'too_late'), self.late(name), strict=True))}
                for name, spread in self.latencies.items()}})
        return found

    def late(self, name: str) -> tuple[int, int | None]:
        """Return how many of a latency are late and too late; None where T is unknown."""
        values = self.latencies[name].values
        return (int(np.count_nonzero(values > LATE)), None if self.period is None else
                int(np.count_nonzero(values > self.period)))


def measure_timing(run: RunData, setting: Setting) -> Timing:
    """Return the timing of a run, of its longest stretch where the plant restarted."""
    run, _ = longest_stretch(run)
    note = UNTIMED.get(setting.mode, '')
    timed = setting.mode != 'offline'
    judged = not note
    topics = {name: _topic(channel, setting.period, timed, judged)
              for name, channel in run.channels.items()}
    return Timing(note, setting.period, _speed(run) if timed else None, topics,
                  _latencies(run) if timed else {},
                  _samples_late(run.channels.get('state'), setting.period))


def _clock(channel: Channel) -> tuple[str, Integers]:
    """Return which clock a channel's times are from, and the times [ns]."""
    if (channel.publish_time > 0).all() and (channel.publish_time != channel.log_time).any():
        return 'publish', channel.publish_time
    return 'log', channel.log_time


def _topic(channel: Channel, period: float | None, timed: bool, judged: bool) -> TopicTiming:
    """Return the timing of one topic."""
    sequence = count_sequence(channel['seq'])
    if not timed or not len(channel):
        return TopicTiming(sequence, 'none', None, None, None, None, None)
    clock, times = _clock(channel)
    seq, rows = first_of_each(channel['seq'])
    neighbours = np.diff(seq) == 1
    periods = np.diff(times[rows])[neighbours] * 1e-9
    spread = Spread.of(periods)
    if spread is None or period is None or not judged:
        return TopicTiming(sequence, clock, spread, None, None, None, None)
    off = periods - period
    return TopicTiming(sequence, clock, spread, Spread.of(np.abs(off)),
                       float(np.mean(np.abs(off) <= LATE)), int(np.count_nonzero(off > LATE)),
                       int(np.count_nonzero(off > period)))


def _speed(run: RunData) -> float | None:
    """Return loop time over wall time of the states."""
    state = run.channels.get('state')
    if state is None or len(state) < 2:
        return None
    wall = float(state.log_time.max() - state.log_time.min()) * 1e-9
    stamps = state['stamp'][np.isfinite(state['stamp'])]
    return float(np.ptp(stamps)) / wall if wall > 0.0 and len(stamps) else None


def _latencies(run: RunData) -> dict[str, Spread]:
    """Return state → command latencies by every clock there is [s]."""
    found: dict[str, Spread | None] = {}
    state, command = run.channels.get('state'), run.channels.get('command')
    if state is not None and command is not None and len(state) and len(command):
        seq, rows = first_of_each(state['seq'])
        asked, answers = first_of_each(command['echo_seq'])
        _, question, answer = np.intersect1d(seq, asked, return_indices=True)
        pairs = rows[question], answers[answer]
        if _clock(state)[0] == _clock(command)[0] == 'publish':
            found['publish'] = Spread.of(
                1e-9 * (command.publish_time[pairs[1]] - state.publish_time[pairs[0]]))
        found['log'] = Spread.of(1e-9 * (command.log_time[pairs[1]] - state.log_time[pairs[0]]))
    for name, channel in (('hold', command), ('round_trip', state)):
        if channel is not None and name in channel.labels:
            values = channel[name]
            found[name] = Spread.of(values[values > 0.0])
    if state is not None and command is not None and {'hold', 'round_trip'} <= found.keys():
        found['transport'] = Spread.of(_transport(state, command))
    return {name: spread for name, spread in found.items() if spread is not None}


def _transport(state: Channel, command: Channel) -> Array:
    """Return round trips less the holds of the commands that ended them [s]."""
    echoed, rows = first_of_each(state['echo_seq'])
    seq, answers = first_of_each(command['seq'])
    _, ends, begins = np.intersect1d(echoed, seq, return_indices=True)
    trip, hold = state['round_trip'][rows[ends]], command['hold'][answers[begins]]
    return np.asarray((trip - hold)[(hold > 0.0) & (trip > hold)], dtype=np.float64)


def _samples_late(state: Channel | None, period: float | None) -> dict[int, int]:
    """Return d → how many states found a command of 1 + d samples before as the newest."""
    if (state is None or period is None
            or not {'echo_seq', 'echo_stamp'} <= set(state.labels) or not len(state)):
        return {}
    _, rows = first_of_each(state['seq'])
    echoed = state['echo_seq'][rows] >= 0.0
    with np.errstate(over='ignore', invalid='ignore'):
        age = (state['stamp'] - state['echo_stamp'])[rows][echoed] / period
    late, counts = np.unique(np.rint(age[np.isfinite(age)]) - 1.0, return_counts=True)
    return {int(d): int(count) for d, count in zip(late, counts, strict=True)}

# SPDX-License-Identifier: Apache-2.0
"""Steps of the controllers of a run: a row for a command, with the messages that belong to it.

A step is a command and its terms, joined by seq; terms and command name the state they answer and
terms the reference used. One log may hold several starts of the controller (command seq from 0
again) and of the plant (state seq from 0 again): a seq then names several messages, of which the
one with the right stamp counts, and of those the nearest in log time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.loop.controller import SNAP
from dz_ros.runs.axes import require_one
from dz_ros.runs.sequence import readable, starts

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class StepTable:
    """Steps of the law in order; rows of the channels, −1 where the message is not in the log.

    Attributes:
        start: Which start of the controller, from 0, shape (N,).
        seq: seq of the command, shape (N,).
        command: Row of the command, shape (N,).
        terms: Row of the terms, shape (N,).
        state: Row of the state answered, shape (N,).
        reference: Row of the reference used, shape (N,).
        stamp: Stamp of the state answered [s]; NaN where unknown, shape (N,).
        begin_ns: Log time of the first message of each start.
        end_ns: Log time of the last one.
        findings: What is wrong with the messages themselves.
    """

    start: Integers
    seq: Integers
    command: Integers
    terms: Integers
    state: Integers
    reference: Integers
    stamp: Array
    begin_ns: tuple[int, ...]
    end_ns: tuple[int, ...]
    findings: tuple[str, ...]

    @property
    def follows(self) -> Flags:
        """Whether the step before is in the log, directly before it, shape (N,)."""
        found = np.zeros(len(self.seq), dtype=bool)
        found[1:] = (np.diff(self.seq) == 1) & (np.diff(self.start) == 0)
        return found

    @classmethod
    def of(cls, run: RunData) -> StepTable:
        """Return the steps of the law that left a command or terms in a log.

        Raises:
            RecordingError: The run has several axes.
        """
        require_one(run)
        command, terms = run.channels.get('command'), run.channels.get('terms')
        command_rows, command_start, command_seq = counted(command)
        terms_rows, terms_start, terms_seq = counted(terms)
        command_time = command.log_time[command_rows] if command else command_rows
        terms_time = terms.log_time[terms_rows] if terms else terms_rows
        if len(command_start) and len(terms_start) and command_start[-1] < terms_start[-1]:
            command_start = _same_starts(command_start, command_time, terms_start, terms_time)
        else:
            terms_start = _same_starts(terms_start, terms_time, command_start, command_time)
        findings: list[str] = []
        distinct, places = np.unique(np.concatenate([command_seq, terms_seq]),
                                     return_inverse=True)
        own = np.concatenate([command_start, terms_start]) * len(distinct) + places
        command_keys, terms_keys = np.split(own, [len(command_seq)])
        keys = np.unique(own)
        start, seq = np.divmod(keys, max(len(distinct), 1))
        seq = distinct[seq]
        at_command = _first_rows(keys, command_keys, command_rows, command, 'command', findings)
        at_terms = _first_rows(keys, terms_keys, terms_rows, terms, 'terms', findings)
        state, reference, stamp = _inputs(run, at_command, at_terms)
        both = [(command_start, command_time), (terms_start, terms_time)]
        count = int(start[-1]) + 1 if len(start) else 0
        times = [np.concatenate([time[own == e] for own, time in both]) for e in range(count)]
        return cls(start, seq, at_command, at_terms, state, reference, stamp,
                   tuple(int(item.min()) for item in times),
                   tuple(int(item.max()) for item in times), tuple(findings))


def counted(channel: Channel | None) -> tuple[Integers, Integers, Integers]:
    """Return (rows whose seq is a count, how often the publisher had restarted, seq)."""
    if channel is None:
        return (np.empty(0, dtype=np.int64),) * 3
    rows = np.flatnonzero(readable(channel['seq']))
    seq = channel['seq'][rows].astype(np.int64)
    return rows, starts(seq), seq


def column(channel: Channel | None, label: str, rows: Integers) -> Array:
    """Return one column at some rows; NaN where there is no row."""
    if channel is None or not len(channel):
        return np.full(len(rows), np.nan)
    return np.where(rows >= 0, channel[label][rows], np.nan)


def differ(a: Array, b: Array) -> Flags:
    """Return where two arrays of the same shape differ in a bit; two NaN do not."""
    a = np.ascontiguousarray(a, dtype=float)
    b = np.ascontiguousarray(b, dtype=float)
    bits: Flags = a.view(np.uint64) != b.view(np.uint64)
    return bits & ~(np.isnan(a) & np.isnan(b))


def by_stamp(references: Channel, stamp: Array, time: Integers) -> Integers:
    """Return the reference meant for each stamp, which the controller prefers; −1 = none."""
    found = np.full(len(stamp), -1, dtype=np.int64)
    order = np.argsort(references['stamp'], kind='stable')
    stamps = references['stamp'][order]
    left = np.searchsorted(stamps, stamp - SNAP)
    right = np.searchsorted(stamps, stamp + SNAP)
    for i in np.flatnonzero(right > left).tolist():
        rows = order[left[i]:right[i]]
        found[i] = rows[int(np.argmin(np.abs(references.log_time[rows] - time[i])))]
    return found


class _Index:
    """The messages of a channel by seq."""

    def __init__(self, channel: Channel) -> None:
        rows, _, seq = counted(channel)
        order = np.argsort(seq, kind='stable')
        self._rows = rows[order]
        self._seq = seq[order]
        self._stamp = channel['stamp'][self._rows]
        self._time = channel.log_time[self._rows]

    def find(self, seq: Array, stamp: Array, time: Integers) -> Integers:
        """Return the row for each seq; of several the right stamp, then the nearest log time.

        Args:
            seq: seq wanted; anything that is no seq of the channel gives −1, shape (N,).
            stamp: Stamp wanted [s]; NaN = any, shape (N,).
            time: Log time of the message that names it [ns], shape (N,).
        """
        left = np.searchsorted(self._seq, seq, 'left')
        right = np.searchsorted(self._seq, seq, 'right')
        found = np.full(len(seq), -1, dtype=np.int64)
        there = right > left
        found[there] = self._rows[left[there]]
        for i in np.flatnonzero(right - left > 1).tolist():
            low, high = int(left[i]), int(right[i])
            with np.errstate(invalid='ignore'):
                wrong = np.abs(self._stamp[low:high] - stamp[i]) >= SNAP
            distance = np.abs(self._time[low:high] - time[i])
            found[i] = self._rows[low + int(np.lexsort((distance, wrong))[0])]
        return found


def _same_starts(own: Integers, times: Integers, other: Integers,
                 other_times: Integers) -> Integers:
    """Return the starts of one channel by the count of another, which may have seen more."""
    if not len(own) or not len(other) or own[-1] == other[-1]:
        return own
    begins = np.array([other_times[np.searchsorted(other, e)] for e in range(other[-1] + 1)])
    mine = np.array([times[np.searchsorted(own, e)] for e in range(own[-1] + 1)])
    nearest = np.abs(mine[:, np.newaxis] - begins).argmin(axis=1)
    return np.asarray(nearest[own], dtype=np.int64)


def _first_rows(keys: Integers, own: Integers, rows: Integers, channel: Channel | None,
                name: str, findings: list[str]) -> Integers:
    """Return the first row of each key; find out where a repetition has other numbers."""
    found = np.full(len(keys), -1, dtype=np.int64)
    if channel is None:
        return found
    if len(rows) < len(channel):
        findings.append(f'{name}: {len(channel) - len(rows)} message(s) with a seq that is none')
    distinct, index, inverse = np.unique(own, return_index=True, return_inverse=True)
    found[np.searchsorted(keys, distinct)] = rows[index]
    again = np.setdiff1d(np.arange(len(rows)), index)
    if len(again):
        columns = [i for i, label in enumerate(channel.labels) if label != 'hold']
        other = channel.values[rows[again]][:, columns]
        same = channel.values[rows[index[inverse[again]]]][:, columns]
        wrong = again[differ(other, same).any(axis=1)]
        if len(wrong):
            findings.append(f'{name}: {len(wrong)} message(s) came again with other numbers, the '
                            f'first with seq {int(channel["seq"][rows[wrong[0]]])}')
    return found


def _inputs(run: RunData, command: Integers, terms: Integers) -> tuple[Integers, Integers, Array]:
    """Return (row of the state, row of the reference, stamp of the state) of every step."""
    none = np.full(len(command), -1, dtype=np.int64)
    stamp, reference_seq = np.full(len(command), np.nan), np.full(len(command), np.nan)
    time = np.zeros(len(command), dtype=np.int64)
    state = none.copy()
    states, references = run.channels.get('state'), run.channels.get('reference')
    index = _Index(states) if states is not None and len(states) else None
    for name, rows, at in (('command', command, 'echo_stamp'), ('terms', terms, 'stamp')):
        channel = run.channels.get(name)
        if channel is None or not len(channel):
            continue
        there = np.flatnonzero(rows >= 0)
        own = rows[there]
        stamp[there], time[there] = channel[at][own], channel.log_time[own]
        if name == 'terms':
            reference_seq[there] = channel['reference_seq'][own]
        if index is not None and states is not None:
            named = index.find(channel['echo_seq'][own], stamp[there], time[there])
            # Terms and command name the same state; where not, the one of the right stamp counts.
            wrong = (named < 0) | (states['stamp'][named] != stamp[there])
            state[there] = np.where(wrong & (state[there] >= 0), state[there], named)
    if states is not None and len(states):
        stamp = np.where(state >= 0, states['stamp'][state], stamp)
    if references is None:
        return state, none, stamp
    reference = _Index(references).find(reference_seq, stamp, time)
    unnamed = np.flatnonzero(terms < 0)
    reference[unnamed] = by_stamp(references, stamp[unnamed], time[unnamed])
    return state, reference, stamp

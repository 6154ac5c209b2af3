# SPDX-License-Identifier: Apache-2.0
"""Counting messages by their ``seq``: missing, repeated, out of order, restarted; one rule (ours).

A publisher counts its messages, seq = 0, 1, 2, … A seq between the first and the last that no
message carries is *missing*: it was *skipped* (never published) or *lost* (published and never
received); a recording distinguishes the two only where an event `unmeasured` names those skipped.
A message whose seq came before is *repeated*; one that comes after a larger seq is *out of order*.

A publisher *restarted* where seq falls to 0, or by more than `DISORDER`, unless the next message
goes on where the count had been. Messages from there on are counted apart. (The live page, which
cannot wait for the next message, takes any fall as a restart.)
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.records import SEQ_LIMIT

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

DISORDER = 100
"""A seq that falls by no more than this, and not to 0, is out of order."""
_REMEMBERED = 10_000
"""Missing seq that `SequenceCounter` remembers; those beyond stay missing."""


@dataclass(frozen=True)
class SequenceCount:
    """Counts of the seq of one topic.

    Attributes:
        messages: Messages received.
        first: Smallest seq; None without messages.
        last: Largest seq; None without messages.
        missing: seq between the first and the last of a count that no message carries.
        repeated: Messages whose seq had been received before.
        reordered: Messages, not repeated ones, that came after one with a larger seq.
        unreadable: Messages whose seq is no count.
        restarts: Number of times the publisher began to count again.
    """

    messages: int = 0
    first: int | None = None
    last: int | None = None
    missing: int = 0
    repeated: int = 0
    reordered: int = 0
    unreadable: int = 0
    restarts: int = 0

    @property
    def clean(self) -> bool:
        """True where every seq came once and in order."""
        return (self.missing == self.repeated == self.reordered == self.unreadable
                == self.restarts == 0)

    def to_dict(self) -> dict[str, Any]:
        """Return the counts by name."""
        return asdict(self)


def readable(seq: Array) -> Flags:
    """Return which seq are counts: whole numbers from 0 that a double holds, shape (N,)."""
    with np.errstate(invalid='ignore'):
        found: Flags = (seq >= 0.0) & (seq < SEQ_LIMIT) & (seq == np.rint(seq))
    return found


def first_of_each(seq: Array) -> tuple[Integers, Integers]:
    """Return the distinct readable seq in ascending order and the row where each came first."""
    rows = np.flatnonzero(readable(seq))
    distinct, first = np.unique(seq[rows].astype(np.int64), return_index=True)
    return distinct, rows[first]


def starts(seq: Integers) -> Integers:
    """Return how often the publisher had restarted before each message, shape (N,).

    Args:
        seq: Readable seq in the order received, shape (N,).
    """
    found = np.zeros(len(seq), dtype=np.int64)
    before, after = seq[:-1], seq[1:]
    fell = (after < before) & ((after == 0) | (before - after > DISORDER))
    fell[:-1] &= seq[2:] < before[:-1]
    found[1:] = np.cumsum(fell)
    return found


def count_sequence(seq: Array) -> SequenceCount:
    """Return the counts of a topic's seq, in the order received.

    Args:
        seq: seq of every message, shape (N,).
    """
    whole = seq[readable(seq)].astype(np.int64)
    if not len(whole):
        return SequenceCount(len(seq), unreadable=len(seq))
    own = starts(whole)
    missing = reordered = distinct = 0
    for part in np.split(whole, np.flatnonzero(np.diff(own)) + 1):
        different, rows = np.unique(part, return_index=True)
        firsts = part[np.sort(rows)]
        reordered += int(np.count_nonzero(firsts[1:] < np.maximum.accumulate(firsts)[:-1]))
        distinct += len(different)
        missing += int(different[-1] - different[0]) + 1 - len(different)
    return SequenceCount(len(seq), int(whole.min()), int(whole.max()), missing,
                         len(whole) - distinct, reordered, len(seq) - len(whole), int(own[-1]))


class SequenceCounter:
    """The counts of `count_sequence`, message by message."""

    def __init__(self) -> None:
        self._messages = self._missing = self._repeated = self._reordered = 0
        self._unreadable = self._restarts = 0
        self._smallest: int | None = None
        self._largest = self._last = -1
        self._first = 0
        self._expected: int | None = None
        self._missed: set[int] = set()
        self._fallen: int | None = None

    def add(self, seq: float) -> None:
        """Count one message."""
        self._messages += 1
        if seq == self._expected and self._fallen is None:
            self._last = self._expected
            self._expected += 1
        elif seq.is_integer() and 0.0 <= seq < SEQ_LIMIT:
            self._irregular(int(seq))
        else:
            self._unreadable += 1

    def count(self) -> SequenceCount:
        """Return the counts so far."""
        if self._expected is None:
            return SequenceCount(self._messages, unreadable=self._unreadable)
        smallest = self._first if self._smallest is None else min(self._smallest, self._first)
        return SequenceCount(
            self._messages, smallest if self._fallen is None else min(smallest, self._fallen),
            max(self._largest, self._expected - 1), self._missing, self._repeated,
            self._reordered, self._unreadable, self._restarts + (self._fallen is not None))

    def _irregular(self, seq: int) -> None:
        """Count a message that is not the next one, and the one before if it was in doubt."""
        fallen, self._fallen = self._fallen, None
        if fallen is not None:
            if seq < self._last:
                self._restarts += 1
                self._smallest = self._first if self._smallest is None else min(
                    self._smallest, self._first)
                self._largest = max(self._largest, (self._expected or 0) - 1)
                self._expected = None
                self._missed.clear()
            self._place(fallen)
        if seq < self._last and (seq == 0 or self._last - seq > DISORDER):
            self._fallen = seq
        else:
            self._place(seq)

    def _place(self, seq: int) -> None:
        """Count a message of the present count."""
        self._last = seq
        expected = self._expected
        if expected is None:
            self._first, self._expected = seq, seq + 1
        elif seq >= expected:
            self._miss(expected, seq)
            self._expected = seq + 1
        elif seq in self._missed:
            self._missed.discard(seq)
            self._missing -= 1
            self._reordered += 1
        elif seq < self._first:
            self._miss(seq + 1, self._first)
            self._first = seq
            self._reordered += 1
        else:
            self._repeated += 1

    def _miss(self, begin: int, end: int) -> None:
        """Take note of seq that did not come, as many as are remembered."""
        self._missing += end - begin
        room = _REMEMBERED - len(self._missed)
        self._missed.update(range(max(begin, end - room), end))


def longest_stretch(run: RunData) -> tuple[RunData, int]:
    """Return the longest part of a run between restarts of the plant, and their number.

    The other channels are cut where the states are, by log time.
    """
    state = run.channels.get('state')
    if state is None or len(state) < 2:
        return run, 0
    rows = np.flatnonzero(readable(state['seq']))
    begins = rows[1:][np.diff(starts(state['seq'][rows].astype(np.int64))) > 0]
    if not len(begins):
        return run, 0
    edges = [0, *begins.tolist(), len(state)]
    longest = int(np.argmax(np.diff(edges)))
    begin, end = edges[longest], edges[longest + 1]
    low = int(state.log_time[begin]) if begin else None
    high = int(state.log_time[end]) if end < len(state) else None
    cut = {name: _between(channel, low, high) for name, channel in run.channels.items()}
    cut['state'] = _rows(state, np.arange(begin, end))
    return replace(run, channels=cut), len(begins)


def _between(channel: Channel, low: int | None, high: int | None) -> Channel:
    """Return the messages logged in [low, high) [ns]; None = without limit."""
    keep = np.ones(len(channel), dtype=bool)
    if low is not None:
        keep &= channel.log_time >= low
    if high is not None:
        keep &= channel.log_time < high
    return _rows(channel, np.flatnonzero(keep))


def _rows(channel: Channel, rows: Integers) -> Channel:
    """Return some messages of a channel."""
    return Channel(channel.labels, channel.values[rows], channel.log_time[rows],
                   channel.publish_time[rows], channel.axes)

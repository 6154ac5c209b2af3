"""Counting samples by their ``seq``: what is missing, came twice, came out of order.

A ``seq`` that no message of a topic carries, between its first and its last, was either never
sent or lost on the way; a recording alone cannot tell the two apart. A state of seq 0 after later
ones is a plant that started anew.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.dataset import Channel, RunData

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

NEAR_START = 10.0
"""The seq after a 0 may be this large in a run that starts anew: some are lost at the start."""

LARGEST = 2.0 ** 53
"""Integers beyond this are not exact as doubles: such a seq is unreadable."""


@dataclass(frozen=True)
class SequenceCount:
    """What the seq of one topic say.

    Attributes:
        messages: Messages received.
        first: Smallest seq; None without messages.
        last: Largest seq; None without messages.
        lost: seq between them that no message carries.
        duplicated: Messages whose seq had been received before.
        reordered: Messages, not duplicates, that came after one with a larger seq.
        unreadable: Messages whose seq is no whole number.
    """

    messages: int
    first: int | None
    last: int | None
    lost: int
    duplicated: int
    reordered: int
    unreadable: int

    @property
    def clean(self) -> bool:
        """True where every seq came once and in order."""
        return self.lost == self.duplicated == self.reordered == self.unreadable == 0

    def to_dict(self) -> dict[str, Any]:
        """Return the counts by name."""
        return asdict(self)


def readable(seq: Array) -> NDArray[np.bool_]:
    """Return which seq are whole numbers that a double holds exactly, shape (N,)."""
    with np.errstate(invalid='ignore'):
        found: NDArray[np.bool_] = (np.abs(seq) <= LARGEST) & (seq == np.rint(seq))
    return found


def first_of_each(seq: Array) -> tuple[Integers, Integers]:
    """Return the distinct readable seq in ascending order and the row where each came first."""
    rows = np.flatnonzero(readable(seq))
    distinct, first = np.unique(seq[rows].astype(np.int64), return_index=True)
    return distinct, rows[first]


def count_sequence(seq: Array) -> SequenceCount:
    """Return what a topic's seq say, in the order received.

    Args:
        seq: seq of every message, shape (N,).
    """
    good = readable(seq)
    whole = seq[good].astype(np.int64)
    distinct, rows = first_of_each(seq)
    if not len(whole):
        return SequenceCount(len(seq), None, None, 0, 0, 0, len(seq))
    firsts = seq[np.sort(rows)].astype(np.int64)
    reordered = int(np.count_nonzero(firsts[1:] < np.maximum.accumulate(firsts)[:-1]))
    first, last = int(distinct[0]), int(distinct[-1])
    return SequenceCount(len(seq), first, last, last - first + 1 - len(distinct),
                         len(whole) - len(distinct), reordered, len(seq) - len(whole))


def longest_stretch(run: RunData) -> tuple[RunData, int]:
    """Return the longest part of a run between restarts of the plant, and their number.

    The other channels are cut where the states are, by log time.
    """
    state = run.channels.get('state')
    if state is None or len(state) < 2:
        return run, 0
    seq = np.where(readable(state['seq']), state['seq'], -1.0)
    largest = np.maximum.accumulate(seq)
    following = np.append(seq[1:], -1.0)
    anew = np.flatnonzero((seq[1:-1] == 0.0) & (following[1:-1] < largest[:-2])
                          & (following[1:-1] <= NEAR_START)) + 1
    if not len(anew):
        return run, 0
    edges = [0, *(int(row) for row in anew), len(state)]
    longest = int(np.argmax(np.diff(edges)))
    begin, end = edges[longest], edges[longest + 1]
    low = int(state.log_time[begin]) if begin else None
    high = int(state.log_time[end]) if end < len(state) else None
    cut = {name: _between(channel, low, high) for name, channel in run.channels.items()}
    cut['state'] = _rows(state, np.arange(begin, end))
    return replace(run, channels=cut), len(anew)


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
                   channel.publish_time[rows])

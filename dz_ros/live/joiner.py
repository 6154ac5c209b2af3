# SPDX-License-Identifier: Apache-2.0
"""Messages of five topics → rows, in order, each as soon as it is whole or will not become so."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
import math

from dz_ros.core.records import SEQ_LIMIT
from dz_ros.core.safety.message_guards import plausible
from dz_ros.live.columns import Layout

ROW_WAIT = 0.05
"""Longest wait of a row for messages that have not come [s]."""
ALIVE = 1.0
"""A topic silent for longer is not waited for [s]."""
MAX_ROWS = 5000
"""More rows than this never wait; a seq further ahead than this must be confirmed by another."""
MOST_NUMBERS = 4_000_000
"""Numbers of rows that wait, at most, however many columns there are."""


@dataclass
class _Row:
    values: list[float]
    since: float
    have: set[str] = field(default_factory=set)


class Joiner:
    """Joins messages by the seq of the state they belong to.

    Args:
        layout: Where each number goes.

    Attributes:
        newest: seq of the newest state; −1 = none.
        stamp: Its stamp [s].
        restarted: Whether the states restarted; the caller then makes a new joiner.
        lost: States that never came, by the gaps in their seq.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self._most = max(min(MAX_ROWS, MOST_NUMBERS // max(layout.base, 1)), 100)
        self.newest = -1
        self.stamp = 0.0
        self.restarted = False
        self.lost = 0
        self._rows: dict[int, _Row] = {}
        self._queue: deque[int] = deque()
        self._emitted = -1
        self._odd = -1
        self._received: dict[str, float] = {}
        self._echo = {topic: labels.index('echo_seq') for topic, labels in layout.labels.items()
                      if topic in ('command', 'terms') and 'echo_seq' in labels}
        state = layout.labels.get('state', ())
        self._state_echo = state.index('echo_seq') if 'echo_seq' in state else 0

    def __len__(self) -> int:
        """Return the number of rows that wait."""
        return len(self._rows)

    def put(self, topic: str, numbers: Sequence[float], published: float, now: float) -> None:
        """Take a message.

        Args:
            topic: Its topic.
            numbers: What it carries, as the topic's labels name it.
            published: When it was published [s since the epoch].
            now: Now, by a steady clock [s].
        """
        self._received[topic] = now
        key = numbers[self._echo.get(topic, 0)]
        if not 0.0 <= key < SEQ_LIMIT or key != int(key):     # NaN is not either
            return
        seq = int(key)
        if topic == 'state' and not plausible((*numbers[:2], numbers[self._state_echo]), -1):
            return
        if topic == 'state' and not self._state(seq, numbers, published, now):
            return
        if seq <= self._emitted:
            return
        row = self._rows.get(seq)
        if row is None:
            if (topic == 'state' or seq > self.newest + MAX_ROWS
                    or len(self._rows) >= 2 * self._most):
                return
            row = self._rows[seq] = _Row([math.nan] * self.layout.base, now)
        if topic in row.have:       # the first answer to a state is the one that acted
            return
        part = self.layout.parts[topic]
        place = part.start
        values = row.values
        for pick in part.picks:
            values[place] = numbers[pick]
            place += 1
        row.have.add(topic)

    def _state(self, seq: int, numbers: Sequence[float], published: float, now: float) -> bool:
        """Note a state, the first one of a seq opens its row; return whether it is believed."""
        stamp = numbers[1]
        if seq < self.newest and (stamp < self.stamp or self._confirms(seq)):
            self.restarted = True
            return False
        if self.newest >= 0 and seq > self.newest + MAX_ROWS and not self._confirms(seq):
            return False
        if seq > self.newest:
            if self.newest >= 0:
                self.lost += seq - self.newest - 1
            self.newest, self.stamp = seq, stamp
        if seq <= self._emitted:
            return False
        row = self._rows.get(seq)
        if row is None:
            row = self._rows[seq] = _Row([math.nan] * self.layout.base, now)
        if 'state' not in row.have:
            row.values[0:3] = [float(seq), stamp, published]
            self._queue.append(seq)
        return True

    def _confirms(self, seq: int) -> bool:
        """Return whether a seq that does not fit follows another one that did not either."""
        before, self._odd = self._odd, seq
        return 0 <= before < seq <= before + MAX_ROWS

    def take(self, now: float) -> list[list[float]]:
        """Return the rows that are whole, or have waited long enough, in order of their seq."""
        expected = {topic for topic, received in self._received.items() if now - received < ALIVE}
        found = []
        while self._queue:
            seq = self._queue[0]
            row = self._rows[seq]
            if (not expected <= row.have and now - row.since < ROW_WAIT
                    and len(self._queue) < self._most):
                break
            self._queue.popleft()
            if seq > self._emitted:
                found.append(row.values)
                self._emitted = seq
            del self._rows[seq]
        if len(self._rows) >= 2 * self._most:       # answers to states that never came
            self._rows = {seq: row for seq, row in self._rows.items()
                          if seq > self._emitted and (now - row.since < ALIVE
                                                      or 'state' in row.have)}
        return found

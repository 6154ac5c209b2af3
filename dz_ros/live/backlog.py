# SPDX-License-Identifier: Apache-2.0
"""Messages that are expensive to read: read in order, in a bounded share of the time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import time

SHARE = 0.1
"""Largest share of the time spent on reading in the long run."""
AT_ONCE = 0.5
"""Processor time that may be spent before the share counts [s]."""
MAX_BYTES = 4 << 20
"""Bytes that wait; of more, the oldest messages are dropped."""


class Backlog:
    """Messages that wait for their turn.

    Args:
        read: Reads a message: its bytes and its time [ns].
        clock: Returns the time [s].
    """

    def __init__(self, read: Callable[[bytes, int], None],
                 clock: Callable[[], float] = time.monotonic) -> None:
        self._read = read
        self._clock = clock
        self._waiting: deque[tuple[bytes, int]] = deque()
        self._bytes = 0
        self._spent = 0.0
        self._since = clock()

    def put(self, payload: bytes, source_ns: int) -> int:
        """Add a message; return how many older ones were dropped for it."""
        self._waiting.append((payload, source_ns))
        self._bytes += len(payload)
        before = len(self._waiting)
        while self._bytes > MAX_BYTES and len(self._waiting) > 1:
            self._bytes -= len(self._waiting.popleft()[0])
        return before - len(self._waiting)

    def work(self) -> None:
        """Read messages, as many as the share of the time allows."""
        now = self._clock()
        self._spent = max(self._spent - SHARE * (now - self._since), 0.0)
        self._since = now
        while self._waiting and self._spent <= AT_ONCE:
            payload, source_ns = self._waiting.popleft()
            self._bytes -= len(payload)
            self._read(payload, source_ns)
            self._spent += self._clock() - now
            now = self._clock()

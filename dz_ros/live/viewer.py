# SPDX-License-Identifier: Apache-2.0
"""One browser: what it is sent, and when it is dropped.

Rows are not queued for it: a viewer remembers how far it has got and takes the rows from there on
out of the one history; an answer in numbers is made when the one before it has left. So a viewer
that stops reading costs little more than the system's buffers, and is dropped once nothing has
left for `STALLED` seconds.
"""

from __future__ import annotations

import asyncio
from collections import deque
import time
from typing import Any

from dz_ros.live.clock import clock
from dz_ros.live.requests import text_of
from dz_ros.live.source import Source

STALLED = 5.0
"""A frame of which nothing has left for this long means that the viewer does not read [s]."""
TEXTS = 400
"""More texts waiting than this mean the same."""
RATE, BURST = 20.0, 40.0
"""Requests a viewer may send: a second, and at once."""


class Budget:
    """Requests left to a viewer.

    Args:
        now: Now, by a steady clock [s].
    """

    def __init__(self, now: float) -> None:
        self._left = BURST
        self._at = now

    def spend(self, now: float) -> bool:
        """Take one; return False where none is left."""
        self._left = min(BURST, self._left + (now - self._at) * RATE)
        self._at = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Viewer:
    """A connected page.

    Args:
        socket: Its prepared WebSocket.
        transport: The connection below it.
        name: Its address, for the record of actions.
        source: What it is shown.

    Attributes:
        token: What it has shown.
        may_act: Whether its actions are accepted.
        seconds: How much of the past it wants [s].
        cursor: Count of the first row it does not have; None = it has not asked yet.
        busy: Whether a request of its is being worked on.
    """

    def __init__(self, socket: Any, transport: Any, name: str, source: Source) -> None:
        self.name = name
        self.source = source
        self.token = ''
        self.may_act = False
        self.seconds = 0.0
        self.cursor: int | None = None
        self.generation = -1
        self.busy = False
        self.budget = Budget(time.monotonic())
        self.wake = asyncio.Event()
        self._socket = socket
        self._transport = transport
        self._waiting: deque[bytes | str] = deque()
        self._sending_since: float | None = None
        self._unsent = 0
        self._left = asyncio.Event()

    @property
    def held(self) -> int:
        """Bytes that wait to be sent, and those sent that have not left."""
        return sum(map(len, self._waiting)) + self._unsent_now()

    def _unsent_now(self) -> int:
        return self._transport.get_write_buffer_size() if self._transport is not None else 0

    def send(self, message: dict[str, Any] | str) -> None:
        """Queue a text, given as what it means or as it is sent."""
        self._put(message if isinstance(message, str) else text_of(message))

    async def give(self, frame: bytes) -> None:
        """Send an answer in numbers; return when it has left, so that there is one at a time."""
        left = self._left = asyncio.Event()
        self._put(frame)
        await left.wait()

    def _put(self, item: bytes | str) -> None:
        if len(self._waiting) >= TEXTS:
            self.drop()
            return
        self._waiting.append(item)
        self.wake.set()

    async def send_all(self, history: Any) -> None:
        """Send what waits, then the rows it does not have yet."""
        while self._waiting:
            await self._send(self._waiting.popleft())
        while (self.cursor is not None and self.generation == history.generation
               and self.cursor < history.head and not self._waiting):
            frame, self.cursor = history.frame(self.cursor, clock())
            await self._send(frame)
            if self.cursor < history.head:
                await asyncio.sleep(0)      # a long history lets others have their turn
        if self._waiting:
            self.wake.set()

    async def _send(self, item: bytes | str) -> None:
        self._sending_since = time.monotonic()
        if isinstance(item, str):
            await self._socket.send_str(item)
        else:
            await self._socket.send_bytes(item)
            self._left.set()
        self._sending_since = None

    def stalled(self, now: float) -> bool:
        """Return whether what is being sent does not leave; slowly is not at all another thing."""
        if self._sending_since is None:
            return False
        unsent = self._unsent_now()
        if unsent < self._unsent:
            self._sending_since = now
        self._unsent = unsent
        return now - self._sending_since > STALLED

    def leave(self) -> None:
        """Release the coroutine that waits for an answer to be sent."""
        self._left.set()

    def drop(self) -> None:
        """Cut the connection: a close frame would wait for a viewer that does not read."""
        if self._transport is not None:
            self._transport.abort()

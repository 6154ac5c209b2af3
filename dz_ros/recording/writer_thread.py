# SPDX-License-Identifier: Apache-2.0
"""Writing a run in a thread of its own, so that receiving messages never waits for a disk."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from queue import Empty, SimpleQueue
import threading
import time
from typing import Any

from dz_ros.errors import RecordingError
from dz_ros.recording.channels import Qos
from dz_ros.recording.run_description import CONFIGURATION
from dz_ros.recording.summary import Summary
from dz_ros.recording.writer import CHUNK_SECONDS, RunWriter

QueuedMessage = tuple[str, bytes, int, int]
"""Topic, payload, log time and publish time, as of `RunWriter.write`."""
_Item = Sequence[QueuedMessage] | Callable[[], None] | None

MAX_PENDING = 500_000
"""Messages that wait for a disk that does not answer; those beyond are lost."""
MAX_PENDING_BYTES = 256 << 20
"""What they take at most, without what holds them: messages from outside may be large."""
CLOSE_TIME_OUT = 5.0
"""When closing, the disk is given up after it has taken nothing for this long [s]."""
PLACE_PERIOD = 0.25
"""Period of checking that the file is still in its place [s]."""
BURST, DESCRIPTION_PERIOD = 40, 10.0
"""Descriptions that are stored at once, and the period in which one more is added to them [s];
what changes more often is in the events."""


class QueuedWriter:
    """Feeds a `RunWriter` from a queue; a context manager that closes it.

    Everything may be called from any thread and returns at once, `close` apart. The first error
    is kept; what could not be written is counted. A description that is stored already is not
    stored again, and one that keeps changing not each time (`BURST`).
    """

    def __init__(self, writer: RunWriter, idle: float = CHUNK_SECONDS, *,
                 clock: Callable[[], float] = time.monotonic) -> None:
        """Start the thread.

        Args:
            writer: The run; from now on it belongs to the thread.
            idle: Time that the thread waits before it checks for an old chunk [s].
            clock: Seconds, for descriptions that change often.
        """
        self._writer = writer
        self._idle = min(idle, PLACE_PERIOD)
        self._clock = clock
        self._queue: SimpleQueue[_Item] = SimpleQueue()
        self._error: RecordingError | None = None
        self._given = self._taken = self._lost = self._refused = 0
        self._given_bytes = self._taken_bytes = 0
        self._giving = threading.Lock()
        self._described: dict[str, Mapping[str, Any]] = {}
        self._changed: dict[str, Mapping[str, Any]] = {}
        self._descriptions = 0
        self._began = clock()
        self._placed = 0.0
        self._closed: Summary | None = None
        self._closing = threading.Lock()
        self._thread = threading.Thread(target=self._run, name='run writer', daemon=True)
        self._thread.start()

    @property
    def error(self) -> RecordingError | None:
        """The first thing that went wrong, or None."""
        return self._error

    @property
    def pending(self) -> int:
        """Number of messages that wait to be written."""
        return self._given - self._taken - self._refused

    @property
    def lost(self) -> int:
        """Number of messages refused so far; a file that breaks loses its open chunk besides."""
        return self._lost + self._refused

    @property
    def condition(self) -> str:
        """Why the disk does not take what is written now, as of `OutputFile.condition`."""
        return self._writer.file.condition

    @property
    def broken(self) -> bool:
        """Whether nothing can be written any more."""
        return self._writer.file.failure is not None

    @property
    def directory(self) -> Path:
        """The run, where it is now."""
        return self._writer.directory

    def put(self, topic: str, payload: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Give one message to be stored; arguments as of `RunWriter.write`."""
        self.put_all([(topic, payload, log_time_ns, publish_time_ns)])

    def put_all(self, messages: Sequence[QueuedMessage]) -> None:
        """Give messages to be stored, at one wake-up of the thread; they are not copied."""
        if not messages:
            return
        with self._giving:
            sizes = [len(message[1] or b'') for message in messages]
            room = self._room(sizes)
            refused = max(len(messages) - room, 0)
            if refused:
                messages = messages[:room]
                self._refused += refused
                self._error = self._error or RecordingError(
                    f'{self._writer.path}: the disk does not keep up; {MAX_PENDING} messages or '
                    f'{MAX_PENDING_BYTES >> 20} MiB wait, those beyond are lost')
            self._given_bytes += sum(sizes[:room])
            self._given += len(messages) + refused
        if messages:
            self._queue.put(messages)

    def _room(self, sizes: Sequence[int]) -> int:
        """Return how many of these messages, from the first on, may wait as well."""
        most = max(MAX_PENDING - self.pending, 0)
        free = MAX_PENDING_BYTES - (self._given_bytes - self._taken_bytes)
        if sum(sizes) <= free:
            return most
        return min(most, sum(total <= free for total in accumulate(sizes)))

    def add_topic(self, topic: str, type_name: str,
                  qos: Qos | Sequence[Mapping[str, Any]] | None = None) -> None:
        """Register a topic ahead of its messages."""
        self._queue.put(lambda: self._writer.add_topic(topic, type_name, qos))

    def add_metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Store texts under a name; those stored before under the same name may be left out."""
        self._queue.put(lambda: self._describe(name, mapping))

    def add_configuration(self, configuration: Mapping[str, Any]) -> None:
        """Store all that is known of the configuration by now."""
        known = dict(configuration)
        self._queue.put(lambda: self._describe(CONFIGURATION, known))

    def close(self) -> Summary:
        """Write what is pending, close the run and return what it holds; raises nothing.

        Where the file cannot be finished, the summary is not complete and `error` has the cause.
        """
        with self._closing:
            if self._closed is None:
                self._queue.put(None)
                self._closed = self._finish() if self._written() else self._give_up()
            return self._closed

    def _written(self) -> bool:
        """Wait for the thread; return whether it has ended, False if the disk does not answer."""
        before = None
        while self._thread.is_alive() and before != (
                reached := (self._taken, self._writer.file.stored.bytes)):
            before = reached
            self._thread.join(CLOSE_TIME_OUT)
        return not self._thread.is_alive()

    def _finish(self) -> Summary:
        """Close the run."""
        try:
            found = self._writer.close()
        except RecordingError as error:
            self._error = self._error or error
            found = self._writer.summary()
        return self._account(found)

    def _give_up(self) -> Summary:
        """Leave the run to a thread that waits for the disk."""
        self._error = self._error or RecordingError(
            f'{self._writer.path}: the disk has not answered for {CLOSE_TIME_OUT:g} s; what it '
            f'holds is kept: dz bag recover {self._writer.directory}')
        return self._account(self._writer.file.stored)

    def _account(self, found: Summary) -> Summary:
        """Count as lost whatever was given and is not in what was found."""
        self._taken, self._refused = self._given, 0     # also what was put after the end
        self._lost = self._given - found.messages
        return replace(found, lost=self._lost)

    def __enter__(self) -> QueuedWriter:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _run(self) -> None:
        """Write until None comes."""
        try:
            while True:
                try:
                    item = self._queue.get(timeout=self._idle)
                except Empty:
                    item = self._writer.flush_if_due
                if item is None:
                    self._store(lambda: self._catch_up(len(self._changed)))
                    return
                self._store(item)
                now = time.monotonic()
                if now - self._placed >= PLACE_PERIOD:
                    self._placed = now
                    self._store(self._check_place)
                    self._store(self._catch_up)
        except BaseException as error:
            self._error = self._error or RecordingError(f'recording broke: {error!r}')
            raise

    def _check_place(self) -> None:
        """Find out whether the file is still in its place, unless that is over."""
        if not self.broken:
            self._writer.file.check_place()

    def _describe(self, name: str, description: Mapping[str, Any]) -> None:
        """Take a description, the last one of its name, to be stored as soon as it may."""
        self._changed.pop(name, None)
        if self._described.get(name) != description:
            self._changed[name] = description
            self._catch_up()

    def _catch_up(self, at_least: int = 0) -> None:
        """Store descriptions that have changed, as many as may be by now."""
        allowed = BURST + int((self._clock() - self._began) / DESCRIPTION_PERIOD)
        for name in list(self._changed)[:max(allowed - self._descriptions, at_least)]:
            self._descriptions += 1
            self._described[name] = found = self._changed.pop(name)
            if name == CONFIGURATION:
                self._writer.add_configuration(found)
            else:
                self._writer.add_metadata(name, found)

    def _store(self, item: Sequence[QueuedMessage] | Callable[[], None]) -> None:
        """Write messages or do something else with the run; keep the first error."""
        if callable(item):
            try:
                item()
            except RecordingError as error:
                self._error = self._error or error
            return
        for message in item:
            self._taken += 1
            self._taken_bytes += len(message[1])
            try:
                self._writer.write(*message)
            except RecordingError as error:
                self._error = self._error or error
                self._lost += 1

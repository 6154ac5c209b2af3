"""A run written by a thread of its own, so that who receives messages never waits for a disk."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from queue import Empty, SimpleQueue
import threading
from typing import Any

from dz_ros.errors import RecordingError
from dz_ros.recording.channels import Qos
from dz_ros.recording.summary import Summary
from dz_ros.recording.writer import CHUNK_SECONDS, RunWriter

QueuedMessage = tuple[str, bytes, int, int]
"""Topic, payload, log time and publish time, as of `RunWriter.write`."""
_Item = Sequence[QueuedMessage] | Callable[[], None] | None


class QueuedWriter:
    """Feeds a `RunWriter` from a queue; a context manager that closes it.

    Everything may be called from any thread and returns at once, `close` apart. The first error
    is kept; what could not be written is counted.
    """

    def __init__(self, writer: RunWriter, idle: float = CHUNK_SECONDS) -> None:
        """Start the thread.

        Args:
            writer: The run; from now on it belongs to the thread.
            idle: How long the thread waits before it looks for an old chunk [s].
        """
        self._writer = writer
        self._idle = idle
        self._queue: SimpleQueue[_Item] = SimpleQueue()
        self._error: RecordingError | None = None
        self._given = self._taken = self._lost = 0
        self._giving = threading.Lock()
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
        return self._given - self._taken

    @property
    def lost(self) -> int:
        """Number of messages refused so far; a file that breaks loses its open chunk besides."""
        return self._lost

    def put(self, topic: str, payload: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Give one message to be stored; arguments as of `RunWriter.write`."""
        self.put_all([(topic, payload, log_time_ns, publish_time_ns)])

    def put_all(self, messages: Sequence[QueuedMessage]) -> None:
        """Give messages to be stored, at one wake-up of the thread; they are not copied."""
        if messages:
            with self._giving:
                self._given += len(messages)
            self._queue.put(messages)

    def add_topic(self, topic: str, type_name: str,
                  qos: Qos | Sequence[Mapping[str, Any]] | None = None) -> None:
        """Register a topic ahead of its messages."""
        self._queue.put(lambda: self._writer.add_topic(topic, type_name, qos))

    def add_metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Store texts under a name."""
        self._queue.put(lambda: self._writer.add_metadata(name, mapping))

    def add_configuration(self, configuration: Mapping[str, Any]) -> None:
        """Store configuration that became known after the start."""
        self._queue.put(lambda: self._writer.add_configuration(configuration))

    def close(self) -> Summary:
        """Write what is pending, close the run and return what it holds; raises nothing.

        Where the file cannot be finished, the summary is not complete and `error` says why.
        """
        with self._closing:
            if self._closed is None:
                self._queue.put(None)
                self._thread.join()
                self._taken = self._given       # what was put after the end is lost
                try:
                    found = self._writer.close()
                except RecordingError as error:
                    self._error = self._error or error
                    found = self._writer.summary()
                self._lost = self._taken - found.messages
                self._closed = replace(found, lost=self._lost)
            return self._closed

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
                    return
                self._store(item)
        except BaseException as error:
            self._error = self._error or RecordingError(f'recording broke: {error!r}')
            raise

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
            try:
                self._writer.write(*message)
            except RecordingError as error:
                self._error = self._error or error
                self._lost += 1

# SPDX-License-Identifier: Apache-2.0
"""File that is only appended to; what the disk refuses waits in memory and is written later.

The MCAP writer must never see a write fail: its offsets, indexes and checksums would no longer be
those of the file. It writes into this object, which always accepts; `store` moves what was
accepted to the disk, block by block. A block that does not fit as a whole is taken back, so the
file always ends behind a whole block and can be continued or read at any time.
"""

from __future__ import annotations

from collections import deque
from contextlib import suppress
import os
from pathlib import Path

from dz_ros.errors import RecordingError, RunExistsError
from dz_ros.recording.summary import Summary

REMOVED = ' (deleted)'
"""What the system adds to the name of an open file that was removed."""


class OutputFile:
    """New file in a directory of its own, with blocks that wait for the disk.

    Attributes:
        path: The file; `check_place` follows it where it is moved.
        backlog: Bytes that may wait for the disk; 0 = none, its first refusal is final.
        condition: Why the disk takes nothing now, and what becomes of what is written; '' while
            it does.
        failure: What has ended the writing; None = nothing.
        size: Bytes on the disk.
    """

    def __init__(self, path: Path) -> None:
        """Create the file.

        Raises:
            OSError: It is there, or cannot be created.
        """
        self.path = path
        self.backlog = 0
        self.condition = ''
        self.failure: RecordingError | None = None
        self.size = 0
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC,
                                   0o666)
        self._origin = self._link()
        self._block: list[bytes] = []
        self._blocks: deque[tuple[bytes, Summary]] = deque()
        self._waiting = 0
        self._accepted = 0
        self._refusal = ''
        self._stored = Summary(self.directory, {}, 0, None, 0.0, complete=False)

    @classmethod
    def in_new_directory(cls, directory: Path) -> OutputFile:
        """Return the file NAME/NAME_0.mcap of a directory NAME that is made.

        Raises:
            RunExistsError: The directory exists.
            RecordingError: It or the file cannot be created.
        """
        try:
            directory.mkdir(parents=True)
            return cls(directory / f'{directory.name}_0.mcap')
        except FileExistsError:
            raise RunExistsError(f'{directory} exists already and a run is never overwritten: '
                                 'choose another name or move it away') from None
        except OSError as error:
            with suppress(OSError):
                directory.rmdir()
            raise RecordingError(f'{directory} cannot be created: '
                                 f'{error.strerror or error}') from None

    @property
    def directory(self) -> Path:
        """Where the file is."""
        return self.path.parent

    @property
    def waiting(self) -> bool:
        """Whether there is something that the disk has refused."""
        return self._waiting > 0

    @property
    def full(self) -> bool:
        """Whether as much waits as may."""
        return self._waiting > self.backlog

    @property
    def stored(self) -> Summary:
        """What is on the disk; of a file that was removed, nothing."""
        return Summary(self.directory, self._stored.topics, self.size, self._stored.start_ns,
                       self._stored.duration, complete=False)

    def write(self, data: bytes) -> int:
        """Accept data; never fails."""
        self._block.append(bytes(data))
        self._accepted += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes accepted so far."""
        return self._accepted

    def flush(self) -> None:
        """Do nothing, which is all that a writer may ask for: `store` decides when to write."""

    def store(self, summary: Summary) -> None:
        """Make a block of what was accepted since the last one; write all blocks that wait.

        Args:
            summary: What the file holds with this block.

        Raises:
            RecordingError: The disk refuses a block and there is no backlog.
        """
        block = b''.join(self._block)
        self._block.clear()
        self._blocks.append((block, summary))
        self._waiting += len(block)
        try:
            while self._blocks:
                block, summary = self._blocks[0]
                self._put(block)
                self._blocks.popleft()
                self.size += len(block)
                self._waiting -= len(block)
                self._stored = summary
        except OSError as error:
            self._refusal = f'{self.path} cannot be written: {error.strerror or error}'
            if not self.backlog:
                raise self.fail(f'{self._refusal}; what it holds is kept: dz bag recover '
                                f'{self.directory}') from None
            self.condition = (
                f'{self._refusal}; {self._room} wait in memory, messages are lost from now on'
                if self.full else f'{self._refusal}; up to {self._room} wait in memory until it '
                'can be')
        else:
            self.condition = ''

    def _put(self, block: bytes) -> None:
        """Write a block behind the last one, as a whole or not at all."""
        rest = memoryview(block)
        try:
            while rest:
                written = os.pwrite(self._descriptor, rest, self.size + len(block) - len(rest))
                rest = rest[written:]
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self.size)
            raise

    @property
    def _room(self) -> str:
        """The size of the backlog as text."""
        return f'{self.backlog / 2**20:.3g} MB'

    def refuse(self) -> RecordingError:
        """Return what to raise for data that comes while the backlog is full."""
        return RecordingError(f'{self._refusal}; what came while {self._room} waited in memory '
                              'is lost')

    def check_place(self) -> None:
        """Find out whether the file is still where it was; follow it where it was moved.

        Raises:
            RecordingError: It was removed, or cut by others; nothing more can be written.
        """
        own = os.fstat(self._descriptor)
        if own.st_size < self.size:
            written, self.size = self.size, own.st_size
            self._stored = Summary(self.directory, {}, self.size, None, 0.0)
            raise self.fail(f'{self.path} was cut to {self.size} of {written} bytes by another '
                            'program while it was recorded; nothing more is recorded')
        with suppress(OSError):
            if os.path.samestat(self.path.stat(), own):
                return
        found = self._link()
        # A file that has another link has left this place as well.
        if own.st_nlink and not (found is not None and found.name.endswith(REMOVED)):
            if found is not None and found != self._origin:
                self.path = self._origin = found
            return
        held, self._stored = self._stored.messages, Summary(self.directory, {}, 0, None, 0.0)
        self.condition = ''
        # The descriptor stays open: until this process ends, the data can be read by it.
        self.failure = RecordingError(
            f'{self.path} was removed while it was recorded: {held} messages are lost with it '
            'and nothing more is recorded; while this process runs they can be saved: dz bag '
            f'recover /proc/{os.getpid()}/fd/{self._descriptor} NEW')
        raise self.failure

    def _link(self) -> Path | None:
        """Return the file's path as the system knows it; None where that cannot be found out."""
        try:
            return Path(f'/proc/self/fd/{self._descriptor}').readlink()
        except OSError:
            return None

    def fail(self, message: str) -> RecordingError:
        """Close the file for good; return what to raise, then and for all that comes later."""
        self.failure = RecordingError(message)
        with suppress(OSError):
            self._release()
        return self.failure

    def close(self) -> None:
        """Close the file; again is nothing.

        Raises:
            RecordingError: The system has kept back an error of an earlier write.
        """
        try:
            self._release()
        except OSError as error:
            raise self.fail(f'{self.path} cannot be written: {error.strerror or error}; what it '
                            f'holds is kept: dz bag recover {self.directory}') from None

    def discard(self) -> None:
        """Close and remove a file that holds nothing, and its directory."""
        self._release()
        self.path.unlink()
        self.directory.rmdir()

    def _release(self) -> None:
        """Close the descriptor."""
        if self._descriptor >= 0:
            descriptor, self._descriptor = self._descriptor, -1
            os.close(descriptor)

# SPDX-License-Identifier: Apache-2.0
"""Whether the machine, not the driver, was late: by its scheduler, and by a process that waits.

A sample that a driver answers late proves nothing while the machine does not run its processes.
`MachineWatch` starts a process of its own, which waits for a millisecond again and again: where
it is woken late, so may be anything else. It shares no interpreter with the driver, so a driver
that blocks is not mistaken for the machine. `RunQueue` knows of one thread alone for how long it
could have run and was not let, which the first sees only where every core is as busy.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
import os
import subprocess
import sys
from types import TracebackType

Stall = tuple[float, float]
"""Begin and end of a time in which the machine did not run a process, by the steady clock [s]."""

LEAST = 1e-3
"""Shortest stall that is noted [s]."""
_MOST = 1000
"""Stalls kept between two questions."""
_PROGRAM = f"""
import select, sys, time
stalls, end = [], time.monotonic()
while True:
    begin = end
    asked = select.select([sys.stdin], [], [], 1e-3)[0]
    end = time.monotonic()
    if end - begin > 1e-3 + {LEAST}:
        stalls = [*stalls[-{_MOST - 1}:], (begin, end)]
    if asked:
        if not sys.stdin.readline():
            break
        print(*(f'{{begin!r}},{{end!r}}' for begin, end in stalls), flush=True)
        stalls = []
"""


class MachineWatch:
    """Notes the stalls of this machine while it is open; a context manager.

    Attributes:
        process: The process that waits.
    """

    def __init__(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, '-I', '-S', '-c', _PROGRAM], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, text=True, start_new_session=True)

    def stalls(self) -> tuple[Stall, ...]:
        """Return the stalls since the last call; none where the process has ended."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            self.process.stdin.write('\n')
            self.process.stdin.flush()
            texts = self.process.stdout.readline().split()
        except (OSError, ValueError):
            return ()
        return tuple((float(begin), float(end)) for begin, end in
                     (text.split(',') for text in texts))

    def close(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            with suppress(OSError):     # what could not be written any more
                if stream is not None:
                    stream.close()

    def __enter__(self) -> MachineWatch:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()


class RunQueue:
    """How long this thread was ready to run while others ran; a context manager.

    Where the system does not report it, that is 0.
    """

    def __init__(self) -> None:
        try:
            self._file = os.open('/proc/thread-self/schedstat', os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            self._file = -1

    def waited(self) -> float:
        """Return the time since the thread began, as of proc(5), schedstat [s]."""
        try:
            return int(os.pread(self._file, 100, 0).split()[1]) * 1e-9
        except (OSError, ValueError, IndexError):
            return 0.0

    def __enter__(self) -> RunQueue:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if self._file >= 0:
            os.close(self._file)


def overlap(stalls: Iterable[Stall], begin: float, end: float) -> float:
    """Return how long the machine stalled between two instants [s]."""
    return sum(max(0.0, min(last, end) - max(first, begin)) for first, last in stalls)


def lateness(stalls: Sequence[Stall]) -> str:
    """Return a sentence's part on the longest stall, '' without any."""
    if not stalls:
        return ''
    longest = max(end - begin for begin, end in stalls)
    return (f'the machine was late too: a process that only waits stood still {len(stalls)} '
            f'times, for up to {longest * 1e3:.1f} ms')

"""What a process asks of the operating system so that others cannot hold it up.

Nothing of it is needed, and all of it may be refused: what is refused comes back as words, one for
each, and the process goes on without. Linux; elsewhere everything is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
import ctypes
import os
from pathlib import Path

_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4
ADVICE = ('run it as root, or allow it in /etc/security/limits.conf (rtprio 98, memlock '
          'unlimited) and log in anew; dz doctor says what it would gain')


def usable_cores() -> list[int]:
    """Return the cores this process may run on, by number."""
    if hasattr(os, 'sched_getaffinity'):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def _threads() -> Iterable[int]:
    """Return the ids of all threads of this process; threads made later inherit from theirs."""
    return [int(path.name) for path in Path('/proc/self/task').iterdir()]


def use_fifo(priority: int) -> None:
    """Let all threads run under SCHED_FIFO.

    Raises:
        OSError: Not permitted, or there is no such thing.
    """
    if not hasattr(os, 'sched_setscheduler'):
        raise OSError('not on this system')
    for thread in _threads():
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))


def use_cores(cores: Iterable[int]) -> None:
    """Let all threads run on these cores only.

    Raises:
        OSError: None of them exists or is allowed, or there is no such thing.
    """
    if not hasattr(os, 'sched_setaffinity'):
        raise OSError('not on this system')
    for thread in _threads():
        os.sched_setaffinity(thread, cores)


def lock_memory() -> None:
    """Keep what the process has touched, and will touch, in RAM.

    Raises:
        OSError: Not permitted, or there is no such thing.
    """
    library = ctypes.CDLL(None, use_errno=True)
    if not hasattr(library, 'mlockall'):
        raise OSError('not on this system')
    if library.mlockall(_CURRENT | _FUTURE | _ON_FAULT):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def ask(priority: int = 0, cores: Iterable[int] = (), lock: bool = False) -> list[str]:
    """Ask for what is wanted; return what was refused, in words.

    Args:
        priority: SCHED_FIFO priority; 0 = none.
        cores: Cores to run on; none = any.
        lock: Whether to lock the memory.
    """
    wanted: list[tuple[str, Callable[[], None]]] = []
    cores = sorted(cores)
    if cores:
        wanted.append((f'cores {",".join(map(str, cores))}', lambda: use_cores(cores)))
    if lock:
        wanted.append(('locked memory', lock_memory))
    if priority:
        wanted.append((f'SCHED_FIFO {priority}', lambda: use_fifo(priority)))
    refused = []
    for what, do in wanted:
        try:
            do()
        except (OSError, ValueError) as error:
            refused.append(f'{what} ({getattr(error, "strerror", None) or error})')
    return refused

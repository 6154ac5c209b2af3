# SPDX-License-Identifier: Apache-2.0
"""Privileges a process asks of the operating system so that others cannot hold it up.

None is needed, and all may be refused: refusals come back as text, and the process goes on
without. Linux; elsewhere everything is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
import ctypes
import os
from pathlib import Path

_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4
ADVICE = ('run it as root, or allow it in /etc/security/limits.conf (rtprio 98, memlock '
          'unlimited) and log in again; dz doctor measures what it would gain')


def usable_cores() -> list[int]:
    """Return the cores this process may run on, by number."""
    if hasattr(os, 'sched_getaffinity'):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def _threads() -> Iterable[int]:
    """Return the ids of all threads of this process; threads made later inherit from theirs."""
    return [int(path.name) for path in Path('/proc/self/task').iterdir()]


def use_fifo(priority: int) -> None:
    """Let all threads run under SCHED_FIFO; OSError where that is refused."""
    if not hasattr(os, 'sched_setscheduler'):
        raise OSError('not on this system')
    for thread in _threads():
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))


def use_cores(cores: Iterable[int]) -> None:
    """Let all threads run on these cores only; OSError where that is refused."""
    if not hasattr(os, 'sched_setaffinity'):
        raise OSError('not on this system')
    for thread in _threads():
        os.sched_setaffinity(thread, cores)


def lock_memory() -> None:
    """Keep the process's memory in RAM; OSError where that is refused."""
    library = ctypes.CDLL(None, use_errno=True)
    if not hasattr(library, 'mlockall'):
        raise OSError('not on this system')
    if library.mlockall(_CURRENT | _FUTURE | _ON_FAULT):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def ask(priority: int = 0, cores: Iterable[int] = (), lock: bool = False) -> list[str]:
    """Ask for privileges; return as text which were refused.

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

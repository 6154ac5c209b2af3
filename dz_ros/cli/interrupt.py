# SPDX-License-Identifier: Apache-2.0
"""An interrupt of a long computation ends it within a second, with one line.

Python runs a signal's handler between two bytecodes of the main thread, so a long call of compiled
code would hold Ctrl-C up. A thread reads the signal at once and ends the process, with its worker
processes, where the main thread has not done it within `LIMIT`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
import multiprocessing
import os
from pathlib import Path
import signal
import sys
import threading
from types import FrameType

LIMIT = 0.8
"""Longest time from the signal to the end of the process [s]."""
INTERRUPTED = 128 + 2
NOTHING_KEPT = 'nothing is kept; the same command begins again'


def line(kept: str = '') -> str:
    """Return the line printed for an interrupt, with what was kept."""
    return f'dz: interrupted{": " if kept else ""}{kept}'


@contextmanager
def prompt_end(kept: Callable[[], str] = lambda: NOTHING_KEPT) -> Iterator[None]:
    """Raise KeyboardInterrupt for SIGINT; end the process itself where that does not end in time.

    Args:
        kept: Returns what was kept and how to go on: the text of the KeyboardInterrupt, printed
            here where the process is ended.
    """
    if (threading.current_thread() is not threading.main_thread()
            or signal.getsignal(signal.SIGINT) == signal.SIG_IGN):      # as nohup arranges
        yield
        return
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    over, asked = threading.Event(), threading.Event()

    def watch() -> None:
        while number := os.read(reading, 1):
            if number[0] != signal.SIGINT:
                continue
            asked.set()
            if not over.wait(LIMIT):
                for process in multiprocessing.active_children():
                    process.kill()
                for pid in _starting():
                    with suppress(OSError):
                        os.kill(pid, signal.SIGKILL)
                os.write(2, f'{line(kept())}\n'.encode())
                os._exit(INTERRUPTED)

    interrupted = False         # an Event has a lock, which a second interrupt would wait for

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = True
        raise KeyboardInterrupt

    def unraisable(problem: sys.UnraisableHookArgs) -> None:
        # Lost in a callback: `watch` ends it. Else an object that was interrupted half-made.
        if problem.exc_type is not KeyboardInterrupt and not asked.is_set():
            hook(problem)

    hook, sys.unraisablehook = sys.unraisablehook, unraisable
    earlier = signal.signal(signal.SIGINT, interrupt)
    wakeup = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(kept()) from None
    except Exception:       # what an interrupt in the middle of an import may be turned into
        if interrupted:
            raise KeyboardInterrupt(kept()) from None
        raise
    finally:
        over.set()
        signal.set_wakeup_fd(wakeup)
        signal.signal(signal.SIGINT, earlier)
        sys.unraisablehook = hook
        os.close(writing)
        with suppress(RuntimeError):
            thread.join()
        os.close(reading)


def _starting() -> list[int]:
    """Return worker processes that multiprocessing does not know yet, where /proc shows them.

    One that is left waiting for what it is to do would print a traceback.
    """
    found = []
    for path in Path('/proc/self/task').glob('*/children'):
        with suppress(OSError, ValueError):
            found += [pid for pid in map(int, path.read_text().split())
                      if b'spawn_main' in Path(f'/proc/{pid}/cmdline').read_bytes()]
    return found

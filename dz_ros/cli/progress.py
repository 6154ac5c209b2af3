# SPDX-License-Identifier: Apache-2.0
"""What takes long shows on standard error what it does, how far it is and how long the rest takes.

`Progress` counts what a verb does many times; `stage` names one step of a verb, with the time it
has taken, and counts where the step can. Both are silent where `silence` was asked for: with
--quiet, and with --json, whose reader is a program.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import sys
import threading
import time
import weakref

NOTICED = 3.0
"""What takes longer shows what it does, without a terminal too [s]."""
INTERVAL = 5.0
"""Between two lines where there is no terminal [s]."""
TICK = 0.5
"""Between two lines of a stage on a terminal, where each takes the place of the last one [s]."""

Step = Callable[[int, int, str], None]
"""Called with what is done, all there is, and a word."""

_silent = [False]


def silence(silent: bool) -> None:
    """Show nothing from now on, or show it again."""
    _silent[0] = silent


class _Line:
    """A line on standard error that is rewritten on a terminal."""

    def __init__(self, shown: float) -> None:
        self.begun = False
        self._width = 0
        self._shown = shown     # when the last one was, by the steady clock
        self.terminal = sys.stderr.isatty()

    def show(self, text: str, last: bool = False) -> None:
        """Show a text; elsewhere than on a terminal one in `INTERVAL`, and the last one."""
        now = time.monotonic()
        if not (self.terminal or last or now - self._shown >= INTERVAL):
            return
        self._shown, self.begun = now, True
        if self.terminal:
            print('\r' + text.ljust(self._width), end='\n' if last else '', file=sys.stderr,
                  flush=True)
        else:
            print(text, file=sys.stderr, flush=True)
        self._width = len(text)


class Progress:
    """Shows how far many runs are.

    Args:
        total: Runs in all.
        what: What there are `total` of.
        before: What goes on before the first of them is done.

    Attributes:
        done: Runs done so far.
    """

    def __init__(self, total: int, what: str = 'runs',
                 before: str = 'starting, compiling') -> None:
        self._what = what
        self._before = before
        self._total = total
        self._begin = time.monotonic()
        self._line = _Line(self._begin - INTERVAL + NOTICED)
        self._base = self.done = 0
        if self._line.terminal:
            self(0, total)
            return
        _later(NOTICED, self)       # starting may take longer than that

    def wait(self) -> None:
        """Show that it goes on where nothing has been done so far, and do so again."""
        if self.done >= self._total:
            return
        if self.done == self._base:
            passed = time.monotonic() - self._begin
            self._show(f'{self._before}: {passed:.0f} s', True)
            _later(INTERVAL, self)
        elif not self._line.begun:
            self._show('', True)

    def resume(self, done: int) -> None:
        """Count runs that were done before, so that they do not make the estimate rosy."""
        self._base = self.done = done

    def __call__(self, done: int, total: int, what: str = '') -> None:
        """Show that `done` of `total` runs are done, the last of them `what`."""
        self._total, self.done = total, done
        self._show(what, done >= total)

    def _show(self, what: str, now: bool) -> None:
        """Show how far it is, now or where a line is due."""
        if _silent[0]:
            return
        passed, left = time.monotonic() - self._begin, self._total - self.done
        self._line.show(f'{self.done} of {self._total} {self._what}, '
                        f'{_left(self.done - self._base, left, passed)}'
                        + (f' ({what})' if what else ''), now)


def _later(seconds: float, progress: Progress) -> None:
    """Have progress wait after a time, unless it has ended before."""
    timer = threading.Timer(seconds, _wait, (weakref.ref(progress),))
    timer.daemon = True
    timer.start()


def _wait(found: weakref.ref[Progress]) -> None:
    """Show a line of what still goes on."""
    progress = found()
    if progress is not None:
        progress.wait()


@contextmanager
def stage(what: str) -> Iterator[Step]:
    """Show what is being done once it takes longer than `NOTICED`.

    Args:
        what: What is being done, e.g. ``reading runs/a``.

    Yields:
        A function that takes how far it is, where that is known.
    """
    over, counts = threading.Event(), [0, 0]

    def step(done: int, total: int, _what: str = '') -> None:
        counts[:] = done, total

    def text(passed: float) -> str:
        done, total = counts
        return f'{what}: ' + (f'{done} of {total}, {_left(done, total - done, passed)}'
                              if total else f'{passed:.0f} s')

    def show() -> None:
        begin = time.monotonic()
        line = _Line(begin - INTERVAL)
        if over.wait(NOTICED):
            return
        while True:
            line.show(text(time.monotonic() - begin))
            if over.wait(TICK):
                break
        line.show(f'{what}: {time.monotonic() - begin:.0f} s', last=True)

    thread = threading.Thread(target=show, daemon=True)
    if not _silent[0]:
        thread.start()
    try:
        yield step
    finally:
        over.set()
        if thread.ident is not None:
            thread.join()


def _left(done: int, left: int, passed: float) -> str:
    """Return how long the rest takes, or all took."""
    if left <= 0:
        return f'{passed:.0f} s'
    return f'about {passed * left / done:.0f} s left' if done > 0 else 'time left unknown'

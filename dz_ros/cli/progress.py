# SPDX-License-Identifier: Apache-2.0
"""How far many runs are and how long the rest takes, on standard error."""

from __future__ import annotations

import sys
import time

NOTICED = 3.0
"""What takes longer shows its progress, without a terminal too [s]."""


class Progress:
    """A line that is rewritten on a terminal; elsewhere one every few seconds.

    Args:
        total: Runs in all.
        quiet: Print nothing.
        what: What there are `total` of.
        after: Without a terminal nothing is printed before this has passed [s].

    Attributes:
        done: Runs done so far.
    """

    INTERVAL = 5.0
    """Between two lines where there is no terminal [s]."""

    def __init__(self, total: int, quiet: bool = False, what: str = 'runs',
                 after: float = 0.0) -> None:
        self._after = after
        self._what = what
        self._total = total
        self._quiet = quiet
        self._begin = time.monotonic()
        self._shown = self._begin
        self._width = 0
        self._base = self.done = 0

    def resume(self, done: int) -> None:
        """Count runs that were done before, so that they do not make the estimate rosy."""
        self._base = self.done = done

    def __call__(self, done: int, total: int, what: str = '') -> None:
        """Show that `done` of `total` runs are done, the last of them `what`."""
        self._total, self.done = total, done
        now = time.monotonic()
        terminal = sys.stderr.isatty()
        last = done >= total
        if self._quiet or not (terminal or now - self._begin >= self._after):
            return
        if not (terminal or last or now - self._shown >= self.INTERVAL):
            return
        self._shown = now
        line = f'{done} of {total} {self._what}, {self._left(done, now)}'
        line += f' ({what})' if what else ''
        if terminal:
            print('\r' + line.ljust(self._width), end='\n' if last else '', file=sys.stderr,
                  flush=True)
        else:
            print(line, file=sys.stderr, flush=True)
        self._width = len(line)

    def _left(self, done: int, now: float) -> str:
        """Return how long the rest takes, or took."""
        passed = now - self._begin
        if done >= self._total:
            return f'{passed:.0f} s'
        fresh = done - self._base
        if fresh <= 0:
            return 'time left unknown'
        return f'about {passed * (self._total - done) / fresh:.0f} s left'

# SPDX-License-Identifier: Apache-2.0
"""What is refused or goes wrong repeatedly: counted by kind, logged at each power of ten.

Drivers and parts of nodes count (`Counted`); the node logs and puts the numbers into the
diagnostics (`CountedLog`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from dz_ros.core.text import LONGEST, printable

MAX_KINDS = 200
"""Different kinds that are counted; what comes after them is counted together."""


class Counted:
    """Counts by kind, of which there are few.

    Attributes:
        counts: Kind → number; 0 for one that has not been counted.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def add(self, what: str, detail: str = '') -> None:  # noqa: ARG002
        """Count one of a kind; `detail` is for the log."""
        self.counts[self._kind(what)] += 1

    def _kind(self, what: str) -> str:
        full = what not in self.counts and len(self.counts) >= MAX_KINDS
        return 'something else' if full else what


class CountedLog(Counted):
    """Counts and logs.

    Args:
        warn: Logs a line.
    """

    def __init__(self, warn: Callable[[str], None]) -> None:
        super().__init__()
        self._warn = warn

    def add(self, what: str, detail: str = '') -> None:
        """Count one of a kind; log its detail."""
        what = self._kind(what)
        self.set(what, self.counts[what] + 1, detail)

    def set(self, what: str, number: int, detail: str = '') -> None:
        """Take over a number that is counted elsewhere."""
        before = self.counts[what]
        self.counts[what] = number
        if number > before and _digits(number) > _digits(before):
            text = printable(detail, LONGEST)
            self._warn(f'{printable(what, LONGEST)} ({number} so far)'
                       + (f': {text}' if text else ''))


def _digits(number: int) -> int:
    return len(str(number)) if number else 0

# SPDX-License-Identifier: Apache-2.0
"""Absolute deadlines t0 + k T of the steady clock: no drift; an overrun skips whole periods."""

from __future__ import annotations

from collections.abc import Callable
import time

LATE_NS = 1_000_000
"""A tick later than this after its deadline counts as late [ns]."""


class Deadlines:
    """Ticks k = 1, 2, … at start + k T.

    Args:
        period: T [s].
        start_ns: Instant of tick 0 on the clock [ns].
        clock: Steady clock [ns].

    Attributes:
        index: Number k of the tick last begun.
        late: Ticks begun more than `LATE_NS` after their deadline.
        skipped: Ticks that were never begun because the one before overran them.
    """

    def __init__(self, period: float, start_ns: int,
                 clock: Callable[[], int] = time.monotonic_ns) -> None:
        self.period = period
        self.start_ns = start_ns
        self.index = 0
        self.late = 0
        self.skipped = 0
        self._clock = clock

    def remaining(self) -> float:
        """Return the time until the next deadline [s]; negative when it has passed."""
        return (self._deadline_ns(self.index + 1) - self._clock()) * 1e-9

    def begin(self) -> int:
        """Begin the next tick whose period has not passed altogether; return its number."""
        following = self.index + 1
        behind = self._clock() - self._deadline_ns(following)
        missed = max(0, int(behind * 1e-9 / self.period))
        self.skipped += missed
        self.index = following + missed
        if behind > LATE_NS:
            self.late += 1
        return self.index

    def _deadline_ns(self, index: int) -> int:
        return self.start_ns + round(index * self.period * 1e9)

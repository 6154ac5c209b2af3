# SPDX-License-Identifier: Apache-2.0
"""How long one hop of the loop takes, counted as it happens (ours).

    late       more than 1 ms
    too late   more than one period T: the next sample was there before the answer to this one

A histogram of everything since the start, with `PER_DECADE` classes a decade of time, and the
values of the window that is being reported. Nothing here knows a clock.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

from dz_ros.core.lateness import LATE, LATE_TEXT
from dz_ros.core.safety.health import LATE_SHARE, Level, percentiles, Report

SHORTEST, LONGEST = 1e-5, 10.0
"""Durations below and above these share the first and the last class [s]."""
PER_DECADE = 10
MAX_DURATIONS = 100_000
"""More durations than this in a window are counted, not kept."""


def edges() -> tuple[float, ...]:
    """Return the upper edges of all classes but the last [s], shape (61,)."""
    count = round(PER_DECADE * math.log10(LONGEST / SHORTEST)) + 1
    return tuple(SHORTEST * 10.0 ** (i / PER_DECADE) for i in range(count))


def quantile(counts: Sequence[int], share: float) -> float:
    """Return the upper edge of the class in which a share of all lies [s]; NaN without any."""
    whole = sum(counts)
    if not whole:
        return math.nan
    reached = 0
    uppers = edges()
    for upper, count in zip(uppers, counts, strict=False):
        reached += count
        if reached >= share * whole:
            return upper
    return uppers[-1]


class Latency:
    """Durations of one hop.

    Args:
        period: T [s].

    Attributes:
        counts: Number of durations in each class since the start.
        late, too_late: Number of those beyond 1 ms and beyond T.
        largest: The longest one [s].
    """

    def __init__(self, period: float) -> None:
        self.counts = [0] * (len(edges()) + 1)
        self.late = self.too_late = 0
        self.largest = 0.0
        self._period = period
        self._window: list[float] = []
        self._seen = 0
        self._late_before = 0

    @property
    def count(self) -> int:
        """Number of durations."""
        return sum(self.counts)

    def add(self, seconds: float) -> None:
        """Count a duration [s]."""
        place = 0
        if seconds > SHORTEST:
            place = math.ceil(PER_DECADE * math.log10(seconds / SHORTEST) - 1e-9)
        self.counts[min(place, len(self.counts) - 1)] += 1
        self._seen += 1
        if seconds > LATE:
            self.late += 1
        if seconds > self._period:
            self.too_late += 1
        if seconds > self.largest:
            self.largest = seconds
        if len(self._window) < MAX_DURATIONS:
            self._window.append(seconds)

    def report(self, report: Report, label: str, judged: bool) -> None:
        """Add the values of the window and the totals; begin the next window.

        Args:
            report: Diagnostics of the node.
            label: Name of the hop.
            judged: True where time is the wall's.
        """
        percentiles(self._window, report, label)
        report.put(f'{label} late (> {LATE_TEXT})', self.late, 'd')
        report.put(f'{label} too late (> T)', self.too_late, 'd')
        fresh = self.too_late - self._late_before
        if judged and fresh > LATE_SHARE * max(self._seen, 1):
            report.summarize(Level.WARN, f'{fresh} of {self._seen} {label} too late')
        self._late_before, self._seen = self.too_late, 0
        self._window.clear()

    def summary(self) -> dict[str, Any]:
        """Return the whole histogram by name, times in s; classes without a duration left out."""
        uppers = (*edges(), math.inf)
        return {'count': self.count, 'late': self.late, 'too_late': self.too_late,
                'p50': _number(quantile(self.counts, 0.5)),
                'p99': _number(quantile(self.counts, 0.99)),
                'p999': _number(quantile(self.counts, 0.999)), 'max': self.largest,
                'up_to': [_number(upper) for upper, count in zip(uppers, self.counts, strict=True)
                          if count],
                'in_class': [count for count in self.counts if count]}


def _number(seconds: float) -> float | None:
    """Return a duration in four digits; None where JSON has no number for it."""
    return float(f'{seconds:.4g}') if math.isfinite(seconds) else None

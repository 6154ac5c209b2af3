# SPDX-License-Identifier: Apache-2.0
"""Samples for which a device had no measurement, listed in events: their log is not torn.

Such a sample has no state and leaves out its `seq`. Ranges are collected and published so rarely
that the other events of a run stay within the depth of the topic.
"""

from __future__ import annotations

from typing import Any

EVENT_INTERVALS = 1.0, 64.0
"""Shortest and longest time between two events; it doubles from one to the next [s]."""
MAX_RANGES_PER_EVENT = 500
"""Ranges in one event."""


class Unmeasured:
    """Ranges of `seq` that are left out."""

    def __init__(self) -> None:
        self._ranges: list[list[int]] = []
        self._reason = ''
        self._published_at, self._interval = 0.0, EVENT_INTERVALS[0]

    def missed(self, seq: int, reason: str) -> None:
        """Take note of a sample without a measurement, and why there is none."""
        self._reason = reason
        if self._ranges and self._ranges[-1][1] == seq - 1:
            self._ranges[-1][1] = seq
        else:
            self._ranges.append([seq, seq])

    def due(self, seq: int, t: float) -> bool:
        """Return whether ranges are due at loop time t [s], when sample `seq` was measured."""
        return bool(self._ranges) and self._ranges[-1][1] < seq and (
            t - self._published_at >= self._interval or len(self._ranges) >= MAX_RANGES_PER_EVENT)

    def details(self, t: float) -> dict[str, Any]:
        """Return the fields of an event on the ranges so far; begin again."""
        if self._published_at:
            self._interval = min(2.0 * self._interval, EVENT_INTERVALS[1])
        ranges, self._ranges, self._published_at = self._ranges, [], t
        return {'ranges': ranges, 'reason': self._reason,
                'samples': sum(high - low + 1 for low, high in ranges)}

    def __bool__(self) -> bool:
        return bool(self._ranges)

# SPDX-License-Identifier: Apache-2.0
"""The phase of the samples, learnt by a driver from the times at which they end (ours).

A sample is that of its loop time, however late the host comes to it: what a device measured at
another instant is brought there by its speed.
"""

from __future__ import annotations

import math


class Phase:
    """When loop time 0 was on the steady clock: early samples are followed, late ones hardly.

    Args:
        period: T [s].
    """

    EARLIER, LATER = 0.3, 0.02
    RESTART = 1.0
    """Loop time that is off by more than this has restarted [s]."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._zero: float | None = None
        self._ended = -math.inf

    def sample_ended(self, now: float, t: float) -> float:
        """Note at `now` that a sample ends at loop time t [s]; return when that was [s]."""
        off = math.inf if self._zero is None else now - t - self._zero
        if self._zero is None or abs(off) > self.RESTART:
            self._zero = now - t
        else:
            self._zero += off * (self.EARLIER if off < 0.0 else self.LATER)
        self._ended = self._zero + t
        return self._ended

    def next(self, now: float, lead: float) -> float:
        """Return the instant `lead` before a sample that is later than half a period from now."""
        base = now if self._zero is None else self._zero - lead
        return base + (math.floor((now - base) / self._period + 0.5) + 1.0) * self._period

    def near(self, now: float) -> float:
        """Return the instant of the sample that has ended last; now, where none has of late."""
        return nearest(self._ended, now, self._period)


def nearest(sample: float, now: float, period: float) -> float:
    """Return the instant of a sample; now, where there is no loop or one that waits [s]."""
    return sample if abs(now - sample) < period else now

# SPDX-License-Identifier: Apache-2.0
"""When to poll for a message that is under way, and when to give up (ours).

A process that sleeps until a message wakes it up begins to wake up when the message is there. One
that polls has it at once, and keeps a core meanwhile: polling from the moment of the question
takes the core from the processes that make the answer, so that the slowest answers become slower
still, which is what a first version did. So the poller sleeps for as long as answers take at
least, wakes up just before the next one can be there, and polls for a bounded time.
"""

from __future__ import annotations

LEAD = 60e-6
"""Polling begins this long before the quickest answers: what waking up takes [s]."""
LIMITS = (1e-3, 0.2)
"""Polling ends after this time [s], and after this share of a period."""
FALL, RISE = 0.3, 0.005
"""Shares by which the estimate follows quicker and slower answers: it is a low quantile."""


class ExpectedArrival:
    """How long after a question its answer is polled for.

    Args:
        period: Between two questions [s].
    """

    def __init__(self, period: float) -> None:
        self._window = min(LIMITS[0], LIMITS[1] * period)
        self._quickest = self._period = period

    def add(self, delay: float) -> None:
        """Take note of how long an answer took [s]."""
        delay = min(max(delay, 0.0), self._period)
        share = FALL if delay < self._quickest else RISE
        self._quickest += share * (delay - self._quickest)

    @property
    def begin(self) -> float:
        """Time after the question at which polling begins [s]."""
        return max(0.0, self._quickest - LEAD)

    @property
    def end(self) -> float:
        """Time after the question at which polling ends [s]."""
        return self.begin + LEAD + self._window

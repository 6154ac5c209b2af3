# SPDX-License-Identifier: Apache-2.0
"""Working at a phase offset to the loop's period, when others do not need the machine (ours).

A node that receives a clock by messages, and whose answer is not needed before the next tick,
would otherwise wake up in the very moment in which the nodes compute that need the tick. It
does not poll until a share of the period after the next tick is due; what came meanwhile waits.

When ticks come is learnt from those that had to be waited for. From time to time one is waited for
on purpose, so a clock that runs at another speed, or restarts, is followed.
"""

from __future__ import annotations

from collections.abc import Callable
import math
import time

OFFSET_SHARE = 0.3
"""Polling begins this share of a period after a tick is due."""
TICKS_PER_LEARNING = 200
"""One tick in this number is waited for on purpose."""
MIDDLE_SHARE = 0.55
"""The work of several ticks begins this share of a period after one of them …"""
WORK_SHARE = 0.15
"""… and may keep a core for this share of a period, or the next tick would be late."""
PERIOD_RANGE = (0.0005, 0.05)
"""Only for periods within these is there a time between two ticks to speak of [s]."""
TICK_MAX_AGE = 1.0
"""A tick that came longer ago does not show when the next ones come [s]."""
WAITED_SHARE = 0.05
"""A tick within this share of a period after polling began had come before."""


def collecting_time(now: float, tick: float, period: float, work: float, least: float,
                    most: float) -> float:
    """Return how long to let the work of several ticks collect before it is done in one turn [s].

    Args:
        now: Steady clock [s].
        tick: When a tick came lately [s].
        period: T [s].
        work: How long the work of one tick takes, about [s].
        least: Shortest time [s].
        most: Longest time, before the wait for the next middle between two ticks [s].
    """
    collect = min(max(WORK_SHARE * period / work * period, least), most)
    if not PERIOD_RANGE[0] <= period <= PERIOD_RANGE[1] or abs(now - tick) > TICK_MAX_AGE:
        return collect
    return until_middle(now, tick, period, collect)


def until_middle(now: float, tick: float, period: float, least: float) -> float:
    """Return how long to sleep, at least `least`, so as to wake up between two ticks [s]."""
    middle = tick + MIDDLE_SHARE * period
    return middle + math.ceil((now + least - middle) / period) * period - now


class PhaseOffset:
    """When to poll.

    Args:
        period: T [s].
        clock: Steady clock [s].
        sleep: Sleeps for a time [s].
    """

    def __init__(self, period: float, clock: Callable[[], float] = time.monotonic,
                 sleep: Callable[[float], None] = time.sleep) -> None:
        self._period = period
        self._clock = clock
        self._sleep = sleep
        self._offset: float | None = None       # arrival of a tick, less its stamp
        self._began = clock()                   # of polling
        self._poll_at: float | None = None
        self._left = 0                          # ticks until one is waited for
        self._doubted = False

    def received(self, stamp: float, now: float) -> None:
        """Take note of a tick of this stamp [s] that was received now [s]."""
        seen, before = now - stamp, self._offset
        if now - self._began > WAITED_SHARE * self._period:     # it was waited for
            late = before is not None and seen - before > WAITED_SHARE * self._period
            if late and not self._doubted:      # the tick, or this process held up: again
                self._doubted, self._left = True, 1
            else:
                self._offset, self._doubted, self._left = seen, False, TICKS_PER_LEARNING
        elif self._left == 0 or not 0.0 <= seen - (before or 0.0) < self._period:
            self._offset = None                 # it came before it was expected
        self._left = max(self._left - 1, 0)
        if self._offset is not None:
            after = OFFSET_SHARE if self._left > 0 else -OFFSET_SHARE
            self._poll_at = stamp + self._offset + (1.0 + after) * self._period

    def rest(self) -> None:
        """Sleep until it is time to poll for the tick after the one received last."""
        if self._poll_at is not None:
            left, self._poll_at = self._poll_at - self._clock(), None
            if left > 0.0:
                self._sleep(min(left, (1.0 + OFFSET_SHARE) * self._period))
        self._began = self._clock()

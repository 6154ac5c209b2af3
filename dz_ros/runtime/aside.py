"""Working beside a beat that others need the machine for: a little later in each period (ours).

A node that hears a clock by messages, and whose answer is not needed before the next beat, would
otherwise wake up in the very moment in which those compute for whom the beat was made. It does not
listen until a share of the period after the next beat is due; what came meanwhile waits for it.

When beats come is learnt from those that had to be waited for: they are heard as they come. Every
so often one is waited for on purpose, so a clock that runs at another speed, or starts anew, is
followed.
"""

from __future__ import annotations

from collections.abc import Callable
import math
import time

SHARE = 0.3
"""Listening begins this share of a period after a beat is due."""
EVERY = 200
"""One beat in so many is waited for."""
MIDDLE = 0.55
"""Who has work for several beats at once begins this share of a period after one of them …"""
ROOM = 0.15
"""… and may keep a core for this share of a period, or the next beat would be late."""
SHORTEST, LONGEST = 0.0005, 0.05
"""Only for periods within these is there a time between two beats to speak of [s]."""
FRESH = 1.0
"""A beat that came longer ago tells nothing of when the next ones come [s]."""
AT_ONCE = 0.05
"""What is heard within this share of a period after listening began had come before."""


def turn(now: float, beat: float, period: float, work: float, least: float, most: float) -> float:
    """Return how long to let work of several beats collect before it is done in one turn [s].

    Args:
        now: Steady clock [s].
        beat: When a beat came of late [s].
        period: T [s].
        work: How long the work of one beat takes, about [s].
        least: Shortest time [s].
        most: Longest time, before the wait for the next middle between two beats [s].
    """
    beats = ROOM * period / work
    collect = min(max(beats * period, least), most)
    if not SHORTEST <= period <= LONGEST or abs(now - beat) > FRESH:
        return collect
    return until_middle(now, beat, period, collect)


def until_middle(now: float, beat: float, period: float, least: float) -> float:
    """Return how long to sleep so as to wake up between two beats [s].

    Args:
        now: Steady clock [s].
        beat: When one of the beats came, of late [s].
        period: T [s].
        least: Shortest sleep [s].
    """
    middle = beat + MIDDLE * period
    return middle + math.ceil((now + least - middle) / period) * period - now


class Aside:
    """When to listen.

    Args:
        period: T [s].
        clock: Steady clock [s].
        sleep: Sleeps so long [s].
    """

    def __init__(self, period: float, clock: Callable[[], float] = time.monotonic,
                 sleep: Callable[[float], None] = time.sleep) -> None:
        self._period = period
        self._clock = clock
        self._sleep = sleep
        self._offset: float | None = None       # arrival of a beat, less its stamp
        self._began = clock()                   # of listening
        self._listen: float | None = None
        self._left = 0                          # beats until one is waited for
        self._doubted = False

    def heard(self, stamp: float, now: float) -> None:
        """Take note of a beat of this stamp [s] that was heard now [s]."""
        seen, before = now - stamp, self._offset
        if now - self._began > AT_ONCE * self._period:      # it was waited for
            late = before is not None and seen - before > AT_ONCE * self._period
            if late and not self._doubted:      # the beat, or this process held up: ask again
                self._doubted, self._left = True, 1
            else:
                self._offset, self._doubted, self._left = seen, False, EVERY
        elif self._left == 0 or not 0.0 <= seen - (before or 0.0) < self._period:
            self._offset = None                 # it came before it was expected
        self._left = max(self._left - 1, 0)
        if self._offset is not None:
            after = SHARE if self._left > 0 else -SHARE
            self._listen = stamp + self._offset + (1.0 + after) * self._period

    def rest(self) -> None:
        """Sleep until it is time to listen for the beat after the one heard last."""
        if self._listen is not None:
            left, self._listen = self._listen - self._clock(), None
            if left > 0.0:
                self._sleep(min(left, (1.0 + SHARE) * self._period))
        self._began = self._clock()

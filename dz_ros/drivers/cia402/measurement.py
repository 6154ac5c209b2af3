# SPDX-License-Identifier: Apache-2.0
"""Measurements from what the drive answers to SYNC (ours).

`Answers` joins the PDOs of one SYNC, in whatever order they come; `Position` follows the position
across the end of its counter and finds values that cannot be true. Nothing here knows a bus.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
import threading

from dz_ros.drivers.cia402.scaling import WHOLE, wrapped
from dz_ros.drivers.cia402.states import INTERNAL_LIMIT

REPEATED = 20
"""More SYNCs with too many answers than with the right number: another node answers."""
FROZEN = 10
"""Number of equal answers in a row that are examined for a velocity that contradicts them."""
FOLLOWS = 5
"""A torque has followed the target after this number of answers."""
FROZEN_COUNTS = 10.0
"""Counts the velocity must have promised meanwhile."""
LIVE = 4
"""A torque that has had this number of values is measured."""
JUMP = 0.5
"""Largest difference of the position from what the velocity predicts [motor turns]."""
BLIND, AT_REST = 0.25, 5.0
"""A narrow counter is followed over this time without an answer, moving or at rest [s]."""


@dataclass(frozen=True)
class Measurement:
    """Answer of the drive to one SYNC.

    Attributes:
        x: Position [unit of x].
        speed: Velocity [unit of x/s]; nan where the drive does not send it.
        synced_at: When the SYNC went out that it answers, by the steady clock [s].
        at: When it was complete [s].
        torque: Torque over the rated one; nan where the drive does not send it.
    """

    x: float
    speed: float
    synced_at: float
    at: float
    torque: float = math.nan


class Answers:
    """Joins the PDOs that answer one SYNC.

    A PDO is taken for an answer to the last SYNC. Where answers are owed, the first PDOs may be
    late ones and only the one after them is certain; what is owed for `DOUBT` SYNCs counts as
    lost. The same PDO again is no answer. A sample that is not certain is left out.

    Args:
        streams: Number of PDOs that answer each SYNC.

    Attributes:
        repeated: SYNCs with too many answers, less those with the right number.
    """

    DOUBT = 2
    CREDIT = 8
    """Number of answers counted as lost that may still come."""

    def __init__(self, streams: int) -> None:
        self.repeated = 0
        self._lock = threading.Lock()
        self._synced_at: float | None = None
        self._owed = [0] * streams
        self._doubt = [0] * streams
        self._credit = [0] * streams
        self._came = [0] * streams
        self._found: list[tuple[int, ...] | None] = [None] * streams

    def sync(self, at: float) -> None:
        """Begin a sample, just before its SYNC goes out at `at` [s]."""
        with self._lock:
            if self._synced_at is not None:
                balance = [owed + 1 - came
                           for owed, came in zip(self._owed, self._came, strict=True)]
                more = False
                for stream, owed in enumerate(balance):
                    self._doubt[stream] = self._doubt[stream] + 1 if owed > 0 else 0
                    lost = self._came[stream] > 0 and self._doubt[stream] > self.DOUBT
                    credit = self._credit[stream]
                    more = more or owed + credit < 0
                    if owed < 0 or lost:
                        self._credit[stream] = min(max(credit + owed, 0), self.CREDIT)
                    self._owed[stream] = 0 if lost else max(owed, 0)
                if more:
                    self.repeated += 1
                elif max(balance) <= 0:
                    self.repeated = max(self.repeated - 1, 0)
            self._synced_at = at
            self._came = [0] * len(self._came)
            self._found = [None] * len(self._found)

    def take(self, stream: int, values: tuple[int, ...]
             ) -> tuple[float, Sequence[tuple[int, ...]]] | None:
        """Take a PDO's values; return (instant of the SYNC, values of each PDO) when complete."""
        with self._lock:
            self._came[stream] += 1
            if self._synced_at is None or self._came[stream] != 1 + self._owed[stream]:
                return None
            self._found[stream] = values
            whole = [item for item in self._found if item is not None]
            return (self._synced_at, whole) if len(whole) == len(self._found) else None


class Position:
    """Follows a position across the end of its counter.

    Args:
        turn: Counts of a motor turn.
        modulus: Number of values of the counter; 2^32 for a plain one.

    Attributes:
        lost: Whether it is not known any more how many turns were made.
        last: Newest counts with turns, speed [counts/s] and when [s]; None before the first.
    """

    def __init__(self, turn: float, modulus: int = WHOLE) -> None:
        self.turn = turn
        self.modulus = modulus
        self.lost = False
        self.last: tuple[int, float, float] | None = None

    @property
    def narrow(self) -> bool:
        """Whether the counter has fewer than 32 bits."""
        return self.modulus < WHOLE

    def forget(self) -> None:
        """Take the next count as it is."""
        self.last, self.lost = None, False

    def follow(self, counts: int, speed: float, at: float) -> tuple[int | None, str]:
        """Return the position without wraps, None if it is not known, and what is wrong, or ''.

        Args:
            counts: Position actual value.
            speed: Velocity [counts/s]; nan = not measured.
            at: When both were [s].
        """
        if self.last is None:
            self.last = (counts, speed, at)
            return counts, ''
        last, before, then = self.last
        passed = at - then
        speeds = [item for item in (before, speed) if math.isfinite(item)]
        if self.lost:
            return None, ''
        if self.narrow and passed > BLIND and (
                passed > AT_REST or max(map(abs, speeds), default=0.0) * passed
                > self.modulus / 8.0):
            self.lost = True
            return None, (f'no position for {passed:.2f} s: a counter of {self.modulus} values '
                          'does not show how many turns were made')
        promised = passed * sum(speeds) / len(speeds) if speeds else 0.0
        nearest = last + round(promised)
        position = nearest + wrapped(counts - nearest, self.modulus)
        slack = JUMP * self.turn + passed * sum(abs(item) for item in speeds)
        off = abs(position - last - promised)
        if passed < BLIND and speeds and off > slack:
            self.lost = True
            return None, (f'the position jumps by {wrapped(counts - last, self.modulus)} counts '
                          'where the velocity gives '
                          f'{promised:.0f}: homed meanwhile, a modulo axis or a narrow counter '
                          '(driver.position_range)?')
        if not math.isfinite(speed) and passed > 0.0:
            speed = (position - last) / passed      # the only one there is
        self.last = (position, speed, at)
        return position, ''


class Repeats:
    """Finds a drive that sends the same answer again and again.

    An axis at rest does that too. What contradicts it is a velocity, or a torque that used to
    change and no longer does where the target changes.

    Args:
        swing: Change of the target that a torque must follow [number of its object].
    """

    def __init__(self, swing: float) -> None:
        self._swing = swing
        self._torques: set[int] = set()
        self._answer: object = None
        self._number = 0
        self._since = 0.0
        self._targets = (0, 0)
        self._swung = 0         # answers since the target has changed by more than the swing

    def look(self, answers: Sequence[tuple[int, ...]], speed: float, at: float,
             target: int) -> str:
        """Return what is wrong where the same answer comes again and again, or ''.

        Args:
            answers: All answers to one SYNC: status and position, velocity and
                torque.
            speed: Its velocity [counts/s]; nan = not measured.
            at: When [s].
            target: Its last target.
        """
        if len(self._torques) < LIVE and len(answers) > 1:
            self._torques.add(answers[1][1])
        if answers != self._answer:
            self._answer, self._number, self._since = answers, 1, at
            self._targets, self._swung = (target, target), 0
            return ''
        self._number += 1
        self._targets = (min(self._targets[0], target), max(self._targets[1], target))
        self._swung += self._targets[1] - self._targets[0] > self._swing
        if self._number <= FROZEN:
            return ''
        if abs(speed) * (at - self._since) > FROZEN_COUNTS:
            return (f'the drive repeats one answer: its position stands still at a velocity of '
                    f'{speed:.0f} counts/s')
        if answers[0][0] & INTERNAL_LIMIT:
            return ''       # its own limit holds the torque, whatever the target
        # A target that was just given may be later than the SYNC that was answered.
        if len(self._torques) >= LIVE and self._swung >= FOLLOWS:
            return ('the drive repeats one answer: its torque does not change where the target '
                    f'goes from {self._targets[0]} to {self._targets[1]}')
        return ''

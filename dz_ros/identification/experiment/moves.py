# SPDX-License-Identifier: Apache-2.0
"""The moves that show a dead-zone: slow ramps and steps both ways, ended by coasting or braking.

    rest          v = 0: noise of the measurement, and whether the device stays where it is
    each repeat   ramp right, ramp left, step right, step left, then a rest of random length
    a ramp        |v| grows at effort/ramp until the device has moved far or fast enough; from the
                  second one on it begins at half of where motion began the last time
    a step        |v| that ended the last ramp of its side, until the same
    then          coasting, v = 0, or braking: a ramp the other way, twice as fast, until it stands

While the device moves one way its friction keeps its sign, and v passes both ends of the
dead-zone or rests within it: only such motion separates friction and dead-zone, break-away from
rest does not. The places at which repeats begin are random, so that what depends on position
differs between them and shows as scatter instead of hiding as an error common to all.

A move ends at 0.6 of the speed limit or after 0.3 of the travel. Beyond a limit the safe command
goes out; once the device stands it is led back by slow ramps. It gives up where the device does
not come to rest, passes a limit for the fourth time, does not move, or moves against the command.
A move in which the machine stalled, so that a command was held for long, is made again, and what a
limit stopped in it does not count.
At order 1 the state x is the speed: it has no place, and travel limits it alone. Neither clock nor
device: measurements in, command out. (ours)

Over 300 lines: the moves are one generator, whose parts hand on where they stopped.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from functools import partial
from itertools import pairwise
import math
import random
from statistics import mean, stdev

from dz_ros.errors import DriverError
from dz_ros.identification.experiment.plan import Limits, MOVING, NOISE, Plan

REST = 1.0
"""Rest at the beginning [s]."""
SETTLE = 0.2
"""Rest after each move [s]."""
FILTER = 0.04
"""Decisions are made on the mean of this long [s]."""
NEAR, FAR, AWAY = 0.3, 0.6, 0.7
"""Shares of the travel: length of a move; place at which one ends in any case, and at which
coasting becomes braking."""
FAST = 0.6
"""Share of the speed limit (order 1: of the travel) at which a move ends."""
COAST = 2.0
"""Coasting becomes braking after this [s]."""
STOP = 10.0
"""Within this the device must have come to rest [s]."""
BREACHES = 3
"""Number of times a limit may be passed."""
STALL = 0.05
"""A command that was held this much longer than T is a stall of the machine [s]."""
TRIES = 3
"""Number of times a move is made where the machine stalls in it."""
WAYS = 20
"""Moves that a way back may take; from where it then stands the next move begins."""

Moves = Generator[float, None, None]
"""Yields a command; resumed with the next measurement in the attributes."""


class _BreachError(DriverError):
    """A limit was passed; the text names it."""


class Experiment:
    """Generator of commands from measurements.

    Args:
        limits: How far, fast and hard.
        plan: What is done within them.
        order: Order n of the device's loop.
        period: T [s].
        safe_command: Command at rest [actuator unit].

    Attributes:
        repeat: Number of the present repeat; −1 at rest and on ways between.
        kind: Part of the experiment: rest, ramp, step, coast, brake or return.
        home: Where x was at the beginning.
        moving: Speed (order 1: |x|) beyond which the device counts as moving.
        noise: Standard deviation of x, x' … at rest, shape (n,).
        breakaway: (repeat, v) at each begin of a motion on a ramp, the sign of v its side.
        breaches: What the limits stopped, as text; not what a stall of the machine caused.
        stalls: Durations of the stalls of the machine [s].
    """

    def __init__(self, limits: Limits, plan: Plan, order: int, period: float,
                 safe_command: float = 0.0) -> None:
        self.limits, self.plan = limits, plan
        self.repeat, self.kind = -1, 'rest'
        self.home = 0.0
        self.noise: tuple[float, ...] = ()
        self.breakaway: list[tuple[int, float]] = []
        self.breaches: list[str] = []
        self.stalls: list[float] = []
        self._stalled = False
        self._placed = order > 1
        self._period, self._safe = period, safe_command
        self._rate = limits.effort / plan.ramp
        self._fast = limits.speed if self._placed else limits.travel
        self.moving = MOVING * self._fast
        self._recent: deque[Sequence[float]] = deque(maxlen=max(1, round(FILTER / period)))
        self._begun: dict[int, float] = {}      # side → |v| at which motion began on a ramp
        self._ends: dict[int, float] = {}       # side → |v| that ended a ramp
        self._random = random.Random(plan.seed)
        self._x = self._speed = 0.0
        self._guarded = False
        self._moves = self._all()

    @property
    def duration(self) -> float:
        """About how long it takes [s]: four moves a repeat, each a ramp and a way back."""
        return REST + self.plan.repeats * (4.0 * (self.plan.ramp + SETTLE) + self.plan.pause)

    @property
    def position(self) -> float:
        """Where x is, from where it was at the beginning."""
        return self._x

    def command(self, x: Sequence[float]) -> float | None:
        """Return the command after the measurement x, shape (n,); None = it is over.

        Raises:
            DriverError: The device does not do what it would have to.
        """
        self._recent.append(x)
        means = [sum(item) / len(self._recent) for item in zip(*self._recent, strict=True)]
        self._x = means[0] - self.home
        self._speed = means[1] if self._placed else self._x
        return next(self._moves, None)

    def stalled(self, duration: float) -> None:
        """Note that a command was held for this much longer than T: the move is made again [s]."""
        if duration >= STALL:
            self.stalls.append(duration)
            self._stalled = True

    # The moves.

    def _all(self) -> Moves:
        yield from self._at_rest()
        self._guarded = True
        for repeat in range(self.plan.repeats):
            place = self._random.uniform(-NEAR, NEAR) * self.limits.travel
            for i, (kind, side) in enumerate((('ramp', 1), ('ramp', -1), ('step', 1),
                                              ('step', -1))):
                yield from self._tried(partial(self._measured, repeat, place, kind, side,
                                               (repeat + i // 2) % 2 == 0))
            yield from self._rest(self.plan.pause * self._random.uniform(0.5, 1.5))
        try:
            yield from self._towards(0.0, 1 if self._x < 0.0 else -1)
        except _BreachError as breach:
            yield from self._back(str(breach))

    def _measured(self, repeat: int, place: float, kind: str, side: int,
                  coasting: bool) -> Moves:
        """Go to where a move begins, and make it."""
        yield from self._towards(place, -side)
        self.repeat = repeat
        yield from self._move(kind, side, coasting)

    def _tried(self, make: Callable[[], Moves]) -> Moves:
        """Make a move, again where the machine stalls in it; where a limit is passed go back.

        Raises:
            DriverError: As `_back`.
        """
        for _ in range(TRIES):
            self._stalled = False
            try:
                yield from make()
            except _BreachError as breach:
                yield from self._back(str(breach))
            self.repeat = -1
            if not self._stalled:
                break

    def _at_rest(self) -> Moves:
        """Measure the noise, and check that the device stays where it is.

        Raises:
            DriverError: It does not, or the noise is too large.
        """
        seen: list[Sequence[float]] = []
        for _ in range(max(20, round(REST / self._period))):
            seen.append(self._recent[-1])
            yield self._safe
        columns = list(zip(*seen, strict=True))
        # Of differences, so that a drift is not taken for noise.
        self.noise = tuple(stdev(b - a for a, b in pairwise(item)) / math.sqrt(2.0)
                           for item in columns)
        half = len(seen) // 2
        first, last = mean(columns[0][:half]), mean(columns[0][half:])
        self.home = mean(columns[0])
        self._x = last - self.home
        if abs(last - first) > max(0.05 * self.limits.travel, NOISE * self.noise[0]):
            raise DriverError(f'the device does not rest under the command {self._safe:g}: it '
                              f'went from {first:.4g} to {last:.4g} within a second; hold it, or '
                              'use a run of a loop that holds it (--from)')
        index = int(self._placed)
        self.moving = max(self.moving, NOISE * self.noise[index] / len(self._recent) ** 0.5)
        if self.moving > 0.5 * FAST * self._fast:
            raise DriverError(f'the noise of x{index}, {self.noise[index]:.3g}, hides motion: '
                              f'allow more than {self._fast:g}')

    def _move(self, kind: str, side: int, coasting: bool, place: float | None = None) -> Moves:
        """Drive to one side until far or fast enough, then stop.

        Args:
            kind: ramp, step or return.
            side: 1 or −1, the sign of v.
            coasting: Whether it coasts before it brakes.
            place: Where it ends; None = after a share of the travel.

        Raises:
            DriverError: It does not move, or not that way.
        """
        self.kind = kind
        step = kind == 'step' and side in self._ends
        v = self._ends[side] if step else 0.5 * self._begun.get(side, 0.0)
        end = self._x + side * NEAR * self.limits.travel if place is None else place
        end = min(side * end, FAR * self.limits.travel)
        moving, waited = False, 0.0
        if self._placed and side * self._x >= end:
            return
        while not (side * self._speed >= FAST * self._fast or waited > self.plan.ramp
                   or (self._placed and side * self._x >= end)):
            yield from self._give(side * v)
            if not moving and side * self._speed > self.moving:
                moving = True
                if not step:
                    self._begun[side] = v
                if kind == 'ramp':
                    self.breakaway.append((self.repeat, side * v))
            if not moving and side * self._speed < -0.5 * FAST * self._fast:
                raise DriverError('the device moves against the command: turn the sign of the '
                                  'command or of the measurement')
            if step or v >= self.limits.effort:
                waited += self._period
            v = v if step else min(v + self._rate * self._period, self.limits.effort)
        if not moving and waited > self.plan.ramp:
            raise DriverError(f'no motion {"right" if side > 0 else "left"} up to |v| = {v:.4g}: '
                              'allow more effort, or check whether it is blocked')
        if kind == 'ramp':
            self._ends[side] = v
        yield from self._stop(side, coasting)

    def _stop(self, side: int, coasting: bool) -> Moves:
        """Come to rest after a move to a side.

        Raises:
            DriverError: It does not.
        """
        t = 0.0
        self.kind = 'coast'
        while (coasting and side * self._speed > self.moving and t < COAST
               and not (self._placed and side * self._x > AWAY * self.limits.travel)):
            yield from self._give(self._safe)
            t += self._period
        t = 0.0
        self.kind = 'brake'
        while side * self._speed > self.moving:
            yield from self._give(-side * min(2.0 * self._rate * t, self.limits.effort))
            t += self._period
            if t > STOP:
                raise DriverError(f'the device does not come to rest within {STOP:g} s')
        yield from self._rest(SETTLE)

    def _rest(self, duration: float) -> Moves:
        self.kind = 'rest'
        for _ in range(math.ceil(duration / self._period)):
            yield from self._give(self._safe)

    def _towards(self, place: float, side: int) -> Moves:
        """Go to a side by slow ramps until a place is not far ahead."""
        for _ in range(WAYS):
            if not self._placed or side * (place - self._x) <= 0.5 * NEAR * self.limits.travel:
                return
            yield from self._move('return', side, False, place)

    def _back(self, breach: str) -> Moves:
        """After a limit was passed: the safe command until it stands, then back.

        Raises:
            DriverError: It does not stand, or this was once too often.
        """
        if not self._stalled:
            self.breaches.append(breach)
        self.kind, self._guarded, t = 'rest', False, 0.0
        while abs(self._speed) > self.moving:
            yield self._safe
            t += self._period
            if t > STOP:
                raise DriverError(f'{breach}; the device does not come to rest within {STOP:g} s '
                                  'of the safe command')
        if len(self.breaches) > BREACHES:
            raise DriverError(f'a limit was passed {len(self.breaches)} times, the last: '
                              f'{breach}; allow less effort, a longer ramp, or more travel')
        self._guarded = True
        try:
            yield from self._rest(SETTLE)
            yield from self._towards(0.0, 1 if self._x < 0.0 else -1)
        except _BreachError as another:
            yield from self._back(str(another))

    def _give(self, v: float) -> Moves:
        """Give a command; check the limits afterwards.

        Raises:
            _BreachError: One was passed.
        """
        yield v
        if not self._guarded:
            return
        outward = self._speed if self._x > 0.0 else -self._speed
        if abs(self._x) > self.limits.travel and outward > self.moving:
            raise _BreachError(f'travel {self._x:.4g} beyond {self.limits.travel:g}')
        if self._placed and abs(self._speed) > self.limits.speed:
            raise _BreachError(f'speed {self._speed:.4g} beyond {self.limits.speed:g}')

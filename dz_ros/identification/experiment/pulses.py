# SPDX-License-Identifier: Apache-2.0
"""Small moves of a device that is new: does it follow the command, and what do its sensors show.

    sign test      rest; v grows slowly to one side until the device just moves, then v = 0; the
                   same on the other side. A motion against the command ends it at once.
    pulses         rest; steps of v to both sides, somewhat above what moved it, each until the
                   device has moved a little, then v = 0

Both keep the limits of the moves of identification, whose parts they are made of, and stay within
a small share of the travel. (ours)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from dz_ros.errors import DriverError
from dz_ros.identification.experiment.moves import Experiment, Moves, REST, SETTLE
from dz_ros.identification.experiment.plan import Limits, Plan

CERTAIN = 2.0
"""Number of thresholds of motion that a speed has to pass to count as a direction."""
LITTLE = 0.05
"""Share of the travel after which a pulse ends in any case."""
ABOVE = 1.5
"""A pulse's |v| over that at which motion began."""
PULSES = 10
"""Pulses to each side."""
LONGEST = 0.5
"""A pulse ends after this [s]."""


class WrongSignError(DriverError):
    """The device moves against the command, or a velocity is not that of the position."""


class SignTest(Experiment):
    """Moves a device as little as it takes to see which way it goes.

    Attributes:
        sides: Side → v at which it began to move, by the sign of v.
    """

    def __init__(self, limits: Limits, plan: Plan, order: int, period: float,
                 safe_command: float = 0.0) -> None:
        super().__init__(limits, replace(plan, repeats=2), order, period, safe_command)
        self.sides: dict[int, float] = {}

    @property
    def duration(self) -> float:
        """About how long it takes [s]."""
        return REST + 2.0 * (self.plan.ramp + SETTLE)

    def _all(self) -> Moves:
        yield from self._at_rest()
        self._guarded = True
        for repeat, side in enumerate((1, -1)):
            self.repeat = repeat
            yield from self._nudge(side)
            self.repeat = -1

    def _nudge(self, side: int) -> Moves:
        """Let v grow to one side until the device moves.

        Raises:
            WrongSignError: It moves the other way, or its velocity does not fit its position.
            DriverError: It does not move.
        """
        self.kind, v, begun = 'sign', 0.0, self._x
        certain = CERTAIN * self.moving
        while abs(self._speed) <= certain:
            if v >= self.limits.effort:
                raise DriverError(f'no motion {"right" if side > 0 else "left"} up to |v| = '
                                  f'{v:.4g}: allow more effort, or check whether it is blocked')
            v = min(v + self._rate * self._period, self.limits.effort)
            yield from self._give(side * v)
        self.sides[side] = v
        for _ in range(len(self._recent)):      # the filter's own time, at the same command
            if abs(self._x - begun) > LITTLE * self.limits.travel:
                break
            yield from self._give(side * v)
        went, speed = self._x - begun, self._speed
        if speed * side < 0.0:
            raise WrongSignError(f'wrong sign: v = {side * v:.4g} moves the device '
                                 f'{"left" if side > 0 else "right"} (speed {speed:.3g}): turn '
                                 'the sign of the command or of the measurement')
        if self._placed and went * speed < 0.0:
            raise WrongSignError(f'wrong sign of the velocity: the position changed by {went:.3g} '
                                 f'while the velocity was {speed:.3g}')
        yield from self._stop(side, True)


class Pulses(Experiment):
    """Steps both ways that show resolution, noise and delay.

    Args:
        limits, plan, order, period, safe_command: As of `Experiment`.
        sides: v at which the device began to move, by the sign of v.
    """

    def __init__(self, limits: Limits, plan: Plan, order: int, period: float,
                 safe_command: float, sides: Sequence[float]) -> None:
        super().__init__(limits, replace(plan, repeats=PULSES), order, period, safe_command)
        self._v = {1: abs(sides[0]), -1: abs(sides[1])}

    @property
    def duration(self) -> float:
        """About how long it takes [s]."""
        return REST + 2.0 * PULSES * (LONGEST + 2.0 * SETTLE)

    def _all(self) -> Moves:
        yield from self._at_rest()
        self._guarded = True
        for repeat in range(PULSES):
            for side in (1, -1) if repeat % 2 == 0 else (-1, 1):
                yield from self._tried(partial(self._pulse, repeat, side,
                                               1.0 + (ABOVE - 1.0) * (1.0 + repeat % 3)))

    def _pulse(self, repeat: int, side: int, share: float) -> Moves:
        """Step to one side until the device has moved a little.

        Raises:
            WrongSignError: It moves the other way.
        """
        self.repeat, self.kind, begun, t = repeat, 'pulse', self._x, 0.0
        v = min(share * self._v[side], self.limits.effort)
        while (t < LONGEST and side * (self._x - begun) < LITTLE * self.limits.travel
               and abs(self._speed) < 0.5 * self._fast):
            yield from self._give(side * v)
            t += self._period
            if self._speed * side < -CERTAIN * self.moving:
                raise WrongSignError(f'wrong sign: v = {side * v:.4g} moves the device '
                                     f'{"left" if side > 0 else "right"}')
        yield from self._stop(side, False)

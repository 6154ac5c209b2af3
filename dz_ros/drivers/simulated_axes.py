# SPDX-License-Identifier: Apache-2.0
"""Simulated actuators of axes that a plant couples: advanced together, no ROS, no clock.

Each axis is a `SimulatedActuator` of its own, with its queue of commands, its limits and its
sensors; what moves them is one `Motion`. The first of them that is advanced to an instant advances
all. With commands at t_k they repeat the offline loop bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import TYPE_CHECKING

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import played
from dz_ros.core.loop.coupled import Motion
from dz_ros.core.records import Truth
from dz_ros.drivers.simulated import SAME_INSTANT, SimulatedActuator
from dz_ros.errors import LoopError

if TYPE_CHECKING:
    from collections.abc import Iterator


class CoupledAxes:
    """What the simulated actuators of a coupled plant share: the motion and its time.

    Args:
        each: Configurations of the axes.

    Attributes:
        actuators: Those of the axes, in their order.
    """

    def __init__(self, each: Sequence[Configuration]) -> None:
        first = each[0]
        self._each = list(each)
        self.motion = Motion(each)
        self.actuators = [CoupledActuator(item, self, place) for place, item in enumerate(each)]
        self._t = 0.0
        self._seq = -1
        self._truths: list[Truth] = []
        self._period = first.loop.period
        self._substeps = first.plant_settings.substeps

    def configure(self, place: int, configuration: Configuration) -> None:
        """Give an axis other parameters from now on."""
        self._each[place] = configuration
        self.motion.configure(self._each)

    def advance(self, t: float, seq: int) -> list[Truth]:
        """Advance all axes to loop time t [s]; once for each sample.

        Raises:
            LoopError: The plant has diverged.
        """
        if seq == self._seq and t <= self._t + SAME_INSTANT:
            return self._truths
        self._seq, stamp = seq, self._t
        x0 = [list(item) for item in self.motion.x]
        for at in self._instants(t, stamp):
            if at > self._t + SAME_INSTANT:
                self._integrate(at)
            for actuator in self.actuators:
                actuator.take_due(at)
        push = [actuator.push_at(stamp) for actuator in self.actuators]
        held = [actuator.held for actuator in self.actuators]
        found = self.motion.truths(held, stamp, push, x0)
        if t > self._t + SAME_INSTANT:
            self._integrate(t)
        self._truths = [Truth(seq, stamp, *item) for item in found]
        return self._truths

    def _instants(self, t: float, stamp: float) -> Iterator[float]:
        """Yield the instants at which commands take effect before t, in order."""
        found = {at for actuator in self.actuators for at in actuator.due(t, stamp)}
        return iter(sorted(found))

    def _integrate(self, t: float) -> None:
        """Move all axes to t [s] with the commands held."""
        span = t - self._t
        if abs(span - self._period) < SAME_INSTANT:
            steps, h = self._substeps, self._period / self._substeps
        else:
            steps = max(1, int(np.ceil(self._substeps * span / self._period - SAME_INSTANT)))
            h = span / steps
        held = [actuator.held for actuator in self.actuators]
        push = [actuator.push_at(self._t) for actuator in self.actuators]
        try:
            self.motion.advance(held, self._t, h, steps, push)
            finite = all(math.isfinite(item) for own in self.motion.x for item in own)
        except (ArithmeticError, ValueError):
            finite = False
        if not finite:
            raise LoopError(f'the simulated plant diverged at t = {self._t:g} s, beyond what '
                            'numbers can hold')
        self._t = t


class CoupledActuator(SimulatedActuator):
    """The simulated actuator of one axis of a coupled plant.

    Args:
        configuration: Of this axis.
        machine: What it shares with the others.
        place: Which axis it is.
    """

    def __init__(self, configuration: Configuration, machine: CoupledAxes, place: int) -> None:
        super().__init__(configuration.driver_parameters, configuration)
        self._machine, self._place = machine, place
        self.x = machine.motion.x[place]

    def configure(self, configuration: Configuration) -> None:
        """Give plant and dead-zone other parameters, or a pulse, from now on; same structure."""
        super().configure(configuration)
        self._machine.configure(self._place, configuration)

    def advance(self, t: float, seq: int) -> Truth:
        """Advance all axes to loop time t [s]; return what is known of this one.

        Raises:
            LoopError: The plant has diverged.
        """
        found = self._machine.advance(t, seq)[self._place]
        self.t = t
        return found

    def due(self, t: float, stamp: float) -> list[float]:
        """Return the instants at which commands take effect before t [s]."""
        return [at for at, _ in self._pending if at < t - SAME_INSTANT
                or at <= stamp + SAME_INSTANT]

    def take_due(self, at: float) -> None:
        """Hold the newest command that takes effect until an instant [s]."""
        while self._pending and self._pending[0][0] <= at:
            v = self._pending.popleft()[1]
            self.held = played(v, self.held, self._play) if self._play > 0.0 else v

    def push_at(self, t: float) -> float:
        """Return what the pulse adds to x^(n) in the sample of loop time t [s]."""
        first, after, acceleration = self._pulse
        return acceleration if first <= int(t / self._period + SAME_INSTANT) < after else 0.0

# SPDX-License-Identifier: Apache-2.0
"""Motor, load and dead-zone of the simulated drive, in the drive's numbers (ours).

The configured plant behind its dead-zone, integrated in wall time. Enabled, it gets the
value of the target object; during a quick stop and a fault reaction it is braked, v = −x'/(b τ);
without voltage it gets nothing.
"""

from __future__ import annotations

import math

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.cia402.scaling import Scaling
from dz_ros.drivers.cia402.settings import Cia402Parameters
from dz_ros.drivers.simulated import SimulatedActuator, SimulatedParameters

_STANDING = 0.02
"""The axis stands below this share of what one braking time constant changes: x'/(b τ) [1]."""


class Motor:
    """What the drive moves.

    Args:
        configuration: Plant, dead-zone, noise, seed.
        brake: Time constant τ of braking [s].
        modulus: Number of values of its position, from 0 on; 0 = 32 bits with sign.

    Attributes:
        position: Position actual value, 32 bits.
        velocity: Velocity actual value, 32 bits.
        target: What the target object holds, after the drive's limit.
        v: Command the plant gets now.
    """

    def __init__(self, configuration: Configuration, brake: float, modulus: int = 0) -> None:
        assert isinstance(configuration.driver_parameters, Cia402Parameters)
        self.plant = SimulatedActuator(SimulatedParameters(), configuration)
        self._scaling = Scaling.of(configuration.driver_parameters)
        self._brake = 1.0 / (configuration.plant.b * brake)
        self._second = configuration.plant.order > 1
        self._modulus = modulus
        self.velocity = 0
        self.target = 0
        self.v = 0.0
        self._before = (0.0, self.plant.x[0])
        self._measure()

    @property
    def t(self) -> float:
        """Time until which it has moved [s]."""
        return self.plant.t

    @property
    def standing(self) -> bool:
        """Whether it hardly moves: braking it would take a command in the dead-zone's noise."""
        return abs(self._speed()) * self._brake < _STANDING or not self._second

    def limit(self, target: int) -> bool:
        """Take a target; return whether it had to be held within the largest."""
        largest = self._scaling.largest
        self.target = min(max(target, -largest), largest)
        return self.target != target

    def move(self, t: float, driven: bool, braking: bool) -> None:
        """Move until t [s] with the command so far, then give the plant the one for now."""
        if t > self.plant.t:
            self.plant.advance(t, 0)
            self._measure()
        if driven:
            v = self._scaling.v(self.target)
        elif braking and self._second:
            largest = self._scaling.limit
            v = min(max(-self._speed() * self._brake, -largest), largest)
        else:
            v = 0.0
        if v != self.v:
            self.v = v
            self.plant.command(v, t)

    def _speed(self) -> float:
        return self.plant.x[1] if self._second else 0.0

    def _measure(self) -> None:
        """Bring the actual values up to date."""
        measured = self.plant.measure()
        counts = self._scaling.counts(measured[0])
        self.position = counts % self._modulus if self._modulus else counts
        if self._second:
            self.velocity = self._scaling.number(measured[1])
            return
        t, x = self._before
        if self.plant.t > t:
            change = (self.plant.x[0] - x) / (self.plant.t - t)
            self.velocity = self._scaling.number(change) if math.isfinite(change) else 0
            self._before = (self.plant.t, self.plant.x[0])

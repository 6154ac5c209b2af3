# SPDX-License-Identifier: Apache-2.0
"""The simulated actuator and plant: dead-zone and plant advanced in loop time, no ROS, no clock.

Time is the caller's: a command takes effect at the instant it arrives (plus the configured delay
in whole samples), in the middle of a sample if need be, and the plant is integrated piece by piece
between those instants (RK4). With commands at t_k it repeats the offline loop bit for bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any, ClassVar

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import dead_zone, played, residual, Schedule
from dz_ros.core.loop.integration import make_advance, make_unmodelled
from dz_ros.core.plants.coupled import CoupledPlant
from dz_ros.core.records import Truth
from dz_ros.core.schema import parameter
from dz_ros.drivers.contract import Driver
from dz_ros.errors import ConfigurationError, LoopError

SAME_INSTANT = 1e-9
"""Pieces of a sample closer than this to the whole sample, or to nothing, are that [s]."""


@dataclass(frozen=True)
class SimulatedParameters:
    """What it measures; the sections plant and loop have the rest."""

    measured: int = parameter(0, '1', "number of x, x', … that it measures; 0 = all, n − 1 = the "
                              'velocity is observed', minimum=0, structural=True)


class SimulatedActuator(Driver):
    """A plant behind a dead-zone that takes commands and is measured.

    Attributes:
        x: True state now, shape (n,).
        t: Loop time now [s].
        held: Command the actuator holds now, behind its play.
    """

    name = 'simulated'
    summary = 'the configured plant behind its dead-zone, without any hardware'
    order = 0
    lockstep = True
    Parameters: ClassVar[type] = SimulatedParameters

    def __init__(self, parameters: Any, configuration: Configuration) -> None:
        super().__init__(parameters, configuration)
        c = configuration
        self.x = list(c.x0)
        self.t = 0.0
        self.held = 0.0
        self._period = c.loop.period
        self._substeps = c.plant_settings.substeps
        self._delay = c.loop.delay
        self._limit = c.plant_settings.command_limit
        self._pulse = c.pulse_samples
        self._plant = c.plant.constants
        self._zone = c.zone_numbers
        self._psi: float | None = None
        self._unmodelled = make_unmodelled(c.plant)
        self._advance = make_advance(c.plant.regressors, c.plant.disturbance,
                                     sticking=c.plant.sticking)
        self._work = ([0.0] * c.plant.regressor_count, *([0.0] * c.plant.order for _ in range(4)))
        self._grain = c.plant_settings.command_resolution
        self._play = c.plant_settings.backlash
        self._quanta = c.quanta
        self._noise = ((np.random.default_rng(c.loop.seed), np.asarray(c.noise))
                       if any(c.noise) else None)
        self._pending: deque[tuple[float, float]] = deque()

    @classmethod
    def for_axes(cls, each: Sequence[Configuration]) -> Sequence[SimulatedActuator]:
        """Return the actuators of all axes of a machine, which a plant may couple.

        Raises:
            ConfigurationError: It does, and this class simulates one axis by itself.
        """
        if isinstance(each[0].plant, CoupledPlant):
            if cls is not SimulatedActuator:
                raise ConfigurationError('driver.name', cls.name, 'simulates one axis by itself; '
                                         f'plant.model = {each[0].plant_settings.model!r} moves '
                                         'several together: must be simulated')
            from dz_ros.drivers.simulated_axes import CoupledAxes

            return CoupledAxes(each).actuators
        return [cls(item.driver_parameters, item) for item in each]

    @property
    def measured(self) -> int:
        """Number of x, x', … it measures."""
        order = self.configuration.plant.order
        return min(getattr(self.parameters, 'measured', 0), order) or order

    @property
    def resolution(self) -> float:
        """One step of its position sensor [unit of x]."""
        return self._quanta[0] or super().resolution

    @property
    def derivative_resolution(self) -> tuple[float, ...]:
        """One step of x', x'', … that it measures [state units]."""
        return self._quanta[1:] if any(self._quanta[1:]) else super().derivative_resolution

    @property
    def command_resolution(self) -> float:
        """One step that it rounds the command to [actuator unit]."""
        return self._grain or super().command_resolution

    @property
    def limit(self) -> float:
        """Largest |v| the actuator takes [actuator unit]."""
        return self._limit or math.inf

    def applied_command(self) -> float:
        """Return the newest command that has arrived, clipped [actuator unit]."""
        return self._pending[-1][1] if self._pending else self.held

    def configure(self, configuration: Configuration) -> None:
        """Give plant and dead-zone other parameters, or a pulse, from now on; same structure."""
        super().configure(configuration)
        self._pulse = configuration.pulse_samples
        self._plant = configuration.plant.constants
        self.follow(self._psi)

    def follow(self, psi: float | None) -> None:
        """Let the dead-zone follow a scheduling variable as measured; None = as configured."""
        self._psi = psi
        c = self.configuration
        self._zone = (c.zone_numbers if psi is None else
                      c.dead_zone.numbers(Schedule((0.0,), (psi,))))

    def command(self, v: float, t: float) -> None:
        """Take a command that arrives at loop time t [s]; it acts `loop.delay` samples later."""
        if self._limit > 0.0:
            v = min(max(v, -self._limit), self._limit)
        if self._grain > 0.0:
            v = math.floor(v / self._grain + 0.5) * self._grain
        sample = round(t / self._period)
        if self._delay == 0 or abs(t - sample * self._period) > SAME_INSTANT:
            at = t + self._delay * self._period
        else:
            at = (sample + self._delay) * self._period
        self._pending.append((at, v))

    def measure(self) -> tuple[float, ...]:
        """Return what is measured of x, x', …: the true ones plus seeded noise, quantised."""
        found = list(self.x)
        if self._noise is not None:
            random, sigma = self._noise
            noise = random.standard_normal(len(found)) * sigma
            found = [value + float(error) for value, error in zip(found, noise, strict=True)]
        for i, quantum in enumerate(self._quanta):
            if quantum > 0.0:
                found[i] = math.floor(found[i] / quantum + 0.5) * quantum
        return tuple(found[:self.measured])

    def advance(self, t: float, seq: int) -> Truth:
        """Integrate to loop time t [s], switching commands when they take effect.

        Returns:
            What the plant knows of the sample `seq` it leaves: w and d of the command held at the
            end of it, the disturbance at its beginning.

        Raises:
            LoopError: The plant has diverged.
        """
        stamp = self.t
        x, push, first = tuple(self.x), self._push(), math.nan
        while self._pending and (self._pending[0][0] < t - SAME_INSTANT
                                 or self._pending[0][0] <= stamp + SAME_INSTANT):
            at, v = self._pending.popleft()
            if at > self.t + SAME_INSTANT:
                first = self.held if math.isnan(first) else first
                self._integrate(at)
            self.held = played(v, self.held, self._play) if self._play > 0.0 else v
        first = self.held if math.isnan(first) else first
        if t > self.t + SAME_INSTANT:
            self._integrate(t)
        w = dead_zone(self.held, stamp, self._zone)
        begun = w if first == self.held else dead_zone(first, stamp, self._zone)
        disturbance = self._unmodelled(stamp, x, begun, self._plant, self._work[0], push)
        return Truth(seq, stamp, w, residual(self.held, w, stamp, self._zone), disturbance)

    def _integrate(self, t: float) -> None:
        span = t - self.t
        if abs(span - self._period) < SAME_INSTANT:
            steps, h = self._substeps, self._period / self._substeps
        else:
            steps = max(1, int(np.ceil(self._substeps * span / self._period - SAME_INSTANT)))
            h = span / steps
        try:
            self._advance(self.x, self.held, self.t, h, steps, self._plant, self._zone,
                          *self._work, self._push())
        except (ArithmeticError, ValueError):
            self.x = [math.nan] * len(self.x)
        if not all(map(math.isfinite, self.x)):
            raise LoopError(f'the simulated plant diverged at t = {self.t:g} s, beyond what '
                            'numbers can hold')
        self.t = t

    def _push(self) -> float:
        """Return what the pulse adds to x^(n) in the present sample."""
        first, after, acceleration = self._pulse
        return acceleration if first <= int(self.t / self._period + SAME_INSTANT) < after else 0.0

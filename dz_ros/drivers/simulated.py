"""The simulated actuator and plant: dead-zone and plant advanced in loop time, no ROS, no clock.

The driver of ``nodes/plant_node.py``. Time is whatever the caller says it is: a command takes
effect at the instant it arrives (plus the configured delay in whole samples), in the middle of a
sample if need be, and the plant is integrated piece by piece between those instants (RK4). With
commands that arrive exactly at t_k it repeats the offline loop bit for bit.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import math
from typing import Any, ClassVar

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import dead_zone, residual
from dz_ros.core.driver import Driver
from dz_ros.core.integration import make_advance
from dz_ros.core.records import Truth
from dz_ros.errors import LoopError

SNAP = 1e-9
"""Pieces of a sample closer than this to the whole sample, or to nothing, are that [s]."""


@dataclass(frozen=True)
class SimulatedParameters:
    """None of its own: the sections plant and loop say it all."""


class SimulatedActuator(Driver):
    """A plant behind a dead-zone that takes commands and is measured.

    Args:
        parameters: None of its own.
        configuration: Plant, dead-zone, initial state, noise, delay, command limit, seed.

    Attributes:
        x: True state now, shape (n,).
        t: Loop time now [s].
        held: Command the actuator holds now.
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
        self._kick = c.kick_samples
        self._plant = c.plant.constants
        self._zone = c.dead_zone.constants
        self._disturbance = c.plant.disturbance
        self._advance = make_advance(c.plant.regressors, c.plant.disturbance)
        self._work = ([0.0] * c.plant.regressor_count, *([0.0] * c.plant.order for _ in range(4)))
        self._sigma = c.noise if any(c.noise) else None
        self._random = np.random.default_rng(c.loop.seed)
        self._pending: deque[tuple[float, float]] = deque()

    @property
    def limit(self) -> float:
        """Largest |v| the actuator takes [actuator unit]."""
        return self._limit or math.inf

    def in_force(self) -> float:
        """Return the newest command that has arrived, clipped [actuator unit]."""
        return self._pending[-1][1] if self._pending else self.held

    def configure(self, configuration: Configuration) -> None:
        """Give plant and dead-zone other parameters, or a kick, from now on; same structure."""
        super().configure(configuration)
        self._kick = configuration.kick_samples
        self._plant = configuration.plant.constants
        self._zone = configuration.dead_zone.constants

    def command(self, v: float, t: float) -> None:
        """Take a command that arrives at loop time t [s]; it acts `loop.delay` samples later."""
        if self._limit > 0.0:
            v = min(max(v, -self._limit), self._limit)
        sample = round(t / self._period)
        if self._delay == 0 or abs(t - sample * self._period) > SNAP:
            at = t + self._delay * self._period
        else:
            at = (sample + self._delay) * self._period
        self._pending.append((at, v))

    def measure(self) -> tuple[float, ...]:
        """Return the measured state, shape (n,): the true one plus seeded noise."""
        if self._sigma is None:
            return tuple(self.x)
        noise = self._random.standard_normal(len(self.x)) * np.asarray(self._sigma)
        return tuple(value + float(error) for value, error in zip(self.x, noise, strict=True))

    def advance(self, t: float, seq: int) -> Truth:
        """Integrate to loop time t [s], switching commands when they take effect.

        Returns:
            What the plant knows of the sample `seq` it leaves: w and d of the command held at the
            end of it, the disturbance at its beginning.

        Raises:
            LoopError: The plant has diverged.
        """
        stamp = self.t
        disturbance = self._disturbance(stamp, self.x, self._plant) - self._push()
        while self._pending and (self._pending[0][0] < t - SNAP
                                 or self._pending[0][0] <= stamp + SNAP):
            at, v = self._pending.popleft()
            if at > self.t + SNAP:
                self._integrate(at)
            self.held = v
        if t > self.t + SNAP:
            self._integrate(t)
        w = dead_zone(self.held, stamp, self._zone)
        return Truth(seq, stamp, w, residual(self.held, w, stamp, self._zone), disturbance)

    def _integrate(self, t: float) -> None:
        span = t - self.t
        if abs(span - self._period) < SNAP:
            steps, h = self._substeps, self._period / self._substeps
        else:
            steps = max(1, int(np.ceil(self._substeps * span / self._period - SNAP)))
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
        """Return what the kick adds to x^(n) in the present sample."""
        first, after, acceleration = self._kick
        return acceleration if first <= int(self.t / self._period + SNAP) < after else 0.0

# SPDX-License-Identifier: Apache-2.0
"""From one value to another along x_d = start + (goal − start) f(z), f = 1/(1 + e^−z)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.schema import parameter
from dz_ros.core.trajectories.base import Trajectory
from dz_ros.errors import ConfigurationError


@dataclass(frozen=True)
class LogisticParameters:
    """Parameters of the curve, z = (t − t_middle)/time_constant."""

    start: float = parameter(0.0, 'unit of x', 'value long before')
    goal: float = parameter(1.0, 'unit of x', 'value long after')
    t_middle: float = parameter(5.0, 's', 'time of the middle')
    time_constant: float = parameter(1.0, 's', 'how slow it is', minimum=0.0, open_minimum=True)

    def check(self, prefix: str) -> None:
        """Check what concerns several parameters.

        Raises:
            ConfigurationError: The curve goes nowhere.
        """
        if self.start == self.goal:
            raise ConfigurationError(f'{prefix}goal', self.goal, f'must not be {prefix}start')


class Logistic(Trajectory):
    """Two derivatives are written out here, so it serves plants up to order 2."""

    name = 'logistic'
    summary = 'from start to goal along a logistic curve'
    max_order = 2
    Parameters = LogisticParameters

    @property
    def constants(self) -> tuple[float, ...]:
        """Start, distance, time of the middle, time constant."""
        p = self.parameters
        return (p.start, p.goal - p.start, p.t_middle, p.time_constant)

    @staticmethod
    def evaluate(t: float, p: Sequence[float], x_d: Any) -> None:
        """Write x_d and as many derivatives as asked for."""
        f = 0.5 * (1.0 + math.tanh(0.5 * (t - p[2]) / p[3]))
        slope = f * (1.0 - f) / p[3]
        x_d[0] = p[0] + p[1] * f
        x_d[1] = p[1] * slope
        if len(x_d) > 2:
            x_d[2] = p[1] * slope * (1.0 - 2.0 * f) / p[3]

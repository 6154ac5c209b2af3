# SPDX-License-Identifier: Apache-2.0
"""Inverted pendulum: a mass on a rod, held by a torque at the pivot.

    m l² q'' + k l² q' − m g l sin q + m l h cos q = w,    h = h_0 sin ω_h t

State: angle q from the upright [rad], q' [rad/s]; command and w: torque [N m]. Y1 = −sin q,
Y2 = q'; a_1 = g/l, a_2 = k/m, b = 1/(m l²). The horizontal acceleration h of the pivot gives the
disturbance (h/l) cos q.

Equation and values (m, l, k such that g/l ≈ 10, k/m = 1, 1/(m l²) = 10): [khalil2002], pendulum of
example 12.2, with the angle counted from the upright. Shaking of the pivot: ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.plants.base import Plant
from dz_ros.core.schema import parameter


@dataclass(frozen=True)
class PendulumParameters:
    """Parameters of the pendulum."""

    bob_mass: float = parameter(0.1, 'kg', 'mass m at the end of the rod', minimum=0.0,
                                open_minimum=True)
    length: float = parameter(1.0, 'm', 'length l of the rod', minimum=0.0, open_minimum=True)
    gravity: float = parameter(9.81, 'm/s²', 'acceleration of gravity g', minimum=0.0)
    damping: float = parameter(0.1, 'N s/m', "friction k on the speed l q' of the mass",
                               minimum=0.0)
    pivot_acceleration: float = parameter(0.5, 'm/s²', 'amplitude h_0 of the horizontal '
                                          'acceleration of the pivot')
    pivot_frequency: float = parameter(3.0, 'rad/s', 'angular frequency ω_h of it', minimum=0.0)


class Pendulum(Plant):
    """Angle of a pendulum from the upright, which is unstable."""

    name = 'pendulum'
    summary = 'inverted pendulum with a torque at its pivot, order 2'
    order = 2
    regressor_count = 2
    state_units = ('rad', 'rad/s')
    actuator_unit = 'N m'
    regressor_units = ('1', 'rad/s')
    default_x0 = (0.3, 0.0)
    Parameters = PendulumParameters

    @property
    def a(self) -> tuple[float, ...]:
        """g/l [1/s²], k/m [1/s]."""
        p = self.parameters
        return (p.gravity / p.length, p.damping / p.bob_mass)

    @property
    def b(self) -> float:
        """1/(m l²) [rad/s² per N m]."""
        p = self.parameters
        return float(1.0 / (p.bob_mass * p.length * p.length))

    @property
    def extra(self) -> tuple[float, ...]:
        """h_0/l [1/s²], ω_h [rad/s]."""
        p = self.parameters
        return (p.pivot_acceleration / p.length, p.pivot_frequency)

    @staticmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:  # noqa: ARG004
        """Write Y1 = −sin q, Y2 = q'."""
        y[0] = -math.sin(x[0])
        y[1] = x[1]

    @staticmethod
    def disturbance(t: float, x: Sequence[float], p: Sequence[float]) -> float:
        """Return (h_0/l) sin ω_h t cos q [rad/s²]."""
        return p[3] * math.sin(p[4] * t) * math.cos(x[0])

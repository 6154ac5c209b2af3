# SPDX-License-Identifier: Apache-2.0
"""Surge speed of an underwater vehicle: a first-order lag with linear and quadratic drag.

    (m + m_a) u' + d_1 u + d_2 |u| u + F_w sin ω_w t = w

State u: speed through the water [m/s]; command and w: thrust [N]. The dead-zone is that of the
thrusters, which give nothing around standstill. Y1 = u, Y2 = |u| u; a_1 = d_1/(m + m_a),
a_2 = d_2/(m + m_a), b = 1/(m + m_a); the wave force F_w is the disturbance.

Equation: surge alone of [fossen2011]. Masses and drag: the BlueROV2 Heavy of [benzon2022]. Waves:
ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.plants.base import Plant
from dz_ros.core.schema import parameter


@dataclass(frozen=True)
class SurgeParameters:
    """Parameters of the vehicle."""

    mass: float = parameter(13.5, 'kg', 'mass m of the vehicle', minimum=0.0, open_minimum=True)
    added_mass: float = parameter(6.36, 'kg', 'added mass m_a of the water in surge', minimum=0.0)
    linear_drag: float = parameter(13.7, 'N s/m', 'linear drag d_1', minimum=0.0)
    quadratic_drag: float = parameter(141.0, 'N s²/m²', 'quadratic drag d_2', minimum=0.0)
    wave_force: float = parameter(2.0, 'N', 'amplitude F_w of the force of the waves')
    wave_frequency: float = parameter(1.0, 'rad/s', 'angular frequency ω_w of the waves',
                                      minimum=0.0)


class FirstOrder(Plant):
    """Speed of a vehicle in water."""

    name = 'first_order'
    summary = 'surge speed of an underwater vehicle, linear and quadratic drag, order 1'
    order = 1
    regressor_count = 2
    state_units = ('m/s',)
    actuator_unit = 'N'
    regressor_units = ('m/s', 'm²/s²')
    default_x0 = (0.0,)
    Parameters = SurgeParameters

    @property
    def a(self) -> tuple[float, ...]:
        """d_1/(m + m_a) [1/s], d_2/(m + m_a) [1/m]."""
        return (self.parameters.linear_drag * self.b, self.parameters.quadratic_drag * self.b)

    @property
    def b(self) -> float:
        """1/(m + m_a) [1/kg]."""
        return float(1.0 / (self.parameters.mass + self.parameters.added_mass))

    @property
    def extra(self) -> tuple[float, ...]:
        """F_w/(m + m_a) [m/s²], ω_w [rad/s]."""
        return (self.parameters.wave_force * self.b, self.parameters.wave_frequency)

    @staticmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:  # noqa: ARG004
        """Write Y1 = u, Y2 = |u| u."""
        speed = x[0]
        y[0] = speed
        y[1] = abs(speed) * speed

    @staticmethod
    def disturbance(t: float, x: Sequence[float], p: Sequence[float]) -> float:  # noqa: ARG004
        """Return F_w/(m + m_a) sin ω_w t [m/s²]."""
        return p[3] * math.sin(p[4] * t)

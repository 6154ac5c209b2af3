# SPDX-License-Identifier: Apache-2.0
"""Positioning axis: a mass with viscous and smoothed Coulomb friction and a constant force.

    M x'' + F_v x' + F_c tanh(x'/v_s) + F_0 = K_f w

State: position x [m] and speed x' [m/s]; command and w: voltage [V] at the input of the drive.
Y1 = x', Y2 = tanh(x'/v_s) with the smoothing speed v_s known, Y3 = 1; a_1 = F_v/M, a_2 = F_c/M,
a_3 = F_0/M of either sign, b = K_f/M. F_0 is what a vertical axis weighs or an amplifier's offset
amounts to. Model and the order of magnitude of its parameters: [janot2019].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.plants.base import Plant
from dz_ros.core.schema import parameter


@dataclass(frozen=True)
class AxisParameters:
    """Parameters of the axis."""

    mass: float = parameter(100.0, 'kg', 'moved mass M, that of the motor included', minimum=0.0,
                            open_minimum=True)
    viscous_friction: float = parameter(200.0, 'N s/m', 'viscous friction F_v', minimum=0.0)
    coulomb_friction: float = parameter(20.0, 'N', 'Coulomb friction F_c', minimum=0.0)
    constant_force: float = parameter(0.0, 'N', 'constant force F_0 against positive motion')
    smoothing_speed: float = parameter(0.002, 'm/s', 'speed v_s below which the Coulomb friction '
                                       'fades; known to the controller', minimum=1e-5)
    force_constant: float = parameter(35.0, 'N/V', 'force per voltage K_f', minimum=0.0,
                                      open_minimum=True)


class Axis(Plant):
    """Position of a driven mass with friction."""

    name = 'axis'
    summary = 'positioning axis with friction and a constant force, order 2'
    order = 2
    regressor_count = 3
    state_units = ('m', 'm/s')
    actuator_unit = 'V'
    regressor_units = ('m/s', '1', '1')
    default_x0 = (0.0, 0.0)
    friction = (1, 2)
    Parameters = AxisParameters

    @property
    def a(self) -> tuple[float, ...]:
        """F_v/M [1/s], F_c/M [m/s²], F_0/M [m/s²]."""
        p = self.parameters
        return (p.viscous_friction / p.mass, p.coulomb_friction / p.mass,
                p.constant_force / p.mass)

    @property
    def b(self) -> float:
        """K_f/M [m/s² per V]."""
        return float(self.parameters.force_constant / self.parameters.mass)

    @property
    def extra(self) -> tuple[float, ...]:
        """1/v_s [s/m]."""
        return (1.0 / self.parameters.smoothing_speed,)

    @staticmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:
        """Write Y1 = x', Y2 = tanh(x'/v_s), Y3 = 1."""
        speed = x[1]
        y[0] = speed
        y[1] = math.tanh(speed * p[4])
        y[2] = 1.0

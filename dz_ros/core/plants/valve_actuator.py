# SPDX-License-Identifier: Apache-2.0
"""Electro-hydraulic actuator: a valve moves a cylinder that carries a mass against a spring.

    x/w = K_v ω_0² / ((p + ω_r)(p² + 2 δ_0 ω_0 p + ω_0²))                     p = d/dt

    x''' + (2 δ_0 ω_0 + ω_r) x'' + (ω_0² + 2 δ_0 ω_0 ω_r) x' + ω_r ω_0² x = K_v ω_0² w

State: position x [m], x' [m/s], x'' [m/s²]; command and w: signal of the valve [V]. Its overlap is
the dead-zone. Y = (x, x', x''), b = K_v ω_0².

Equation: [merritt1967], chapter 6, valve and piston with inertia and spring load: ω_0 the
hydraulic natural frequency, √(4 β_e A²/(V_t M)) without spring; δ_0 the damping ratio, 0.1 … 0.2
in practice; K_v = K_q/A the velocity gain; ω_r the corner frequency of the load spring, 0 without
one. Values (ours): a piston of A = 20 cm² moves M = 20 t, with V_t = 1.4 l of oil of
β_e = 6.9e8 Pa.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dz_ros.core.plants.base import Plant
from dz_ros.core.schema import parameter


@dataclass(frozen=True)
class ValveActuatorParameters:
    """Parameters of valve, cylinder and load."""

    natural_frequency: float = parameter(20.0, 'rad/s', 'hydraulic natural frequency ω_0',
                                         minimum=0.0, open_minimum=True)
    damping_ratio: float = parameter(0.2, '1', 'hydraulic damping ratio δ_0', minimum=0.0)
    velocity_gain: float = parameter(0.02, 'm/s per V', 'speed of the piston per valve signal K_v',
                                     minimum=0.0, open_minimum=True)
    spring_corner: float = parameter(0.5, 'rad/s', 'corner frequency ω_r of the load spring; '
                                     '0 = no spring', minimum=0.0)


class ValveActuator(Plant):
    """Position of a valve-controlled cylinder."""

    name = 'valve_actuator'
    summary = 'electro-hydraulic valve-controlled actuator with load spring, order 3'
    order = 3
    regressor_count = 3
    state_units = ('m', 'm/s', 'm/s²')
    actuator_unit = 'V'
    regressor_units = ('m', 'm/s', 'm/s²')
    default_x0 = (0.0, 0.0, 0.0)
    Parameters = ValveActuatorParameters

    @property
    def a(self) -> tuple[float, ...]:
        """ω_r ω_0² [1/s³], ω_0² + 2 δ_0 ω_0 ω_r [1/s²], 2 δ_0 ω_0 + ω_r [1/s]."""
        p = self.parameters
        square = p.natural_frequency * p.natural_frequency
        damping = 2.0 * p.damping_ratio * p.natural_frequency
        return (p.spring_corner * square, square + damping * p.spring_corner,
                damping + p.spring_corner)

    @property
    def b(self) -> float:
        """K_v ω_0² [m/s³ per V]."""
        p = self.parameters
        return float(p.velocity_gain * p.natural_frequency * p.natural_frequency)

    @staticmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:  # noqa: ARG004
        """Write Y = (x, x', x'')."""
        y[0] = x[0]
        y[1] = x[1]
        y[2] = x[2]

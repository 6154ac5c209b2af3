"""Servo: an inertia with viscous and smoothed Coulomb friction, moved by a current.

    J q'' + B q' + T_c tanh(q'/ω_s) + T_g sin N q = K_t w

State: angle q [rad] and speed q' [rad/s]; command and w: current [A]. Y1 = q', Y2 = tanh(q'/ω_s)
with the smoothing speed ω_s known; a_1 = B/J, a_2 = T_c/J, b = K_t/J. The cogging torque
T_g sin N q is the disturbance.

B and T_c for unit inertia: the friction parameters σ_2 = 0.4, F_c = 1 of [canudas1995], read as a
rotation. Smoothing in place of the bristle state, and cogging: ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.plants.base import Plant
from dz_ros.core.schema import parameter


@dataclass(frozen=True)
class ServoParameters:
    """Parameters of the servo."""

    inertia: float = parameter(1.0, 'kg m²', 'inertia J of motor and load', minimum=0.0,
                               open_minimum=True)
    viscous_friction: float = parameter(0.4, 'N m s/rad', 'viscous friction B', minimum=0.0)
    coulomb_friction: float = parameter(1.0, 'N m', 'Coulomb friction T_c', minimum=0.0)
    smoothing_speed: float = parameter(0.01, 'rad/s', 'speed ω_s below which the Coulomb friction '
                                       'fades; known to the controller', minimum=1e-3)
    torque_constant: float = parameter(1.0, 'N m/A', 'torque constant K_t', minimum=0.0,
                                       open_minimum=True)
    cogging_torque: float = parameter(0.1, 'N m', 'amplitude T_g of the cogging torque')
    cogging_periods: float = parameter(12.0, '1/rev', 'periods N of the cogging in a revolution',
                                       minimum=0.0)


class Servo(Plant):
    """Position of a motor with friction."""

    name = 'servo'
    summary = 'servo with viscous and Coulomb friction, order 2'
    order = 2
    regressor_count = 2
    state_units = ('rad', 'rad/s')
    actuator_unit = 'A'
    default_x0 = (0.0, 0.0)
    Parameters = ServoParameters

    @property
    def a(self) -> tuple[float, ...]:
        """B/J [1/s], T_c/J [rad/s²]."""
        p = self.parameters
        return (p.viscous_friction / p.inertia, p.coulomb_friction / p.inertia)

    @property
    def b(self) -> float:
        """K_t/J [rad/s² per A]."""
        return float(self.parameters.torque_constant / self.parameters.inertia)

    @property
    def extra(self) -> tuple[float, ...]:
        """1/ω_s [s/rad], T_g/J [rad/s²], N [1/rev]."""
        p = self.parameters
        return (1.0 / p.smoothing_speed, p.cogging_torque / p.inertia, p.cogging_periods)

    @staticmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:
        """Write Y1 = q', Y2 = tanh(q'/ω_s)."""
        speed = x[1]
        y[0] = speed
        y[1] = math.tanh(speed * p[3])

    @staticmethod
    def disturbance(t: float, x: Sequence[float], p: Sequence[float]) -> float:  # noqa: ARG004
        """Return T_g/J sin N q [rad/s²]."""
        return p[4] * math.sin(p[5] * x[0])

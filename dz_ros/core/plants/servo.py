# SPDX-License-Identifier: Apache-2.0
"""Servo: an inertia with viscous and smoothed Coulomb friction, moved by a current.

    J q'' + B q' + T_c tanh(q'/ω_s) + T_g sin N q = K_t w

State: angle q [rad] and speed q' [rad/s]; command and w: current [A]. Y1 = q', Y2 = tanh(q'/ω_s)
with the smoothing speed ω_s known; a_1 = B/J, a_2 = T_c/J, b = K_t/J. The cogging torque
T_g sin N q is the disturbance.

With T_s > 0 the friction sticks: T_c tanh(q'/ω_s) is replaced by

    f = J clip(q''_free + q'/τ, ±g(q')/J),   g(q') = T_c + (T_s − T_c) exp(−(q'/ω_S)²)

with q''_free what all the rest would give: at rest f holds against anything up to T_s, then falls
to T_c over the Stribeck speed ω_S. The difference f − T_c tanh(q'/ω_s) is disturbance: the law
knows the smoothed friction only. This is the model of Karnopp [karnopp1985], which rests within a
band of speeds, made continuous by the saturation of [xiong2013]; τ is the time in which the speed
of a stuck servo fades. Stribeck curve: [canudas1995].

B, T_c and, where it sticks, T_s and ω_S for unit inertia: the friction parameters σ_2 = 0.4,
F_c = 1, F_S = 1.5, v_S = 0.001 of [canudas1995], read as a rotation. Smoothing or saturation in
place of the bristle state, and cogging: ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.plants.base import Plant
from dz_ros.core.schema import parameter
from dz_ros.errors import ConfigurationError


@dataclass(frozen=True)
class ServoParameters:
    """Parameters of the servo."""

    inertia: float = parameter(1.0, 'kg m²', 'inertia J of motor and load', minimum=0.0,
                               open_minimum=True)
    viscous_friction: float = parameter(0.4, 'N m s/rad', 'viscous friction B', minimum=0.0)
    coulomb_friction: float = parameter(1.0, 'N m', 'Coulomb friction T_c', minimum=0.0)
    smoothing_speed: float = parameter(0.01, 'rad/s', 'speed ω_s below which the Coulomb friction '
                                       'fades; known to the controller', minimum=1e-3)
    static_friction: float = parameter(0.0, 'N m', 'static friction T_s; 0 = the friction is '
                                       'smoothed and does not stick', minimum=0.0)
    stribeck_speed: float = parameter(0.001, 'rad/s', 'speed ω_S over which friction falls from '
                                      'T_s to T_c', minimum=1e-5)
    stick_time: float = parameter(0.002, 's', 'time τ in which the speed of a stuck servo fades; '
                                  'at least half an integration step', minimum=1e-5)
    torque_constant: float = parameter(1.0, 'N m/A', 'torque constant K_t', minimum=0.0,
                                       open_minimum=True)
    cogging_torque: float = parameter(0.1, 'N m', 'amplitude T_g of the cogging torque')
    cogging_periods: float = parameter(12.0, '1/rev', 'periods N of the cogging in a revolution',
                                       minimum=0.0)

    def check(self, prefix: str) -> None:
        """Check that what sticks is not less than what slides."""
        if 0.0 < self.static_friction < self.coulomb_friction:
            raise ConfigurationError(f'{prefix}static_friction', self.static_friction, 'must be '
                                     f'0 or at least coulomb_friction = {self.coulomb_friction:g}')


class Servo(Plant):
    """Position of a motor with friction."""

    name = 'servo'
    summary = 'servo with viscous and Coulomb friction, order 2'
    order = 2
    regressor_count = 2
    state_units = ('rad', 'rad/s')
    actuator_unit = 'A'
    regressor_units = ('rad/s', '1')
    default_x0 = (0.0, 0.0)
    friction = (1,)
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
        """1/ω_s [s/rad], T_g/J [rad/s²], N [1/rev], T_s/J [rad/s²], 1/ω_S [s/rad], 1/τ [1/s]."""
        p = self.parameters
        return (1.0 / p.smoothing_speed, p.cogging_torque / p.inertia, p.cogging_periods,
                p.static_friction / p.inertia, 1.0 / p.stribeck_speed, 1.0 / p.stick_time)

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

    @staticmethod
    def sticking(free: float, x: Sequence[float], p: Sequence[float],
                 y: Sequence[float]) -> float:
        """Return f/J − a_2 Y_2 [rad/s²]; 0 where T_s = 0."""
        highest = p[6]
        if highest == 0.0:
            return 0.0
        smoothed = p[2] * y[1]
        ratio = x[1] * p[7]
        limit = p[2] + (highest - p[2]) * math.exp(-ratio * ratio)
        held = free + smoothed + x[1] * p[8]
        if held > limit:
            held = limit
        elif held < -limit:
            held = -limit
        return held - smoothed

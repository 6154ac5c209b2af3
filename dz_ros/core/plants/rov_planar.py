# SPDX-License-Identifier: Apache-2.0
"""An underwater vehicle in the horizontal plane: surge, sway and yaw by four vectored thrusters.

    M ν' + C(ν) ν + D(ν) ν = B T(f/T'(U_0), U) + Rᵀ(ψ) (F_w sin ω_w t, 0, 0),   η' = R(ψ) ν
    f = B⁺ Rᵀ(ψ) (w_1, w_2, w_3),   scaled so that no |f_j| exceeds what full command gives

η = (x, y, ψ): position in a frame at rest whose first axis is the surge of heading ψ = 0 [m, m,
rad]; ν: speeds of the body. Commands and w: forces along x and y [N] and moment [N m]; they are
turned by the heading and allocated to the thrusters (`dz_ros.core.plants.allocation`). T is the
curve of a thruster over pulse width and supply voltage U (`dz_ros.core.plants.thruster.thrust`):
its dead band, its unequal and rising slopes are the dead-zone of this plant, in each thruster, so
that the dead-zones of the axes themselves (`plant.dead_zone`) are meant to be absent. The
allocation knows only the slope T' at `NOMINAL` volts. Thrusters answer at once.

    M = diag(m_1, m_2, m_3)   C ν = (−m_2 v r, m_1 u r, (m_2 − m_1) u v)
    D = diag(m_4 + m_7 |u|, m_5 + m_8 |v|, m_6 + m_9 |r|)

The structure in the frame at rest, for laws of all axes, is R [M (Rᵀ a + Ṙᵀ v) + (C + D) Rᵀ v],
linear in m_1 … m_9. The view of an axis has the heading 0 and the others at rest: Y1 = x_i',
Y2 = |x_i'| x_i'.

Equations: [fossen2011] in the plane. Masses and drag: the BlueROV2 Heavy of [benzon2022]. Arm of
the thrusters, signs and waves: ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.plants.allocation import allocate, pseudo_inverse, vectored
from dz_ros.core.plants.coupled import CoupledParameters, CoupledPlant
from dz_ros.core.plants.thruster import SLOPE, thrust
from dz_ros.core.schema import parameter

THRUSTERS = 4
FULL = 400.0
"""Largest command of a thruster, pulse width less 1500 µs [µs]."""
_VOLTS, _WAVE, _WAVE_RATE, _MASSES = 0, 1, 2, 3
_MATRIX = _MASSES + 9
_INVERSE = _MATRIX + 3 * THRUSTERS


@dataclass(frozen=True)
class RovPlanarParameters(CoupledParameters):
    """Parameters of vehicle, thrusters and water."""

    mass: float = parameter(13.5, 'kg', 'mass of the vehicle', minimum=0.0, open_minimum=True)
    inertia: float = parameter(0.37, 'kg m²', 'moment of inertia about the vertical', minimum=0.0,
                               open_minimum=True)
    added_mass_surge: float = parameter(6.36, 'kg', 'added mass of the water in surge',
                                        minimum=0.0)
    added_mass_sway: float = parameter(7.12, 'kg', 'added mass of the water in sway', minimum=0.0)
    added_inertia: float = parameter(0.222, 'kg m²', 'added inertia of the water in yaw',
                                     minimum=0.0)
    linear_drag_surge: float = parameter(13.7, 'N s/m', 'linear drag m_4', minimum=0.0)
    linear_drag_sway: float = parameter(0.0, 'N s/m', 'linear drag m_5', minimum=0.0)
    linear_drag_yaw: float = parameter(0.0, 'N m s/rad', 'linear drag m_6', minimum=0.0)
    quadratic_drag_surge: float = parameter(141.0, 'N s²/m²', 'quadratic drag m_7', minimum=0.0)
    quadratic_drag_sway: float = parameter(217.0, 'N s²/m²', 'quadratic drag m_8', minimum=0.0)
    quadratic_drag_yaw: float = parameter(1.5, 'N m s²/rad²', 'quadratic drag m_9', minimum=0.0)
    angle: float = parameter(0.7854, 'rad', 'angle of each thruster to the axis of the vehicle',
                             minimum=0.1, maximum=1.47)
    lever: float = parameter(0.19, 'm', 'arm of each thruster about the centre of mass',
                             minimum=0.0, open_minimum=True)
    voltage: float = parameter(16.0, 'V', 'supply voltage U of the thrusters', minimum=10.0,
                               maximum=20.0)
    wave_force: float = parameter(2.0, 'N', 'amplitude F_w of the force of the waves along x')
    wave_frequency: float = parameter(1.0, 'rad/s', 'angular frequency ω_w of the waves',
                                      minimum=0.0)


def turned(i: int, a: int, cosine: float, sine: float) -> float:
    """Return R_ia, the rotation of body axis a into axis i at rest."""
    if i == 2 or a == 2:
        return 1.0 if i == a else 0.0
    if i == a:
        return cosine
    return sine if i == 1 else -sine


def turning(i: int, a: int, cosine: float, sine: float, rate: float) -> float:
    """Return Ṙ_ia at the yaw rate r [rad/s]."""
    if i == 2 or a == 2:
        return 0.0
    if i == a:
        return -sine * rate
    return cosine * rate if i == 1 else -cosine * rate


class RovPlanar(CoupledPlant):
    """One of surge, sway and yaw."""

    name = 'rov_planar'
    summary = 'underwater vehicle in the plane by four thrusters, 3 axes, order 2'
    axes = 3
    order = 2
    regressor_count = 2
    structure_count = 9
    structure_units = ('m/s²', 'm/s²', 'rad/s²', 'm/s', 'm/s', 'rad/s', 'm²/s²', 'm²/s²',
                       'rad²/s²')
    default_x0 = (0.0, 0.0)
    Parameters = RovPlanarParameters

    @property
    def state_units(self) -> tuple[str, ...]:  # type: ignore[override]
        """Units of displacement and speed."""
        return ('rad', 'rad/s') if self.axis == 2 else ('m', 'm/s')

    @property
    def actuator_unit(self) -> str:  # type: ignore[override]
        """Unit of force or moment."""
        return 'N m' if self.axis == 2 else 'N'

    @property
    def regressor_units(self) -> tuple[str, ...]:  # type: ignore[override]
        """Units of speed and its square."""
        return ('rad/s', 'rad²/s²') if self.axis == 2 else ('m/s', 'm²/s²')

    @property
    def weights(self) -> tuple[float, ...]:
        """m_1 … m_9."""
        p = self.parameters
        return (p.mass + p.added_mass_surge, p.mass + p.added_mass_sway,
                p.inertia + p.added_inertia, p.linear_drag_surge, p.linear_drag_sway,
                p.linear_drag_yaw, p.quadratic_drag_surge, p.quadratic_drag_sway,
                p.quadratic_drag_yaw)

    @property
    def structure_weights(self) -> tuple[float, ...]:
        """m_1 … m_9: the commands are forces."""
        return self.weights

    @property
    def a(self) -> tuple[float, ...]:
        """Linear and quadratic drag of the axis over its mass."""
        m = self.weights
        return (m[3 + self.axis] / m[self.axis], m[6 + self.axis] / m[self.axis])

    @property
    def b(self) -> float:
        """1 over the mass of the axis."""
        return float(1.0 / self.weights[self.axis])

    @property
    def machine_constants(self) -> tuple[float, ...]:
        """U, F_w, ω_w, m_1 … m_9, B and B⁺ row by row."""
        p = self.parameters
        matrix = vectored(p.angle, p.lever)
        return (p.voltage, p.wave_force, p.wave_frequency, *self.weights,
                *matrix.ravel().tolist(), *pseudo_inverse(matrix).ravel().tolist())

    @staticmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:  # noqa: ARG004
        """Write Y1 = x_i', Y2 = |x_i'| x_i'."""
        y[0] = x[1]
        y[1] = abs(x[1]) * x[1]

    @staticmethod
    def structure(x: Sequence[float], p: Sequence[float], y: Any) -> None:  # noqa: ARG004
        """Write M_ijk = R_ia R_ja and C_ijk of the body's terms, k by k, axis by axis."""
        cosine, sine, rate = math.cos(x[4]), math.sin(x[4]), x[5]
        surge = cosine * x[1] + sine * x[3]
        sway = cosine * x[3] - sine * x[1]
        for i in range(3):
            for k in range(9):
                at = (9 * i + k) * 7
                a = k % 3
                own = turned(i, a, cosine, sine)
                y[at] = 0.0
                for j in range(3):
                    mass = 0.0
                    force = 0.0
                    if k < 3:
                        mass = own * turned(j, a, cosine, sine)
                        force = own * turning(j, a, cosine, sine, rate)
                    elif k < 6:
                        force = own * turned(j, a, cosine, sine)
                    else:
                        speed = rate
                        if a == 0:
                            speed = surge
                        elif a == 1:
                            speed = sway
                        force = own * abs(speed) * turned(j, a, cosine, sine)
                    if k == 0:      # m_1: (C ν)_v = m_1 u r, (C ν)_r = −m_1 u v
                        force += surge * (turned(i, 1, cosine, sine) * turned(j, 2, cosine, sine)
                                          - turned(i, 2, cosine, sine)
                                          * turned(j, 1, cosine, sine))
                    elif k == 1:    # m_2: (C ν)_u = −m_2 v r, (C ν)_r = m_2 v u
                        force += sway * (turned(i, 2, cosine, sine) * turned(j, 0, cosine, sine)
                                         - turned(i, 0, cosine, sine)
                                         * turned(j, 2, cosine, sine))
                    y[at + 1 + j] = mass
                    y[at + 4 + j] = force

    @staticmethod
    def dynamics(t: float, x: Sequence[float], w: Sequence[float], p: Sequence[float],
                 out: Any) -> None:
        """Write x'', y'' [m/s²] and ψ'' [rad/s²]."""
        cosine, sine, rate = math.cos(x[4]), math.sin(x[4]), x[5]
        surge = cosine * x[1] + sine * x[3]
        sway = cosine * x[3] - sine * x[1]
        thrusts = [0.0] * THRUSTERS
        allocate(p, _INVERSE, (cosine * w[0] + sine * w[1], cosine * w[1] - sine * w[0], w[2]),
                 FULL * SLOPE, thrusts)
        forces = [0.0, 0.0, 0.0]
        for j in range(THRUSTERS):
            pushed = thrust(thrusts[j] / SLOPE, p[_VOLTS])
            for i in range(3):
                forces[i] += p[_MATRIX + THRUSTERS * i + j] * pushed
        wave = p[_WAVE] * math.sin(p[_WAVE_RATE] * t)
        m = _MASSES
        drag_u = (p[m + 3] + p[m + 6] * abs(surge)) * surge
        drag_v = (p[m + 4] + p[m + 7] * abs(sway)) * sway
        drag_r = (p[m + 5] + p[m + 8] * abs(rate)) * rate
        faster_u = (forces[0] + cosine * wave - drag_u + p[m + 1] * sway * rate) / p[m]
        faster_v = (forces[1] - sine * wave - drag_v - p[m] * surge * rate) / p[m + 1]
        out[0] = cosine * faster_u - sine * faster_v - rate * x[3]
        out[1] = sine * faster_u + cosine * faster_v + rate * x[1]
        out[2] = (forces[2] - drag_r - (p[m + 1] - p[m]) * surge * sway) / p[m + 2]

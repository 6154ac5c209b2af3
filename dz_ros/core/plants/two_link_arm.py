# SPDX-License-Identifier: Apache-2.0
"""Two links in a vertical plane, a motor behind a dead-zone in each joint [slotine_li1991].

    M(q) q'' + C(q, q') q' + F q' + g(q) = K_t w,     q = (q_1, q_2), w = (D_1(v_1), D_2(v_2))

    M = | m_1 + 2 m_2 cos q_2    m_3 + m_2 cos q_2 |     C = m_2 sin q_2 | −q_2'   −(q_1' + q_2') |
        | m_3 + m_2 cos q_2      m_3               |                     |  q_1'          0       |

    g = | m_4 cos q_1 + m_5 cos(q_1 + q_2) |     F = diag(m_6, m_7)
        | m_5 cos(q_1 + q_2)               |

    m_1 = I_1 + M_1 c_1² + I_2 + M_2 (l² + c_2²),  m_2 = M_2 l c_2,  m_3 = I_2 + M_2 c_2²,
    m_4 = (M_1 c_1 + M_2 l) g,  m_5 = M_2 c_2 g,  m_6, m_7: viscous friction

State of a joint: angle q_i [rad] (q_1 from the horizontal, q_2 from the first link) and speed
q_i' [rad/s]; command and w: current [A]. C is the choice for which M' − 2C is skew-symmetric, so
the motion is linear in m_1 … m_7 as

    M a + C v + F v + g = Σ_k m_k (Σ_j M_ijk(q) a_j + C_ijk(q, q') v_j + g_ik(q)),

the structure that a law of all joints uses with v = q_r', a = q_r'' (`structure`). M_k: mass of
link k, l: length of the first one, c_k: distance of a link's centre of mass from its joint, I_k:
its inertia about it. Numbers: the manipulator of [slotine_li1991], the load taken as the second
link and without its angle δ_e; gravity and friction are ours, as theirs moves in a horizontal
plane without friction.

The view of one joint has the other one at rest, the elbow at a right angle or the first link
level: Y1 = cos q_i, Y2 = q_i'; M_11 = m_1, M_22 = m_3 there. The weight of the second link at the
first joint is left out of it. (ours)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.plants.coupled import CoupledParameters, CoupledPlant
from dz_ros.core.schema import parameter


@dataclass(frozen=True)
class TwoLinkArmParameters(CoupledParameters):
    """Parameters of the arm."""

    mass_1: float = parameter(1.0, 'kg', 'mass M_1 of the first link', minimum=0.0)
    mass_2: float = parameter(2.0, 'kg', 'mass M_2 of the second link with its load', minimum=0.0,
                              open_minimum=True)
    length_1: float = parameter(1.0, 'm', 'length l of the first link', minimum=0.0,
                                open_minimum=True)
    centre_1: float = parameter(0.5, 'm', 'centre of mass c_1 of the first link from its joint',
                                minimum=0.0)
    centre_2: float = parameter(0.6, 'm', 'centre of mass c_2 of the second link from its joint',
                                minimum=0.0)
    inertia_1: float = parameter(0.12, 'kg m²', 'inertia I_1 of the first link about its centre '
                                 'of mass', minimum=0.0, open_minimum=True)
    inertia_2: float = parameter(0.25, 'kg m²', 'inertia I_2 of the second link about its centre '
                                 'of mass', minimum=0.0, open_minimum=True)
    gravity: float = parameter(9.81, 'm/s²', 'gravity g in the plane of motion; 0 where that is '
                               'horizontal', minimum=0.0)
    friction_1: float = parameter(0.5, 'N m s/rad', 'viscous friction m_6 of the first joint',
                                  minimum=0.0)
    friction_2: float = parameter(0.2, 'N m s/rad', 'viscous friction m_7 of the second joint',
                                  minimum=0.0)
    torque_constant: float = parameter(1.0, 'N m/A', 'torque constant K_t of both motors, gears '
                                       'included', minimum=0.0, open_minimum=True)


class TwoLinkArm(CoupledPlant):
    """One joint of an arm of two links."""

    name = 'two_link_arm'
    summary = 'two links in a vertical plane, 2 axes, order 2'
    axes = 2
    order = 2
    regressor_count = 2
    structure_count = 7
    structure_units = ('rad/s²', 'rad/s²', 'rad/s²', '1', '1', 'rad/s', 'rad/s')
    state_units = ('rad', 'rad/s')
    actuator_unit = 'A'
    regressor_units = ('1', 'rad/s')
    default_x0 = (0.0, 0.0)
    Parameters = TwoLinkArmParameters

    @property
    def weights(self) -> tuple[float, ...]:
        """m_1 … m_7 [kg m², kg m², kg m², N m, N m, N m s/rad, N m s/rad]."""
        p = self.parameters
        return (p.inertia_1 + p.mass_1 * p.centre_1 ** 2 + p.inertia_2
                + p.mass_2 * (p.length_1 ** 2 + p.centre_2 ** 2),
                p.mass_2 * p.length_1 * p.centre_2,
                p.inertia_2 + p.mass_2 * p.centre_2 ** 2,
                (p.mass_1 * p.centre_1 + p.mass_2 * p.length_1) * p.gravity,
                p.mass_2 * p.centre_2 * p.gravity, p.friction_1, p.friction_2)

    @property
    def structure_weights(self) -> tuple[float, ...]:
        """m_1 … m_7 over K_t."""
        return tuple(item / self.parameters.torque_constant for item in self.weights)

    @property
    def _inertia(self) -> float:
        """M_ii of the view [kg m²]."""
        return self.weights[0 if self.axis == 0 else 2]

    @property
    def a(self) -> tuple[float, ...]:
        """Weight of the link over its inertia [rad/s²], friction over inertia [1/s]."""
        m = self.weights
        return (m[3 + self.axis] / self._inertia, m[5 + self.axis] / self._inertia)

    @property
    def b(self) -> float:
        """K_t over the joint's own inertia [rad/s² per A]."""
        return float(self.parameters.torque_constant / self._inertia)

    @property
    def machine_constants(self) -> tuple[float, ...]:
        """K_t, m_1 … m_7."""
        return (self.parameters.torque_constant, *self.weights)

    @staticmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:  # noqa: ARG004
        """Write Y1 = cos q_i, Y2 = q_i'."""
        y[0] = math.cos(x[0])
        y[1] = x[1]

    @staticmethod
    def structure(x: Sequence[float], p: Sequence[float], y: Any) -> None:  # noqa: ARG004
        """Write g_ik, M_i1k, M_i2k, C_i1k + F_i1k, C_i2k + F_i2k, k by k, joint by joint."""
        for i in range(70):
            y[i] = 0.0
        cosine, sine = math.cos(x[2]), math.sin(x[2])
        y[1] = 1.0                              # m_1: M_11
        y[6] = 2.0 * cosine                     # m_2: M_11, M_12, C_11, C_12
        y[7] = cosine
        y[8] = -sine * x[3]
        y[9] = -sine * (x[1] + x[3])
        y[12] = 1.0                             # m_3: M_12
        y[15] = math.cos(x[0])                  # m_4, m_5: g_1
        y[20] = math.cos(x[0] + x[2])
        y[28] = 1.0                             # m_6
        y[41] = cosine                          # second joint, m_2: M_21, C_21
        y[43] = sine * x[1]
        y[46] = 1.0                             # m_3: M_21, M_22
        y[47] = 1.0
        y[55] = y[20]                           # m_5: g_2
        y[69] = 1.0                             # m_7

    @staticmethod
    def dynamics(t: float, x: Sequence[float], w: Sequence[float],  # noqa: ARG004
                 p: Sequence[float], out: Any) -> None:
        """Write q'' = M⁻¹ (K_t w − C q' − F q' − g) [rad/s²]."""
        speed_1, speed_2 = x[1], x[3]
        bend, pull = p[2] * math.cos(x[2]), p[2] * math.sin(x[2])
        m11, m12, m22 = p[1] + 2.0 * bend, p[3] + bend, p[3]
        outer = p[5] * math.cos(x[0] + x[2])
        torque_1 = (p[0] * w[0] + pull * speed_2 * (2.0 * speed_1 + speed_2)
                    - p[6] * speed_1 - p[4] * math.cos(x[0]) - outer)
        torque_2 = p[0] * w[1] - pull * speed_1 * speed_1 - p[7] * speed_2 - outer
        determinant = m11 * m22 - m12 * m12
        out[0] = (m22 * torque_1 - m12 * torque_2) / determinant
        out[1] = (m11 * torque_2 - m12 * torque_1) / determinant

# SPDX-License-Identifier: Apache-2.0
"""Position of a vehicle in water, driven by thrusters whose dead band follows the supply voltage.

    (m + m_a) x'' + d_1 x' + d_2 |x'| x' + F_w sin ω_w t = n cos α T(v, U)

State: position x [m] and speed x' [m/s]; command v: pulse width less 1500 µs [µs], of all n
thrusters at once, each at the angle α to the motion. T: thrust of one thruster [N] at the supply
voltage U, `thrust`. Y1 = x', Y2 = |x'| x'; a_1 = d_1/(m + m_a), a_2 = d_2/(m + m_a),
b = n cos α T'/(m + m_a) with T' the slope of T on the right at `NOMINAL` volts, so that the slopes
m of the dead-zone are shares of it; the force of the waves F_w is the disturbance.

`thrust(v, volts)` is the curve by itself, plain scalar code that numba compiles too; `ZONE` is the
same curve as a `DeadZone` (w = thrust over T'), for a plant of your own: its numbers for
`dz_ros.core.deadzone.dead_zone` are `ZONE.numbers(Schedule(times, volts))`.

Dead band and mean slopes at four voltages: public performance data of the T200 thruster
[bluerobotics2019]. Between them linear, beyond them constant (ours). At the edge of the band the
slope is smaller: 0.068 and 0.054 N/µs at 12 V, taken as the same share of the mean slope at every
voltage, and growing evenly to full command (ours). Vehicle: as in
`dz_ros.core.plants.first_order`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.deadzone import dead_zone, DeadZone, Schedule
from dz_ros.core.plants.base import Plant
from dz_ros.core.schema import parameter

VOLTS = (10.0, 12.0, 16.0, 20.0)
"""Supply voltages of the figures [V]."""
BAND_RIGHT = (44.0, 40.0, 32.0, 32.0)
"""Upper edge of the dead band less 1500 µs at them [µs]: the least that gives thrust."""
BAND_LEFT = (-44.0, -40.0, -32.0, -28.0)
"""The lower edge less 1500 µs [µs]."""
SLOPE_RIGHT = (0.083, 0.104, 0.145, 0.180)
"""Mean slope of the thrust at them on the right [N/µs]."""
SLOPE_LEFT = (0.066, 0.082, 0.113, 0.135)
"""The same on the left [N/µs]."""
NOMINAL = 16.0
"""Voltage at which the dead-zone's slope on the right is 1 [V]."""
SLOPE = 0.145
"""Slope T' there [N/µs]."""
EDGE_SLOPE = 0.656
"""Slope at the edge of the band as a share of the mean: mean of 0.068/0.104 and 0.054/0.082."""
EDGE_SPAN = 360.0
"""Distance from the band to full command, 400 µs less the band at 12 V [µs]."""

ZONE = DeadZone(
    m_r=1.0, m_l=SLOPE_LEFT[2] / SLOPE, b_r=BAND_RIGHT[2], b_l=BAND_LEFT[2],
    schedule_points=VOLTS, m_r_table=tuple(item / SLOPE for item in SLOPE_RIGHT),
    m_l_table=tuple(item / SLOPE for item in SLOPE_LEFT), b_r_table=BAND_RIGHT,
    b_l_table=BAND_LEFT, edge_slope=EDGE_SLOPE, edge_span=EDGE_SPAN)
"""The curve, w in µs at `NOMINAL` volts on the right."""

# ψ(t) = t: the numbers of ZONE with the voltage in the place of the time.
_BY_VOLTAGE = ZONE.numbers(Schedule((VOLTS[0], VOLTS[-1]), (VOLTS[0], VOLTS[-1])))


def thrust(v: float, volts: float) -> float:
    """Return the thrust of one thruster [N].

    Args:
        v: Pulse width less 1500 µs [µs]; −400 … 400 of the device.
        volts: Supply voltage [V]; below 10 and above 20 V as at the nearest of the two.
    """
    return SLOPE * dead_zone(v, volts, _BY_VOLTAGE)


@dataclass(frozen=True)
class ThrusterParameters:
    """Parameters of vehicle and thrusters."""

    mass: float = parameter(13.5, 'kg', 'mass m of the vehicle', minimum=0.0, open_minimum=True)
    added_mass: float = parameter(6.36, 'kg', 'added mass m_a of the water in surge', minimum=0.0)
    linear_drag: float = parameter(13.7, 'N s/m', 'linear drag d_1', minimum=0.0)
    quadratic_drag: float = parameter(141.0, 'N s²/m²', 'quadratic drag d_2', minimum=0.0)
    thrusters: float = parameter(4.0, '1', 'number n of thrusters that push along x',
                                 minimum=0.0, open_minimum=True)
    angle: float = parameter(0.7854, 'rad', 'angle α of each to x', minimum=0.0, maximum=1.5)
    slope: float = parameter(SLOPE, 'N/µs', "slope T' of one thruster where the dead-zone's is 1",
                             minimum=0.0, open_minimum=True)
    wave_force: float = parameter(2.0, 'N', 'amplitude F_w of the force of the waves')
    wave_frequency: float = parameter(1.0, 'rad/s', 'angular frequency ω_w of the waves',
                                      minimum=0.0)


class Thruster(Plant):
    """Position of a vehicle under water."""

    name = 'thruster'
    summary = 'position of an underwater vehicle, thrusters by pulse width, order 2'
    order = 2
    regressor_count = 2
    state_units = ('m', 'm/s')
    actuator_unit = 'µs'
    regressor_units = ('m/s', 'm²/s²')
    default_x0 = (0.0, 0.0)
    Parameters = ThrusterParameters

    @property
    def _mass(self) -> float:
        """Mass with that of the water, m + m_a [kg]."""
        return float(self.parameters.mass + self.parameters.added_mass)

    @property
    def a(self) -> tuple[float, ...]:
        """d_1/(m + m_a) [1/s], d_2/(m + m_a) [1/m]."""
        p = self.parameters
        return (p.linear_drag / self._mass, p.quadratic_drag / self._mass)

    @property
    def b(self) -> float:
        """N cos α T'/(m + m_a) [m/s² per µs]."""
        p = self.parameters
        return float(p.thrusters * math.cos(p.angle) * p.slope / self._mass)

    @property
    def extra(self) -> tuple[float, ...]:
        """F_w/(m + m_a) [m/s²], ω_w [rad/s]."""
        return (self.parameters.wave_force / self._mass, self.parameters.wave_frequency)

    @staticmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:  # noqa: ARG004
        """Write Y1 = x', Y2 = |x'| x'."""
        speed = x[1]
        y[0] = speed
        y[1] = abs(speed) * speed

    @staticmethod
    def disturbance(t: float, x: Sequence[float], p: Sequence[float]) -> float:  # noqa: ARG004
        """Return F_w/(m + m_a) sin ω_w t [m/s²]."""
        return p[3] * math.sin(p[4] * t)

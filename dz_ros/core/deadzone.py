# SPDX-License-Identifier: Apache-2.0
"""Dead-zone of an actuator, equations (1)–(4) of Wang, Su and Hong (2004) [wang2004].

    D(v) = m_r (v − b_r)   v ≥ b_r
           0               b_l < v < b_r                                   (1)
           m_l (v − b_l)   v ≤ b_l

    D(v) = m v + d(v),  m the slope of the side v is on                    (2)
    |d| ≤ ρ = max{m_max b_r,max, −m_max b_l,min}                           (4)

v: command, w = D(v): what reaches the plant, both in the actuator's unit. The slopes may differ
and each parameter may drift, p(t) = p + A sin(ω t) (ours).

Each parameter may also follow a scheduling variable ψ, such as the supply voltage, by a table
m_r(ψ), …, linear between its points and constant beyond them; ψ(t) is a constant or a table over
time (`Schedule`), drift comes on top. And the slope may begin smaller at the edge of the band, as
that of a propeller does (ours):

    D(v) = m u (e + (1 − e) min(u/U, 1)) sign,   u the distance of v from the band       (1')

e: share of the slope m at the edge, U: distance at which D reaches m u; e = 1 is (1).

Over 300 lines: the numbers that the compiled function reads and the class that writes them must
agree.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.schema import parameter
from dz_ros.errors import ConfigurationError

_DRIFT = '[amplitude, angular frequency] of a sinusoidal drift of {0}; amplitude 0 = constant'


_EXTENDED = 2.0
"""First number of a dead-zone with tables or (1'); 1 = it drifts, 0 = it is constant."""
_EDGE, _SPAN, _COUNT, _TABLES = 13, 14, 15, 16
"""Places of e, U, number of points and the tables in the numbers of `DeadZone.numbers`."""


def interpolate(x: float, z: Sequence[float], at_x: int, at_y: int, count: int) -> float:
    """Return y(x) of a table, linear between its points, constant beyond them.

    x_1 < x_2 < … are in z from index `at_x` on, y_1, y_2, … from `at_y` on; count >= 1.
    """
    if x <= z[at_x]:
        return z[at_y]
    for i in range(1, count):
        if x < z[at_x + i]:
            left = z[at_x + i - 1]
            low = z[at_y + i - 1]
            return low + (z[at_y + i] - low) * ((x - left) / (z[at_x + i] - left))
    return z[at_y + count - 1]


def scheduling_variable(t: float, z: Sequence[float]) -> float:
    """Return ψ at time t [s], which ends the numbers of a dead-zone with tables."""
    count = int(z[_COUNT])
    at = _TABLES + 5 * count
    instants = (len(z) - at) // 2
    return interpolate(t, z, at, at + instants, instants)


def _followed(parameter: float, t: float, z: Sequence[float]) -> float:
    """Return a parameter (0.0 … 3.0: m_r, m_l, b_r, b_l) at time t [s], drift included.

    Its number is a float: numba compiles a function again for each whole number in a call.
    """
    which = int(parameter)
    value = z[1 + which]
    count = int(z[_COUNT])
    if count > 0:
        value = interpolate(scheduling_variable(t, z), z, _TABLES,
                            _TABLES + (1 + which) * count, count)
    return value + z[5 + 2 * which] * math.sin(z[6 + 2 * which] * t)


def _risen(u: float, z: Sequence[float]) -> float:
    """Return u (e + (1 − e) min(u/U, 1)) of (1'), u >= 0."""
    edge = z[_EDGE]
    if edge == 1.0:
        return u
    share = u / z[_SPAN]
    if share > 1.0:
        share = 1.0
    return u * (edge + (1.0 - edge) * share)


def _extended_dead_zone(v: float, t: float, z: Sequence[float]) -> float:
    """Return w = D(v) at time t [s] with tables or (1')."""
    b_r = _followed(2.0, t, z)
    if v >= b_r:
        return _followed(0.0, t, z) * _risen(v - b_r, z)
    b_l = _followed(3.0, t, z)
    if v <= b_l:
        return -_followed(1.0, t, z) * _risen(b_l - v, z)
    return 0.0


def dead_zone(v: float, t: float, z: Sequence[float]) -> float:
    """Return w = D(v) at time t [s], (1); z: `DeadZone.numbers`."""
    if z[0] == _EXTENDED:
        return _extended_dead_zone(v, t, z)
    m_r, m_l, b_r, b_l = z[1], z[2], z[3], z[4]
    if z[0] != 0.0:
        m_r += z[5] * math.sin(z[6] * t)
        m_l += z[7] * math.sin(z[8] * t)
        b_r += z[9] * math.sin(z[10] * t)
        b_l += z[11] * math.sin(z[12] * t)
    if v >= b_r:
        return m_r * (v - b_r)
    if v <= b_l:
        return m_l * (v - b_l)
    return 0.0


def played(v: float, before: float, width: float) -> float:
    """Return the output of a backlash for input v and its output before [actuator unit].

    It rests while v moves within a play of this width and follows at half the width behind it
    beyond, with slope 1 [tao_kokotovic1995b].
    """
    return min(max(before, v - 0.5 * width), v + 0.5 * width)


def residual(v: float, w: float, t: float, z: Sequence[float]) -> float:
    """Return d(v) = w − m v of (2), m the slope on v's side at time t."""
    right = v >= 0.0
    if z[0] == _EXTENDED:
        return w - _followed(0.0 if right else 1.0, t, z) * v
    m = z[1] if right else z[2]
    if z[0] != 0.0:
        m += (z[5] * math.sin(z[6] * t)) if right else (z[7] * math.sin(z[8] * t))
    return w - m * v


def rho(b_r_max: float, b_l_min: float, m_max: float) -> float:
    """Return ρ, the bound (4) on |d|, from the known bounds (A4)."""
    return max(m_max * b_r_max, -m_max * b_l_min)


@dataclass(frozen=True)
class Schedule:
    """A scheduling variable ψ(t): linear between its instants, constant before and after.

    Attributes:
        times: Instants, rising [s], shape (K,); (0,) for a constant.
        values: ψ at them, shape (K,).
    """

    times: tuple[float, ...]
    values: tuple[float, ...]

    def __call__(self, t: float) -> float:
        """Return ψ(t), t [s]."""
        count = len(self.times)
        return interpolate(t, (*self.times, *self.values), 0, count, count)


NAMES = ('m_r', 'm_l', 'b_r', 'b_l')
"""Parameters of the dead-zone in the order of their numbers."""
_FOLLOWS = '{0} at each of schedule_points; empty = it does not follow'


def _nothing_known(psi: float) -> tuple[float, float]:  # noqa: ARG001
    return (1.0, 1.0)


@dataclass(frozen=True)
class DeadZone:
    """Parameters of the dead-zone, (A2)–(A3); the controller never sees them (A1)."""

    m_r: float = parameter(1.0, '1', 'slope right of the band', minimum=0.0, open_minimum=True)
    m_l: float = parameter(1.0, '1', 'slope left of the band', minimum=0.0, open_minimum=True)
    b_r: float = parameter(0.5, 'actuator unit', 'right break point', minimum=0.0)
    b_l: float = parameter(-0.6, 'actuator unit', 'left break point', maximum=0.0)
    m_r_drift: tuple[float, ...] = parameter(
        (0.0, 0.0), '1, rad/s', _DRIFT.format('m_r'), length=2)
    m_l_drift: tuple[float, ...] = parameter(
        (0.0, 0.0), '1, rad/s', _DRIFT.format('m_l'), length=2)
    b_r_drift: tuple[float, ...] = parameter(
        (0.0, 0.0), 'actuator unit, rad/s', _DRIFT.format('b_r'), length=2)
    b_l_drift: tuple[float, ...] = parameter(
        (0.0, 0.0), 'actuator unit, rad/s', _DRIFT.format('b_l'), length=2)
    schedule_points: tuple[float, ...] = parameter(
        (), 'unit of the scheduling variable', 'points of the tables below, rising; empty = the '
        'dead-zone does not follow loop.schedule_values')
    m_r_table: tuple[float, ...] = parameter((), '1', _FOLLOWS.format('m_r'), minimum=0.0,
                                             open_minimum=True)
    m_l_table: tuple[float, ...] = parameter((), '1', _FOLLOWS.format('m_l'), minimum=0.0,
                                             open_minimum=True)
    b_r_table: tuple[float, ...] = parameter((), 'actuator unit', _FOLLOWS.format('b_r'),
                                             minimum=0.0)
    b_l_table: tuple[float, ...] = parameter((), 'actuator unit', _FOLLOWS.format('b_l'),
                                             maximum=0.0)
    edge_slope: float = parameter(1.0, '1', 'share of the slope at the edge of the band; 1 = the '
                                  'slope is the same everywhere', minimum=0.0, maximum=2.0,
                                  open_minimum=True)
    edge_span: float = parameter(1.0, 'actuator unit', 'distance from the band at which the mean '
                                 'slope is m; the slope is m beyond it', minimum=0.0,
                                 open_minimum=True)

    def check(self, prefix: str) -> None:
        """Check the tables, and that drift keeps each parameter on its side of zero."""
        points = self.schedule_points
        if any(low >= high for low, high in pairwise(points)):
            raise ConfigurationError(f'{prefix}schedule_points', list(points), 'must rise')
        for name in NAMES:
            table = getattr(self, f'{name}_table')
            if len(table) not in (0, len(points)):
                raise ConfigurationError(f'{prefix}{name}_table', list(table), 'must have '
                                         f'{len(points)} numbers, one for each of '
                                         'schedule_points, or none')
            drift = getattr(self, f'{name}_drift')
            if drift[0] == 0.0:
                continue
            least = min(map(abs, table or (getattr(self, name),))) - abs(drift[0])
            if least < 0.0 or (least == 0.0 and name.startswith('m')):
                raise ConfigurationError(f'{prefix}{name}_drift', list(drift),
                                         f'amplitude must be smaller than |{name}|')

    @property
    def absent(self) -> bool:
        """Whether both break points are 0 for good."""
        return self.b_r == self.b_l == self.b_r_drift[0] == self.b_l_drift[0] == 0.0 and not (
            any(self.b_r_table) or any(self.b_l_table))

    @property
    def follows(self) -> bool:
        """Whether any parameter has a table."""
        return any(getattr(self, f'{name}_table') for name in NAMES)

    @property
    def constants(self) -> tuple[float, ...]:
        """`numbers` without a scheduling variable: the parameters by their own values."""
        return self.numbers(None)

    def numbers(self, schedule: Schedule | None) -> tuple[float, ...]:
        """Return the flat numbers for `dead_zone`.

        Flag, m_r, m_l, b_r, b_l, 4 × (amplitude, ω); with tables or (1') also e, U, the number of
        points, the points, the four tables, the instants and values of ψ. Where ψ is constant the
        tables are evaluated here.
        """
        drifts = [getattr(self, f'{name}_drift') for name in NAMES]
        drifting = 1.0 if any(amplitude != 0.0 for amplitude, _ in drifts) else 0.0
        values = tuple(getattr(self, name) for name in NAMES)
        followed = schedule if self.follows else None
        if followed is not None and len(set(followed.values)) == 1:
            values = tuple(self.at(followed.values[0], name) for name in NAMES)
            followed = None
        plain = (*values, *(number for drift in drifts for number in drift))
        if followed is None and self.edge_slope == 1.0:
            return (drifting, *plain)
        head = (_EXTENDED, *plain, self.edge_slope, self.edge_span)
        if followed is None:
            return (*head, 0.0)
        tables = [getattr(self, f'{name}_table') or (value,) * len(self.schedule_points)
                  for name, value in zip(NAMES, values, strict=True)]
        return (*head, float(len(self.schedule_points)), *self.schedule_points,
                *(number for table in tables for number in table),
                *followed.times, *followed.values)

    def at(self, psi: float, name: str) -> float:
        """Return a parameter by name where ψ has this value, without drift."""
        table = getattr(self, f'{name}_table')
        if not table:
            return float(getattr(self, name))
        count = len(table)
        return interpolate(psi, (*self.schedule_points, *table), 0, count, count)

    def extent(self, name: str, schedule: Schedule | None = None) -> tuple[float, float]:
        """Return the lowest and highest value of a parameter, drift and ψ counted in."""
        drift = abs(getattr(self, f'{name}_drift')[0])
        values = [float(getattr(self, name))]
        if schedule is not None and getattr(self, f'{name}_table'):
            low, high = min(schedule.values), max(schedule.values)
            values = [self.at(psi, name) for psi in (
                low, high, *(point for point in self.schedule_points if low < point < high))]
        return min(values) - drift, max(values) + drift

    def slopes(self, schedule: Schedule | None = None,
               known: Callable[[float], tuple[float, float]] = _nothing_known,
               points: Sequence[float] = ()) -> tuple[float, float]:
        """Return the least and largest w over the distance of v from the band, on both sides.

        Args:
            schedule: The scheduling variable ψ; None = the tables are not followed.
            known: ψ → slopes right and left that the law divides by.
            points: ψ at which they change their course.
        """
        ends = []
        values = (0.0,) if schedule is None else (*schedule.values, *(
            point for point in (*self.schedule_points, *points)
            if min(schedule.values) < point < max(schedule.values)))
        for psi in values:
            for name, share in zip(NAMES, known(psi), strict=False):
                drift = abs(getattr(self, f'{name}_drift')[0])
                m = getattr(self, name) if schedule is None else self.at(psi, name)
                ends += [(m - drift) / share, (m + drift) / share]
        return min(ends) * min(self.edge_slope, 1.0), max(ends) * max(self.edge_slope, 1.0)

    def history(self, name: str, t: NDArray[np.float64],
                schedule: Schedule | None) -> NDArray[np.float64]:
        """Return a parameter at each of the times t [s], drift and ψ counted in, shape of t."""
        amplitude, omega = getattr(self, f'{name}_drift')
        table, value = getattr(self, f'{name}_table'), getattr(self, name)
        if table and schedule is not None:
            value = np.interp(np.interp(t, schedule.times, schedule.values),
                              self.schedule_points, table)
        found: NDArray[np.float64] = value + amplitude * np.sin(omega * t)
        return found

    def __call__(self, v: float, t: float = 0.0) -> float:
        """Return w = D(v) at time t [s]."""
        return dead_zone(v, t, self.constants)

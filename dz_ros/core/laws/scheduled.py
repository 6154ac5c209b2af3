# SPDX-License-Identifier: Apache-2.0
"""The law `scheduled` (ours): `robust_eso` in front of a table of the dead-zone, any order n.

    v_d = v of `robust_eso`,   χ = ½ (1 + tanh(v_d/e0))
    v   = v_d/(m̂_r χ + m̂_l (1 − χ)) + f (b̂_r χ + b̂_l (1 − χ)),   clipped to ±v_max

m̂_r(ψ), m̂_l(ψ), b̂_r(ψ), b̂_l(ψ): tables over the scheduling variable ψ, linear between their points
and constant beyond them; ψ is what was measured at the sample before (`psi_0` at the first). f:
share of the break points that is compensated; what is left of the dead-zone is a smaller one, with
the slope m/m̂, and is what `robust_eso` and its bounds (A4) are about: m_bounds are those of m/m̂,
b_r_bounds and b_l_bounds may stay those of the device, since |b − f b̂| is smaller.

The smooth dead-zone inverse with fixed break points is of [tao_kokotovic1994]; the guarantee is
that of `robust_eso` for what is left. e0 should be small against b: the smooth change makes the
loop steeper about v_d = 0.

ψ is the last number of the memory: `Controller` and offline loop write it after the step, where
`loop.schedule_values` gives it; else it stays `psi_0`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

from dz_ros.core.deadzone import interpolate, NAMES
from dz_ros.core.laws.base import Numbers
from dz_ros.core.laws.extensions import clip, right_share
from dz_ros.core.laws.robust_eso import PROJECTION, RobustEso, RobustEsoGains, V_MAX
from dz_ros.core.schema import parameter
from dz_ros.core.signals import before, Signal, V_EXTRA
from dz_ros.errors import ConfigurationError

_AT_EACH = 'known {0} at each of the table points'
PSI = Signal('psi', '', 'scheduling variable', symbol='ψ')
_step = RobustEso.kernel


@dataclass(frozen=True)
class ScheduledGains(RobustEsoGains):
    """Gains of `robust_eso` and the tables; the defaults know nothing and change nothing."""

    table_points: tuple[float, ...] = parameter(
        (0.0,), 'unit of the scheduling variable', 'points of the tables, rising')
    m_r_known: tuple[float, ...] = parameter((1.0,), '1', _AT_EACH.format('m_r'), minimum=0.0,
                                             open_minimum=True)
    m_l_known: tuple[float, ...] = parameter((1.0,), '1', _AT_EACH.format('m_l'), minimum=0.0,
                                             open_minimum=True)
    b_r_known: tuple[float, ...] = parameter((0.0,), 'actuator unit', _AT_EACH.format('b_r'),
                                             minimum=0.0)
    b_l_known: tuple[float, ...] = parameter((0.0,), 'actuator unit', _AT_EACH.format('b_l'),
                                             maximum=0.0)
    compensated: float = parameter(0.8, '1', 'share f of the known break points that is added to '
                                   'v; above b/b̂ the loop may oscillate about 0', minimum=0.0,
                                   maximum=1.0)
    e0: float = parameter(0.01, 'actuator unit', 'width of the change from b̂_l to b̂_r, small '
                          'against them', minimum=0.0, open_minimum=True)
    psi_0: float = parameter(0.0, 'unit of the scheduling variable', 'ψ before the first '
                             'measurement')

    def check(self, prefix: str) -> None:
        """Check that the tables fit their points."""
        points = self.table_points
        if not points or any(low >= high for low, high in pairwise(points)):
            raise ConfigurationError(f'{prefix}table_points', list(points),
                                     'must be one number or more, rising')
        for name in NAMES:
            table = getattr(self, f'{name}_known')
            if len(table) != len(points):
                raise ConfigurationError(f'{prefix}{name}_known', list(table), 'must have '
                                         f'{len(points)} numbers, one for each of table_points')


class Scheduled(RobustEso):
    """Robust law behind a known part of the dead-zone."""

    name = 'scheduled'
    summary = 'robust_eso in front of a table of the dead-zone over a measured variable'
    Gains: ClassVar[type] = ScheduledGains

    @property
    def constants(self) -> tuple[float, ...]:
        """Those of `robust_eso`; f, e0, number of points, the points, the four tables."""
        g = self.gains
        return (*super().constants, g.compensated, g.e0, float(len(g.table_points)),
                *g.table_points, *(number for name in NAMES
                                   for number in getattr(g, f'{name}_known')))

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """Those of `robust_eso`, ψ last."""
        return (*super().signals, *before((PSI,)))

    @property
    def schedule_place(self) -> int:
        """Place of ψ in the memory."""
        return len(super().initial_memory())

    def initial_memory(self) -> tuple[float, ...]:
        """Memory of `robust_eso`, ψ before the first measurement."""
        return (*super().initial_memory(), self.gains.psi_0)

    def known_slopes(self, psi: float) -> tuple[float, float]:
        """Return m̂_r, m̂_l where the scheduling variable has this value."""
        g, count = self.gains, len(self.gains.table_points)
        right, left = (interpolate(psi, (*g.table_points, *table), 0, count, count)
                       for table in (g.m_r_known, g.m_l_known))
        return (right, left)

    @staticmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,
               dt: float, new_memory: Any, terms: Any) -> float:
        """One sample of `robust_eso`, then the tables."""
        v_d = _step(c, memory, x_d, x, y, dt, new_memory, terms)
        n = len(x)
        at = PROJECTION + 3 * n + n * n + 2 * len(y) + 2
        count = int(c[at + 2])
        points = at + 3
        table = points + count
        psi = memory[len(memory) - 1]
        right = right_share(v_d, c[at + 1])
        m_r = interpolate(psi, c, points, table, count)
        m_l = interpolate(psi, c, points, table + count, count)
        b_r = interpolate(psi, c, points, table + 2 * count, count)
        b_l = interpolate(psi, c, points, table + 3 * count, count)
        v = (v_d / (m_r * right + m_l * (1.0 - right))
             + c[at] * (b_r * right + b_l * (1.0 - right)))
        if c[V_MAX] > 0.0:
            v = clip(v, -c[V_MAX], c[V_MAX])
        terms[V_EXTRA] += v - v_d
        return v

# SPDX-License-Identifier: Apache-2.0
"""What the robust gain k* covers: dead-zone, integral, disturbance (ours, after (18)).

    k* ≥ ρ/m_min + ρ_I + Δ/(b_min m_min)

ρ = max{m_max b_r,max, −m_max b_l,min} (4) bounds d(v); with a feed-forward max |d̂ − d| takes its
place, and nothing where the law compensates the dead-zone itself. ρ_I is the authority of an
integral. What is left covers a disturbance |·| ≤ Δ = (k* − ρ/m_min − ρ_I) b_min m_min. A device
that rounds v to steps of q adds m_max q/2 to ρ.

`dz check`, the controller's log at its start and the report state `RobustGain.words`, so they
cannot disagree.
"""

from __future__ import annotations

from dataclasses import dataclass

from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import rho
from dz_ros.core.laws.base import Design
from dz_ros.core.laws.extensions import largest_rest
from dz_ros.core.units import Units

ROUNDING = 1e-9
"""k* may miss its bound by this share: sums that are meant to be equal."""


def least_robust_gain(bound: float, m_min: float, b_min: float = 1.0, disturbance: float = 0.0,
                      reserve: float = 0.0) -> float:
    """Return the least k* that covers dead-zone, disturbance and integral, (18) [actuator unit].

    Args:
        bound: ρ [actuator unit].
        m_min: Least slope m.
        b_min: Least input gain b [unit of x^(n) per actuator unit].
        disturbance: Bound Δ of the disturbance [unit of x^(n)].
        reserve: Authority ρ_I of an integral [actuator unit].
    """
    return bound / m_min + disturbance / (b_min * m_min) + reserve


def dead_zone_bound(c: Configuration, design: Design) -> float:
    """Return what of the dead-zone k* has to cover, ρ, or m_max |d̂ − d|/m with a feed-forward."""
    known = c.controller_settings
    if design.inverse:
        return 0.0
    if design.guess:
        return known.m_bounds[1] * largest_rest(design.guess, known.b_r_bounds, known.b_l_bounds)
    return rho(known.b_r_bounds[1], known.b_l_bounds[0], known.m_bounds[1])


def rounding_bound(c: Configuration, step: float) -> float:
    """Return what rounding of v adds to ρ, m_max q/2 [actuator unit].

    From |D(v + δ) − m v| ≤ ρ + m_max |δ|, |δ| ≤ q/2.

    Args:
        c: The bounds of m.
        step: One step q of the command [actuator unit].
    """
    return 0.5 * c.controller_settings.m_bounds[1] * step


@dataclass(frozen=True)
class RobustGain:
    """The robust gain of a configuration beside what it has to cover.

    Attributes:
        law: Name of the law.
        design: What is known of the law.
        bound: What of the dead-zone k* has to cover, ρ [actuator unit].
        m_min: Least slope m.
        b_min: Least input gain b [unit of x^(n) per actuator unit].
        units: Those of the plant.
    """

    law: str
    design: Design
    bound: float
    m_min: float
    b_min: float
    units: Units

    @classmethod
    def of(cls, c: Configuration) -> RobustGain | None:
        """Return that of a configuration of one axis; None where nothing is known of its law."""
        design, known = c.law.design, c.controller_settings
        return None if design is None else cls(
            c.law.name, design, dead_zone_bound(c, design), known.m_bounds[0], known.b_bounds[0],
            Units.of(c.plant))

    @property
    def least(self) -> float:
        """The least k* that covers dead-zone and integral [actuator unit]."""
        return self.with_disturbance(0.0)

    def with_disturbance(self, disturbance: float) -> float:
        """Return the least k* that covers a disturbance [unit of x^(n)] too [actuator unit]."""
        return least_robust_gain(self.bound, self.m_min, self.b_min, disturbance,
                                 self.design.reserve)

    def covers(self, disturbance: float = 0.0) -> bool:
        """Return whether k* covers the dead-zone and a disturbance [unit of x^(n)]."""
        return self.design.k >= self.with_disturbance(disturbance) * (1.0 - ROUNDING)

    @property
    def room(self) -> float:
        """The largest disturbance that k* covers beside the dead-zone [unit of x^(n)]."""
        return max(0.0, (self.design.k - self.least) * self.b_min * self.m_min)

    @property
    def term(self) -> str:
        """What k* is compared with, as text."""
        v = self.units.behind('v')
        share = f' + {self.design.reserve:g}{v} of the integral' if self.design.reserve else ''
        name = 'what the feed-forward leaves, rho' if self.design.guess else 'rho'
        return f'{name}/m_min{share} = {self.least:.4g}{v}'

    @property
    def words(self) -> str:
        """What k* covers, as text."""
        k, v = self.design.k, self.units.behind('v')
        inverse = f'{self.law} compensates the dead-zone itself'
        if k <= 0.0:
            return (f'{inverse}, nothing covers a disturbance' if self.design.inverse else
                    f'{self.law} has no robust term: nothing covers the dead-zone, {self.term}')
        if not self.covers():
            return f'k* = {k:g}{v} does not cover the dead-zone: {self.term}'
        return ((f'{inverse}, k* = {k:g}{v} covers' if self.design.inverse else
                 f'k* = {k:g}{v} covers the dead-zone ({self.term}) and')
                + f' a disturbance of up to {self.room:.4g}{self.units.behind("x^(n)")}')

    def leaves_to_integral(self, disturbance: float) -> bool:
        """Return whether an integral inside the layer has to take a part, and can (unproven)."""
        return not self.covers(disturbance) and (
            self.design.inner_reserve >= self.with_disturbance(disturbance) - self.design.k)

    def beside(self, disturbance: float) -> str:
        """Return as text what covers the rest of a disturbance [unit of x^(n)]; '' = no rest."""
        if self.covers(disturbance):
            return ''
        v = self.units.behind('v')
        if self.leaves_to_integral(disturbance):
            return (', of which the integral inside the layer, up to '
                    f'{self.design.inner_reserve:g}{v}, takes the rest: in simulation, without '
                    f'proof (k* = {self.with_disturbance(disturbance):.4g}{v} would have one)')
        return ', more than k* covers'

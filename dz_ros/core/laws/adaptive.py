# SPDX-License-Identifier: Apache-2.0
"""The adaptive law without a robust term [slotine_li1991], and with one not made for a dead-zone.

    v = −k_d s + φ̂ u_fd + Yᵀθ̂ − k sat(s/ε),   θ̂_i' = −γ Y_i s_ε,   φ̂' = −η u_fd s_ε

That is (14)–(16) of [wang2004], any order n: `adaptive` with k = 0, `sliding`
[slotine_coetsee1986] with k ≥ |disturbance|/(b m). Proven for a plant without dead-zone: all
signals bounded, s → the layer (`adaptive`: without disturbance). With one, s keeps an error of the
order ρ/(m k_d) under `adaptive` and, without projection, θ̂, φ̂ may drift; for `sliding` nothing
is proven unless k happens to exceed ρ/m_min + disturbance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

from dz_ros.core.laws.base import Design, Tunable
from dz_ros.core.laws.wang2004 import adaptive_design, AdaptiveGains, Wang2004
from dz_ros.core.schema import parameter
from dz_ros.core.tracking import error_weights, feed_forward_weights


@dataclass(frozen=True)
class RestingGains(AdaptiveGains):
    """Gains of the adaptive part of (14)–(16)."""

    epsilon: float = parameter(0.02, 'unit of s', 'adaptation stands still where |s| ≤ ε',
                               minimum=0.0, open_minimum=True)


@dataclass(frozen=True)
class SwitchingGains(RestingGains):
    """The same with a robust term made for the disturbance, not for the dead-zone."""

    k: float = parameter(1.47, 'actuator unit', 'gain k of the robust term: disturbance bound '
                         '1.25 / m_min 0.85 (ours)', minimum=0.0)


class Adaptive(Wang2004):
    """(14)–(16) with k* = 0."""

    name = 'adaptive'
    summary = 'adaptive law without a robust term, (14)-(16) with k* = 0'
    Gains: ClassVar[type] = RestingGains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 0.3, 30.0), Tunable('k_d', 2.0, 100.0),
        Tunable('gamma', 0.02, 20.0), Tunable('eta', 0.02, 20.0))

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k, ε, γ, η, Λ, Λ_v."""
        g = self.gains
        return (g.k_d, self._k, g.epsilon, g.gamma, g.eta, *error_weights(g.lambda_, self.order),
                *feed_forward_weights(g.lambda_, self.order))

    @property
    def _k(self) -> float:
        return float(getattr(self.gains, 'k', 0.0))

    @cached_property
    def design(self) -> Design:
        """What the design rules need."""
        found = adaptive_design(self.gains, self.order, self._k, self.gains.epsilon)
        return found if self._k > 0.0 else replace(found, target=0.0)


class Sliding(Adaptive):
    """(14)–(16) with k for the disturbance only."""

    name = 'sliding'
    summary = 'adaptive sliding control after Slotine and Coetsee 1986, unaware of the dead-zone'
    Gains: ClassVar[type] = SwitchingGains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        *Adaptive.tunable, Tunable('k', 0.3, 8.0), Tunable('epsilon', 0.002, 0.5))

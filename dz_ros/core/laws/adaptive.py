"""The adaptive law without a robust term, any order n [slotine_li1991] (chapter 8).

    v = −k_d s + φ̂ u_fd + Yᵀθ̂,   θ̂_i' = −γ Y_i s_ε,   φ̂' = −η u_fd s_ε

That is (14)–(16) of [wang2004] with k* = 0. Proven for a plant without dead-zone and disturbance:
all signals bounded, s → the layer. Behind a dead-zone nothing covers d(v): s keeps an error of the
order ρ/(m k_d) and, without projection, θ̂, φ̂ may drift.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from dz_ros.core.laws.base import Design
from dz_ros.core.laws.wang2004 import adaptive_design, Wang2004
from dz_ros.core.schema import parameter
from dz_ros.core.tracking import error_weights, feed_forward_weights


@dataclass(frozen=True)
class AdaptiveGains:
    """Gains of the adaptive part of (14)–(16), as in [wang2004]; λ is ours."""

    lambda_: float = parameter(1.0, '1/s', 'slope λ of the filtered error (8)',
                               minimum=0.0, open_minimum=True)
    k_d: float = parameter(10.0, 'actuator unit per unit of s', 'damping gain k_d of (14)',
                           minimum=0.0, open_minimum=True)
    epsilon: float = parameter(0.02, 'unit of s', 'adaptation stands still where |s| ≤ ε',
                               minimum=0.0, open_minimum=True)
    gamma: float = parameter(0.5, '1', 'adaptation gain γ of (15)', minimum=0.0)
    eta: float = parameter(0.5, '1', 'adaptation gain η of (16)', minimum=0.0)
    theta_0: tuple[float, ...] = parameter(
        (0.85,), '1', 'initial θ̂, one number for each regressor or one for all')
    phi_0: float = parameter(0.85, '1', 'initial φ̂')


@dataclass(frozen=True)
class SwitchingGains(AdaptiveGains):
    """The same with a robust term made for the disturbance, not for the dead-zone."""

    k: float = parameter(1.47, 'actuator unit', 'gain k of the robust term: disturbance bound '
                         '1.25 / m_min 0.85 (ours)', minimum=0.0)


class Adaptive(Wang2004):
    """(14)–(16) with k* = 0."""

    name = 'adaptive'
    summary = 'adaptive law without a robust term, (14)-(16) with k* = 0'
    Gains: ClassVar[type] = AdaptiveGains

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k, ε, γ, η, Λ, Λ_v."""
        g = self.gains
        return (g.k_d, self._k, g.epsilon, g.gamma, g.eta, *error_weights(g.lambda_, self.order),
                *feed_forward_weights(g.lambda_, self.order))

    @property
    def _k(self) -> float:
        return float(getattr(self.gains, 'k', 0.0))

    @property
    def design(self) -> Design:
        """What the design rules need."""
        found = adaptive_design(self.gains, self.order, self._k, self.gains.epsilon)
        return found if self._k > 0.0 else replace(found, target=0.0)

# SPDX-License-Identifier: Apache-2.0
"""The dead-zone inverted with its true break points: a bound, not a candidate [tao_kokotovic1994].

    v_d = −k_d s + φ̂ u_fd + Yᵀθ̂ − k sat(s/ε)                               (14)
    v   = v_d + b_r (v_d > 0),   v_d + b_l (v_d < 0),   0 (v_d = 0)
    θ̂_i' = −γ Y_i s_ε,   φ̂' = −η u_fd s_ε

Any order n. With equal slopes D(v) = m v_d exactly, so the theorem of [wang2004] holds with d = 0:
k has to cover the disturbance only. b_r and b_l, which (A1)–(A4) take as unknown, are gains here.
v jumps by b_r − b_l where v_d changes sign.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from dz_ros.core.laws.adaptive import Adaptive, SwitchingGains
from dz_ros.core.laws.base import Design, Numbers, Tunable
from dz_ros.core.laws.wang2004 import adaptive_step
from dz_ros.core.schema import parameter
from dz_ros.core.signals import V_EXTRA


@dataclass(frozen=True)
class ExactInverseGains(SwitchingGains):
    """Gains of (14) and the break points; the defaults are those of the example."""

    k: float = parameter(2.5, 'actuator unit', 'gain k of the robust term', minimum=0.0)
    b_r: float = parameter(0.5, 'actuator unit', "the actuator's true b_r", minimum=0.0)
    b_l: float = parameter(-0.6, 'actuator unit', "the actuator's true b_l", maximum=0.0)


class ExactInverse(Adaptive):
    """(14) behind the exact inverse."""

    name = 'exact_inverse'
    summary = 'ideal bound: the dead-zone inverted with its true break points'
    Gains = ExactInverseGains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 0.3, 30.0), Tunable('k_d', 2.0, 60.0),
        Tunable('epsilon', 0.002, 0.5), Tunable('gamma', 0.02, 20.0))

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k, ε, γ, η, Λ, Λ_v, b_r, b_l."""
        return (*super().constants, self.gains.b_r, self.gains.b_l)

    @cached_property
    def design(self) -> Design:
        """What the design rules need: k need not cover the dead-zone."""
        return replace(super().design, inverse=True)

    @staticmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,
               dt: float, new_memory: Any, terms: Any) -> float:
        """One sample."""
        v_d = adaptive_step(c, memory, x_d, x, y, dt, new_memory, terms)
        jump = 0.0
        if v_d > 0.0:
            jump = c[5 + 2 * len(x)]
        elif v_d < 0.0:
            jump = c[6 + 2 * len(x)]
        terms[V_EXTRA] = jump
        return v_d + jump

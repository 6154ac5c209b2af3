"""The dead-zone inverted with its true break points: a bound, not a candidate [tao_kokotovic1994].

    v_d = −k_d s + φ̂ u_fd + Yᵀθ̂ − k sat(s/ε)                               (14)
    v   = v_d + b_r (v_d > 0),   v_d + b_l (v_d < 0),   0 (v_d = 0)
    θ̂_i' = −γ Y_i s_ε,   φ̂' = −η u_fd s_ε

Any order n. With equal slopes D(v) = m v_d exactly, so the theorem of [wang2004] holds with d = 0:
k has to cover the disturbance only. It needs what (A1)–(A4) say nobody knows, b_r and b_l, as
gains; k is 0, 1.47 or 2.5 in the comparison. v jumps by b_r − b_l where v_d changes sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from dz_ros.core.laws.adaptive import Adaptive, SwitchingGains
from dz_ros.core.laws.base import Design
from dz_ros.core.laws.wang2004 import adapt, control
from dz_ros.core.records import STATUS
from dz_ros.core.schema import parameter
from dz_ros.core.tracking import feed_forward, filtered_error


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

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k, ε, γ, η, Λ, Λ_v, b_r, b_l."""
        return (*super().constants, self.gains.b_r, self.gains.b_l)

    @property
    def design(self) -> Design:
        """What the design rules need: k need not cover the dead-zone."""
        return replace(super().design, inverse=True)

    @staticmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
               x: Sequence[float], y: Sequence[float], dt: float, new_memory: Any,
               terms: Any) -> float:
        """One sample."""
        n = len(x)
        s = filtered_error(c, 5, x_d, x)
        u_fd = feed_forward(c, 5 + n, x_d, x)
        v_d = control(c[0], c[1], c[2], memory, s, u_fd, y, terms)
        jump = 0.0
        if v_d > 0.0:
            jump = c[5 + 2 * n]
        elif v_d < 0.0:
            jump = c[6 + 2 * n]
        terms[7] = jump
        adapt(c[3], c[4], memory, y, u_fd, terms[1], dt, new_memory)
        for i in range(len(memory)):
            terms[STATUS + 1 + i] = memory[i]
        terms[STATUS] = 0.0
        return v_d + jump

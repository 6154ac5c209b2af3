"""Adaptive fuzzy dead-zone compensation, after Lewis, Tim, Wang and Li [lewis1999].

    r = −s,   w = (14) with k,   θ̂, φ̂ by (15), (16)
    X₊ = clip((w + D)/(2D), 0, 1),   X₋ = 1 − X₊     memberships of "w is right", "w is left"
    v  = w + d̂₊ X₊ + d̂₋ X₋
    d̂± ' = g (X± r − κ|r| d̂±),   d̂±(0) = 0

Any order n in this form (ours; the original drives a Lagrangian mechanical system, order 2 per
joint). Rebuilt from descriptions, not transcribed: say "after". In the original tracking error and
d̂ are proven uniformly ultimately bounded; here the leakage bounds d̂, |d̂±| ≤ 1/κ (as long as
g κ|s| T < 1), and the rest rests on simulation. Gains are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from dz_ros.core.laws.adaptive import Adaptive, SwitchingGains
from dz_ros.core.laws.base import Design
from dz_ros.core.laws.extensions import clip
from dz_ros.core.laws.wang2004 import adapt, control
from dz_ros.core.records import STATUS
from dz_ros.core.schema import parameter
from dz_ros.core.tracking import feed_forward, filtered_error


@dataclass(frozen=True)
class FuzzyGains(SwitchingGains):
    """Gains of (14)–(16) and of the compensator."""

    fuzzy_overlap: float = parameter(0.1, 'actuator unit', 'half-width D of the overlap of the '
                                     'memberships', minimum=0.0, open_minimum=True)
    fuzzy_gain: float = parameter(20.0, 'actuator unit per unit of s per s',
                                  'adaptation gain g of d̂±', minimum=0.0)
    fuzzy_leakage: float = parameter(0.1, '1 per actuator unit', 'leakage κ of d̂±', minimum=0.0)


class Fuzzy(Adaptive):
    """(14) behind an adaptive fuzzy compensator of two rules."""

    name = 'fuzzy'
    summary = 'adaptive fuzzy dead-zone compensation after Lewis et al. 1999'
    Gains = FuzzyGains

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k, ε, γ, η, Λ, Λ_v, D, g, κ."""
        g = self.gains
        return (*super().constants, g.fuzzy_overlap, g.fuzzy_gain, g.fuzzy_leakage)

    @property
    def signal_names(self) -> tuple[str, ...]:
        """θ̂, φ̂, d̂₊, d̂₋ as used in v, which are the whole memory."""
        return (*super().signal_names, 'd_plus', 'd_minus')

    def initial_memory(self) -> tuple[float, ...]:
        """θ̂(0), φ̂(0), d̂± = 0."""
        return (*super().initial_memory(), 0.0, 0.0)

    @property
    def design(self) -> Design:
        """What the design rules need: k need not cover the dead-zone."""
        return replace(super().design, inverse=True, target=0.0)

    @staticmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
               x: Sequence[float], y: Sequence[float], dt: float, new_memory: Any,
               terms: Any) -> float:
        """One sample."""
        n = len(x)
        own = 5 + 2 * n
        plus = len(y) + 1
        s = filtered_error(c, 5, x_d, x)
        u_fd = feed_forward(c, 5 + n, x_d, x)
        w = control(c[0], c[1], c[2], memory, s, u_fd, y, terms)
        right = clip((w + c[own]) / (2.0 * c[own]), 0.0, 1.0)
        compensation = memory[plus] * right + memory[plus + 1] * (1.0 - right)
        terms[7] = compensation
        adapt(c[3], c[4], memory, y, u_fd, terms[1], dt, new_memory)
        leak = c[own + 2] * abs(s)
        new_memory[plus] = memory[plus] + dt * c[own + 1] * (
            -right * s - leak * memory[plus])
        new_memory[plus + 1] = memory[plus + 1] + dt * c[own + 1] * (
            -(1.0 - right) * s - leak * memory[plus + 1])
        for i in range(len(memory)):
            terms[STATUS + 1 + i] = memory[i]
        terms[STATUS] = 0.0
        return float(w + compensation)

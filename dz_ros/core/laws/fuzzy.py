# SPDX-License-Identifier: Apache-2.0
"""Adaptive fuzzy dead-zone compensation, after Lewis, Tim, Wang and Li [lewis1999].

    r = −s,   w = (14) with k,   θ̂, φ̂ by (15), (16)
    X₊ = clip((w + D)/(2D), 0, 1),   X₋ = 1 − X₊     memberships of "w is right", "w is left"
    v  = w + d̂₊ X₊ + d̂₋ X₋
    d̂± ' = g (X± r − κ|r| d̂±),   d̂±(0) = 0

Any order n in this form (ours), rebuilt from descriptions, not transcribed. The leakage bounds d̂,
|d̂±| ≤ 1/κ (as long as g κ|s| T < 1); the rest is simulation. Gains are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from dz_ros.core.design.linear_loop import LayerModel
from dz_ros.core.laws.adaptive import Adaptive, SwitchingGains
from dz_ros.core.laws.base import Design, Numbers, Tunable
from dz_ros.core.laws.extensions import clip
from dz_ros.core.laws.wang2004 import adaptive_step
from dz_ros.core.schema import parameter
from dz_ros.core.signals import Role, S, Signal, V_EXTRA
from dz_ros.core.tracking import error_weights


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
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 0.3, 30.0), Tunable('k_d', 2.0, 60.0),
        Tunable('k', 0.3, 8.0), Tunable('epsilon', 0.002, 0.5), Tunable('gamma', 0.02, 20.0))

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k, ε, γ, η, Λ, Λ_v, D, g, κ."""
        g = self.gains
        return (*super().constants, g.fuzzy_overlap, g.fuzzy_gain, g.fuzzy_leakage)

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """θ̂, φ̂, d̂₊, d̂₋ as used in v, which are the whole memory."""
        return (*super().signals, Signal('d_plus', 'v', 'break point right', Role.ESTIMATE, 'd̂_+'),
                Signal('d_minus', 'v', 'break point left', Role.ESTIMATE, 'd̂_-'))

    def initial_memory(self) -> tuple[float, ...]:
        """θ̂(0), φ̂(0), d̂± = 0."""
        return (*super().initial_memory(), 0.0, 0.0)

    @cached_property
    def design(self) -> Design:
        """What the design rules need: k need not cover the dead-zone."""
        return replace(super().design, inverse=True, target=0.0)

    def layer_model(self, gain: float | None = None) -> LayerModel | None:
        """Return the model far from v = 0, where one rule acts: its d̂ is an integral of −s."""
        bare = super().layer_model(gain)
        if bare is None:
            return None
        weights = np.asarray(error_weights(self.gains.lambda_, self.order))
        step = -self.period * self.gains.fuzzy_gain * weights[None, :]
        return replace(bare, places=(self.regressor_count + 1,), a=np.eye(1), b=step,
                       c=np.ones(1))

    @staticmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,
               dt: float, new_memory: Any, terms: Any) -> float:
        """One sample."""
        own = 5 + 2 * len(x)
        plus = len(y) + 1
        w = adaptive_step(c, memory, x_d, x, y, dt, new_memory, terms)
        s = terms[S]
        right = clip((w + c[own]) / (2.0 * c[own]), 0.0, 1.0)
        compensation = memory[plus] * right + memory[plus + 1] * (1.0 - right)
        terms[V_EXTRA] = compensation
        leak = c[own + 2] * abs(s)
        new_memory[plus] = memory[plus] + dt * c[own + 1] * (
            -right * s - leak * memory[plus])
        new_memory[plus + 1] = memory[plus + 1] + dt * c[own + 1] * (
            -(1.0 - right) * s - leak * memory[plus + 1])
        return float(w + compensation)

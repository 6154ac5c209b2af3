# SPDX-License-Identifier: Apache-2.0
"""Super-twisting control with an adaptive gain [shtessel2012], over a nominal model.

    v  = ff − k_d s − α |s|^½ sgn s − w,   w' = ½ β sgn s,   β = 2 κ α
    α' = α_1 where |s| > μ, −α_1 where |s| ≤ μ and α > α_0, never below α_0

Sampled, sgn is taken as sat(s/ε) and |s|^½ sgn s as s/√ε where |s| ≤ ε (ours): the discontinuity
is a layer, as in the other laws, else it chatters at every rate. Both advance by one Euler step
after v; while v is clipped, w moves towards 0 only (ours). The source lets α grow slowly where
α ≤ α_0; the floor in place of that is ours. Proven in continuous time: finite-time convergence
for a σ of bounded rate; a dead-zone's residual jumps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Any, ClassVar

from dz_ros.core.laws.base import Design, publish, Tunable
from dz_ros.core.laws.nominal import clipped, Nominal, nominal_terms, NominalGains
from dz_ros.core.schema import parameter
from dz_ros.core.signals import (
    Signal,
    STATUS,
    V_DAMPING,
    V_EXTRA,
    V_FEED_FORWARD,
    V_REGRESSOR,
    V_ROBUST,
)
from dz_ros.core.tracking import sat


@dataclass(frozen=True)
class SuperTwistingGains(NominalGains):
    """Gains; the values are ours."""

    alpha_0: float = parameter(4.0, 'actuator unit per root of the unit of s', 'least α',
                               minimum=0.0, open_minimum=True)
    alpha_rate: float = parameter(5.0, 'α per s', 'α_1, rate of the adaptation', minimum=0.0)
    kappa: float = parameter(5.0, '1/s', 'κ of β = 2 κ α', minimum=0.0)
    mu: float = parameter(0.05, 'unit of s', 'μ, |s| beyond which α grows', minimum=0.0)
    epsilon: float = parameter(0.02, 'unit of s', 'ε, where the law is made continuous',
                               minimum=0.0, open_minimum=True)


class SuperTwisting(Nominal):
    """Second-order sliding mode with a gain that grows where it is needed."""

    name = 'super_twisting'
    summary = 'adaptive-gain super-twisting, after Shtessel, Taleb and Plestan 2012'
    Gains: ClassVar[type] = SuperTwistingGains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 0.3, 60.0), Tunable('k_d', 2.0, 150.0),
        Tunable('alpha_0', 0.5, 40.0), Tunable('alpha_rate', 0.1, 50.0),
        Tunable('kappa', 0.2, 60.0), Tunable('epsilon', 0.002, 0.5))

    @property
    def own(self) -> tuple[float, ...]:
        """α_0, α_1, κ, μ, ε, √ε."""
        g = self.gains
        return (g.alpha_0, g.alpha_rate, g.kappa, g.mu, g.epsilon, math.sqrt(g.epsilon))

    @property
    def moving(self) -> tuple[int, ...]:
        """Place of w; α does not move v at s = 0."""
        return (2,)

    @cached_property
    def design(self) -> Design:
        """What the design rules need: the slope at s = 0."""
        found = super().design
        return replace(found, gain=found.gain + self.gains.alpha_0
                       / math.sqrt(self.gains.epsilon))

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """The memory: begun, α, w."""
        return (Signal('started', '1', '1 after the first sample'),
                Signal('alpha_extra', '1', 'α beyond α_0'),
                Signal('v_twist', 'v', 'integral of the sign of s', symbol='w'))

    @staticmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
               x: Sequence[float], y: Sequence[float], dt: float,
               new_memory: Any, terms: Any) -> float:
        """One sample."""
        s = nominal_terms(c, x_d, x, y, terms)
        at = 3 + 2 * len(x) + len(y)
        epsilon = c[at + 4]
        alpha = c[at] + memory[1]
        size = abs(s)
        if size <= epsilon:
            root = s / c[at + 5]
        else:
            root = math.sqrt(size)
            if s < 0.0:
                root = -root
        terms[V_ROBUST] = -alpha * root
        terms[V_EXTRA] = -memory[2]
        whole = ((((terms[V_DAMPING] + terms[V_FEED_FORWARD]) + terms[V_REGRESSOR])
                  + terms[V_ROBUST]) + terms[V_EXTRA])
        v = clipped(whole, c[at - 1])
        terms[V_EXTRA] += v - whole
        change = -c[at + 1]
        if size > c[at + 3]:
            change = c[at + 1]
        new_memory[0] = memory[0]
        if dt > 0.0:
            new_memory[0] = 1.0
        new_memory[1] = max(memory[1] + dt * change, 0.0)
        new_memory[2] = memory[2]
        if v == whole or s * memory[2] < 0.0:
            new_memory[2] += dt * (c[at + 2] * alpha * sat(s / epsilon))
        publish(memory, STATUS + 1, terms)
        return float(v)

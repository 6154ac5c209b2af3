# SPDX-License-Identifier: Apache-2.0
"""Control with a nominal model and a disturbance observer of first order [chen2000].

    σ̂ = p + g s/b̂,   p' = −g (v − ff + σ̂),   v = ff − k_d s − σ̂,   ff = φ_0 u_fd + Yᵀθ_0

so that σ̂' = g (σ − σ̂) for σ of `dz_ros.core.laws.nominal`; s in place of the whole state is ours.
p advances by the exact step of its equation with s and v held. Proven for a slow σ; a dead-zone's
residual jumps at every change of sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any, ClassVar

from dz_ros.core.laws.base import publish, Tunable
from dz_ros.core.laws.nominal import clipped, Nominal, nominal_terms, NominalGains
from dz_ros.core.schema import parameter
from dz_ros.core.signals import Signal, STATUS, V_DAMPING, V_EXTRA, V_FEED_FORWARD, V_REGRESSOR


@dataclass(frozen=True)
class DisturbanceObserverGains(NominalGains):
    """Gains; the values are ours."""

    observer_rate: float = parameter(40.0, 'rad/s', 'g, bandwidth of the observer', minimum=0.0,
                                     open_minimum=True)


class DisturbanceObserver(Nominal):
    """A nominal law and an estimate of what it leaves."""

    name = 'disturbance_observer'
    summary = 'nominal model with a disturbance observer, after Chen et al. 2000'
    Gains: ClassVar[type] = DisturbanceObserverGains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 0.3, 60.0), Tunable('k_d', 2.0, 150.0),
        Tunable('observer_rate', 2.0, 200.0), Tunable('phi_0', 0.4, 2.0))

    @property
    def own(self) -> tuple[float, ...]:
        """G."""
        return (self.gains.observer_rate,)

    @property
    def moving(self) -> tuple[int, ...]:
        """Place of p."""
        return (1,)

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """The memory: begun, p."""
        return (Signal('started', '1', '1 after the first sample'),
                Signal('observer_state', 'v', 'state of the observer', symbol='p'))

    @staticmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
               x: Sequence[float], y: Sequence[float], dt: float,
               new_memory: Any, terms: Any) -> float:
        """One sample."""
        s = nominal_terms(c, x_d, x, y, terms)
        rate = c[3 + 2 * len(x) + len(y)]
        share = rate * s * c[1]
        state = memory[1]
        if memory[0] == 0.0:
            state = -share
        sigma = state + share
        terms[V_EXTRA] = -sigma
        whole = (((terms[V_DAMPING] + terms[V_FEED_FORWARD]) + terms[V_REGRESSOR])
                 + terms[V_EXTRA])
        v = clipped(whole, c[2 + 2 * len(x) + len(y)])
        terms[V_EXTRA] += v - whole
        for i in range(len(memory)):
            new_memory[i] = memory[i]
        if dt > 0.0:
            rest = v - terms[V_FEED_FORWARD] - terms[V_REGRESSOR]
            new_memory[0] = 1.0
            new_memory[1] = state - (1.0 - math.exp(-rate * dt)) * (rest + sigma)
        publish(memory, STATUS + 1, terms)
        return float(v)

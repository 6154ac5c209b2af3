# SPDX-License-Identifier: Apache-2.0
"""PID control, the second baseline [astrom_hagglund1995], for any order n (ours for n ≠ 2).

    v  = −k_d (λⁿ I + n λ^(n−1) x̃ + … + n λ x̃^(n−2) + x̃^(n−1)),   the weights of (p + λ)ⁿ
    I' = x̃
    n = 2:  v = −k_d (x̃' + 2λ x̃ + λ² I)

I advances by one Euler step after v. Proven for a linear plant only; behind a dead-zone the
integral has to cross the band at every change of sign, which costs time and overshoot, and at
rest it may hunt. No anti-windup: I runs on while the actuator saturates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from dz_ros.core.design.linear_loop import LayerModel
from dz_ros.core.laws.base import Design, Law, Numbers, publish, Tunable
from dz_ros.core.schema import parameter
from dz_ros.core.signals import S, Signal, STATUS, U_FD, V_DAMPING
from dz_ros.core.tracking import error_weights, filtered_error

INTEGRAL = Signal('integral', 'x s', 'integral of x̃', symbol='I')


@dataclass(frozen=True)
class PidGains:
    """Gains of PID control; the values are ours."""

    lambda_: float = parameter(1.0, '1/s', 'n-fold corner frequency λ', minimum=0.0,
                               open_minimum=True)
    k_d: float = parameter(10.0, 'actuator unit per unit of x^(n−1)', 'gain k_d', minimum=0.0,
                           open_minimum=True)


class Pid(Law):
    """Proportional, integral and derivative action, n-fold corner."""

    name = 'pid'
    summary = "PID baseline: -k_d (x̃' + 2λ x̃ + λ² ∫x̃)"
    Gains = PidGains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 0.3, 60.0), Tunable('k_d', 2.0, 150.0),)

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, weights of I, x̃, …, x̃^(n−1)."""
        return (self.gains.k_d, *error_weights(self.gains.lambda_, self.order + 1))

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """I as used in v."""
        return (INTEGRAL,)

    @cached_property
    def design(self) -> Design:
        """What the design rules need: no layer, no robust term."""
        return Design(self.gains.lambda_, self.gains.k_d, 0.0, 0.0, self.gains.k_d, 0.0)

    def layer_model(self, gain: float | None = None) -> LayerModel:
        """Return the law, which is linear everywhere: I' = x̃ in steps of T."""
        gain = self.gains.k_d if gain is None else gain
        weights = np.asarray(error_weights(self.gains.lambda_, self.order + 1))
        return LayerModel((0,), np.eye(1), self.period * np.eye(1, self.order),
                          -gain * weights[:1], -gain * weights[1:])

    def initial_memory(self) -> tuple[float, ...]:
        """I = 0."""
        return (0.0,)

    @staticmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,  # noqa: ARG004
               dt: float, new_memory: Any, terms: Any) -> float:
        """One sample."""
        s = c[1] * memory[0] + filtered_error(c, 2, x_d, x)
        v = -c[0] * s
        new_memory[0] = memory[0] + dt * (x[0] - x_d[0])
        terms[S] = s
        terms[U_FD] = x_d[len(x)]
        terms[V_DAMPING] = v
        terms[STATUS] = 0.0
        publish(memory, STATUS + 1, terms)
        return v

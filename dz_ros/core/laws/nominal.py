# SPDX-License-Identifier: Apache-2.0
"""What laws with a nominal model and an estimate of the rest have in common (ours).

    ff = φ_0 u_fd + Yᵀθ_0,   v = ff − k_d s − (what the law makes of the rest)

θ_0, φ_0 are nominal values of a_i/(b m), 1/(b m) and never change; b̂ = 1/φ_0. Of the plant's
equation that leaves s' = b̂ (v − ff + σ) with σ [actuator unit] what the model does not cover, the
dead-zone's residual d/m included.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from dz_ros.core.design.linear_loop import LayerModel
from dz_ros.core.laws.base import Design, Law, per_regressor
from dz_ros.core.schema import parameter
from dz_ros.core.signals import (
    S,
    S_EPS,
    STATUS,
    U_FD,
    V_DAMPING,
    V_FEED_FORWARD,
    V_REGRESSOR,
    V_ROBUST,
)
from dz_ros.core.tracking import (
    error_weights,
    feed_forward,
    feed_forward_weights,
    filtered_error,
)

PROBE = 1e-7
"""Step of the differences that give the linear model."""


@dataclass(frozen=True)
class NominalGains:
    """Gains of the nominal part; the values are ours."""

    lambda_: float = parameter(5.0, '1/s', 'slope λ of the filtered error (8)', minimum=0.0,
                               open_minimum=True)
    k_d: float = parameter(20.0, 'actuator unit per unit of s', 'damping gain k_d', minimum=0.0,
                           open_minimum=True)
    theta_0: tuple[float, ...] = parameter(
        (0.85,), 'actuator unit per unit of Y_i',
        'nominal a_i/(b m), one number for each regressor or one for all')
    phi_0: float = parameter(0.85, 'actuator unit per unit of x^(n)', 'nominal 1/(b m)',
                             minimum=0.0, open_minimum=True)
    v_clip: float = parameter(16.7, 'actuator unit', 'v is clipped to this, and the estimate '
                              'reckons with it; 0 = not', minimum=0.0)


def clipped(v: float, limit: float) -> float:
    """Return v clipped to the limit; 0 = none."""
    if limit > 0.0:
        return min(max(v, -limit), limit)
    return v


def nominal_terms(c: Sequence[float], x_d: Sequence[float], x: Sequence[float],
                  y: Sequence[float], terms: Any) -> float:
    """Write s, u_fd and the nominal terms of v; return s.

    Args:
        c: k_d, φ_0, Λ, Λ_v, θ_0, limit of v, then what the law has besides.
        x_d: x_d … x_d^(n), shape (n + 1,).
        x: Measured state, shape (n,).
        y: Y(x), shape (r,).
        terms: Buffer for the terms.
    """
    n = len(x)
    s = filtered_error(c, 2, x_d, x)
    u_fd = feed_forward(c, 2 + n, x_d, x)
    regressor = 0.0
    for i in range(len(y)):
        regressor += c[2 + 2 * n + i] * y[i]
    terms[S] = s
    terms[S_EPS] = s
    terms[U_FD] = u_fd
    terms[V_DAMPING] = -c[0] * s
    terms[V_FEED_FORWARD] = c[1] * u_fd
    terms[V_REGRESSOR] = regressor
    terms[V_ROBUST] = 0.0
    terms[STATUS] = 0.0
    return s


class Nominal(Law):
    """Base of the laws with a nominal model; `places` of the memory move in the layer."""

    Gains: ClassVar[type] = NominalGains

    def __init__(self, gains: Any = None, order: int = 2, regressor_count: int = 2,
                 period: float = 0.005) -> None:
        super().__init__(gains, order, regressor_count, period)
        self._theta = per_regressor(self.gains.theta_0, regressor_count, 'theta_0')

    @property
    @abstractmethod
    def own(self) -> tuple[float, ...]:
        """Constants besides those of the nominal part."""

    @property
    @abstractmethod
    def moving(self) -> tuple[int, ...]:
        """Places of the memory that move in the layer."""

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, φ_0, Λ, Λ_v, θ_0, limit of v, those of the law."""
        g, n = self.gains, self.order
        return (g.k_d, g.phi_0, *error_weights(g.lambda_, n),
                *feed_forward_weights(g.lambda_, n), *self._theta, g.v_clip, *self.own)

    @cached_property
    def design(self) -> Design:
        """What the design rules need: no robust term, no layer."""
        g = self.gains
        lead = feed_forward_weights(g.lambda_, self.order)[-1] * g.phi_0
        return Design(g.lambda_, g.k_d, 0.0, 0.0, g.k_d, lead)

    def initial_memory(self) -> tuple[float, ...]:
        """Nothing before."""
        return (0.0,) * len(self.signals)

    def layer_model(self, gain: float | None = None) -> LayerModel:
        """Return the law about s = 0, found by differences of its kernel, which is linear there.

        The first number of the memory is 0 until the law has begun.
        """
        if gain is not None:
            own = self.design.gain - self.gains.k_d
            if gain <= own:
                gain = own + 1e-9
            law = type(self)(replace(self.gains, k_d=gain - own), self.order,
                             self.regressor_count, self.period)
            return law.layer_model()
        n, places = self.order, self.moving
        constants, width = self._step_numbers
        y = (0.0,) * self.regressor_count

        def step(memory: Sequence[float], x: Sequence[float]) -> list[float]:
            after = [0.0] * len(memory)
            v = self.kernel(constants, memory, (0.0,) * (n + 1), x, y, self.period, after,
                            [0.0] * width)
            return [v, *(after[place] for place in places)]

        rest = list(self.initial_memory())
        rest[0] = 1.0
        columns = []
        for place in (*places, *range(-n, 0)):
            ends = []
            for side in (1.0, -1.0):
                memory, x = list(rest), [0.0] * n
                if place < 0:
                    x[n + place] = side * PROBE
                else:
                    memory[place] += side * PROBE
                ends.append(step(memory, x))
            columns.append([(right - left) / (2.0 * PROBE)
                            for right, left in zip(*ends, strict=True)])
        table, p = np.array(columns).T, len(places)
        return LayerModel(places, table[1:, :p], table[1:, p:], table[0, :p], table[0, p:])

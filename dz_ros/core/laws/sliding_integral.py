# SPDX-License-Identifier: Apache-2.0
"""Adaptive sliding control with an integral in the surface [slotine_li1991], any order n.

    s    = (p + λ)ⁿ ∫x̃          n = 2:  x̃' + 2λ x̃ + λ² I
    u_fd = x_d^(n) − (s' − x̃^(n))   n = 2:  x_d'' − 2λ x̃' − λ² x̃
    v    = −k_d s + φ̂ u_fd + Yᵀθ̂ − k sat(s/ε),   θ̂_i' = −γ Y_i s_ε,   φ̂' = −η u_fd s_ε,   I' = x̃

The same theorem as for `sliding`, on a surface of one order more; on it a constant residual in
the layer leaves no constant x̃. I advances with θ̂, φ̂, by one Euler step after v; it starts at 0, so
s(0) is larger than in `sliding`. The value k is made for the disturbance alone (ours).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from dz_ros.core.design.linear_loop import LayerModel
from dz_ros.core.laws.adaptive import Adaptive, Sliding, SwitchingGains
from dz_ros.core.laws.base import Design, Numbers, publish
from dz_ros.core.laws.pid import INTEGRAL
from dz_ros.core.laws.wang2004 import adapt, control
from dz_ros.core.signals import S_EPS, Signal, STATUS
from dz_ros.core.tracking import error_weights, feed_forward, filtered_error


class SlidingIntegral(Adaptive):
    """(14)–(16) on the surface (p + λ)ⁿ ∫x̃."""

    name = 'sliding_integral'
    summary = 'adaptive sliding control with an integral in the surface'
    Gains = SwitchingGains
    tunable = Sliding.tunable

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k, ε, γ, η, weights of x̃ … x̃^(n−1) in s, in −u_fd, weight of I in s."""
        g = self.gains
        weights = error_weights(g.lambda_, self.order + 1)
        return (g.k_d, self._k, g.epsilon, g.gamma, g.eta, *weights[1:], *weights[:-1],
                weights[0])

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """θ̂, φ̂, I as used in v, which are the whole memory."""
        return (*super().signals, INTEGRAL)

    @cached_property
    def design(self) -> Design:
        """What the design rules need: u_fd weighs x^(n−1) by n λ; Ω_ε is of another surface."""
        lead = self.order * self.gains.lambda_ * self.gains.phi_0
        return replace(super().design, lead=lead, target=0.0)

    def layer_model(self, gain: float | None = None) -> LayerModel:
        """Return the model with the integral in the surface: u_fd weighs x̃ … x̃^(n−1)."""
        gain = self.design.gain if gain is None else gain
        weights = np.asarray(error_weights(self.gains.lambda_, self.order + 1))
        return LayerModel((self.regressor_count + 1,), np.eye(1),
                          self.period * np.eye(1, self.order), -gain * weights[:1],
                          -gain * weights[1:] - self.gains.phi_0 * weights[:-1])

    def initial_memory(self) -> tuple[float, ...]:
        """θ̂(0), φ̂(0), I = 0."""
        return (*super().initial_memory(), 0.0)

    @staticmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,
               dt: float, new_memory: Any, terms: Any) -> float:
        """One sample."""
        n = len(x)
        integral = len(y) + 1
        s = c[5 + 2 * n] * memory[integral] + filtered_error(c, 5, x_d, x)
        u_fd = feed_forward(c, 5 + n, x_d, x)
        v = control(c[0], c[1], c[2], memory, s, u_fd, y, terms)
        adapt(c[3], c[4], memory, y, u_fd, terms[S_EPS], dt, new_memory)
        new_memory[integral] = memory[integral] + dt * (x[0] - x_d[0])
        publish(memory, STATUS + 1, terms)
        terms[STATUS] = 0.0
        return v

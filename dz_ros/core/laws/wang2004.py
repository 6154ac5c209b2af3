# SPDX-License-Identifier: Apache-2.0
"""The robust adaptive law of Wang, Su and Hong [wang2004], any order n, any number of regressors.

    s    = Λᵀ x̃                                                            (8)
    u_fd = x_d^(n) − Λ_vᵀ x̃                                                (17)
    s_ε  = s − ε sat(s/ε)                                                   (11)
    v    = −k_d s + φ̂ u_fd + Yᵀθ̂ − k* sat(s/ε)                             (14)
    θ̂_i' = −γ Y_i s_ε                                                       (15)
    φ̂'   = −η u_fd s_ε                                                      (16)
    k*  ≥ ρ/m_min                                                           (18)

θ̂ estimates a_i/(b m), φ̂ estimates 1/(b m). Order of operations: v with θ̂_k, φ̂_k, then one Euler
step of (15), (16) with the same Y, u_fd, s_ε over the accepted interval (mathematics.md §3).

Proven (continuous time, (A1)–(A8), no unmodelled disturbance beyond what k* covers, no delay): all
signals bounded, |x̃_i| → ≤ 2^(i−1) λ^(i−n) ε. Not covered: sampling, loop delay, measurement noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from dz_ros.core.design.boundary_layer import layer_gain
from dz_ros.core.laws.base import Design, Law, per_regressor, publish, Tunable
from dz_ros.core.schema import parameter
from dz_ros.core.signals import (
    estimates,
    S,
    S_EPS,
    Signal,
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
    sat,
)


@dataclass(frozen=True)
class AdaptiveGains:
    """Gains of (8), (15), (16) and the damping; defaults are the paper's, λ ours."""

    lambda_: float = parameter(1.0, '1/s', 'slope λ of the filtered error (8); not in the paper',
                               minimum=0.0, open_minimum=True)
    k_d: float = parameter(10.0, 'actuator unit per unit of s', 'damping gain k_d of (14)',
                           minimum=0.0, open_minimum=True)
    gamma: float = parameter(0.5, 'actuator unit per unit of Y_i squared and unit of s and second',
                             'adaptation gain γ of (15)', minimum=0.0)
    eta: float = parameter(0.5, 'actuator unit per unit of x^(n) squared and unit of s and second',
                           'adaptation gain η of (16)', minimum=0.0)
    theta_0: tuple[float, ...] = parameter(
        (0.85,), 'actuator unit per unit of Y_i',
        'initial θ̂, one number for each regressor or one for all')
    phi_0: float = parameter(0.85, 'actuator unit per unit of x^(n)', 'initial φ̂')


@dataclass(frozen=True)
class Wang2004Gains(AdaptiveGains):
    """Gains of (8)–(16); the choice of ε is ours."""

    k_star: float = parameter(2.5, 'actuator unit', 'robust gain k* of (14), (18)', minimum=0.0)
    epsilon: float = parameter(0.02, 'unit of s', 'half-width ε of the boundary layer (11)',
                               minimum=0.0, open_minimum=True)


def adaptive_design(gains: Any, order: int, k: float, epsilon: float) -> Design:
    """Return the design of a law built around (14) with robust gain k and layer ε."""
    lead = feed_forward_weights(gains.lambda_, order)[-1] * gains.phi_0
    return Design(gains.lambda_, gains.k_d, k, epsilon, layer_gain(gains.k_d, k, epsilon), lead,
                  epsilon)


def control(k_d: float, k: float, epsilon: float, weights: Sequence[float], s: float,
            u_fd: float, y: Sequence[float], terms: Any) -> float:
    """Return v of (14); write s, s_ε, u_fd and its four parts into terms.

    `weights` holds θ̂_1 … θ̂_r, φ̂ (and what follows), y is Y(x), shape (r,).
    """
    saturated = sat(s / epsilon)
    v_damping = -k_d * s
    v_feed_forward = weights[len(y)] * u_fd
    v_regressor = 0.0
    for i in range(len(y)):
        v_regressor += y[i] * weights[i]
    v_robust = -k * saturated
    terms[S] = s
    terms[S_EPS] = s - epsilon * saturated
    terms[U_FD] = u_fd
    terms[V_DAMPING] = v_damping
    terms[V_FEED_FORWARD] = v_feed_forward
    terms[V_REGRESSOR] = v_regressor
    terms[V_ROBUST] = v_robust
    return v_damping + v_feed_forward + v_regressor + v_robust


def adapt(gamma: float, eta: float, weights: Sequence[float], y: Sequence[float], u_fd: float,
          s_eps: float, dt: float, after: Any) -> None:
    """Write θ̂, φ̂ after one Euler step of (15), (16) over dt [s] into `after`."""
    r = len(y)
    for i in range(r):
        after[i] = weights[i] - dt * gamma * y[i] * s_eps
    after[r] = weights[r] - dt * eta * u_fd * s_eps


def adaptive_step(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
                  x: Sequence[float], y: Sequence[float], dt: float, new_memory: Any,
                  terms: Any) -> float:
    """Return v of one sample of (8)–(17), in the binding order; the kernel of `Wang2004`.

    c begins with k_d, k*, ε, γ, η, Λ, Λ_v, the memory with θ̂, φ̂; all of it is published.
    """
    n = len(x)
    s = filtered_error(c, 5, x_d, x)
    u_fd = feed_forward(c, 5 + n, x_d, x)
    v = control(c[0], c[1], c[2], memory, s, u_fd, y, terms)
    adapt(c[3], c[4], memory, y, u_fd, terms[S_EPS], dt, new_memory)
    publish(memory, STATUS + 1, terms)
    terms[STATUS] = 0.0
    return v


class Wang2004(Law):
    """Equations (8)–(17) as printed."""

    name = 'wang2004'
    summary = 'robust adaptive law (14)-(16) of Wang, Su and Hong 2004'
    Gains: ClassVar[type] = Wang2004Gains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 0.3, 30.0), Tunable('k_d', 2.0, 60.0), Tunable('k_star', 1.5, 8.0),
        Tunable('epsilon', 0.005, 0.5), Tunable('gamma', 0.02, 20.0), Tunable('eta', 0.02, 20.0))

    def __init__(self, gains: Any = None, order: int = 2, regressor_count: int = 2,
                 period: float = 0.005) -> None:
        super().__init__(gains, order, regressor_count, period)
        self._theta_0 = per_regressor(self.gains.theta_0, regressor_count, 'theta_0')

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k*, ε, γ, η, Λ, Λ_v."""
        g = self.gains
        return (g.k_d, g.k_star, g.epsilon, g.gamma, g.eta,
                *error_weights(g.lambda_, self.order),
                *feed_forward_weights(g.lambda_, self.order))

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """θ̂ and φ̂ as used in v, which are the whole memory."""
        return estimates(self.regressor_count)

    def initial_memory(self) -> tuple[float, ...]:
        """θ̂(0), φ̂(0)."""
        return (*self._theta_0, self.gains.phi_0)

    @cached_property
    def design(self) -> Design:
        """What the design rules need."""
        return adaptive_design(self.gains, self.order, self.gains.k_star, self.gains.epsilon)

    kernel = staticmethod(adaptive_step)

"""The robust adaptive law of Wang, Su and Hong (2004), any order n, any number r of regressors.

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
from typing import Any

from dz_ros.core.laws.base import Law
from dz_ros.core.records import STATUS
from dz_ros.core.schema import parameter
from dz_ros.core.tracking import error_weights, feed_forward_weights, sat
from dz_ros.errors import ConfigurationError


@dataclass(frozen=True)
class Wang2004Gains:
    """Gains of (8)–(16); defaults are the paper's section 4, λ and the choice of ε ours."""

    lambda_: float = parameter(1.0, '1/s', 'slope λ of the filtered error (8); not in the paper',
                               minimum=0.0, open_minimum=True)
    k_d: float = parameter(10.0, 'actuator unit per unit of s', 'damping gain k_d of (14)',
                           minimum=0.0, open_minimum=True)
    k_star: float = parameter(2.5, 'actuator unit', 'robust gain k* of (14), (18)', minimum=0.0)
    epsilon: float = parameter(0.02, 'unit of s', 'half-width ε of the boundary layer (11)',
                               minimum=0.0, open_minimum=True)
    gamma: float = parameter(0.5, '1', 'adaptation gain γ of (15)', minimum=0.0)
    eta: float = parameter(0.5, '1', 'adaptation gain η of (16)', minimum=0.0)
    theta_0: tuple[float, ...] = parameter(
        (0.85,), '1', 'initial θ̂, one number for each regressor or one for all')
    phi_0: float = parameter(0.85, '1', 'initial φ̂')


def initial_theta(gains: Any, count: int) -> tuple[float, ...]:
    """Return θ̂(0), shape (count,).

    Raises:
        ConfigurationError: theta_0 has neither one entry nor `count`.
    """
    if len(gains.theta_0) == count:
        return tuple(gains.theta_0)
    if len(gains.theta_0) == 1:
        return tuple(gains.theta_0) * count
    raise ConfigurationError('controller.theta_0', list(gains.theta_0),
                             f'must have 1 or {count} numbers, one for each regressor')


class Wang2004(Law):
    """Equations (8)–(17) as printed."""

    name = 'wang2004'
    summary = 'robust adaptive law (14)-(16) of Wang, Su and Hong 2004'
    Gains = Wang2004Gains

    def __init__(self, gains: Any = None, order: int = 2, regressor_count: int = 2,
                 period: float = 0.005) -> None:
        super().__init__(gains, order, regressor_count, period)
        self._theta_0 = initial_theta(self.gains, regressor_count)

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k*, ε, γ, η, Λ, Λ_v."""
        g = self.gains
        return (g.k_d, g.k_star, g.epsilon, g.gamma, g.eta,
                *error_weights(g.lambda_, self.order),
                *feed_forward_weights(g.lambda_, self.order))

    @property
    def signal_names(self) -> tuple[str, ...]:
        """θ̂ and φ̂ as used in v, which are the whole memory."""
        return (*(f'theta{i + 1}' for i in range(self.regressor_count)), 'phi')

    def initial_memory(self) -> tuple[float, ...]:
        """θ̂(0), φ̂(0)."""
        return (*self._theta_0, self.gains.phi_0)

    def memory_from_signals(self, signals: Sequence[float]) -> tuple[float, ...]:
        """θ̂_k, φ̂_k are published as they were used."""
        return tuple(signals)

    @staticmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
               x: Sequence[float], y: Sequence[float], dt: float, new_memory: Any,
               terms: Any) -> float:
        """One sample of (8)–(17), in the binding order of operations."""
        n = len(x)
        r = len(y)
        s = 0.0
        u_fd = x_d[n]
        for i in range(n):
            error = x[i] - x_d[i]
            s += c[5 + i] * error
            u_fd -= c[5 + n + i] * error
        saturated = sat(s / c[2])
        s_eps = s - c[2] * saturated
        phi = memory[r]
        v_damping = -c[0] * s
        v_feed_forward = phi * u_fd
        v_regressor = 0.0
        for i in range(r):
            v_regressor += y[i] * memory[i]
        v_robust = -c[1] * saturated
        for i in range(r):
            new_memory[i] = memory[i] - dt * c[3] * y[i] * s_eps
            terms[STATUS + 1 + i] = memory[i]
        new_memory[r] = phi - dt * c[4] * u_fd * s_eps
        terms[STATUS + 1 + r] = phi
        terms[0] = s
        terms[1] = s_eps
        terms[2] = u_fd
        terms[3] = v_damping
        terms[4] = v_feed_forward
        terms[5] = v_regressor
        terms[6] = v_robust
        terms[7] = 0.0
        terms[STATUS] = 0.0
        return v_damping + v_feed_forward + v_regressor + v_robust

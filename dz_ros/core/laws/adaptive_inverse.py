# SPDX-License-Identifier: Apache-2.0
"""Adaptive dead-zone inverse, after Tao and Kokotović [tao_kokotovic1994; tao_kokotovic1995].

    u_l = u_fd + Yᵀâ − k_d s − k sat(s/ε),     S_a = s − ε_a sat(s/ε_a)
    χ_r = 1/(1 + e^(−2u_l/e0)),  χ_l = 1 − χ_r
    v   = (u_l + β̂2 χ_r + β̂3 χ_l)/β̂1
    â_i' = −γ Y_i S_a,   β̂1' = η v S_a,   β̂2' = −g_b χ_r S_a,   β̂3' = −g_b χ_l S_a

â estimates a_i, β̂1 b m, β̂2 b m b_r, β̂3 b m b_l; the three β̂ are clipped to prior bounds. Any
order n in this form (ours), rebuilt from descriptions on the filtered error of [wang2004], not
transcribed. Proven in the originals for plants that are linear apart from the dead-zone; here with
exact χ and no disturbance (mathematics.md §14). Gains and bounds are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from dz_ros.core.design.boundary_layer import layer_gain
from dz_ros.core.laws.adaptive import SwitchingGains
from dz_ros.core.laws.base import Design, Numbers, publish, Tunable
from dz_ros.core.laws.extensions import break_point, clip, right_share
from dz_ros.core.laws.wang2004 import Wang2004
from dz_ros.core.schema import parameter
from dz_ros.core.signals import (
    Role,
    S,
    S_EPS,
    Signal,
    STATUS,
    U_FD,
    V_DAMPING,
    V_EXTRA,
    V_FEED_FORWARD,
    V_REGRESSOR,
    V_ROBUST,
)
from dz_ros.core.tracking import (
    error_weights,
    feed_forward,
    feed_forward_weights,
    filtered_error,
    outside_layer,
    sat,
)
from dz_ros.errors import ConfigurationError


@dataclass(frozen=True)
class AdaptiveInverseGains(SwitchingGains):
    """Gains of the inverse; (14) is divided by β̂1, so they have other units than elsewhere."""

    k_d: float = parameter(10.0, 'unit of x^(n) per unit of s', 'damping gain k_d', minimum=0.0,
                           open_minimum=True)
    gamma: float = parameter(0.5, 'unit of x^(n) per unit of Y_i squared and unit of s and second',
                             'adaptation gain γ of â', minimum=0.0)
    eta: float = parameter(0.5, 'unit of x^(n) per actuator unit squared and unit of s and second',
                           'adaptation gain η of β̂1', minimum=0.0)
    theta_0: tuple[float, ...] = parameter(
        (0.85,), 'unit of x^(n) per unit of Y_i',
        'initial estimate â(0), one number for each regressor or one for all')
    phi_0: float = parameter(0.85, 'actuator unit per unit of x^(n)', 'initial estimate 1/β̂1(0)',
                             minimum=0.0, open_minimum=True)
    k: float = parameter(1.47, 'unit of x^(n)', 'gain k of the robust term', minimum=0.0)
    beta2_0: float = parameter(0.35, 'unit of x^(n)', 'initial estimate β̂2(0), of b m b_r')
    beta3_0: float = parameter(-0.4, 'unit of x^(n)', 'initial estimate β̂3(0), of b m b_l')
    g_b: float = parameter(5.0, '1/s²', 'adaptation gain of β̂2, β̂3', minimum=0.0)
    epsilon_a: float = parameter(0.004, 'unit of s', 'adaptation stands still where |s| ≤ ε_a',
                                 minimum=0.0, open_minimum=True)
    e0: float = parameter(0.1, 'actuator unit', 'width of the change from left to right',
                          minimum=0.0, open_minimum=True)
    beta1_bounds: tuple[float, ...] = parameter(
        (0.4, 2.5), 'unit of x^(n) per actuator unit', 'bounds of β̂1', length=2, minimum=0.0,
        open_minimum=True)
    beta2_bounds: tuple[float, ...] = parameter((0.04, 1.5), 'unit of x^(n)', 'bounds of β̂2',
                                                length=2)
    beta3_bounds: tuple[float, ...] = parameter((-1.75, -0.04), 'unit of x^(n)', 'bounds of β̂3',
                                                length=2)

    def check(self, prefix: str) -> None:
        """Check that the initial β̂ lie in their bounds."""
        starts = (('phi_0', 1.0 / self.phi_0), ('beta2_0', self.beta2_0),
                  ('beta3_0', self.beta3_0))
        for i, (name, value) in enumerate(starts, 1):
            low, high = getattr(self, f'beta{i}_bounds')
            if not low <= value <= high:
                raise ConfigurationError(f'{prefix}{name}', getattr(self, name),
                                         f'β̂{i}(0) = {value:g} must lie in beta{i}_bounds '
                                         f'[{low:g}, {high:g}]')


class AdaptiveInverse(Wang2004):
    """Adaptive dead-zone inverse on the filtered error."""

    name = 'adaptive_inverse'
    summary = 'adaptive dead-zone inverse after Tao and Kokotović 1994, 1995'
    Gains = AdaptiveInverseGains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 0.3, 30.0), Tunable('k_d', 2.0, 60.0),
        Tunable('k', 0.3, 8.0), Tunable('epsilon', 0.002, 0.5), Tunable('gamma', 0.02, 20.0))

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k, ε, γ, η, Λ, Λ_v, g_b, ε_a, e0, bounds of β̂1, β̂2, β̂3."""
        g = self.gains
        return (g.k_d, g.k, g.epsilon, g.gamma, g.eta, *error_weights(g.lambda_, self.order),
                *feed_forward_weights(g.lambda_, self.order), g.g_b, g.epsilon_a, g.e0,
                *g.beta1_bounds, *g.beta2_bounds, *g.beta3_bounds)

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """â, β̂1, β̂2, β̂3 as used in v, which are the whole memory."""
        return (*(Signal(f'a{i}', f'x^(n)/Y{i}', f'a_{i}', Role.ESTIMATE, f'â_{i}')
                  for i in range(1, self.regressor_count + 1)),
                Signal('beta1', 'x^(n)/v', 'b m', Role.ESTIMATE, 'β̂_1'),
                Signal('beta2', 'x^(n)', 'b m b_r', Role.ESTIMATE, 'β̂_2'),
                Signal('beta3', 'x^(n)', 'b m b_l', Role.ESTIMATE, 'β̂_3'))

    @cached_property
    def design(self) -> Design:
        """What the design rules need; all slopes are divided by β̂1(0)."""
        g = self.gains
        lead = feed_forward_weights(g.lambda_, self.order)[-1] * g.phi_0
        return Design(g.lambda_, g.k_d * g.phi_0, g.k * g.phi_0, g.epsilon,
                      layer_gain(g.k_d, g.k, g.epsilon) * g.phi_0, lead, inverse=True)

    def initial_memory(self) -> tuple[float, ...]:
        """â(0), β̂(0)."""
        return (*self._theta_0, 1.0 / self.gains.phi_0, self.gains.beta2_0, self.gains.beta3_0)

    @staticmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,
               dt: float, new_memory: Any, terms: Any) -> float:
        """One sample."""
        n = len(x)
        r = len(y)
        own = 5 + 2 * n
        s = filtered_error(c, 5, x_d, x)
        u_fd = feed_forward(c, 5 + n, x_d, x)
        s_a = outside_layer(s, c[own + 1])
        known = 0.0
        for i in range(r):
            known += y[i] * memory[i]
        switching = -c[1] * sat(s / c[2])
        u_l = u_fd + known - c[0] * s + switching
        right = right_share(u_l, c[own + 2])
        beta1 = memory[r]
        terms[S] = s
        terms[S_EPS] = s_a
        terms[U_FD] = u_fd
        terms[V_DAMPING] = -c[0] * s / beta1
        terms[V_FEED_FORWARD] = u_fd / beta1
        terms[V_REGRESSOR] = known / beta1
        terms[V_ROBUST] = switching / beta1
        terms[V_EXTRA] = break_point(u_l, memory[r + 1], memory[r + 2], c[own + 2]) / beta1
        v = (terms[V_DAMPING] + terms[V_FEED_FORWARD] + terms[V_REGRESSOR] + terms[V_ROBUST]
             + terms[V_EXTRA])
        for i in range(r):
            new_memory[i] = memory[i] - dt * c[3] * y[i] * s_a
        new_memory[r] = clip(beta1 + dt * c[4] * v * s_a, c[own + 3], c[own + 4])
        new_memory[r + 1] = clip(memory[r + 1] - dt * c[own] * right * s_a,
                                 c[own + 5], c[own + 6])
        new_memory[r + 2] = clip(memory[r + 2] - dt * c[own] * (1.0 - right) * s_a,
                                 c[own + 7], c[own + 8])
        publish(memory, STATUS + 1, terms)
        terms[STATUS] = 0.0
        return float(v)

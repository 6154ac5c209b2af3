"""Adaptive dead-zone inverse, after Tao and Kokotović [tao_kokotovic1994; tao_kokotovic1995].

    u_l = u_fd + Yᵀâ − k_d s − k sat(s/ε),     S_a = s − ε_a sat(s/ε_a)
    χ_r = 1/(1 + e^(−2u_l/e0)),  χ_l = 1 − χ_r
    v   = (u_l + β̂2 χ_r + β̂3 χ_l)/β̂1
    â_i' = −γ Y_i S_a,   β̂1' = η v S_a,   β̂2' = −g_b χ_r S_a,   β̂3' = −g_b χ_l S_a

â estimates a_i, β̂1 b m, β̂2 b m b_r, β̂3 b m b_l; the three β̂ are clipped to prior bounds. Any order
n in this form (ours; the originals adapt an inverse before a linear plant, in continuous and in
discrete time): rebuilt from descriptions on the filtered error of [wang2004], not transcribed, so
say "after". Proven in the originals for plants that are linear apart from the dead-zone. Here,
with exact χ and no disturbance, V = ½ s² + ½|ã|²/γ + ½ β̃1²/η + ½(β̃2² + β̃3²)/g_b gives
V' ≤ −k_d s² (ours); a smooth χ leaves a bounded rest that k must cover. Gains and bounds are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dz_ros.core.boundary_layer import layer_gain
from dz_ros.core.laws.adaptive import SwitchingGains
from dz_ros.core.laws.base import Design, Law, per_regressor
from dz_ros.core.laws.extensions import break_point, clip, right_share
from dz_ros.core.records import STATUS
from dz_ros.core.schema import parameter
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
    """Gains of the inverse; theta_0 is â(0) and phi_0 is 1/β̂1(0)."""

    phi_0: float = parameter(0.85, '1', '1/β̂1(0)', minimum=0.0, open_minimum=True)
    beta2_0: float = parameter(0.35, 'unit of x^(n)', 'β̂2(0), of b m b_r')
    beta3_0: float = parameter(-0.4, 'unit of x^(n)', 'β̂3(0), of b m b_l')
    g_b: float = parameter(5.0, '1', 'adaptation gain of β̂2, β̂3', minimum=0.0)
    epsilon_a: float = parameter(0.004, 'unit of s', 'adaptation stands still where |s| ≤ ε_a',
                                 minimum=0.0, open_minimum=True)
    e0: float = parameter(0.1, 'actuator unit', 'width of the change from left to right',
                          minimum=0.0, open_minimum=True)
    beta1_bounds: tuple[float, ...] = parameter((0.4, 2.5), '1', 'bounds of β̂1', length=2,
                                                minimum=0.0, open_minimum=True)
    beta2_bounds: tuple[float, ...] = parameter((0.04, 1.5), 'unit of x^(n)', 'bounds of β̂2',
                                                length=2)
    beta3_bounds: tuple[float, ...] = parameter((-1.75, -0.04), 'unit of x^(n)', 'bounds of β̂3',
                                                length=2)

    def check(self, prefix: str) -> None:
        """Check that the initial β̂ lie in their bounds.

        Raises:
            ConfigurationError: They do not.
        """
        starts = (('phi_0', 1.0 / self.phi_0), ('beta2_0', self.beta2_0),
                  ('beta3_0', self.beta3_0))
        for i, (name, value) in enumerate(starts, 1):
            low, high = getattr(self, f'beta{i}_bounds')
            if not low <= value <= high:
                raise ConfigurationError(f'{prefix}{name}', getattr(self, name),
                                         f'β̂{i}(0) = {value:g} must lie in beta{i}_bounds '
                                         f'[{low:g}, {high:g}]')


class AdaptiveInverse(Law):
    """Adaptive dead-zone inverse on the filtered error."""

    name = 'adaptive_inverse'
    summary = 'adaptive dead-zone inverse after Tao and Kokotović 1994, 1995'
    Gains = AdaptiveInverseGains

    def __init__(self, gains: Any = None, order: int = 2, regressor_count: int = 2,
                 period: float = 0.005) -> None:
        super().__init__(gains, order, regressor_count, period)
        self._a_0 = per_regressor(self.gains.theta_0, regressor_count, 'theta_0')

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k, ε, γ, η, Λ, Λ_v, g_b, ε_a, e0, bounds of β̂1, β̂2, β̂3."""
        g = self.gains
        return (g.k_d, g.k, g.epsilon, g.gamma, g.eta, *error_weights(g.lambda_, self.order),
                *feed_forward_weights(g.lambda_, self.order), g.g_b, g.epsilon_a, g.e0,
                *g.beta1_bounds, *g.beta2_bounds, *g.beta3_bounds)

    @property
    def signal_names(self) -> tuple[str, ...]:
        """â, β̂1, β̂2, β̂3 as used in v, which are the whole memory."""
        return (*(f'a{i + 1}' for i in range(self.regressor_count)), 'beta1', 'beta2', 'beta3')

    @property
    def design(self) -> Design:
        """What the design rules need; all slopes are divided by β̂1(0)."""
        g = self.gains
        lead = feed_forward_weights(g.lambda_, self.order)[-1] * g.phi_0
        return Design(g.lambda_, g.k_d * g.phi_0, g.k * g.phi_0, g.epsilon,
                      layer_gain(g.k_d, g.k, g.epsilon) * g.phi_0, lead, inverse=True)

    def initial_memory(self) -> tuple[float, ...]:
        """â(0), β̂(0)."""
        return (*self._a_0, 1.0 / self.gains.phi_0, self.gains.beta2_0, self.gains.beta3_0)

    def memory_from_signals(self, signals: Sequence[float]) -> tuple[float, ...]:
        """The estimates are published as they were used."""
        return tuple(signals)

    @staticmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
               x: Sequence[float], y: Sequence[float], dt: float, new_memory: Any,
               terms: Any) -> float:
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
        terms[0] = s
        terms[1] = s_a
        terms[2] = u_fd
        terms[3] = -c[0] * s / beta1
        terms[4] = u_fd / beta1
        terms[5] = known / beta1
        terms[6] = switching / beta1
        terms[7] = break_point(u_l, memory[r + 1], memory[r + 2], c[own + 2]) / beta1
        v = terms[3] + terms[4] + terms[5] + terms[6] + terms[7]
        for i in range(r):
            new_memory[i] = memory[i] - dt * c[3] * y[i] * s_a
        new_memory[r] = clip(beta1 + dt * c[4] * v * s_a, c[own + 3], c[own + 4])
        new_memory[r + 1] = clip(memory[r + 1] - dt * c[own] * right * s_a,
                                 c[own + 5], c[own + 6])
        new_memory[r + 2] = clip(memory[r + 2] - dt * c[own] * (1.0 - right) * s_a,
                                 c[own + 7], c[own + 8])
        for i in range(r + 3):
            terms[STATUS + 1 + i] = memory[i]
        terms[STATUS] = 0.0
        return float(v)

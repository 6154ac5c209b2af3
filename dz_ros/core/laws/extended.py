# SPDX-License-Identifier: Apache-2.0
"""The law of [wang2004] with its extensions, each a switch of its own, all off by default (ours).

    v    = −k_d s + φ̂ u_fd + Yᵀθ̂ − k* sat(s/ε)                            (14)
         − v_I                                                  integral
         + b̂_r χ_r(v) + b̂_l χ_l(v)                              dead_zone_feed_forward
    θ̂, φ̂  by one Euler step of (15), (16) after v, or by the late gradient before it;
           clipped to their bounds                              projection
    v_I' = r_I s while |s| ≤ ε, |v_I| ≤ ρ_I, r_I = K²/divisor, K = k_d + k*/ε
    θ̂, φ̂, v_I stand still while |v| > v_max and v s < 0         anti_windup
    ε    = k*/(f μ_d/(β T) − k_d − (n−1) λ φ̂(0))                automatic_epsilon

With every switch off the numbers are those of `wang2004`, bit for bit. The late gradient knows v
of the sample before only, so the anti-windup then uses that one. An interval of 0 leaves the whole
memory as it is. What is proven: mathematics.md §6, §14.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from dz_ros.core.design.boundary_layer import automatic_epsilon, layer_gain
from dz_ros.core.design.linear_loop import integral_model, LayerModel
from dz_ros.core.laws.base import Design, Numbers, publish, Tunable
from dz_ros.core.laws.extensions import (
    break_point,
    clip,
    INTEGRAL,
    LAST,
    last_regressors,
    late_gradient,
    project,
    ProjectedLaw,
    ProjectionGains,
    STARTED,
    winds_up,
)
from dz_ros.core.laws.wang2004 import (
    adapt,
    adaptive_design,
    control,
    Wang2004,
    Wang2004Gains,
)
from dz_ros.core.records import Status
from dz_ros.core.schema import parameter
from dz_ros.core.signals import before, estimates, places, S_EPS, Signal, STATUS, V_EXTRA
from dz_ros.core.tracking import error_weights, feed_forward, feed_forward_weights, filtered_error
from dz_ros.errors import ConfigurationError

_SATURATED = float(Status.SATURATED)
# Places in the constants, counted from the end of Λ_v.
_PROJECTION, _LATE, _V_MAX, _R_I, _RHO_I, _B_R, _B_L, _E0, _BOX = range(9)
# The memory after θ̂, φ̂; Y⁻ follows.
_MEMORY = (INTEGRAL, *LAST, STARTED)
_V_I, _U, _V, _STARTED = places(_MEMORY, 'v_integral', 'u_last', 'v_last', 'started')
_Y = len(_MEMORY)


@dataclass(frozen=True)
class ExtendedGains(ProjectionGains, Wang2004Gains):
    """Gains of the paper's law, the switches and what each switch needs."""

    projection: bool = parameter(False, '', 'clip θ̂, φ̂ to their bounds')
    late_gradient: bool = parameter(False, '', 'adapt before v, by the gradient of the sample '
                                    'before, instead of (15), (16) after it')
    anti_windup: bool = parameter(False, '', 'freeze θ̂, φ̂, v_I while |v| > v_max against s')
    v_max: float = parameter(0.0, 'actuator unit', 'what the actuator can do; 0 = not known',
                             minimum=0.0)
    integral: bool = parameter(False, '', 'bounded integral inside the layer')
    rho_i: float = parameter(1.47, 'actuator unit', "the integral's authority ρ_I, at most "
                             'k* − ρ/m_min', minimum=0.0)
    integral_divisor: float = parameter(16.0, '1', 'r_I = K² / this', minimum=0.0,
                                        open_minimum=True)
    automatic_epsilon: bool = parameter(False, '', 'ε from rate, delay and bounds instead of '
                                        'epsilon')
    beta: float = parameter(1.25, 'unit of x^(n) per actuator unit', 'b_max m_max, for which the '
                            'automatic ε is made', minimum=0.0, open_minimum=True)
    design_delay: int = parameter(1, 'samples', 'loop delay for which the automatic ε is made; 1 '
                                  'for a loop over topics', minimum=0, maximum=100)
    margin: float = parameter(0.5, '1', 'share f of μ_d that the automatic ε uses', minimum=0.0,
                              maximum=1.0, open_minimum=True)
    dead_zone_feed_forward: bool = parameter(False, '', 'add the guessed break point to v')
    b_r_guess: float = parameter(0.35, 'actuator unit', 'b̂_r, the middle of its bounds',
                                 minimum=0.0)
    b_l_guess: float = parameter(-0.4, 'actuator unit', 'b̂_l, the middle of its bounds',
                                 maximum=0.0)
    e0: float = parameter(0.1, 'actuator unit', 'width of the change from b̂_l to b̂_r',
                          minimum=0.0, open_minimum=True)

    def check(self, prefix: str) -> None:
        """Check that the anti-windup knows a limit."""
        if self.anti_windup and self.v_max == 0.0:
            raise ConfigurationError(f'{prefix}v_max', self.v_max,
                                     'anti_windup needs the limit of the actuator, > 0')


class Extended(ProjectedLaw):
    """Equations (8)–(17) and the switches."""

    name = 'extended'
    summary = 'the law of 2004 with switches: projection, late gradient, integral, …'
    Gains = ExtendedGains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        *Wang2004.tunable, Tunable('integral_divisor', 4.0, 64.0))

    def __init__(self, gains: Any = None, order: int = 2, regressor_count: int = 2,
                 period: float = 0.005) -> None:
        super().__init__(gains, order, regressor_count, period)
        g = self.gains
        self.epsilon = g.epsilon
        if g.automatic_epsilon:
            lead = feed_forward_weights(g.lambda_, order)[-1] * g.phi_0
            self.epsilon = automatic_epsilon(g.k_star, g.k_d, lead, g.beta, period,
                                             g.design_delay, g.margin)

    @property
    def _projects(self) -> bool:
        return bool(self.gains.projection)

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k*, ε, γ, η, Λ, Λ_v, then the switches' numbers and the projection box."""
        g = self.gains
        rate = layer_gain(g.k_d, g.k_star, self.epsilon) ** 2 / g.integral_divisor
        return (g.k_d, g.k_star, self.epsilon, g.gamma, g.eta,
                *error_weights(g.lambda_, self.order),
                *feed_forward_weights(g.lambda_, self.order),
                float(g.projection), float(g.late_gradient), g.v_max if g.anti_windup else 0.0,
                rate if g.integral else 0.0, g.rho_i if g.integral else 0.0,
                g.b_r_guess if g.dead_zone_feed_forward else 0.0,
                g.b_l_guess if g.dead_zone_feed_forward else 0.0, g.e0, *self._box)

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """θ̂, φ̂ as used in v, v_I after its update; then the memory before the step."""
        used = estimates(self.regressor_count)
        return (*used, INTEGRAL, *before((*used, *_MEMORY, *last_regressors(len(used) - 1))))

    @cached_property
    def design(self) -> Design:
        """What the design rules need."""
        g = self.gains
        found = adaptive_design(g, self.order, g.k_star, self.epsilon)
        if g.integral:
            found = replace(found, reserve=g.rho_i)
        if g.dead_zone_feed_forward:
            found = replace(found, guess=(g.b_r_guess, g.b_l_guess, g.e0))
        return self.projected(found) if g.projection else found

    def layer_model(self, gain: float | None = None) -> LayerModel | None:
        """Return the model, with the integral where it is switched on; its rate follows K."""
        if not self.gains.integral:
            return super().layer_model(gain)
        found = self.design
        gain = found.gain if gain is None else gain
        return integral_model(self.order, found.lambda_, gain, found.lead,
                              self.regressor_count + 1 + _V_I,
                              self.period * gain * gain / self.gains.integral_divisor)

    def initial_memory(self) -> tuple[float, ...]:
        """θ̂(0), φ̂(0), nothing before."""
        return (*self._theta_0, self.gains.phi_0, *(0.0,) * (4 + self.regressor_count))

    @staticmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,
               dt: float, new_memory: Any, terms: Any) -> float:
        """One sample: late gradient, v, Euler step, integral."""
        n = len(x)
        r = len(y)
        own = 5 + 2 * n
        rest = r + 1
        for i in range(len(memory)):
            new_memory[i] = memory[i]
        s = filtered_error(c, 5, x_d, x)
        u_fd = feed_forward(c, 5 + n, x_d, x)
        status = 0.0
        if c[own + _LATE] != 0.0 and memory[rest + _STARTED] != 0.0 and dt > 0.0:
            if winds_up(memory[rest + _V], c[own + _V_MAX], s):
                status = _SATURATED
            else:
                s_eps = s - c[2] * clip(s / c[2], -1.0, 1.0)
                late_gradient(c[3], c[4], c[0], dt, s_eps, memory, rest + _Y, r,
                              memory[rest + _U], new_memory)
                if c[own + _PROJECTION] != 0.0:
                    project(c, own + _BOX, r, new_memory)
        for i in range(rest):
            terms[STATUS + 1 + i] = new_memory[i]

        v = control(c[0], c[1], c[2], new_memory, s, u_fd, y, terms)
        v_extra = -clip(memory[rest + _V_I], -c[own + _RHO_I], c[own + _RHO_I])
        v_extra += break_point(v + v_extra, c[own + _B_R], c[own + _B_L], c[own + _E0])
        v += v_extra
        terms[V_EXTRA] = v_extra

        if dt > 0.0:
            if winds_up(v, c[own + _V_MAX], s):
                status = _SATURATED
            else:
                if c[own + _LATE] == 0.0:
                    adapt(c[3], c[4], memory, y, u_fd, terms[S_EPS], dt, new_memory)
                    if c[own + _PROJECTION] != 0.0:
                        project(c, own + _BOX, r, new_memory)
                if -c[2] <= s <= c[2]:
                    new_memory[rest + _V_I] = clip(memory[rest + _V_I] + dt * c[own + _R_I] * s,
                                                   -c[own + _RHO_I], c[own + _RHO_I])
            new_memory[rest + _U] = u_fd
            new_memory[rest + _V] = v
            new_memory[rest + _STARTED] = 1.0
            for i in range(r):
                new_memory[rest + _Y + i] = y[i]
        terms[STATUS] = status
        terms[STATUS + 1 + rest] = new_memory[rest + _V_I]
        publish(memory, STATUS + 2 + rest, terms)
        return v

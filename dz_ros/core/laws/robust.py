# SPDX-License-Identifier: Apache-2.0
"""The law `robust` (ours): the paper's law [wang2004] and four additions, any order n.

    K = max(min(κ_f K0, K_cap), 1.5 k_d),  K0 = f μ_d/(β T),  ε = k*/(K − k_d),  ε_a = 1.5 ε
 1. s_a = s − ε_a sat(s/ε_a)
 2. late gradient of θ̂, φ̂ by s_a, clipped to their bounds
 3. G, the guard: three changes of side |s| ≥ ε close together are an oscillation, κ_f ← 0.7 κ_f
 4. w = v_I; where |s| > ε and v_I s < 0 its authority falls from ρ1 to ρ0 at ε_a
 5. v_b = φ̂ u_fd + Yᵀθ̂ − k_d s − k* sat(s/ε) − w
 6. B, the outer gain: v = clip(v_b − k_2 s_a, ±max(|v_b|, V0)): only headroom is used
 7. A, the integral: v_I ← clip(v_I + T (K²/q) s, ±ρ1) while |s| ≤ ε
    optional, between 3 and 4, an identifier of θ̂, φ̂ in the layer

Details, rules and what is proven (limsup |s| ≤ ε_a in continuous time): mathematics.md §10. T is
the accepted interval; one of 0 leaves the whole memory, guard and first-sample flag, as it is.

Over 300 lines: one law with its gains, its guard, its linear model and its kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from dz_ros.core.design.boundary_layer import chatter_limit
from dz_ros.core.design.linear_loop import integral_model, LayerModel
from dz_ros.core.laws.base import Design, Numbers, publish, Tunable
from dz_ros.core.laws.extensions import (
    clip,
    correct_estimates,
    exceeds,
    INTEGRAL,
    LAST,
    last_regressors,
    late_gradient,
    opposed,
    project,
    ProjectedLaw,
    ProjectionGains,
    STARTED,
    winds_up,
)
from dz_ros.core.laws.wang2004 import adaptive_design, AdaptiveGains, control
from dz_ros.core.records import Status
from dz_ros.core.schema import parameter
from dz_ros.core.signals import before, estimates, places, Role, S_EPS, Signal, STATUS, V_EXTRA
from dz_ros.core.tracking import (
    error_weights,
    feed_forward,
    feed_forward_weights,
    filtered_error,
    outside_layer,
)

LEAST_GAIN = 1.5
"""K is never below this many k_d, so that ε = k*/(K − k_d) stays finite."""

OUTER = 1.5
"""ε_a = this many ε."""

GUARD_WINDOW = 0.25
"""Crossings of the layer further apart than this do not count as oscillation [s]."""


@dataclass(frozen=True)
class RobustGains(ProjectionGains, AdaptiveGains):
    """Gains of `robust`; ε is not among them, it follows from K."""

    k_star: float = parameter(2.5, 'actuator unit', 'robust gain k* of (14), (18)', minimum=0.0,
                              open_minimum=True)
    margin: float = parameter(0.445, '1', 'share f of the chatter limit μ_d that K uses',
                              minimum=0.0, maximum=1.0, open_minimum=True)
    beta: float = parameter(1.25, 'unit of x^(n) per actuator unit', 'b_max m_max, for which the '
                            'full margin is wanted', minimum=0.0, open_minimum=True)
    design_delay: int = parameter(1, 'samples', 'loop delay d for which K is made; 1 for a loop '
                                  'over topics', minimum=0, maximum=100)
    gain_cap: float = parameter(120.0, 'actuator unit per unit of s', 'K_cap, the largest K: '
                                'noise of v is about K times that of x^(n−1)', minimum=0.0,
                                open_minimum=True)
    integral_divisor: float = parameter(2.0, '1', 'q of r_I = K²/q; damping √(q b m)/2, 2.5–3 '
                                        'for more', minimum=0.0, open_minimum=True)
    rho_0: float = parameter(1.47, 'actuator unit', 'authority of a wrong-signed integral outside '
                             'ε_a, at most k* − ρ/m_min', minimum=0.0)
    rho_1: float = parameter(16.0, 'actuator unit', 'authority of the integral: above the largest '
                             'expected residual φ̃u + Yᵀθ̃ + d/m, or v_max', minimum=0.0)
    k_2: float = parameter(20.0, 'actuator unit per unit of s', 'outer gain, 2 k_d; 0 for λ ≥ 8 '
                           'on plants with velocity regressors', minimum=0.0)
    v_floor: float = parameter(0.0, 'actuator unit', 'least effort the outer gain may use, a '
                               'normal actuator level: needed when a run starts on the '
                               'trajectory', minimum=0.0)
    v_max: float = parameter(0.0, 'actuator unit', 'what the actuator can do; 0 = not known',
                             minimum=0.0)
    identifier: bool = parameter(False, '', 'identify θ̂, φ̂ inside the layer; no proof with it')


def nominal_gain(gains: RobustGains, period: float) -> float:
    """Return K0 = f μ_d/(β T) [actuator unit / unit of s]."""
    return gains.margin * chatter_limit(gains.design_delay) / (gains.beta * period)


def layer(gains: RobustGains, period: float, kappa_f: float = 1.0) -> tuple[float, float]:
    """Return K = max(min(κ_f K0, K_cap), 1.5 k_d) and ε = k*/(K − k_d)."""
    gain = max(min(kappa_f * nominal_gain(gains, period), gains.gain_cap), LEAST_GAIN * gains.k_d)
    return gain, gains.k_star / (gain - gains.k_d)


_SATURATED = float(Status.SATURATED)
# Places in the constants; Λ, Λ_v and the projection box follow.
(_K_D, _K_STAR, _GAMMA, _ETA, _K0, _K_CAP, _K_LEAST, _Q, _RHO_0, _RHO_1, _K_2, _FLOOR, _V_MAX,
 _WINDOW, _IDENTIFIER, _LAMBDA) = range(16)
GUARD = (Signal('kappa_f', '1', 'factor by which the guard has lowered K', Role.GUARD, 'κ_f'),
         Signal('guard_side', '1', 'side of the last crossing', Role.GUARD),
         Signal('guard_since', '1', 'samples since', Role.GUARD),
         Signal('guard_count', '1', 'changes of side that belong together', Role.GUARD))
"""Memory of the guard, in the order in which `guard` takes it."""
FIRST = Signal('v_first', 'v', 'effort V0 of the first sample')
LAYER = (Signal('gain', 'v/x^(n-1)', 'slope of v in the layer', symbol='K'),
         Signal('epsilon', 'x^(n-1)', 'half-width of the layer', symbol='ε'),
         Signal('v_inner', 'v', 'part w of the slot that acts', symbol='w'))
"""What the laws of this family publish of a step."""
GAIN, EPSILON, INNER = places(LAYER, 'gain', 'epsilon', 'v_inner')

# The memory after θ̂, φ̂; Y⁻ follows.
_MEMORY = (INTEGRAL, *GUARD, *LAST, FIRST, STARTED)
_V_I, _KAPPA, _U, _V, _V0, _STARTED = places(
    _MEMORY, 'v_integral', 'kappa_f', 'u_last', 'v_last', 'v_first', 'started')
_Y = len(_MEMORY)
# What is published of the step, after θ̂, φ̂.
_STEP = (INTEGRAL, GUARD[0], *LAYER)
_STEP_V_I, _STEP_KAPPA, _STEP_LAYER = places(_STEP, 'v_integral', 'kappa_f', 'gain')
_STEP_END = len(_STEP)


def guard(memory: Any, at: int, s: float, epsilon: float, window: float) -> None:
    """Step 3: count changes of side in place; after the third, lower κ_f.

    `memory` holds κ_f, side, since, count from index `at` on; changes of side that belong together
    are at most `window` samples apart.
    """
    since = memory[at + 2] + 1.0
    side = 0.0
    if s >= epsilon:
        side = 1.0
    elif s <= -epsilon:
        side = -1.0
    if side != 0.0:
        if since > window:
            memory[at + 3] = 0.0
        elif side == -memory[at + 1]:
            memory[at + 3] += 1.0
        memory[at + 1] = side
        since = 0.0
        if memory[at + 3] >= 3.0:
            memory[at] *= 0.7
            memory[at + 3] = 0.0
            memory[at + 1] = 0.0
    memory[at + 2] = since


def admitted(v_i: float, s: float, epsilon: float, eps_a: float, rho_0: float,
             rho_1: float) -> float:
    """Step 4: return w, the part of v_I that acts."""
    distance = s if s > 0.0 else -s
    if distance > epsilon and opposed(v_i, s):
        share = clip((distance - epsilon) / (eps_a - epsilon), 0.0, 1.0)
        limit = rho_1 + (rho_0 - rho_1) * share
        return clip(v_i, -limit, limit)
    return v_i


class Robust(ProjectedLaw):
    """Steps 1–7."""

    name = 'robust'
    summary = 'the law of 2004 with projection, integral, outer gain and guard'
    Gains: ClassVar[type] = RobustGains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 0.3, 30.0), Tunable('k_d', 2.0, 60.0), Tunable('k_star', 1.5, 8.0),
        Tunable('margin', 0.1, 1.0), Tunable('gamma', 0.02, 20.0), Tunable('eta', 0.02, 20.0))
    _memory: ClassVar[tuple[Signal, ...]] = _MEMORY

    @property
    def constants(self) -> tuple[float, ...]:
        """Gains in the order of the places above, Λ, Λ_v, projection box."""
        g = self.gains
        return (g.k_d, g.k_star, g.gamma, g.eta, nominal_gain(g, self.period), g.gain_cap,
                LEAST_GAIN * g.k_d, g.integral_divisor, g.rho_0, g.rho_1, g.k_2, g.v_floor,
                g.v_max, GUARD_WINDOW / self.period, float(g.identifier),
                *error_weights(g.lambda_, self.order),
                *feed_forward_weights(g.lambda_, self.order), *self._box)

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """θ̂, φ̂ as used in v; v_I, κ_f after the step; K, ε, w of it; then the memory before."""
        used = estimates(self.regressor_count)
        return (*used, *_STEP,
                *before((*used, *_MEMORY, *last_regressors(self.regressor_count))))

    @cached_property
    def design(self) -> Design:
        """What the design rules need, with κ_f = 1."""
        g = self.gains
        gain, epsilon = self._layer()
        found = adaptive_design(g, self.order, g.k_star, epsilon)
        return self.projected(replace(
            found, gain=gain, target=OUTER * epsilon, reserve=g.rho_0, inner_reserve=g.rho_1,
            least_gain=LEAST_GAIN * g.k_d))

    def _layer(self) -> tuple[float, float]:
        """Return K, ε."""
        return layer(self.gains, self.period)

    def layer_model(self, gain: float | None = None) -> LayerModel:
        """Return the model with the integral of step 7, whose rate follows K."""
        found = self.design
        gain = found.gain if gain is None else gain
        return integral_model(self.order, found.lambda_, gain, found.lead,
                              self.regressor_count + 1 + _V_I,
                              self.period * gain * gain / self.gains.integral_divisor)

    def initial_memory(self) -> tuple[float, ...]:
        """θ̂(0), φ̂(0), v_I = 0, κ_f = 1, nothing before."""
        return (*self._theta_0, self.gains.phi_0, 0.0, 1.0, *(0.0,) * (7 + self.regressor_count))

    def reset_guard(self, memory: Sequence[float]) -> tuple[float, ...]:
        """Return the memory with κ_f = 1 and an empty count."""
        at = self.regressor_count + 1 + self._memory.index(GUARD[0])
        return (*memory[:at], 1.0, 0.0, 0.0, 0.0, *memory[at + len(GUARD):])

    @staticmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,
               dt: float, new_memory: Any, terms: Any) -> float:
        """One sample, in the order of the steps."""
        n = len(x)
        r = len(y)
        rest = r + 1
        box = _LAMBDA + 2 * n
        v_max = c[_V_MAX]
        for i in range(len(memory)):
            new_memory[i] = memory[i]
        gain = max(min(memory[rest + _KAPPA] * c[_K0], c[_K_CAP]), c[_K_LEAST])
        epsilon = c[_K_STAR] / (gain - c[_K_D])
        eps_a = OUTER * epsilon
        s = filtered_error(c, _LAMBDA, x_d, x)
        u_fd = feed_forward(c, _LAMBDA + n, x_d, x)
        s_a = outside_layer(s, eps_a)                                                     # 1
        inside = -epsilon <= s <= epsilon
        status = 0.0
        if dt > 0.0:
            if memory[rest + _STARTED] != 0.0:                                            # 2
                if winds_up(memory[rest + _V], v_max, s):
                    status = _SATURATED
                else:
                    late_gradient(c[_GAMMA], c[_ETA], c[_K_D], dt, s_a, memory, rest + _Y, r,
                                  memory[rest + _U], new_memory)
                    project(c, box, r, new_memory)
            guard(new_memory, rest + _KAPPA, s, epsilon, c[_WINDOW])                      # 3
            if c[_IDENTIFIER] != 0.0 and inside and not exceeds(memory[rest + _V], v_max):
                p = gain * s + new_memory[rest + _V_I]
                moved = correct_estimates(dt * (p - clip(p, -1.0, 1.0)), memory[rest + _U],
                                          memory, rest + _Y, c, box, r, new_memory)
                new_memory[rest + _V_I] = clip(new_memory[rest + _V_I] + moved,
                                               -c[_RHO_1], c[_RHO_1])
        w = admitted(new_memory[rest + _V_I], s, epsilon, eps_a, c[_RHO_0], c[_RHO_1])    # 4
        v_b = control(c[_K_D], c[_K_STAR], epsilon, new_memory, s, u_fd, y, terms) - w    # 5
        size = abs(v_b)
        v_first = memory[rest + _V0]
        if memory[rest + _STARTED] == 0.0:
            v_first = max(size, c[_FLOOR])
        limit = max(size, v_first)
        v = clip(v_b - c[_K_2] * s_a, -limit, limit)                                      # 6
        terms[S_EPS] = s_a
        terms[V_EXTRA] = (v - v_b) - w
        if dt > 0.0:
            if inside:                                                                    # 7
                if exceeds(v, v_max):
                    status = _SATURATED
                else:
                    new_memory[rest + _V_I] = clip(
                        new_memory[rest + _V_I] + dt * (gain * gain / c[_Q]) * s,
                        -c[_RHO_1], c[_RHO_1])
            new_memory[rest + _U] = u_fd
            new_memory[rest + _V] = v
            new_memory[rest + _V0] = v_first
            new_memory[rest + _STARTED] = 1.0
            for i in range(r):
                new_memory[rest + _Y + i] = y[i]
        terms[STATUS] = status
        own = STATUS + 1 + rest
        for i in range(rest):
            terms[STATUS + 1 + i] = new_memory[i]
        terms[own + _STEP_V_I] = new_memory[rest + _V_I]
        terms[own + _STEP_KAPPA] = new_memory[rest + _KAPPA]
        terms[own + _STEP_LAYER + GAIN] = gain
        terms[own + _STEP_LAYER + EPSILON] = epsilon
        terms[own + _STEP_LAYER + INNER] = w
        publish(memory, own + _STEP_END, terms)
        return v

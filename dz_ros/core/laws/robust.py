"""The recommended law (ours): the paper's law [wang2004] and four additions, any order n.

    K = max(min(κ_f K0, K_cap), 1.5 k_d),  K0 = f μ_d/(β T),  ε = k*/(K − k_d),  ε_a = 1.5 ε
 1. s_a = s − ε_a sat(s/ε_a)
 2. late gradient of θ̂, φ̂ by s_a, clipped to their bounds; not in the first sample, not while
    |v⁻| > v_max and v⁻ s < 0
 3. G, the guard: three changes of side |s| ≥ ε, each within 0.25 s of the one before it,
    are an oscillation: κ_f ← 0.7 κ_f from the next sample on. Latched; `reset_guard` releases it
 4. w = v_I; where |s| > ε and v_I s < 0 clipped to ±L,
    L = ρ1 + (ρ0 − ρ1) clip((|s| − ε)/(ε_a − ε), 0, 1)
 5. v_b = φ̂ u_fd + Yᵀθ̂ − k_d s − k* sat(s/ε) − w;  V0 = max(|v_b|, floor) in the first sample
 6. B, the outer gain: v = clip(v_b − k_2 s_a, ±max(|v_b|, V0)): only headroom is used
 7. A, the integral: v_I ← clip(v_I + T (K²/q) s, ±ρ1) while |s| ≤ ε and not |v| > v_max
    optional, between 3 and 4, the identifier: while |s| ≤ ε and not saturated, p = K s + v_I,
    z = p − clip(p, ±1), g = T z/(1 + |Y⁻|² + u⁻²); θ̂ ← proj(θ̂ − g Y⁻), φ̂ ← proj(φ̂ − g u⁻),
    v_I ← clip(v_I + Y⁻ᵀΔθ̂ + u⁻Δφ̂, ±ρ1)

T in 2, 7 and the identifier is the accepted interval; an interval of 0 leaves the whole memory,
guard and first-sample flag included, as it is.

Proven, in continuous time, without delay and noise, with the paper's assumptions and the true
parameters inside the projection box: B adds −c k_2 s_a with c ∈ [0, 1]; for |s| ≥ ε_a an integral
of the wrong sign is at most ρ0. With V = ½ s_a² + ½ b m (|θ̃|²/γ + φ̃²/η),

    V' ≤ −b m [(k_d + c k_2) s_a² + (k* − ρ/m_min − ρ0)|s_a|] ≤ −b m k_d s_a²  if k* ≥ ρ/m_min + ρ0

and a guard step only widens ε_a, so V drops: all signals bounded, limsup |s| ≤ ε_a.
Not proven: the accuracy reached inside the layer (linear analysis and simulation), sampling,
delay, noise, the guard's detection, a disturbance on top of d/m, anything with the identifier on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from dz_ros.core.laws.base import Design, Law, per_regressor
from dz_ros.core.laws.extensions import (
    check_start,
    clip,
    exceeds,
    late_gradient,
    project,
    projection_box,
    winds_up,
)
from dz_ros.core.laws.robust_gains import (
    GUARD_WINDOW,
    layer,
    LEAST_GAIN,
    nominal_gain,
    OUTER,
    RobustGains,
)
from dz_ros.core.laws.wang2004 import adaptive_design, control
from dz_ros.core.records import STATUS, Status
from dz_ros.core.tracking import (
    error_weights,
    feed_forward,
    feed_forward_weights,
    filtered_error,
    outside_layer,
)

_SATURATED = float(Status.SATURATED)
# Places in the constants; Λ, Λ_v and the projection box follow.
(_K_D, _K_STAR, _GAMMA, _ETA, _K0, _K_CAP, _K_LEAST, _Q, _RHO_0, _RHO_1, _K_2, _FLOOR, _V_MAX,
 _WINDOW, _IDENTIFIER, _LAMBDA) = range(16)
# Places in the memory, counted from the end of θ̂, φ̂.
_V_I, _KAPPA, _SIDE, _SINCE, _COUNT, _U, _V, _V0, _STARTED, _Y = range(10)


def guard(memory: Any, at: int, s: float, epsilon: float, window: float) -> None:
    """Step 3: count changes of side in place; after the third, lower κ_f.

    Args:
        memory: Holds κ_f, side, since, count from index `at` on.
        at: Index of κ_f.
        s: Filtered error.
        epsilon: Half-width of the layer.
        window: Longest distance of two changes that belong together [samples].
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


def identify(c: Sequence[float], box: int, r: int, gain: float, s: float, dt: float,
             before: Sequence[float], memory: Any) -> None:
    """Move what K s + v_I says of the estimates' error from v_I into them, in place."""
    rest = r + 1
    u = before[rest + _U]
    p = gain * s + memory[rest + _V_I]
    power = 1.0 + u * u
    for i in range(r):
        power += before[rest + _Y + i] * before[rest + _Y + i]
    step = dt * (p - clip(p, -1.0, 1.0)) / power
    moved = 0.0
    for i in range(r):
        old = memory[i]
        memory[i] = clip(old - step * before[rest + _Y + i], c[box + i], c[box + r + i])
        moved += before[rest + _Y + i] * (memory[i] - old)
    old = memory[r]
    memory[r] = clip(old - step * u, c[box + 2 * r], c[box + 2 * r + 1])
    moved += u * (memory[r] - old)
    memory[rest + _V_I] = clip(memory[rest + _V_I] + moved, -c[_RHO_1], c[_RHO_1])


def admitted(v_i: float, s: float, epsilon: float, eps_a: float, rho_0: float,
             rho_1: float) -> float:
    """Step 4: return w, the part of v_I that acts."""
    distance = s if s > 0.0 else -s
    if distance > epsilon and ((v_i > 0.0 and s < 0.0) or (v_i < 0.0 and s > 0.0)):
        share = clip((distance - epsilon) / (eps_a - epsilon), 0.0, 1.0)
        limit = rho_1 + (rho_0 - rho_1) * share
        return clip(v_i, -limit, limit)
    return v_i


class Robust(Law):
    """Steps 1–7."""

    name = 'robust'
    summary = 'recommended: the law of 2004 with projection, integral, outer gain and guard'
    Gains = RobustGains

    def __init__(self, gains: Any = None, order: int = 2, regressor_count: int = 2,
                 period: float = 0.005) -> None:
        super().__init__(gains, order, regressor_count, period)
        self._theta_0 = per_regressor(self.gains.theta_0, regressor_count, 'theta_0')
        self._box = projection_box(self.gains, regressor_count)
        check_start(self._box, self._theta_0, self.gains.phi_0)

    @property
    def constants(self) -> tuple[float, ...]:
        """Gains in the order of the places above, Λ, Λ_v, projection box."""
        g = self.gains
        return (g.k_d, g.k_star, g.gamma, g.eta, nominal_gain(g, self.period), g.gain_cap,
                LEAST_GAIN * g.k_d, g.integral_divisor, g.rho_0, g.rho_1, g.k_2, g.v_floor,
                g.v_max, GUARD_WINDOW / self.period, float(g.identifier),
                *error_weights(g.lambda_, self.order),
                *feed_forward_weights(g.lambda_, self.order), *self._box)

    @property
    def memory_names(self) -> tuple[str, ...]:
        """θ̂, φ̂, v_I, κ_f, guard (side, since, count), u_fd⁻, v⁻, V0, first-sample flag, Y⁻."""
        r = range(1, self.regressor_count + 1)
        return (*(f'theta{i}' for i in r), 'phi', 'v_integral', 'kappa_f', 'guard_side',
                'guard_since', 'guard_count', 'u_last', 'v_last', 'v_first', 'started',
                *(f'y{i}_last' for i in r))

    @property
    def signal_names(self) -> tuple[str, ...]:
        """θ̂, φ̂ as used in v; v_I, κ_f after the step; K, ε, w of it; then the memory before."""
        return (*self.memory_names[:self.regressor_count + 3], 'gain', 'epsilon', 'v_inner',
                *(f'{name}_before' for name in self.memory_names))

    @property
    def design(self) -> Design:
        """What the design rules need, with κ_f = 1."""
        g, r = self.gains, self.regressor_count
        gain, epsilon = layer(g, self.period)
        found = adaptive_design(g, self.order, g.k_star, epsilon)
        return replace(found, gain=gain, target=OUTER * epsilon, reserve=g.rho_0,
                       least_gain=LEAST_GAIN * g.k_d,
                       integral_rate=gain * gain / g.integral_divisor,
                       theta=tuple(zip(self._box[:r], self._box[r:2 * r], strict=True)),
                       phi=self._box[2 * r:])

    def initial_memory(self) -> tuple[float, ...]:
        """θ̂(0), φ̂(0), v_I = 0, κ_f = 1, nothing before."""
        return (*self._theta_0, self.gains.phi_0, 0.0, 1.0, *(0.0,) * (7 + self.regressor_count))

    def memory_from_signals(self, signals: Sequence[float]) -> tuple[float, ...]:
        """The memory before the step is published whole."""
        return tuple(signals[self.regressor_count + 6:])

    def reset_guard(self, memory: Sequence[float]) -> tuple[float, ...]:
        """Return the memory with κ_f = 1 and an empty count."""
        at = self.regressor_count + 1 + _KAPPA
        return (*memory[:at], 1.0, 0.0, 0.0, 0.0, *memory[at + 4:])

    @staticmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
               x: Sequence[float], y: Sequence[float], dt: float, new_memory: Any,
               terms: Any) -> float:
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
                identify(c, box, r, gain, s, dt, memory, new_memory)
        w = admitted(new_memory[rest + _V_I], s, epsilon, eps_a, c[_RHO_0], c[_RHO_1])    # 4
        v_b = control(c[_K_D], c[_K_STAR], epsilon, new_memory, s, u_fd, y, terms) - w    # 5
        size = abs(v_b)
        v_first = memory[rest + _V0]
        if memory[rest + _STARTED] == 0.0:
            v_first = max(size, c[_FLOOR])
        limit = max(size, v_first)
        v = clip(v_b - c[_K_2] * s_a, -limit, limit)                                      # 6
        terms[1] = s_a
        terms[7] = (v - v_b) - w
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
        first = STATUS + 1
        for i in range(rest + 2):
            terms[first + i] = new_memory[i]
        terms[first + rest + 2] = gain
        terms[first + rest + 3] = epsilon
        terms[first + rest + 4] = w
        for i in range(len(memory)):
            terms[first + rest + 5 + i] = memory[i]
        return v

# SPDX-License-Identifier: Apache-2.0
"""The law `robust_eso` (ours): `robust` with a shaped start and an observer in its slot, any n.

    x_r = x_d + η,  (d/dt + a)^n η = 0  from  η^(i)(0) = x̃^(i)(0), i < n, at every take-over
    K = max(κ_f K0, 1.5 k_d),  ε = k*/(K − k_d),  ε_a = 1.5 ε;  x̃, s, u_fd are formed with x_r
 1. s_a, 2. late gradient, 3. guard as in `robust`
 4. extended-state observer of s: z = exp(−ω_o √κ_f T), r = s − ŝ,  ŝ += (1 − z³) r,
    σ̂ += 1.5 (1 − z)² (1 + z)/(T b̂) r,  σ̂' += (1 − z)³/(T² b̂) r
 5. identifier (switch): what of σ̂ exceeds ±Δ moves into θ̂, φ̂
 6. σ̂ ← clip(σ̂, ±ρ1); periodic learning (switch): w = clip(σ̂ + Σ_h a_h cos hωt + b_h sin hωt, ±ρ1)
 7. w limited as v_I is in `robust`
 8. v_b = φ̂ u_fd + Yᵀθ̂ − k_d s − k* sat(s/ε) − w, outer gain as in `robust`, v ← clip(v, ±v_max)
 9. q = v − φ̂ u_fd − Yᵀθ̂ + the learned part;  ŝ += T b̂ (q_{k−d} + σ̂) + ½ T² b̂ σ̂';  σ̂ += T σ̂';
    η one sample on (exactly)

With the observer off its place is taken by the integral of `robust`. Details, gains by rule and
what is proven: mathematics.md §11. T in 2, 4, 5 and 6 is the accepted interval, in 9 the nominal
one; an interval of 0 leaves the whole memory as it is. (Because v is clipped, a saturated v⁻ is
one that has reached v_max.)

Over 300 lines: one law, with its gains, its steps and its linear model in the layer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any, ClassVar

import numpy as np

from dz_ros.core.design.linear_loop import integral_model, LayerModel, surface_model
from dz_ros.core.laws.base import Numbers, publish, Tunable
from dz_ros.core.laws.extensions import (
    clip,
    correct_estimates,
    LAST,
    last_regressors,
    late_gradient,
    opposed,
    project,
    ProjectionGains,
    STARTED,
)
from dz_ros.core.laws.robust import (
    admitted,
    EPSILON,
    FIRST,
    GAIN,
    GUARD,
    guard,
    GUARD_WINDOW,
    INNER,
    LAYER,
    LEAST_GAIN,
    OUTER,
    Robust,
)
from dz_ros.core.laws.wang2004 import AdaptiveGains, control
from dz_ros.core.records import Status
from dz_ros.core.schema import parameter
from dz_ros.core.signals import (
    before,
    estimates,
    places,
    S_EPS,
    Signal,
    STATUS,
    V_EXTRA,
    V_FEED_FORWARD,
    V_REGRESSOR,
)
from dz_ros.core.tracking import error_weights, feed_forward_weights, outside_layer
from dz_ros.errors import ConfigurationError

_SATURATED = float(Status.SATURATED)
LEARNING_LAG = 2.2
"""What is learned is shifted by this many time constants 1/ω_o of the observer."""

# Places in the constants; Λ, Λ_v, the row of η^(n), the matrix of η, the projection box follow.
(_K_D, _K_STAR, _GAMMA, _ETA, _K0, _K_LEAST, _RHO_0, _RHO_1, _K_2, _FLOOR, _V_MAX, _WINDOW,
 _SHAPED, _OBSERVER, _RATE, _B, _DELAY, _Q, _IDENTIFIER, _BAND, _OMEGA, _MU, _T,
 _LAMBDA) = range(24)
V_MAX, PROJECTION = _V_MAX, _LAMBDA
"""Place of v_max; the projection box begins 3 n + n² after the second, 2 r + 2 numbers."""
_SIGMA = Signal('sigma', 'v', 'estimated residual; without the observer the integral',
                symbol='σ̂')
# The memory after θ̂, φ̂; η, η', … and Y⁻, then a_h, b_h follow.
_MEMORY = (*GUARD, _SIGMA, Signal('sigma_dot', 'v/s', 'rate of sigma'),
           Signal('s_hat', 'x^(n-1)', 'observed s'),
           Signal('q_last', 'v', 'v less its feed-forward, of the sample before'),
           Signal('q_earlier', 'v', 'the same one sample earlier'), *LAST, FIRST,
           Signal('phase', 's', 'time of the learning'), STARTED)
(_KAPPA, _SLOT, _SLOPE, _S_HAT, _Q1, _Q2, _U, _V, _V0, _PHASE, _STARTED) = places(
    _MEMORY, 'kappa_f', 'sigma', 'sigma_dot', 's_hat', 'q_last', 'q_earlier', 'u_last', 'v_last',
    'v_first', 'phase', 'started')
_SHIFT = len(_MEMORY)
# What is published of the step, after θ̂, φ̂; η, η', … and then LAYER follow.
_STEP = (GUARD[0], _SIGMA)
_STEP_KAPPA, _STEP_SIGMA = places(_STEP, 'kappa_f', 'sigma')
_STEP_SHIFT = len(_STEP)
_STEP_LAYER = len(LAYER)


@dataclass(frozen=True)
class RobustEsoGains(ProjectionGains, AdaptiveGains):
    """Gains of `robust_eso`; the defaults are those by rule for the example of [wang2004]."""

    lambda_: float = parameter(10.0, '1/s', 'slope λ of the filtered error (8); by rule K b̂/6',
                               minimum=0.0, open_minimum=True)
    k_d: float = parameter(10.0, 'actuator unit per unit of s', 'damping gain k_d of (14), at '
                           'most K/6', minimum=0.0, open_minimum=True)
    k_star: float = parameter(4.0, 'actuator unit', 'robust gain k* of (14), (18), for '
                              'dead-zone and disturbance', minimum=0.0, open_minimum=True)
    layer_gain: float = parameter(60.0, 'actuator unit per unit of s', 'K0, the slope of v in the '
                                  'layer; by rule 0.375 μ_d/(β T), 0.26 for a quiet set',
                                  minimum=0.0, open_minimum=True)
    design_delay: int = parameter(1, 'samples', 'loop delay d that the observer reckons with; 1 '
                                  'for a loop over topics', minimum=0, maximum=2)
    start_rate: float = parameter(2.0, '1/s', 'a of the shaped start, well below λ; 0 = off, the '
                                  'law then tracks x_d from the first sample on', minimum=0.0)
    observer: bool = parameter(True, '', 'observer of the residual in the slot; false = the '
                               'integral of `robust`')
    observer_rate: float = parameter(50.0, 'rad/s', 'ω_o of the observer; by rule 0.83 K b̂',
                                     minimum=0.0, open_minimum=True)
    input_gain: float = parameter(1.0, 'unit of x^(n) per actuator unit', 'b̂, nominal b m',
                                  minimum=0.0, open_minimum=True)
    integral_divisor: float = parameter(2.0, '1', 'q of r_I = K²/q, without the observer only',
                                        minimum=0.0, open_minimum=True)
    identifier: bool = parameter(True, '', 'identify θ̂, φ̂ inside the layer; no proof with it')
    identifier_band: float = parameter(1.0, 'actuator unit', 'Δ, residual that the identifier '
                                       'leaves to the observer; by rule k*/4', minimum=0.0)
    rho_0: float = parameter(1.47, 'actuator unit', 'authority of a wrong-signed slot outside '
                             'ε_a, at most k* − ρ/m_min', minimum=0.0)
    rho_1: float = parameter(16.0, 'actuator unit', 'authority of the slot: above the largest '
                             'expected residual φ̃u + Yᵀθ̃ + d/m, or v_max', minimum=0.0)
    k_2: float = parameter(40.0, 'actuator unit per unit of s', 'outer gain; by rule 2 K/3',
                           minimum=0.0)
    v_floor: float = parameter(16.7, 'actuator unit', 'least effort the outer gain may use, a '
                               'normal actuator level', minimum=0.0)
    v_max: float = parameter(0.0, 'actuator unit', 'what the actuator can do: v is clipped to it; '
                             '0 = not known', minimum=0.0)
    learning_harmonics: int = parameter(0, '1', 'H, harmonics learned of a periodic reference; '
                                        '0 = off. H ω <= 0.4 ω_o, else it diverges', minimum=0,
                                        maximum=100)
    learning_frequency: float = parameter(1.0, 'rad/s', 'ω of the reference, for the learning',
                                          minimum=0.0, open_minimum=True)
    learning_rate: float = parameter(0.3, '1/s', 'μ of the learning', minimum=0.0)


def start_row(rate: float, order: int) -> tuple[float, ...]:
    """Return the weights of η^(n) = −Σ_i C(n, i) a^(n−i) η^(i), shape (order,)."""
    return tuple(-math.comb(order, i) * rate ** (order - i) for i in range(order))


def start_matrix(rate: float, order: int, period: float) -> tuple[float, ...]:
    """Return what takes η, η', … one period on, row by row, shape (order²,), exactly."""
    numbers = []
    decay = math.exp(-rate * period)
    for i in range(order):
        for column in range(order):
            total = 0.0
            for m in range(i + 1):
                for j in range(max(m, column), order):
                    total += (math.comb(i, m) * (-rate) ** (i - m)
                              * period ** (j - m) / math.factorial(j - m)
                              * math.comb(j, column) * rate ** (j - column))
            numbers.append(decay * total)
    return tuple(numbers)


def at_limit(v: float, v_max: float) -> bool:
    """Return whether a clipped command has reached the known limit; 0 = no limit is known."""
    return v_max > 0.0 and (v >= v_max or v <= -v_max)


def pushes_against(v: float, v_max: float, s: float) -> bool:
    """Return whether a clipped command has reached the limit and pushes against s."""
    return at_limit(v, v_max) and opposed(v, s)


def correct(c: Sequence[float], at: int, s: float, dt: float, memory: Any) -> None:
    """Step 4: correct ŝ, σ̂, σ̂' in place by s − ŝ; κ_f stands at `at` in the memory."""
    z = math.exp(-c[_RATE] * math.sqrt(memory[at]) * dt)
    rest = s - memory[at + _S_HAT]
    memory[at + _S_HAT] += (1.0 - z * z * z) * rest
    memory[at + _SLOT] += 1.5 * (1.0 - z) * (1.0 - z) * (1.0 + z) / (dt * c[_B]) * rest
    memory[at + _SLOPE] += (1.0 - z) * (1.0 - z) * (1.0 - z) / (dt * dt * c[_B]) * rest


def predict(c: Sequence[float], at: int, q: float, memory: Any) -> None:
    """Step 9 without η: ŝ, σ̂ one period on in place, with the command that acts; q = v − ff."""
    acts = q
    if c[_DELAY] == 1.0:
        acts = memory[at + _Q1]
    elif c[_DELAY] == 2.0:
        acts = memory[at + _Q2]
    period = c[_T]
    memory[at + _S_HAT] += (period * c[_B] * (acts + memory[at + _SLOT])
                            + 0.5 * period * period * c[_B] * memory[at + _SLOPE])
    memory[at + _SLOT] += period * memory[at + _SLOPE]
    memory[at + _Q2] = memory[at + _Q1]
    memory[at + _Q1] = q


def learned(omega: float, phase: float, at: int, count: int, memory: Sequence[float]) -> float:
    """Return Σ_h a_h cos h ωt + b_h sin h ωt of step 6; a_1, b_1, … stand at `at`, t: phase."""
    total = 0.0
    for h in range(count):
        angle = (h + 1) * omega * phase
        total += memory[at + 2 * h] * math.cos(angle) + memory[at + 2 * h + 1] * math.sin(angle)
    return total


def learn(omega: float, instant: float, step: float, at: int, count: int, memory: Any) -> None:
    """Step 6: a_h += step cos h ωt, b_h += step sin h ωt in place, at the shifted instant t."""
    for h in range(count):
        angle = (h + 1) * omega * instant
        memory[at + 2 * h] += step * math.cos(angle)
        memory[at + 2 * h + 1] += step * math.sin(angle)


class RobustEso(Robust):
    """Steps 1–9."""

    name = 'robust_eso'
    summary = 'recommended: the law robust with a shaped start and an observer in the layer'
    Gains: ClassVar[type] = RobustEsoGains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 1.0, 40.0), Tunable('layer_gain', 20.0, 150.0),
        Tunable('observer_rate', 10.0, 150.0), Tunable('start_rate', 0.3, 10.0),
        Tunable('k_star', 1.5, 8.0), Tunable('gamma', 0.02, 20.0))
    _memory: ClassVar[tuple[Signal, ...]] = _MEMORY

    def __init__(self, gains: Any = None, order: int = 2, regressor_count: int = 2,
                 period: float = 0.005) -> None:
        super().__init__(gains, order, regressor_count, period)
        g = self.gains
        highest = g.learning_harmonics * g.learning_frequency
        if highest > 0.4 * g.observer_rate * (1.0 + 1e-9):
            raise ConfigurationError(
                'controller.learning_harmonics', g.learning_harmonics, 'H ω must not exceed 0.4 '
                f'ω_o = {0.4 * g.observer_rate:g} rad/s, else the learning diverges; with '
                f'ω = {g.learning_frequency:g} rad/s at most '
                f'{math.floor(0.4 * g.observer_rate / g.learning_frequency)}')
        if g.learning_harmonics and not g.observer:
            raise ConfigurationError('controller.learning_harmonics', g.learning_harmonics,
                                     'needs controller.observer = true')

    @property
    def constants(self) -> tuple[float, ...]:
        """Gains in the order of the places above, Λ, Λ_v, η^(n), matrix of η, projection box."""
        g, n = self.gains, self.order
        return (g.k_d, g.k_star, g.gamma, g.eta, g.layer_gain, LEAST_GAIN * g.k_d, g.rho_0,
                g.rho_1, g.k_2, g.v_floor, g.v_max, GUARD_WINDOW / self.period,
                float(g.start_rate > 0.0), float(g.observer), g.observer_rate, g.input_gain,
                float(g.design_delay), g.integral_divisor, float(g.identifier and g.observer),
                g.identifier_band, g.learning_frequency, g.learning_rate, self.period,
                *error_weights(g.lambda_, n), *feed_forward_weights(g.lambda_, n),
                *start_row(g.start_rate, n), *start_matrix(g.start_rate, n, self.period),
                *self._box)

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """θ̂, φ̂ as used in v; κ_f, σ̂, η … after the step; K, ε, w of it; the memory before."""
        used = estimates(self.regressor_count)
        shift = tuple(Signal(f'eta{i}', f'x^({i})' if i else 'x', 'shift of the reference',
                             symbol='η' + "'" * i) for i in range(self.order))
        learned = tuple(Signal(f'{part}{h}', 'v', f'{part} of harmonic {h} learned')
                        for h in range(1, self.gains.learning_harmonics + 1)
                        for part in ('cosine', 'sine'))
        return (*used, *_STEP, *shift, *LAYER, *before((
            *used, *_MEMORY, *shift, *last_regressors(self.regressor_count), *learned)))

    def _layer(self) -> tuple[float, float]:
        """Return K, ε with κ_f = 1."""
        g = self.gains
        gain = max(g.layer_gain, LEAST_GAIN * g.k_d)
        return gain, g.k_star / (gain - g.k_d)

    def layer_model(self, gain: float | None = None) -> LayerModel:
        """Return the model with the observer (ŝ, σ̂, σ̂', q⁻, q⁻⁻), or with the integral."""
        g, found, at = self.gains, self.design, self.regressor_count + 1
        gain = found.gain if gain is None else gain
        if not g.observer:
            return integral_model(self.order, found.lambda_, gain, found.lead, at + _SLOT,
                                  self.period * gain * gain / g.integral_divisor)
        bare = surface_model(self.order, found.lambda_, gain, found.lead)
        weights = np.asarray(error_weights(g.lambda_, self.order))
        z, period, b = math.exp(-g.observer_rate * self.period), self.period, g.input_gain
        rates = np.array([1.0 - z ** 3, 1.5 * (1.0 - z) ** 2 * (1.0 + z) / (period * b),
                          (1.0 - z) ** 3 / (period ** 2 * b), 0.0, 0.0])
        # Rows: ŝ, σ̂, σ̂', q⁻, q⁻⁻ after the correction, as shares of the memory and of x̃.
        memory, error = np.eye(5), np.outer(rates, weights)
        memory[:, 0] -= rates
        q = -memory[1], -gain * weights - error[1]
        acts = (q, (memory[3], error[3]), (memory[4], error[4]))[g.design_delay]
        rows = []
        for share, command in zip((memory, error), acts, strict=True):
            ahead = share[0] + period * b * (command + share[1]) + 0.5 * period ** 2 * b * share[2]
            rows.append((ahead, share[1] + period * share[2], share[2]))
        return LayerModel(
            tuple(at + place for place in (_S_HAT, _SLOT, _SLOPE, _Q1, _Q2)),
            np.array([*rows[0], q[0], memory[3]]), np.array([*rows[1], q[1], error[3]]),
            -memory[1], bare.d - error[1])

    def initial_memory(self) -> tuple[float, ...]:
        """θ̂(0), φ̂(0), κ_f = 1, nothing before."""
        zeros = _SHIFT - 1 + self.order + self.regressor_count + 2 * self.gains.learning_harmonics
        return (*self._theta_0, self.gains.phi_0, 1.0, *(0.0,) * zeros)

    def take_over(self, memory: Sequence[float]) -> tuple[float, ...]:
        """Return the memory for a new start: θ̂, φ̂, κ_f and what was learned stay."""
        fresh, kept = self.initial_memory(), self.regressor_count + 2
        learned_at = 2 * self.regressor_count + 1 + _SHIFT + self.order
        phase = self.regressor_count + 1 + _PHASE
        return (*memory[:kept], *fresh[kept:phase], memory[phase], *fresh[phase + 1:learned_at],
                *memory[learned_at:])

    @staticmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,
               dt: float, new_memory: Any, terms: Any) -> float:
        """One sample, in the order of the steps."""
        n = len(x)
        r = len(y)
        at = r + 1
        shift = at + _SHIFT
        y_at = shift + n
        waves = y_at + r
        harmonics = (len(memory) - waves) // 2
        row = _LAMBDA + 2 * n
        box = row + n + n * n
        v_max = c[_V_MAX]
        first = memory[at + _STARTED] == 0.0
        for i in range(len(memory)):
            new_memory[i] = memory[i]
        # Where the shift of the reference is published, it is held while the step is made.
        own = STATUS + 1 + at
        kept = own + _STEP_SHIFT
        for i in range(n):
            terms[kept + i] = memory[shift + i]
            if first:
                terms[kept + i] = x[i] - x_d[i] if c[_SHAPED] != 0.0 else 0.0
        s = 0.0
        u_fd = x_d[n]
        for i in range(n):
            error = x[i] - (x_d[i] + terms[kept + i])
            s += c[_LAMBDA + i] * error
            u_fd += c[row + i] * terms[kept + i] - c[_LAMBDA + n + i] * error
        gain = max(memory[at + _KAPPA] * c[_K0], c[_K_LEAST])
        epsilon = c[_K_STAR] / (gain - c[_K_D])
        eps_a = OUTER * epsilon
        s_a = outside_layer(s, eps_a)                                                     # 1
        inside = -epsilon <= s <= epsilon
        held = at_limit(memory[at + _V], v_max)
        status = 0.0
        if dt > 0.0:
            if not first:                                                                 # 2
                if pushes_against(memory[at + _V], v_max, s):
                    status = _SATURATED
                else:
                    late_gradient(c[_GAMMA], c[_ETA], c[_K_D], dt, s_a, memory, y_at, r,
                                  memory[at + _U], new_memory)
                    project(c, box, r, new_memory)
            guard(new_memory, at + _KAPPA, s, epsilon, c[_WINDOW])                        # 3
            if c[_OBSERVER] != 0.0:
                if first:
                    new_memory[at + _S_HAT] = s
                correct(c, at, s, dt, new_memory)                                         # 4
                if c[_IDENTIFIER] != 0.0 and inside and not first and not held:
                    sigma = new_memory[at + _SLOT]                                        # 5
                    excess = sigma - clip(sigma, -c[_BAND], c[_BAND])
                    if excess != 0.0:
                        new_memory[at + _SLOT] += correct_estimates(
                            dt * excess, memory[at + _U], memory, y_at, c, box, r, new_memory)
                new_memory[at + _SLOT] = clip(new_memory[at + _SLOT], -c[_RHO_1], c[_RHO_1])
        w = new_memory[at + _SLOT]
        periodic = 0.0
        if harmonics > 0:                                                                 # 6
            sigma = w
            periodic = learned(c[_OMEGA], memory[at + _PHASE], waves, harmonics, memory)
            w += periodic
            w = clip(w, -c[_RHO_1], c[_RHO_1])
            if dt > 0.0:
                if inside and not held:
                    learn(c[_OMEGA], memory[at + _PHASE] - LEARNING_LAG / c[_RATE],
                          dt * c[_MU] * sigma, waves, harmonics, new_memory)
                new_memory[at + _PHASE] = memory[at + _PHASE] + c[_T]
        w = admitted(w, s, epsilon, eps_a, c[_RHO_0], c[_RHO_1])                          # 7
        v_b = control(c[_K_D], c[_K_STAR], epsilon, new_memory, s, u_fd, y, terms) - w    # 8
        size = abs(v_b)
        v_first = memory[at + _V0]
        if first:
            v_first = max(size, c[_FLOOR])
        limit = max(size, v_first)
        v = clip(v_b - c[_K_2] * s_a, -limit, limit)
        if v_max > 0.0:
            v = clip(v, -v_max, v_max)
        terms[S_EPS] = s_a
        terms[V_EXTRA] = (v - v_b) - w
        if dt > 0.0:
            if c[_OBSERVER] != 0.0:                                                       # 9
                q = v - (terms[V_FEED_FORWARD] + terms[V_REGRESSOR]) + periodic
                predict(c, at, q, new_memory)
            elif inside:
                if at_limit(v, v_max):
                    status = _SATURATED
                else:
                    new_memory[at + _SLOT] = clip(
                        new_memory[at + _SLOT] + dt * (gain * gain / c[_Q]) * s,
                        -c[_RHO_1], c[_RHO_1])
            for i in range(n):
                moved = 0.0
                for j in range(n):
                    moved += c[row + n + i * n + j] * terms[kept + j]
                new_memory[shift + i] = moved
            new_memory[at + _U] = u_fd
            new_memory[at + _V] = v
            new_memory[at + _V0] = v_first
            new_memory[at + _STARTED] = 1.0
            for i in range(r):
                new_memory[y_at + i] = y[i]
        terms[STATUS] = status
        for i in range(at):
            terms[STATUS + 1 + i] = new_memory[i]
        terms[own + _STEP_KAPPA] = new_memory[at + _KAPPA]
        terms[own + _STEP_SIGMA] = new_memory[at + _SLOT]
        for i in range(n):
            terms[kept + i] = new_memory[shift + i]
        layer = kept + n
        terms[layer + GAIN] = gain
        terms[layer + EPSILON] = epsilon
        terms[layer + INNER] = w
        publish(memory, layer + _STEP_LAYER, terms)
        return v

# SPDX-License-Identifier: Apache-2.0
"""The law `coupled_eso` (ours): one computed-torque law for all axes, with `robust_eso`'s slot.

    M(x) x^(n) + C(x) x^(n−1) + g(x) = D w,   D = diag(b_i m_i),   i, j = 1 … axes

    x_r,i = x_d,i + η_i,  (d/dt + a)^n η_i = 0  from  η_i^(l)(0) = x̃_i^(l)(0)      (robust_eso)
    s_i = Λᵀ x̃_i,   a_i = u_fd,i = x_r,i^(n) − Λ_vᵀ x̃_i,   v_r,i = x_i^(n−1) − s_i
    Y_ik = g_ik + Σ_j M_ijk a_j + C_ijk v_r,j       the plant's structure, without its weights
    v_i = Σ_k Y_ik θ̂_ik − k_d M̂_ii s_i − sat_k*(κ (M̂ s)_i) − w_i,   w_i = (M̂ σ̂)_i

sat_k* limits to ±k*. θ̂_ik estimates the weight k over b_i m_i, for each axis by itself: where the
gains of the axes differ, they have different estimates of the same weight. M̂ is a nominal inertia
[actuator unit per unit of x^(n)], symmetric and *fixed*: gains made from an adapted one diverge.

 1. late gradient on θ̂_i with s_a = s_i − ε_a sat(s_i/ε_a), ε_a = 1.5 k*/(κ M̂_ii), projected
 2. observer of s_i, from the commands that acted on all axes:  q_j = Σ_l (M̂⁻¹)_jl (v − Yθ̂)_l,
    ŝ_j += T (q_j,k−d + σ̂_j) + ½ T² σ̂_j',  σ̂_j += T σ̂_j';  z = exp(−ω_o T), r_j = s_j − ŝ_j,
    ŝ_j += (1 − z³) r_j,  σ̂_j += 1.5 (1 − z)² (1 + z)/T r_j,  σ̂_j' += (1 − z)³/T² r_j
 3. v_i, the slot w_i limited as in `robust`, v_i clipped to ±v_max
 4. v − Yθ̂ of this sample is kept, η one sample on (exactly)

The kernel is that of one axis (`Law.coupled`): what it needs of the others, s_j and σ̂_j, it
computes from their states, references and memories. λ, a, ω_o, d and M̂ must therefore be the same
for all axes; k_d, k*, κ, γ and the bounds may differ. A plant that states no structure, or a loop
of one axis, has Y = Y(x) and M̂ a beside it. An interval of 0 leaves the whole memory as it is.

Proven is less than for one axis. With s_ε taken component by component, an axis inside its layer
has s_ε,i' = 0 but s_i' ≠ 0, and M s' is not M s_ε': the terms M_ij s_j' remain in V', so no
set that s converges to is guaranteed. Without the layer (k* = 0, no slot) V = ½ sᵀ M s + ½ Σ D_i
|θ̃_i|²/γ is the standard result for mechanical systems [slotine_li1991]. No guard: a limit cycle
is not seen.

Over 300 lines: one law, with its gains, its step and its linear model in the layer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Any, ClassVar

import numpy as np

from dz_ros.core.axes_keys import axis_key
from dz_ros.core.design.linear_loop import LayerModel, surface_model
from dz_ros.core.laws.base import Design, Law, Numbers, per_regressor, Tunable
from dz_ros.core.laws.extensions import clip
from dz_ros.core.laws.robust import admitted, OUTER
from dz_ros.core.laws.robust_eso import pushes_against, start_matrix, start_row
from dz_ros.core.records import Status
from dz_ros.core.schema import parameter
from dz_ros.core.signals import (
    before,
    places,
    S,
    S_EPS,
    Signal,
    STATUS,
    theta,
    U_FD,
    V_DAMPING,
    V_EXTRA,
    V_FEED_FORWARD,
    V_REGRESSOR,
    V_ROBUST,
)
from dz_ros.core.tracking import error_weights, feed_forward_weights, outside_layer
from dz_ros.errors import ConfigurationError

_SATURATED = float(Status.SATURATED)

# Places in the constants; Λ, Λ_v, the row of η^(n), the matrix of η, the projection box, the own
# row of M̂ and M̂⁻¹ follow. Rows and columns of M̂ are in the order own axis first.
(_K_D, _KAPPA, _K_STAR, _GAMMA, _RATE, _DELAY, _RHO_0, _RHO_1, _V_MAX, _SHAPED, _T,
 _LAMBDA) = range(12)
_MEMORY = (
    Signal('s_hat', 'x^(n-1)', 'observed s', symbol='ŝ'),
    Signal('sigma', 'x^(n)', 'estimated residual, as an acceleration', symbol='σ̂'),
    Signal('sigma_dot', 'x^(n)/s', 'rate of sigma'),
    Signal('q_last', 'v', 'v less its feed-forward, of the sample before'),
    Signal('q_earlier', 'v', 'the same one sample earlier'),
    Signal('q_earliest', 'v', 'the same two samples earlier'),
    Signal('v_last', 'v', 'v of the sample before'),
    Signal('started', '1', 'whether there was a sample before'))
_S_HAT, _SIGMA, _SLOPE, _Q1, _Q2, _Q3, _V, _STARTED = range(len(_MEMORY))
_SHIFT = len(_MEMORY)
_STEP = (Signal('sigma', 'x^(n)', 'estimated residual, as an acceleration', symbol='σ̂'),
         Signal('v_inner', 'v', 'part w of the slot that acts', symbol='w'))
_STEP_SIGMA, _STEP_INNER = places(_STEP, 'sigma', 'v_inner')
_STEP_SHIFT = len(_STEP)


@dataclass(frozen=True)
class CoupledEsoGains:
    """Gains of `coupled_eso`; the defaults are those of a single axis with b m = 1."""

    axis: int = parameter(0, '1', 'axis that the law answers for, its place in loop.axes; follows '
                          'from it', minimum=0, maximum=31, structural=True)
    inertia: tuple[float, ...] = parameter(
        (1.0,), 'actuator unit per unit of x^(n)', 'nominal M̂, symmetric, row by row in the order '
        'of loop.axes', structural=True)
    lambda_: float = parameter(10.0, '1/s', 'slope λ of the filtered error (8), the same for all '
                               'axes', minimum=0.0, open_minimum=True)
    kappa: float = parameter(48.0, '1/s', 'rate κ of s in the layer', minimum=0.0,
                             open_minimum=True)
    k_d: float = parameter(5.0, '1/s', 'damping gain, over M̂_ii', minimum=0.0, open_minimum=True)
    k_star: float = parameter(4.0, 'actuator unit', 'robust gain k*', minimum=0.0,
                              open_minimum=True)
    gamma: float = parameter(0.5, 'actuator unit per unit of Y_i squared and unit of s and second',
                             'adaptation gain γ', minimum=0.0)
    theta_0: tuple[float, ...] = parameter(
        (0.85,), 'actuator unit per unit of Y_i',
        'initial θ̂, one number for each weight or one for all')
    theta_min: tuple[float, ...] = parameter(
        (0.1,), 'actuator unit per unit of Y_i', 'lower bounds of θ̂')
    theta_max: tuple[float, ...] = parameter(
        (3.0,), 'actuator unit per unit of Y_i', 'upper bounds of θ̂')
    start_rate: float = parameter(2.0, '1/s', 'a of the shaped start, the same for all axes; 0 = '
                                  'off', minimum=0.0)
    observer_rate: float = parameter(45.0, 'rad/s', 'ω_o of the observers, the same for all axes',
                                     minimum=0.0, open_minimum=True)
    design_delay: int = parameter(1, 'samples', 'loop delay d that the observers reckon with; 1 '
                                  'for a loop over topics', minimum=0, maximum=2)
    rho_0: float = parameter(1.47, 'actuator unit', 'authority of a wrong-signed slot outside '
                             'ε_a', minimum=0.0)
    rho_1: float = parameter(40.0, 'actuator unit', 'authority of the slot', minimum=0.0)
    v_max: float = parameter(0.0, 'actuator unit', 'what the actuator can do: v is clipped to it; '
                             '0 = not known', minimum=0.0)

    def check(self, prefix: str) -> None:
        """Check that M̂ can be an inertia: square, symmetric, positive definite."""
        size = math.isqrt(len(self.inertia))
        if size * size != len(self.inertia) or size == 0:
            raise ConfigurationError(f'{prefix}inertia', list(self.inertia),
                                     'must have axes² numbers, a symmetric matrix row by row')
        matrix = np.reshape(self.inertia, (size, size))
        if (matrix != matrix.T).any() or np.linalg.eigvalsh(matrix)[0] <= 0.0:
            raise ConfigurationError(f'{prefix}inertia', list(self.inertia),
                                     'must be symmetric and positive definite')
        if self.axis >= size and size > 1:
            raise ConfigurationError(f'{prefix}axis', self.axis, f'must be below {size}, '
                                     f'{prefix}inertia is of as many axes')


class CoupledEso(Law):
    """Steps 1–4."""

    name = 'coupled_eso'
    summary = 'computed torque for all axes at once, with the observer of robust_eso in each'
    Gains: ClassVar[type] = CoupledEsoGains
    coupled = True
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 1.0, 40.0), Tunable('kappa', 20.0, 150.0),
        Tunable('observer_rate', 10.0, 150.0), Tunable('start_rate', 0.3, 10.0),
        Tunable('k_star', 1.5, 8.0), Tunable('gamma', 0.02, 20.0))

    def __init__(self, gains: Any = None, order: int = 2, regressor_count: int = 2,
                 period: float = 0.005) -> None:
        super().__init__(gains, order, regressor_count, period)
        g, r = self.gains, regressor_count
        self._theta_0 = per_regressor(g.theta_0, r, 'theta_0')
        low = per_regressor(g.theta_min, r, 'theta_min')
        high = per_regressor(g.theta_max, r, 'theta_max')
        for i, (value, least, most) in enumerate(zip(self._theta_0, low, high, strict=True), 1):
            if not least <= value <= most:
                raise ConfigurationError('controller.theta_0', list(self._theta_0),
                                         f'θ̂_{i}(0) must lie in its projection bounds '
                                         f'[{least:g}, {most:g}]')
        self._box = (*low, *high)

    @property
    def inertia(self) -> np.ndarray:
        """M̂ with the own axis first, then the others in the order of loop.axes."""
        size = math.isqrt(len(self.gains.inertia))
        own = min(self.gains.axis, size - 1)
        order = [own, *(i for i in range(size) if i != own)]
        return np.reshape(self.gains.inertia, (size, size))[np.ix_(order, order)]

    @property
    def constants(self) -> tuple[float, ...]:
        """Gains in the order of the places above, Λ, Λ_v, η^(n), matrix of η, box, M̂."""
        g, n, inertia = self.gains, self.order, self.inertia
        return (g.k_d, g.kappa, g.k_star, g.gamma, g.observer_rate, float(g.design_delay),
                g.rho_0, g.rho_1, g.v_max, float(g.start_rate > 0.0), self.period,
                *error_weights(g.lambda_, n), *feed_forward_weights(g.lambda_, n),
                *start_row(g.start_rate, n), *start_matrix(g.start_rate, n, self.period),
                *self._box, *inertia[0].tolist(), *np.linalg.inv(inertia).ravel().tolist())

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """θ̂ as used in v; σ̂, w, η … after the step; the memory before."""
        used = tuple(replace(theta(i + 1), unit=f'v/W{i + 1}', meaning=f'weight {i + 1} over b m')
                     for i in range(self.regressor_count))
        shift = tuple(Signal(f'eta{i}', f'x^({i})' if i else 'x', 'shift of the reference',
                             symbol='η' + "'" * i) for i in range(self.order))
        last = tuple(Signal(f'y_last{i + 1}', f'W{i + 1}', f'Y_{i + 1} of the sample before')
                     for i in range(self.regressor_count))
        return (*used, *_STEP, *shift, *before((*used, *_MEMORY, *shift, *last)))

    @cached_property
    def design(self) -> Design:
        """What the design rules need of the own axis, the others at rest."""
        g = self.gains
        own = float(self.inertia[0, 0])
        epsilon = g.k_star / (g.kappa * own)
        lead = feed_forward_weights(g.lambda_, self.order)[-1] * own
        return Design(g.lambda_, g.k_d * own, g.k_star, epsilon, (g.k_d + g.kappa) * own, lead,
                      reserve=g.rho_0, inner_reserve=g.rho_1)

    def layer_model(self, gain: float | None = None) -> LayerModel:
        """Return the model of the own axis with its observer, the others held at rest."""
        g, found, at = self.gains, self.design, self.regressor_count
        gain = found.gain if gain is None else gain
        own = float(self.inertia[0, 0])
        weights = np.asarray(error_weights(g.lambda_, self.order))
        z, period, unit = math.exp(-g.observer_rate * self.period), self.period, np.eye(6)
        rates = (1.0 - z ** 3, 1.5 * (1.0 - z) ** 2 * (1.0 + z) / period,
                 (1.0 - z) ** 3 / period ** 2)
        # Rows: ŝ, σ̂, σ̂', q⁻, q⁻⁻, q⁻⁻⁻ predicted, then corrected, as shares of memory and x̃.
        ahead = (unit[0] + period * (unit[3 + g.design_delay] / own + unit[1])
                 + 0.5 * period ** 2 * unit[2])
        memory = [row - rate * ahead for row, rate in zip(
            (ahead, unit[1] + period * unit[2], unit[2]), rates, strict=True)]
        error = [rate * weights for rate in rates]
        bare = surface_model(self.order, found.lambda_, gain, found.lead)
        return LayerModel(
            tuple(at + place for place in (_S_HAT, _SIGMA, _SLOPE, _Q1, _Q2, _Q3)),
            np.array([*memory, -own * memory[1], unit[3], unit[4]]),
            np.array([*error, -gain * weights - own * error[1], *np.zeros((2, self.order))]),
            -own * memory[1], bare.d - own * error[1])

    def check_axes(self, laws: Mapping[str, Law]) -> None:
        """Check that the axes agree on what each of them computes of the others.

        Raises:
            ConfigurationError: They do not, or M̂ is of another number of axes.
        """
        if len(self.inertia) != len(laws):
            raise ConfigurationError('controller.inertia', list(self.gains.inertia), 'must have '
                                     f'{len(laws) ** 2} numbers, row by row, for {len(laws)} axes')
        for key in ('lambda', 'start_rate', 'observer_rate', 'design_delay', 'inertia'):
            name = 'lambda_' if key == 'lambda' else key
            for axis, law in laws.items():
                if getattr(law.gains, name) != getattr(self.gains, name):
                    raise ConfigurationError(
                        axis_key(axis, f'controller.{key}'), getattr(law.gains, name),
                        f'must be the same for all axes, not also {getattr(self.gains, name)!r}: '
                        'each axis computes the observers of the others')

    @property
    def epsilon(self) -> float:
        """Half-width of the layer of the own axis, k*/(κ M̂_ii) [unit of s]."""
        return self.design.epsilon

    def initial_memory(self) -> tuple[float, ...]:
        """θ̂(0), nothing before."""
        return (*self._theta_0, *(0.0,) * (_SHIFT + self.order + self.regressor_count))

    def take_over(self, memory: Sequence[float]) -> tuple[float, ...]:
        """Return the memory for a new start: θ̂ stays."""
        kept = self.regressor_count
        return (*memory[:kept], *self.initial_memory()[kept:])

    @staticmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,
               dt: float, new_memory: Any, terms: Any) -> float:
        """One sample of the own axis, in the order of the steps.

        y is the plant's structure for this axis, g_k, M_1k …, C_1k … for each weight k, own axis
        first, shape (r (1 + 2 axes),); or Y(x), shape (r,). Of another length, as where an axis is
        looked at with the others held, it is left out: the feed-forward is M̂ a then.
        """
        size = len(new_memory)
        axes = len(memory) // size
        n = len(x) // axes
        r = (size - _SHIFT - n) // 2
        row = _LAMBDA + 2 * n
        box = row + n + n * n
        inertia = box + 2 * r
        known = 1                               # axes that M̂ is of: known + known² numbers
        for i in range(2, len(c) - inertia):
            if i + i * i == len(c) - inertia:
                known = i
        inverse = inertia + known
        shift = r + _SHIFT
        y_at = shift + n
        width = 1 + 2 * axes
        structured = r > 0 and len(y) == r * width
        alone = len(y) == r
        for i in range(size):
            new_memory[i] = memory[i]
        for k in range(r):                      # Y of this sample grows in its place
            if structured:
                new_memory[y_at + k] = y[k * width]
            else:
                new_memory[y_at + k] = y[k] if alone else 0.0
        z = math.exp(-c[_RATE] * dt)
        delayed = r + _Q1
        if c[_DELAY] == 1.0:
            delayed = r + _Q2
        elif c[_DELAY] == 2.0:
            delayed = r + _Q3
        mass_s = 0.0
        mass_sigma = 0.0
        mass_a = 0.0
        own_s = 0.0
        own_a = 0.0
        for j in range(axes):
            at = j * size
            xs = j * n
            ds = xs + j
            s = 0.0
            a = x_d[ds + n]
            for i in range(n):
                moved = x_d[ds + i]
                eta = 0.0
                if memory[at + r + _STARTED] != 0.0:
                    eta = memory[at + shift + i]
                elif c[_SHAPED] != 0.0:
                    eta = x[xs + i] - moved
                error = x[xs + i] - (moved + eta)
                s += c[_LAMBDA + i] * error
                a += c[row + i] * eta - c[_LAMBDA + n + i] * error
            s_hat = s                                                                     # 2
            sigma = memory[at + r + _SIGMA]
            slope = memory[at + r + _SLOPE]
            if memory[at + r + _STARTED] != 0.0:
                acts = 0.0
                for other in range(axes):
                    share = c[inverse + j * known + other]
                    if axes == 1:       # the others held
                        share = 1.0 / c[inertia]
                    acts += share * memory[other * size + delayed]
                s_hat = (memory[at + r + _S_HAT] + c[_T] * (acts + sigma)
                         + 0.5 * c[_T] * c[_T] * slope)
                sigma += c[_T] * slope
            if dt > 0.0:
                rest = s - s_hat
                s_hat += (1.0 - z * z * z) * rest
                sigma += 1.5 * (1.0 - z) * (1.0 - z) * (1.0 + z) / dt * rest
                slope += (1.0 - z) * (1.0 - z) * (1.0 - z) / (dt * dt) * rest
                if j == 0:
                    new_memory[r + _S_HAT] = s_hat
                    new_memory[r + _SIGMA] = sigma
                    new_memory[r + _SLOPE] = slope
            if j == 0:
                own_s = s
                own_a = a
            mass_s += c[inertia + j] * s
            mass_sigma += c[inertia + j] * sigma
            mass_a += c[inertia + j] * a
            if structured:
                speed = x[xs + n - 1] - s
                for k in range(r):
                    place = k * width + 1 + j
                    new_memory[y_at + k] += y[place] * a + y[place + axes] * speed
        layer = c[_K_STAR] / (c[_KAPPA] * c[inertia])
        s_a = outside_layer(own_s, OUTER * layer)
        status = 0.0
        if dt > 0.0 and memory[r + _STARTED] != 0.0:                                      # 1
            if pushes_against(memory[r + _V], c[_V_MAX], own_s):
                status = _SATURATED
            else:
                power = 0.0
                for k in range(r):
                    power += memory[y_at + k] * memory[y_at + k]
                step = dt * c[_GAMMA] * s_a / (
                    1.0 + dt * c[_GAMMA] * power / (c[_K_D] * c[inertia]))
                for k in range(r):
                    new_memory[k] = clip(new_memory[k] - step * memory[y_at + k], c[box + k],
                                         c[box + r + k])
        v_regressor = 0.0                                                                 # 3
        for k in range(r):
            v_regressor += new_memory[y_at + k] * new_memory[k]
        v_feed_forward = 0.0 if structured else mass_a
        v_damping = -c[_K_D] * c[inertia] * own_s
        v_robust = -clip(c[_KAPPA] * mass_s, -c[_K_STAR], c[_K_STAR])
        w = admitted(clip(mass_sigma, -c[_RHO_1], c[_RHO_1]), own_s, layer, OUTER * layer,
                     c[_RHO_0], c[_RHO_1])
        v_b = v_damping + v_feed_forward + v_regressor + v_robust
        v = v_b - w
        if c[_V_MAX] > 0.0:
            v = clip(v, -c[_V_MAX], c[_V_MAX])
        terms[S] = own_s
        terms[S_EPS] = s_a
        terms[U_FD] = own_a
        terms[V_DAMPING] = v_damping
        terms[V_FEED_FORWARD] = v_feed_forward
        terms[V_REGRESSOR] = v_regressor
        terms[V_ROBUST] = v_robust
        terms[V_EXTRA] = v - v_b
        terms[STATUS] = status
        own = STATUS + 1 + r
        for k in range(r):
            terms[STATUS + 1 + k] = new_memory[k]
        terms[own + _STEP_SIGMA] = new_memory[r + _SIGMA]
        terms[own + _STEP_INNER] = w
        started = memory[r + _STARTED] != 0.0
        for i in range(n):                                                                # 4
            moved = 0.0
            for place in range(n):
                eta = 0.0
                if started:
                    eta = memory[shift + place]
                elif c[_SHAPED] != 0.0:
                    eta = x[place] - x_d[place]
                moved += c[row + n + i * n + place] * eta
            if dt > 0.0:
                new_memory[shift + i] = moved
            terms[own + _STEP_SHIFT + i] = new_memory[shift + i]
        if dt > 0.0:
            new_memory[r + _Q3] = memory[r + _Q2]
            new_memory[r + _Q2] = memory[r + _Q1]
            new_memory[r + _Q1] = v - (v_regressor + v_feed_forward)
            new_memory[r + _V] = v
            new_memory[r + _STARTED] = 1.0
        else:
            for k in range(r):
                new_memory[y_at + k] = memory[y_at + k]
        for i in range(size):
            terms[own + _STEP_SHIFT + n + i] = memory[i]
        return v

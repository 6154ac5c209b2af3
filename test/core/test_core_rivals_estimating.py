# SPDX-License-Identifier: Apache-2.0
"""The rivals that estimate what a nominal model leaves, against programs of their equations.

Each program is written from the differential equations of the source, sampled as
docs/mathematics.md §8 states: what is held over a sample is integrated by a matrix exponential,
gains of observers follow from their poles by Ackermann's formula. Nothing is taken from the laws
but their gains.
"""

import functools
import math

import numpy as np
import pytest
from scipy.linalg import expm

from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.core.laws import LAWS
from dz_ros.core.loop.offline import simulate
from dz_ros.core.signals import STATUS

PERIOD = 0.005


def held(a, b, dt):
    """Return Φ, Γ of z' = A z + B u with u held for dt."""
    a, b = np.atleast_2d(a), np.atleast_2d(b)
    n, m = b.shape
    both = exponential(tuple(map(tuple, np.block([[a, b], [np.zeros((m, n + m))]]))), dt)
    return both[:n, :n], both[:n, n:]


@functools.lru_cache
def exponential(rows, dt):
    return expm(dt * np.array(rows))


@functools.lru_cache
def chain(size, rate, dt):
    """Return Φ, Γ of integrators in a chain and the gain L with all poles at e^(−ω T).

    ẑ += L (e − ẑ_1) before and z = Φ z + Γ u after, so that Φ L has Φ's poles to move.
    """
    first = np.eye(1, size)
    phi, gamma = held(np.eye(size, k=1), first.T, dt)
    rows = np.vstack([first @ np.linalg.matrix_power(phi, i) for i in range(size)])
    wanted = np.linalg.matrix_power(phi - math.exp(-rate * dt) * np.eye(size), size)
    gain = np.linalg.solve(phi, wanted @ np.linalg.solve(rows, np.eye(size)[:, -1]))
    return phi, gamma[:, 0], gain


class Nominal:
    """v = ff − k_d s − σ̂ on s' = b̂ (v − ff + σ); s = (p + λ)^(n−1) x̃."""

    def __init__(self, g, n, r):
        self.g = g
        self.surface = np.poly([-g.lambda_] * (n - 1))[::-1] if n > 1 else np.ones(1)
        self.theta = np.array(g.theta_0 if len(g.theta_0) == r else r * g.theta_0)
        self.b = 1.0 / g.phi_0
        self.begun = False

    def __call__(self, x_d, x, y, dt):
        error = x - x_d[:-1]
        s = self.surface @ error
        ff = self.g.phi_0 * (x_d[-1] - self.surface[:-1] @ error[1:]) + y @ self.theta
        if not self.begun:
            self.start(s)
            self.begun = True
        wanted = ff - self.g.k_d * s - self.estimate(s, dt)
        limit = self.g.v_clip or math.inf
        v = min(max(wanted, -limit), limit)
        self.advance(s, v - ff, v != wanted, dt)
        return v


class Chen(Nominal):
    """[chen2000]: d̂ = z + p, z' = −l g₂ z − l (g₂ p + f + g₁ u), l = ∂p/∂x.

    Here x = s, g₂ = b̂, f + g₁ u = b̂ (v − ff), p = g s/b̂.
    """

    def start(self, s):
        self.z = -self.g.observer_rate / self.b * s     # d̂ = 0

    def estimate(self, s, dt):
        return self.z + self.g.observer_rate / self.b * s

    def advance(self, s, rest, clipped, dt):
        slope = self.g.observer_rate / self.b
        phi, gamma = held(-slope * self.b, [[-slope, -slope]], dt)
        known = np.array([self.b * slope * s, self.b * rest])       # g₂ p, f + g₁ u
        self.z = (phi * self.z + gamma @ known).item()


class Xargay(Nominal):
    """[hovakimyan_cao2010], piecewise constant: σ̂ = −Φ⁻¹ e^(A T) x̃, Φ = A⁻¹ (e^(A T) − I).

    x̃ of a predictor x̂' = f + g (u + σ̂) + A (x̂ − x), A = −a; u less C(s) σ̂, C = ω/(p + ω).
    """

    def start(self, s):
        self.predicted, self.filtered = s, 0.0

    def estimate(self, s, dt):
        a = np.array([[-self.g.predictor_rate]])
        flow = exponential(((-self.g.predictor_rate,),), dt)
        inverse = np.linalg.inv(np.linalg.inv(a) @ (flow - np.eye(1)))
        self.sigma = (-inverse @ flow).item() * (self.predicted - s) / self.b
        phi, gamma = held(-self.g.filter_rate, self.g.filter_rate, dt)
        self.filtered = (phi * self.filtered + gamma * self.sigma).item()
        return self.filtered

    def advance(self, s, rest, clipped, dt):
        rate = self.g.predictor_rate
        phi, gamma = held(-rate, [[rate, self.b]], dt)
        self.predicted = (phi * self.predicted + gamma @ [s, rest + self.sigma]).item()


class Shtessel(Nominal):
    """[shtessel2012], u = −α |σ|^½ sgn σ + w, w' = −(β/2) sgn σ, β = 2 ε α, α' = ±ω_1 by |σ| − μ.

    Inside the layer the root is a chord and sgn a slope; w grows only while v is not clipped.
    """

    def start(self, s):
        self.alpha, self.w = self.g.alpha_0, 0.0

    def estimate(self, s, dt):
        depth = min(abs(s) / self.g.epsilon, 1.0)
        root = math.copysign(math.sqrt(abs(s)), s)
        if depth < 1.0:
            root = depth * math.copysign(math.sqrt(self.g.epsilon), s)
        self.sign = math.copysign(depth, s)
        return self.alpha * root - self.w

    def advance(self, s, rest, clipped, dt):
        after = self.w - dt * 0.5 * (2.0 * self.g.kappa * self.alpha) * self.sign
        if not clipped or abs(after) < abs(self.w) or after * self.w < 0.0:
            self.w = after
        grows = 1.0 if abs(s) > self.g.mu else -1.0
        self.alpha = max(self.alpha + dt * grows * self.g.alpha_rate, self.g.alpha_0)


class Gao:
    """[gao2003]: (p + λ)^n for the loop, an extended state observer with all poles at −ω_o.

    z = (e, f, …), e' = f + b̂ v − x_d^(n), the last of them constant.
    """

    def __init__(self, g, n, r):
        self.g, self.last, self.z = g, 0.0, None
        self.loop = np.poly([-g.lambda_] * n)[:0:-1]

    def __call__(self, x_d, x, y, dt):
        g, error = self.g, x - x_d[:-1]
        phi, gamma, gain = chain(1 + g.extended_states, g.observer_rate, dt)
        if self.z is None:
            self.z = np.eye(1, len(phi))[0] * error[-1]
        z = self.z + gain * (error[-1] - self.z[0])
        v = (x_d[-1] - self.loop @ error - z[1]) / g.input_gain
        limit = g.v_clip or math.inf
        v = min(max(v, -limit), limit)
        acts = self.last if g.design_delay else v
        self.z = phi @ z + gamma * (g.input_gain * acts - x_d[-1])
        self.last = v
        return v


LADRC = [('ladrc', {'extended_states': states, 'design_delay': delay})
         for states in (1, 2) for delay in (0, 1)]
CASES = [*LADRC, ('disturbance_observer', {}), ('super_twisting', {}), ('l1', {})]
PROGRAMS = {'ladrc': Gao, 'disturbance_observer': Chen, 'super_twisting': Shtessel,
            'l1': Xargay}
LIMITS = {'free': 0.0, 'clipped': 1.2}


def compare(law, program, samples):
    """Compare v of both over (x_d, x, Y, dt) each; return the commands."""
    memory, found = list(law.initial_memory()), []
    for k, (x_d, x, y, dt) in enumerate(samples):
        after = [math.nan] * len(memory)
        terms = [0.0] * STATUS + [math.nan] * (1 + len(law.signal_names))
        v = law.kernel(law.constants, memory, list(x_d), list(x), list(y), dt, after, terms)
        memory = after
        expected = program(x_d, x, y, dt)
        assert v == pytest.approx(expected, rel=1e-9, abs=1e-9), f'sample {k}'
        found.append(v)
    return np.array(found)


@pytest.mark.parametrize('limit', LIMITS)
@pytest.mark.parametrize(('name', 'values'), CASES)
@pytest.mark.parametrize(('order', 'count'), [(1, 1), (2, 2), (3, 0), (4, 3)])
def test_is_the_program_of_its_equations(name, values, order, count, limit):
    """Errors prescribed, intervals of several lengths."""
    chosen = LAWS.load(name)
    gains = {'lambda': 1.7, 'v_clip': LIMITS[limit], **values}
    law = chosen(schema.build(chosen.Gains, gains, ''), order, count, PERIOD)
    intervals = np.random.default_rng(order).uniform(0.5 * PERIOD, 2.0 * PERIOD, 7)
    i, samples = np.arange(order + 1), []
    for k in range(500):
        t, dt = k * PERIOD, float(intervals[k % 7])
        x_d = np.sin(1.3 * t + 0.5 * np.pi * i) * 1.3 ** i
        x = x_d[:-1] + 0.05 * np.sin((9.0 if k % 400 < 200 else 2.0) * t + i[:-1])
        samples.append((x_d, x, np.sin(np.arange(1, count + 1) * t), dt))
    v = compare(law, PROGRAMS[name](law.gains, order, count), samples)
    assert bool(LIMITS[limit]) == (np.abs(v).max() == LIMITS[limit])


PLANTS = {
    1: {'plant.model': 'first_order', 'plant.x0': [0.2], 'trajectory.amplitude': 0.2,
        'controller.k_d': 200.0, 'controller.theta_0': [11.6, 120.0], 'controller.phi_0': 17.0,
        'controller.input_gain': 0.05, 'controller.b_bounds': [0.045, 0.055]},
    2: {},
    3: {'plant.model': 'valve_actuator', 'plant.x0': [0.02, 0.0, 0.0],
        'trajectory.amplitude': 0.05, 'controller.k_d': 2.0, 'controller.phi_0': 0.106,
        'controller.theta_0': [21.0, 43.0, 0.9], 'controller.input_gain': 8.0,
        'controller.b_bounds': [7.2, 8.8]}}
"""Order → the example, or what is changed of it."""
CLIPS = {1: 20.0, 2: 8.0, 3: 1.5}
"""A limit of v that each of them reaches."""


@pytest.mark.parametrize('delay', [0, 1])
@pytest.mark.parametrize('order', PLANTS)
@pytest.mark.parametrize('limit', LIMITS)
@pytest.mark.parametrize(('name', 'values'), CASES)
def test_is_the_program_of_its_equations_in_the_loop(name, values, order, limit, delay):
    """The loop of the package runs the law; the program is given what the law was given."""
    clip = CLIPS[order] if LIMITS[limit] else 0.0
    own = {f'controller.{item.name}' for item in schema.fields(LAWS.load(name).Gains)}
    shared = {'controller.b_bounds'}
    changes = {key: value for key, value in PLANTS[order].items()
               if not key.startswith('controller.') or key in own | shared}
    c = Configuration.from_flat({
        **changes, 'controller.law': name, 'controller.v_clip': clip, 'loop.delay': delay,
        'loop.duration': 2.5, **{f'controller.{key}': value for key, value in values.items()}})
    run = simulate(c)
    regressors = np.empty((len(run.t), c.plant.regressor_count))
    for x, y in zip(run.x_measured, regressors, strict=True):
        c.plant.regressors(x, c.plant.constants, y)
    program = PROGRAMS[name](c.law.gains, order, c.plant.regressor_count)
    expected = [program(*row, c.loop.period)
                for row in zip(run.x_d, run.x_measured, regressors, strict=True)]
    scale = np.abs(run.v).max()
    assert np.isfinite(scale)
    assert run.v == pytest.approx(expected, rel=1e-9, abs=1e-9 * scale)
    assert (scale == clip) if clip else (scale > CLIPS[order])


def example(t, x, w):
    """(19) of [wang2004], x' of (x, x')."""
    position, velocity = x
    return np.array([velocity, math.tanh(0.5 * position)
                     - (position ** 2 + 2.0 * position) * math.sin(position)
                     - 0.5 * position * math.sin(3.0 * t) + w])


@pytest.mark.parametrize('delay', [0, 1])
@pytest.mark.parametrize(('name', 'values'), CASES)
def test_in_a_loop_of_its_own_the_program_reaches_what_the_law_does(name, values, delay):
    """Plant, dead-zone, delay line and law of the example, none of it from the package."""
    c = Configuration.from_flat({
        'controller.law': name, 'loop.delay': delay, 'loop.duration': 8.0,
        **{f'controller.{key}': value for key, value in values.items()}})
    run = simulate(c)
    program, line = PROGRAMS[name](c.law.gains, 2, 2), [0.0] * delay
    x, h = np.array([-2.5, 3.5]), PERIOD / 4.0
    for k, expected in enumerate(run.x):
        assert expected == pytest.approx(x, rel=1e-7, abs=1e-7), f'sample {k}'
        t = k * PERIOD
        x_d = 2.5 * np.array([math.sin(t), math.cos(t), -math.sin(t)])
        y = np.array([-math.tanh(0.5 * x[0]), (x[0] ** 2 + 2.0 * x[0]) * math.sin(x[0])])
        line.append(program(x_d, x, y, PERIOD))
        v = line.pop(0)
        w = max(v - 0.5, 0.0) + min(v + 0.6, 0.0)
        for i in range(4):
            at = t + i * h
            k1 = example(at, x, w)
            k2 = example(at + 0.5 * h, x + 0.5 * h * k1, w)
            k3 = example(at + 0.5 * h, x + 0.5 * h * k2, w)
            k4 = example(at + h, x + h * k3, w)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)

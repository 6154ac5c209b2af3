# SPDX-License-Identifier: Apache-2.0
"""`robust_eso` against its equations written a second time, in numpy and without the package.

Nothing here is taken from the law: filtered error, shaped start by a matrix exponential, guard,
observer, identifier, slot and outer gain follow docs/mathematics.md §10 and §11.
"""

from collections import deque
from math import comb, exp, sqrt

import numpy as np
import pytest
from scipy.linalg import expm

from dz_ros.core.laws.robust_eso import RobustEso
from dz_ros.core.loop.compiled import available, compiled
from dz_ros.core.signals import STATUS

T = 0.005
STEPS = 400


class Equations:
    """The law for one plant structure, a sample at a time.

    Args:
        g: Gains by name, all that the equations have.
        n: Order.
        r: Number of regressors.
    """

    def __init__(self, g, n, r):
        self.g, self.n, self.r = g, n, r
        self.binomial = np.array([comb(n - 1, i) * g['lambda'] ** (n - 1 - i) for i in range(n)])
        self.theta = np.full(r, g['theta_0'])
        self.phi = g['phi_0']
        self.kappa, self.side, self.count, self.since = 1.0, 0, 0, 0.0
        self.s_hat = self.sigma = self.rate = self.v_i = 0.0
        self.q = deque([0.0] * g['design_delay'])
        self.eta = None
        self.last = None
        self.first_peak = 0.0
        # eta^(n) from (d/dt + a)^n eta = 0, as a companion matrix.
        a = g['start_rate']
        companion = np.eye(n, k=1)
        companion[-1] = [-comb(n, i) * a ** (n - i) for i in range(n)]
        self.companion, self.flow = companion, expm(companion * T)

    def project(self):
        g = self.g
        self.theta = np.clip(self.theta, g['theta_min'], g['theta_max'])
        self.phi = min(max(self.phi, g['phi_min']), g['phi_max'])

    def guard(self, s, epsilon):
        side = 1 if s >= epsilon else -1 if s <= -epsilon else 0
        self.since += 1
        if self.since > round(0.25 / T):
            self.count = 0
        if side:
            if self.side and side != self.side and self.since <= round(0.25 / T):
                self.count += 1
            self.side, self.since = side, 0
        if self.count >= 3:
            self.kappa *= 0.7
            self.count = self.side = 0

    def step(self, x_d, x, y):
        """Return v, and θ̂, φ̂ as used in it."""
        g, n = self.g, self.n
        error = x - x_d[:n]
        first = self.eta is None
        if first:
            self.eta = error.copy() if g['start_rate'] > 0.0 else np.zeros(n)
        eta = np.append(self.eta, self.companion[-1] @ self.eta)
        error = error - eta[:n]
        s = self.binomial @ error
        u = x_d[n] + eta[n] - self.binomial[:-1] @ error[1:]
        gain = max(self.kappa * g['layer_gain'], 1.5 * g['k_d'])
        epsilon = g['k_star'] / (gain - g['k_d'])
        outer = 1.5 * epsilon
        s_a = s - outer * np.clip(s / outer, -1.0, 1.0)
        inside = abs(s) <= epsilon
        v_max = g['v_max']
        at_limit = v_max > 0.0 and not first and abs(self.last[2]) >= v_max * (1.0 - 1e-12)
        if not first and not (at_limit and self.last[2] * s < 0.0):
            y_1, u_1, _ = self.last
            size = 1.0 + T * (g['gamma'] * y_1 @ y_1 + g['eta'] * u_1 ** 2) / g['k_d']
            self.theta = self.theta - T * g['gamma'] * y_1 * s_a / size
            self.phi -= T * g['eta'] * u_1 * s_a / size
            self.project()
        self.guard(s, epsilon)
        if first:
            self.s_hat = s
        z = exp(-g['observer_rate'] * sqrt(self.kappa) * T)
        b = g['input_gain']
        rest = s - self.s_hat
        self.s_hat += (1 - z ** 3) * rest
        self.sigma += 1.5 * (1 - z) ** 2 * (1 + z) / (T * b) * rest
        self.rate += (1 - z) ** 3 / (T ** 2 * b) * rest
        if g['identifier'] and inside and not first and not at_limit:
            excess = self.sigma - np.clip(self.sigma, -g['identifier_band'],
                                          g['identifier_band'])
            if excess != 0.0:
                y_1, u_1, _ = self.last
                share = T * excess / (1.0 + y_1 @ y_1 + u_1 ** 2)
                before, phi = self.theta, self.phi
                self.theta = self.theta - share * y_1
                self.phi -= share * u_1
                self.project()
                self.sigma += y_1 @ (self.theta - before) + u_1 * (self.phi - phi)
        self.sigma = float(np.clip(self.sigma, -g['rho_1'], g['rho_1']))
        w = self.sigma
        if abs(s) > epsilon and w * s < 0.0:
            depth = min(max((abs(s) - epsilon) / (outer - epsilon), 0.0), 1.0)
            most = g['rho_1'] + (g['rho_0'] - g['rho_1']) * depth
            w = min(max(w, -most), most)
        ff = self.phi * u + y @ self.theta
        v_b = ff - g['k_d'] * s - g['k_star'] * np.clip(s / epsilon, -1.0, 1.0) - w
        if first:
            self.first_peak = max(abs(v_b), g['v_floor'])
        bound = max(abs(v_b), self.first_peak)
        v = float(np.clip(v_b - g['k_2'] * s_a, -bound, bound))
        if v_max > 0.0:
            v = min(max(v, -v_max), v_max)
        used = (v, self.theta.copy(), self.phi)
        self.q.append(v - ff)
        acts = self.q.popleft()
        self.s_hat += T * b * (acts + self.sigma) + 0.5 * T ** 2 * b * self.rate
        self.sigma += T * self.rate
        self.eta = self.flow @ self.eta
        self.last = (y, u, v)
        return used


def random_gains(random, delay, r):
    """Return gains with which the loop of the test is stable, by name.

    Else differences of rounding would grow without bound.
    """
    layer = random.uniform(20.0, (70.0, 50.0, 30.0)[delay])
    k_star = random.uniform(2.0, 6.0)
    return {'lambda': layer / random.uniform(6.0, 10.0), 'k_d': layer / random.uniform(5.0, 9.0),
            'gamma': random.uniform(0.1, 3.0), 'eta': random.uniform(0.1, 3.0), 'theta_0': 0.85,
            'phi_0': random.uniform(0.7, 1.2), 'k_star': k_star, 'layer_gain': layer,
            'start_rate': random.choice([0.0, 1.0, random.uniform(0.5, 3.0)]),
            'observer_rate': layer * random.uniform(0.5, 1.0),
            'input_gain': random.uniform(0.7, 1.5), 'design_delay': delay,
            'identifier': bool(random.integers(2)), 'identifier_band': 0.25 * k_star,
            'rho_0': 0.3 * k_star, 'rho_1': 10.0 * k_star, 'k_2': random.uniform(0.3, 0.7) * layer,
            'v_floor': random.choice([0.0, 16.7]), 'v_max': random.choice([0.0, 8.0]),
            'theta_min': 0.1, 'theta_max': 3.0, 'phi_min': 0.3, 'phi_max': 2.5}


def made(gains, n, r):
    """Return the law of the package with these gains."""
    names = {'lambda': 'lambda_'}
    lists = ('theta_0', 'theta_min', 'theta_max')
    return RobustEso(RobustEso.Gains(**{
        names.get(key, key): (value,) if key in lists else value for key, value in gains.items()}),
        n, r, T)


def compare(n, r, delay, closed):
    """Compare law and equations over STEPS samples; return the last κ_f of the equations.

    Args:
        n: Order.
        r: Number of regressors.
        delay: Design delay, also that of the loop [samples].
        closed: Whether v moves the state; else the state jumps about the reference at random.
    """
    random = np.random.default_rng([n, r, delay])
    gains = random_gains(random, delay, r)
    law, equations = made(gains, n, r), Equations(gains, n, r)
    kernel = compiled(law.kernel) if available() else law.kernel
    constants = np.array(law.constants, dtype=float)
    memory = np.array(law.initial_memory(), dtype=float)
    after, terms = np.zeros(len(memory)), np.zeros(STATUS + 1 + len(law.signal_names))
    # A plant of the test's own: a chain of integrators behind a dead-zone, Euler, delayed.
    x = random.uniform(-1.5, 1.5, n)
    a, b, line = random.uniform(-1.0, 1.0, r), random.uniform(0.6, 1.6), deque([0.0] * delay)
    for k in range(STEPS):
        t = k * T
        x_d = np.array([np.sin(1.5 * t + 0.5 * np.pi * i) * 1.5 ** i for i in range(n + 1)])
        if not closed:
            x = x_d[:n] + random.normal(0.0, 0.1, n)
        y = np.array([np.sin(x[0]), x[-1] * abs(x[0]), np.cos(2.0 * x[-1])])[:r]
        v = kernel(constants, memory, x_d, x, y, T, after, terms)
        expected, theta, phi = equations.step(x_d, x, y)
        assert v == pytest.approx(expected, rel=1e-7, abs=1e-7), f'sample {k}'
        # θ̂, φ̂ are the first signals that the law publishes.
        assert terms[STATUS + 1:STATUS + 2 + r] == pytest.approx([*theta, phi], rel=1e-9, abs=1e-9)
        memory, after = after, memory
        line.append(expected)
        acts = line.popleft()
        if closed:
            push = max(acts - 0.5, 0.0) + min(acts + 0.6, 0.0) + 2.0 * np.sin(3.0 * t)
            x = x + T * np.append(x[1:], a @ y + b * push)
    assert np.isfinite(x).all()
    return equations.kappa


@pytest.mark.parametrize('delay', [0, 1, 2])
@pytest.mark.parametrize('r', [0, 1, 2, 3])
@pytest.mark.parametrize('n', [1, 2, 3])
def test_the_compiled_kernel_is_the_equations(n, r, delay):
    compare(n, r, delay, closed=True)


@pytest.mark.parametrize('n', [1, 2, 3])
def test_the_guard_is_the_equations(n):
    assert compare(n, 2, 1, closed=False) < 1.0

# SPDX-License-Identifier: Apache-2.0
"""The law `robust_eso`: reference run, a program of its own, rules, shaped start.

Over 300 lines: the law is written down a second time here, to compare with.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.core.laws.robust_eso import RobustEso, RobustEsoGains
from dz_ros.core.laws.robust_eso_gains import gains_by_rule
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import Status
from dz_ros.core.signals import STATUS
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import flat_parameters

DATA = Path(__file__).parents[1] / 'data'
PERIOD = 0.005


def make(order=2, count=2, period=PERIOD, **values):
    return RobustEso(schema.build(RobustEsoGains, values, 'controller.'), order, count, period)


def run(**values):
    return simulate(Configuration.from_flat({
        'controller.law': 'robust_eso', **{key.replace('__', '.'): value
                                           for key, value in values.items()}}))


def test_is_the_reference_run():
    """Every sample of the reference file, computed by another program."""
    expected = np.loadtxt(DATA / 'robust2_lambda10_rk4.csv', delimiter=',', skiprows=1)
    found = run(plant__substeps=1)
    assert len(found.t) == len(expected) == 4001
    assert np.abs(found.t - expected[:, 1]).max() < 1e-9
    assert np.abs(found.x - expected[:, 2:4]).max() < 1e-9
    assert np.abs(found.v - expected[:, 6]).max() < 1e-7
    for name, column in (('theta1', 8), ('theta2', 9), ('phi', 10), ('sigma', 11), ('eta0', 12),
                         ('eta1', 13), ('kappa_f', 14), ('s', 15)):
        assert np.abs(found.column(name) - expected[:, column]).max() < 1e-9, name


class Program:
    """The law written down again, from its description, with an object's own state."""

    def __init__(self, g, order, count, period):
        self.g, self.n, self.period = g, order, period
        self.weights = np.poly([-g.lambda_] * (order - 1))[::-1] if order > 1 else np.ones(1)
        self.rates = np.concatenate(([0.0], self.weights[:-1]))
        self.estimates = np.append(np.full(count, g.theta_0[0]), g.phi_0)
        self.low = np.append(np.full(count, g.theta_min[0]), g.phi_min)
        self.high = np.append(np.full(count, g.theta_max[0]), g.phi_max)
        self.speeds = np.append(np.full(count, g.gamma), g.eta)
        self.kappa, self.before, self.v_before = 1.0, None, 0.0
        self.s_hat = self.sigma = self.slope = self.integral = 0.0
        self.commands = [0.0, 0.0]
        self.z = np.zeros(order)
        self.time, self.waves = 0.0, np.zeros((g.learning_harmonics, 2))
        self.side = self.since = self.count = 0
        self.guard_steps = self.frozen = self.identified = self.learned = 0

    def saturated(self, v):
        return self.g.v_max > 0.0 and abs(v) >= self.g.v_max

    def shift(self):
        """η, …, η^(n) from z_j = (d/dt + a)^j η."""
        a, z = self.g.start_rate, np.append(self.z, 0.0)
        return np.array([sum(math.comb(i, m) * (-a) ** (i - m) * z[m] for m in range(i + 1))
                         for i in range(self.n + 1)])

    def __call__(self, x_d, x, y, dt):
        g, a, period = self.g, self.g.start_rate, self.period
        first = self.before is None
        if first and a > 0.0:
            e = x - x_d[:-1]
            self.z = np.array([sum(math.comb(j, i) * a ** (j - i) * e[i] for i in range(j + 1))
                               for j in range(self.n)])
        x_r = x_d + self.shift()
        gain = max(self.kappa * g.layer_gain, 1.5 * g.k_d)
        eps = g.k_star / (gain - g.k_d)
        error = x - x_r[:-1]
        s = self.weights @ error
        now = np.append(y, x_r[-1] - self.rates @ error)
        s_a = s - np.clip(s, -1.5 * eps, 1.5 * eps)
        inside, held = abs(s) <= eps, self.saturated(self.v_before)
        if not first:
            if held and self.v_before * s < 0.0:
                self.frozen += 1
            else:
                n = 1.0 + dt * (self.speeds @ self.before ** 2) / g.k_d
                self.estimates = np.clip(
                    self.estimates - dt * self.speeds * self.before * s_a / n, self.low, self.high)
        self.guard(int(np.sign(s)) if abs(s) >= eps else 0)
        if g.observer:
            if first:
                self.s_hat = s
            z = math.exp(-g.observer_rate * math.sqrt(self.kappa) * dt)
            rest = s - self.s_hat
            self.s_hat += (1 - z ** 3) * rest
            self.sigma += 1.5 * (1 - z) ** 2 * (1 + z) / (dt * g.input_gain) * rest
            self.slope += (1 - z) ** 3 / (dt ** 2 * g.input_gain) * rest
            band = g.identifier_band
            if g.identifier and inside and not first and not held:
                excess = self.sigma - np.clip(self.sigma, -band, band)
                step = dt * excess / (1.0 + self.before @ self.before)
                moved = np.clip(self.estimates - step * self.before, self.low, self.high)
                self.sigma += self.before @ (moved - self.estimates)
                self.identified += (moved != self.estimates).any()
                self.estimates = moved
            self.sigma = np.clip(self.sigma, -g.rho_1, g.rho_1)
        w, periodic = self.sigma if g.observer else self.integral, 0.0
        if g.learning_harmonics:
            h = np.arange(1, g.learning_harmonics + 1) * g.learning_frequency
            wave = np.stack((np.cos(h * self.time), np.sin(h * self.time)), axis=1)
            periodic = (self.waves * wave).sum()
            w = np.clip(w + periodic, -g.rho_1, g.rho_1)
            if inside and not held:
                late = h * (self.time - 2.2 / g.observer_rate)
                self.waves = self.waves + dt * g.learning_rate * self.sigma * np.stack(
                    (np.cos(late), np.sin(late)), axis=1)
                self.learned += 1
            self.time += period
        if abs(s) > eps and w * s < 0.0:
            limit = g.rho_1 + (g.rho_0 - g.rho_1) * np.clip((abs(s) - eps) / (0.5 * eps), 0, 1)
            w = np.clip(w, -limit, limit)
        ahead = now @ self.estimates
        v_b = ahead - g.k_d * s - g.k_star * np.clip(s / eps, -1.0, 1.0) - w
        if first:
            self.v_first = max(abs(v_b), g.v_floor)
        limit = max(abs(v_b), self.v_first)
        v = np.clip(v_b - g.k_2 * s_a, -limit, limit)
        if g.v_max > 0.0:
            v = np.clip(v, -g.v_max, g.v_max)
        if g.observer:
            self.commands.append(v - ahead + periodic)
            acts = self.commands[-1 - g.design_delay]
            self.s_hat += (period * g.input_gain * (acts + self.sigma)
                           + 0.5 * period ** 2 * g.input_gain * self.slope)
            self.sigma += period * self.slope
        elif inside and not self.saturated(v):
            self.integral = np.clip(self.integral + dt * gain ** 2 / g.integral_divisor * s,
                                    -g.rho_1, g.rho_1)
        self.z = math.exp(-a * period) * np.array([
            sum(period ** i / math.factorial(i) * self.z[j + i] for i in range(self.n - j))
            for j in range(self.n)])
        self.before, self.v_before = now, v
        return v

    def guard(self, side):
        self.since += 1
        if side == 0:
            return
        if self.since > 0.25 / self.period:
            self.count = 0
        elif side == -self.side:
            self.count += 1
        self.side, self.since = side, 0
        if self.count >= 3:
            self.kappa *= 0.7
            self.count = self.side = 0
            self.guard_steps += 1


def disturbed(order, count, samples, seed):
    """Return references, states that swing through the layer now slowly now fast, regressors."""
    generator = np.random.default_rng(seed)
    t = PERIOD * np.arange(samples)[:, None]
    i = np.arange(order + 1)
    x_d = 1.5 * np.sin(1.3 * t + 0.5 * np.pi * i) * 1.3 ** i
    size = 0.3 * (np.sin(2.0 * t) ** 2 + 0.01)
    shape = np.where(np.sin(1.1 * t) > 0.0, np.sin(120.0 * t + i[:-1]), np.sin(3.0 * t + i[:-1]))
    x = x_d[:, :-1] + size * shape
    y = 2.0 * np.sin(generator.uniform(0.5, 3.0, count) * t + np.arange(count))
    return x_d, x, y


@pytest.mark.parametrize('values', [
    {'lambda': 2.0}, {'lambda': 2.0, 'v_max': 3.0, 'design_delay': 2},
    {'lambda': 1.0, 'start_rate': 0.0, 'k_2': 0.0, 'identifier_band': 0.0},
    {'lambda': 2.0, 'observer': False, 'v_max': 4.0, 'v_floor': 1.0},
    {'lambda': 1.5, 'learning_harmonics': 3, 'learning_frequency': 2.0, 'design_delay': 0,
     'identifier': False},
    {'lambda': 1.0, 'v_max': 4.0, 'rho_0': 0.1, 'rho_1': 0.6, 'theta_max': [0.9],
     'phi_min': 0.84, 'gamma': 5.0, 'eta': 5.0, 'observer_rate': 20.0, 'input_gain': 1.4}])
@pytest.mark.parametrize(('order', 'count'), [(1, 0), (1, 2), (2, 2), (3, 1), (4, 3)])
def test_is_the_program_of_its_description(values, order, count):
    law = make(order, count, **values)
    program = Program(law.gains, order, count, PERIOD)
    intervals = np.random.default_rng(1).uniform(0.5 * PERIOD, 2.0 * PERIOD, 1000).tolist()
    x_d, x, y = disturbed(order, count, 1000, seed=order)
    memory = list(law.initial_memory())
    terms = [0.0] * (STATUS + 1 + len(law.signal_names))
    names = dict(zip(law.signal_names, range(STATUS + 1, 999), strict=False))
    statuses = set()
    for k in range(1000):
        new_memory = [0.0] * len(memory)
        v = law.kernel(law.constants, memory, x_d[k].tolist(), x[k].tolist(), y[k].tolist(),
                       intervals[k], new_memory, terms)
        memory = new_memory
        statuses.add(int(terms[STATUS]))
        expected = program(x_d[k], x[k], y[k], intervals[k])
        assert v == pytest.approx(expected, rel=1e-8, abs=1e-8)
        assert terms[STATUS + 1:STATUS + 2 + count] == pytest.approx(program.estimates, abs=1e-9)
        slot = program.sigma if law.gains.observer else program.integral
        assert terms[names['sigma']] == pytest.approx(slot, rel=1e-8, abs=1e-8)
        assert terms[names['eta0']] == pytest.approx(program.shift()[0], rel=1e-9, abs=1e-9)
        assert terms[names['kappa_f']] == pytest.approx(program.kappa, rel=1e-12)
    # the inputs exercised what there is to exercise
    assert program.guard_steps > 0
    if 'v_max' in values:
        assert program.frozen > 0
        assert int(Status.SATURATED) in statuses
    if law.gains.identifier and law.gains.observer and count:
        assert program.identified > 0
    assert (program.learned > 0) == (law.gains.learning_harmonics > 0)


def test_an_interval_of_zero_leaves_the_memory_as_it_is():
    law = make()
    memory = law.initial_memory()
    for x in ((0.3, 0.1), (0.2, 0.2)):
        after = [math.nan] * len(memory)
        terms = [0.0] * (STATUS + 1 + len(law.signal_names))
        law.kernel(law.constants, memory, (0.0, 0.0, 0.0), x, (1.0, 1.0), 0.0, after, terms)
        assert tuple(after) == tuple(memory)
        law.kernel(law.constants, memory, (0.0, 0.0, 0.0), x, (1.0, 1.0), PERIOD, after, terms)
        memory = tuple(after)


@pytest.mark.parametrize('order', [1, 2, 3, 4])
def test_the_shaped_start_has_no_jump_and_fades_with_its_own_rate(order):
    """s(0) = 0, and η is the motion it is reported to be: (d/dt + a)^n η = 0."""
    law = make(order, 0, start_rate=2.0)
    names = law.signal_names
    x_d, x = (0.0,) * (order + 1), tuple(0.5 / (i + 1) for i in range(order))
    memory, shifts = law.initial_memory(), []
    for k in range(400):
        after, terms = [0.0] * len(memory), [0.0] * (STATUS + 1 + len(names))
        law.kernel(law.constants, memory, x_d, x, (), PERIOD, after, terms)
        if k == 0:
            assert terms[0] == pytest.approx(0.0, abs=1e-12)
        shifts.append(terms[STATUS + 1 + names.index('eta0')])
        memory = tuple(after)
    # Solved by another road: the matrix exponential of the companion matrix.
    companion = np.zeros((order, order))
    companion[:-1, 1:] = np.eye(order - 1)
    companion[-1] = -np.poly([-2.0] * order)[:0:-1]
    from scipy.linalg import expm
    for k in (0, 10, 399):
        exact = expm(companion * PERIOD * (k + 1)) @ np.asarray(x)
        assert shifts[k] == pytest.approx(exact[0], rel=1e-9, abs=1e-12)


def test_a_take_over_starts_again_and_keeps_what_is_known():
    law = make(learning_harmonics=2)
    found = run(controller__learning_harmonics=2, loop__duration=3.0)
    memory = law.memory_from_signals(found.terms[-1, STATUS + 1:].tolist())
    again = law.take_over(memory)
    assert len(again) == len(memory)
    for name, before, after in zip(law.memory_names, memory, again, strict=True):
        if name.startswith(('theta', 'phi', 'kappa', 'cosine', 'sine', 'phase')):
            assert after == before, name
        else:
            assert after == 0.0, name
    after, terms = [0.0] * len(memory), [0.0] * (STATUS + 1 + len(law.signal_names))
    law.kernel(law.constants, again, (0.0, 0.0, 0.0), (3.0, -2.0), (1.0, 1.0), PERIOD, after,
               terms)
    assert terms[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(('changes', 'error', 'peak'), [
    ({}, 0.30e-3, 6.2), ({'plant.b': 0.5}, 0.32e-3, 13.6), ({'plant.b': 2.0}, 0.26e-3, 5.2),
    ({'loop.delay': 1}, 0.33e-3, 8.9), ({'loop.delay': 2}, 0.33e-3, 12.8),
    ({'plant.b': 2.0, 'loop.delay': 1}, 0.28e-3, 8.0),
    ({'trajectory.frequency': 3.0}, 0.30e-3, 25.0)])
def test_accuracy_is_that_of_the_independent_program(changes, error, peak):
    found = simulate(Configuration.from_flat({'controller.law': 'robust_eso',
                                              'loop.duration': 30.0, **changes}))
    tail = found.t >= 20.0
    assert np.abs(found.x - found.x_d[:, :2])[tail, 0].max() < 1.05 * error
    assert np.abs(found.v).max() < 1.02 * peak


def test_periodic_learning_takes_most_of_what_is_left():
    """ω = 3 rad/s, without the identifier: a fraction of the error after a while."""
    errors = []
    for harmonics in (0, 6):
        found = run(controller__learning_harmonics=harmonics, controller__learning_frequency=3.0,
                    controller__identifier=False, trajectory__frequency=3.0, loop__duration=40.0)
        errors.append(np.abs(found.x[:, 0] - found.x_d[:, 0])[found.t >= 30.0].max())
    assert errors[1] < 0.5 * errors[0]


EXPECTED = {'servo': (2.95e-4, 5.54), 'pendulum': (3.75e-4, 0.666), 'first_order': (4.10e-3, 46.6),
            'valve_actuator': (1.06e-4, 6.31)}


@pytest.mark.parametrize('name', EXPECTED)
def test_shipped_gains_are_those_of_the_rules_and_reach_what_they_promise(name):
    """Error over the last half of the run and peak of v, of a program independent of this one."""
    flat = flat_parameters(name)
    assert flat['controller.law'] == 'robust_eso'
    nominal = [item / 0.85 for item in flat['controller.theta_0']]
    rules = gains_by_rule(1.0 / flat['loop.rate'], flat['controller.b_bounds'],
                          flat['controller.m_bounds'], flat['controller.k_star'],
                          flat['controller.k_d'], nominal, flat['controller.phi_0'] / 0.85)
    for key, value in rules.items():
        assert flat[f'controller.{key}'] == pytest.approx(value, rel=6e-3), key
    found = simulate(Configuration.from_flat(flat))
    half = len(found.t) // 2
    error, peak = EXPECTED[name]
    assert np.abs(found.x[half:, 0] - found.x_d[half:, 0]).max() < 1.03 * error
    assert np.abs(found.v).max() < 1.02 * peak


FIGURES = {'robust_eso': (2.93e-4, 3.21e-4, 5.04), 'servo': (2.95e-4, 3.17e-4, 6.69),
           'pendulum': (3.75e-4, 4.00e-4, 0.638), 'first_order': (4.10e-3, 4.43e-3, 13.8),
           'valve_actuator': (1.06e-4, 1.07e-4, 3.25)}
"""Of the program above: max|x̃| without and with a sample of delay, TV of v per second without."""


@pytest.mark.parametrize('delay', [0, 1])
@pytest.mark.parametrize('name', FIGURES)
def test_error_and_variation_with_a_sample_of_delay_are_those_of_the_independent_program(
        name, delay):
    """Over the last half of the run; the delay adds at most an eighth to the variation of v."""
    found = simulate(Configuration.from_flat({**flat_parameters(name), 'loop.delay': delay}))
    half = len(found.t) // 2
    error = np.abs(found.x[half:, 0] - found.x_d[half:, 0]).max()
    variation = np.abs(np.diff(found.v[half:])).sum() / (found.t[-1] - found.t[half])
    assert error == pytest.approx(FIGURES[name][delay], rel=0.04)
    calm = FIGURES[name][2]
    assert 0.98 * calm < variation < (1.125 if delay else 1.02) * calm


@pytest.mark.parametrize(('name', 'quiet'), [('robust_eso', False), ('robust_eso_quiet', True)])
def test_the_configuration_of_the_example_keeps_to_the_rules(name, quiet):
    flat = flat_parameters(name)
    rules = gains_by_rule(0.005, [1.0, 1.0], [0.85, 1.25], 4.0, 10.0, [1.0, 1.0], 1.0, quiet=quiet)
    for key in ('layer_gain', 'lambda', 'observer_rate', 'k_2', 'identifier_band', 'phi_min',
                'theta_max', 'design_delay'):
        assert flat[f'controller.{key}'] == pytest.approx(rules[key], rel=0.02), key


@pytest.mark.parametrize(('values', 'key'), [
    ({'theta_0': [5.0]}, 'theta_0'), ({'phi_0': 0.2}, 'phi_0'), ({'k_star': 0.0}, 'k_star'),
    ({'design_delay': 3}, 'design_delay'), ({'learning_harmonics': 30}, 'learning_harmonics'),
    ({'learning_harmonics': 2, 'observer': False}, 'learning_harmonics')])
def test_refuses_gains_that_do_not_fit(values, key):
    with pytest.raises(ConfigurationError) as caught:
        make(**values)
    assert caught.value.key == f'controller.{key}'

# SPDX-License-Identifier: Apache-2.0
"""What every law must keep, and the paper's law and PD against vector programs of their own."""

from functools import cache
import math

import numpy as np
import pytest

from dz_ros.core import schema
from dz_ros.core.laws import LAWS
from dz_ros.core.laws.base import Law
from dz_ros.core.records import Reference, State, Status
from dz_ros.core.signals import Role, STATUS, TERMS
from dz_ros.errors import ConfigurationError

PERIOD = 0.005
SHAPES = [(n, r) for n in range(1, 5) for r in range(5)]
EVERY_LAW = pytest.mark.parametrize('name', LAWS.builtin)


def make(name, order=2, count=2, **values):
    """Return a law, or skip the shapes it reports it is not made for."""
    law = LAWS.load(name)
    if law.orders and order not in law.orders:
        pytest.skip(f'{name} is for plants of order {law.orders}')
    return law(schema.build(law.Gains, values, 'controller.'), order, count, PERIOD)


def inputs(order, count, samples, seed=0):
    """Return a smooth reference, a state that follows it badly, and regressors."""
    generator = np.random.default_rng(seed)
    t = np.arange(samples)[:, None] * PERIOD
    i = np.arange(order + 1)
    x_d = 1.5 * np.sin(1.3 * t + 0.5 * np.pi * i) * 1.3 ** i
    x = x_d[:, :-1] + 0.3 * np.sin(7.0 * t + i[:-1]) * np.exp(-t) + generator.normal(
        scale=0.01, size=(samples, order))
    y = np.sin(generator.uniform(0.5, 3.0, count) * t + np.arange(count))
    return x_d, x, y


def drive(law, samples=200, intervals=None, seed=0):
    """Run a law's kernel over `inputs`; return v, memory before, memory after, terms."""
    x_d, x, y = inputs(law.order, law.regressor_count, samples, seed)
    memory = list(law.initial_memory())
    rows = []
    for k in range(samples):
        new_memory = [math.nan] * len(memory)
        terms = [0.0] * STATUS + [math.nan] * (1 + len(law.signal_names))
        dt = PERIOD if intervals is None else intervals[k]
        v = law.kernel(law.constants, memory, x_d[k].tolist(), x[k].tolist(), y[k].tolist(), dt,
                       new_memory, terms)
        rows.append((v, list(memory), list(new_memory), list(terms)))
        memory = new_memory
    return rows


@cache
def driven(name, order, count):
    """Return what a law with its own gains gives, made once for all tests that look at it."""
    return drive(make(name, order, count))


@EVERY_LAW
def test_states_its_name(name):
    law = make(name)
    assert isinstance(law, Law)
    assert law.name == name
    assert law.summary
    assert '\n' not in law.summary
    for item in schema.fields(law.Gains):
        assert item.spec.description
        assert item.spec.unit or item.kind in ('bool', 'str')


@EVERY_LAW
@pytest.mark.parametrize(('order', 'count'), SHAPES)
def test_fills_its_buffers_with_finite_numbers(name, order, count):
    law = make(name, order, count)
    assert all(type(number) is float for number in law.constants)
    assert len(law.memory_from_signals([0.0] * len(law.signal_names))) == len(
        law.initial_memory())
    for v, _, after, terms in driven(name, order, count):
        assert math.isfinite(v)
        assert all(map(math.isfinite, after))
        assert all(map(math.isfinite, terms))


@EVERY_LAW
@pytest.mark.parametrize(('order', 'count'), SHAPES)
def test_the_parts_of_v_are_the_whole(name, order, count):
    parts = [i for i, item in enumerate(TERMS) if item.role is Role.TERM]
    for v, _, _, terms in driven(name, order, count):
        assert math.isclose(math.fsum(terms[i] for i in parts), v, rel_tol=1e-12, abs_tol=1e-12)


@EVERY_LAW
@pytest.mark.parametrize(('order', 'count'), SHAPES)
def test_memory_comes_back_from_the_signals_exactly(name, order, count):
    law = make(name, order, count)
    for _, before, _, terms in driven(name, order, count):
        assert list(law.memory_from_signals(terms[STATUS + 1:])) == before


@EVERY_LAW
@pytest.mark.parametrize(('order', 'count'), [(1, 1), (2, 2), (3, 2)])
def test_an_interval_of_zero_freezes_the_memory(name, order, count):
    law = make(name, order, count)
    intervals = [0.0 if k % 3 else PERIOD for k in range(90)]
    for k, (_, before, after, _) in enumerate(drive(law, 90, intervals)):
        if intervals[k] == 0.0:
            assert after == before


@EVERY_LAW
def test_starts_again_from_its_initial_memory(name):
    """Nothing of a run stays in the object: a second run is the first."""
    law = make(name)
    first = drive(law)
    assert drive(law) == first
    assert drive(make(name)) == first


@EVERY_LAW
def test_kernel_leaves_its_arguments_alone_and_takes_arrays(name):
    law = make(name)
    x_d, x, y = inputs(2, 2, 50)
    memory = np.array(law.initial_memory())
    for k, (v, before, after, terms) in enumerate(drive(law, 50)):
        arguments = [np.array(law.constants), np.array(before), x_d[k], x[k], y[k]]
        copies = [argument.copy() for argument in arguments]
        new_memory = np.full(len(memory), np.nan)
        buffer = np.full(len(terms), np.nan)
        buffer[:STATUS] = 0.0
        assert law.kernel(*arguments, PERIOD, new_memory, buffer) == v
        assert new_memory.tolist() == after
        assert buffer.tolist() == terms
        for argument, copy in zip(arguments, copies, strict=True):
            assert (argument == copy).all()


@EVERY_LAW
@pytest.mark.parametrize(('order', 'count'), [(1, 0), (2, 2), (3, 4)])
def test_step_is_the_kernel_in_records(name, order, count):
    law = make(name, order, count)
    x_d, x, y = inputs(order, count, 60)
    memory = law.initial_memory()
    for k, (v, before, after, buffer) in enumerate(drive(law, 60)):
        reference = Reference(k + 7, k * PERIOD, tuple(x_d[k].tolist()))
        state = State(k, k * PERIOD, tuple(x[k].tolist()))
        assert memory == tuple(before)
        command, memory, terms = law.step(memory, reference, state, y[k].tolist(), PERIOD)
        assert memory == tuple(after)
        assert command.v == v
        assert (command.seq, command.echo_seq) == (k, k)
        assert (command.stamp, command.echo_stamp) == (state.stamp, state.stamp)
        assert terms.values == tuple(buffer[:STATUS])
        assert terms.signals == tuple(buffer[STATUS + 1:])
        assert terms.status == Status(int(buffer[STATUS]))
        assert (terms.seq, terms.reference_seq, terms.dt) == (k, k + 7, PERIOD)


@EVERY_LAW
def test_step_keeps_the_caller_s_reason_for_freezing(name):
    law = make(name)
    x_d, x, y = inputs(2, 2, 1)
    _, memory, terms = law.step(law.initial_memory(), Reference(0, 0.0, tuple(x_d[0])),
                                State(0, 0.0, tuple(x[0])), y[0].tolist(), 0.0,
                                Status.BAD_INTERVAL)
    assert memory == law.initial_memory()
    assert terms.status & Status.BAD_INTERVAL


@EVERY_LAW
def test_law_for_orders_refuses_the_others(name):
    law = LAWS.load(name)
    for order in range(1, 5):
        if law.orders and order not in law.orders:
            with pytest.raises(ConfigurationError, match='needs a plant of order'):
                law(law.Gains(), order, 2, PERIOD)


def test_initial_estimates_are_one_for_all_or_one_each():
    assert make('wang2004', 2, 3, theta_0=[0.5]).initial_memory() == (0.5, 0.5, 0.5, 0.85)
    assert make('wang2004', 2, 2, theta_0=[0.5, 0.6]).initial_memory() == (0.5, 0.6, 0.85)
    with pytest.raises(ConfigurationError) as caught:
        make('wang2004', 2, 3, theta_0=[0.5, 0.6])
    assert caught.value.key == 'controller.theta_0'
    assert '1 or 3' in str(caught.value)


@pytest.mark.parametrize(('gain', 'value'), [
    ('lambda', 0.0), ('lambda', -1.0), ('k_d', 0.0), ('k_star', -0.1), ('epsilon', 0.0),
    ('gamma', -1.0), ('eta', math.nan), ('theta_0', [math.inf]), ('phi_0', 'x')])
def test_wang2004_refuses_impossible_gains(gain, value):
    with pytest.raises(ConfigurationError) as caught:
        make('wang2004', **{gain: value})
    assert caught.value.key == f'controller.{gain}'


class VectorLaw:
    """(8)–(17) with numpy: polynomials, scalar products, one state of estimates."""

    def __init__(self, g, order, count):
        binomial = np.poly([-g['lambda']] * (order - 1)) if order > 1 else np.ones(1)
        self.weights = binomial[::-1]
        self.rate_weights = np.concatenate(([0.0], self.weights[:-1]))
        self.g = g
        self.estimates = np.append(np.full(count, g['theta_0']), g['phi_0'])
        self.gains = np.append(np.full(count, g['gamma']), g['eta'])

    def __call__(self, x_d, x, y, dt):
        g = self.g
        error = x - x_d[:-1]
        s = self.weights @ error
        u_fd = x_d[-1] - self.rate_weights @ error
        inside = np.clip(s / g['epsilon'], -1.0, 1.0)
        regressor = np.append(y, u_fd)
        v = -g['k_d'] * s + regressor @ self.estimates - g['k_star'] * inside
        used = self.estimates
        self.estimates = used - dt * self.gains * regressor * (s - g['epsilon'] * inside)
        return v, s, u_fd, used


@pytest.mark.parametrize(('order', 'count'), SHAPES)
def test_wang2004_is_the_vector_program(order, count):
    g = {'lambda': 2.3, 'k_d': 7.0, 'k_star': 1.9, 'epsilon': 0.05, 'gamma': 3.0, 'eta': 2.0,
         'theta_0': 0.7, 'phi_0': 1.1}
    law = make('wang2004', order, count, **{**g, 'theta_0': [0.7]})
    vector = VectorLaw(g, order, count)
    intervals = np.random.default_rng(5).uniform(0.5 * PERIOD, 2.0 * PERIOD, 400).tolist()
    x_d, x, y = inputs(order, count, 400, seed=3)
    outside = 0
    for k, (v, _, _, terms) in enumerate(drive(law, 400, intervals, seed=3)):
        expected, s, u_fd, used = vector(x_d[k], x[k], y[k], intervals[k])
        assert v == pytest.approx(expected, rel=1e-11, abs=1e-11)
        assert terms[0] == pytest.approx(s, rel=1e-11, abs=1e-11)
        assert terms[2] == pytest.approx(u_fd, rel=1e-11, abs=1e-11)
        assert terms[STATUS + 1:] == pytest.approx(used, rel=1e-11, abs=1e-11)
        outside += abs(s) > 0.05
    assert 0 < outside < 400  # both sides of the layer's edge were visited


@pytest.mark.parametrize('order', [1, 2, 3, 4])
@pytest.mark.parametrize('feed_forward', [False, True])
def test_pd_is_the_vector_program(order, feed_forward):
    law = make('pd', order, 2, k_d=4.0, feed_forward=feed_forward, **{'lambda': 1.5})
    weights = np.poly([-1.5] * (order - 1))[::-1] if order > 1 else np.ones(1)
    x_d, x, _ = inputs(order, 2, 100)
    for k, (v, _, _, _) in enumerate(drive(law, 100)):
        expected = -4.0 * weights @ (x[k] - x_d[k, :-1]) + feed_forward * x_d[k, -1]
        assert v == pytest.approx(expected, rel=1e-11, abs=1e-11)


def test_v_at_the_start_of_the_paper_s_run():
    """v(0) = 24.15 λ − 7.415 (mathematics of the example)."""
    for lambda_ in (0.5, 1.0, 2.0, 4.0):
        law = make('wang2004', **{'lambda': lambda_})
        x = (-2.5, 3.5)
        y = [-math.tanh(-1.25), (6.25 - 5.0) * math.sin(-2.5)]
        command, _, _ = law.step(law.initial_memory(), Reference(0, 0.0, (0.0, 2.5, 0.0)),
                                 State(0, 0.0, x), y, PERIOD)
        assert command.v == pytest.approx(24.15 * lambda_ - 7.415, abs=5e-3)

# SPDX-License-Identifier: Apache-2.0
"""Margins from the matrix of the loop: against another program's figures, and laws' kernels."""

import math
import warnings

import numpy as np
import pytest

from dz_ros.core import schema
from dz_ros.core.design.linear_loop import (
    integral_model,
    largest_beta,
    largest_gain,
    loop_matrix,
    noise_of_surface,
    noise_variation,
    spectral_radius,
    surface_model,
)
from dz_ros.core.laws import LAWS
from dz_ros.core.laws.robust import Robust
from dz_ros.core.laws.robust_eso import RobustEso
from dz_ros.core.observers import Luenberger
from dz_ros.core.signals import STATUS
from dz_ros.core.tracking import error_weights

T = 0.005


def seen(omega):
    """Return the Luenberger observer at ω; none at 0."""
    return Luenberger.linear(omega, T) if omega else None


CONDITIONS = [(name, {'v_clip': 0.0} if hasattr(LAWS.load(name).Gains, 'v_clip') else {})
              for name in LAWS.builtin if name != 'neural'] + [
    ('ladrc', {'v_clip': 0.0, 'extended_states': 2}),
    ('extended', {'integral': True}), ('robust_eso', {'observer': False}),
    ('robust_eso', {'design_delay': 0}), ('robust_eso', {'design_delay': 2})]
"""Laws and switches; the weights of `neural` move in the layer with v, which is no linear step."""


def held(x, push):
    """Return the state of a chain of integrators a sample later, its input held."""
    order = len(x)
    return np.array([sum(T ** (j - i) / math.factorial(j - i) * x[j] for j in range(i, order))
                     + T ** (order - i) / math.factorial(order - i) * push for i in range(order)])


def make(law_class, order=2, count=2, **values):
    return law_class(schema.build(law_class.Gains, values, 'controller.'), order, count, T)


@pytest.mark.parametrize(('law', 'limits'), [
    (make(Robust), (6.09, 2.64, 1.32)), (make(RobustEso), (4.445, 2.085, 1.10)),
    (make(RobustEso, layer_gain=50.0, observer_rate=40.0), (5.565, 2.505, 1.345))])
def test_largest_input_gain_is_that_of_the_independent_program(law, limits):
    found = [largest_beta(law.layer_model(), T, delay) for delay in (0, 1, 2)]
    assert found == pytest.approx(limits, rel=3e-3)


@pytest.mark.parametrize('delay', [0, 1, 3])
@pytest.mark.parametrize(('name', 'values'), CONDITIONS)
def test_the_margin_is_what_plain_bisection_ends_at(name, values, delay):
    model = make(LAWS.load(name), **values).layer_model()

    def calm(beta):
        return spectral_radius(model, T, beta, delay) < 1.0

    grid = np.geomspace(1e-3, 2.0, 64) * 2.0 / (abs(model.d[-1]) * T)
    last = max((place for place in range(64) if calm(grid[place])), default=None)
    below, above = (0.0, 0.0) if last is None else grid[last:last + 2]
    for _ in range(34):
        middle = 0.5 * (below + above)
        below, above = (middle, above) if calm(middle) else (below, middle)
    assert largest_beta(model, T, delay) == pytest.approx(below, rel=3e-11)


@pytest.mark.parametrize(('lambda_', 'delay', 'limit'), [
    (10.0, 1, 2.33), (10.0, 2, 1.11), (20.0, 1, 2.06), (20.0, 2, 0.91)])
def test_a_steep_surface_leaves_less_than_the_rule_on_the_slope_reports(lambda_, delay, limit):
    law = make(Robust, **{'lambda': lambda_})
    assert largest_beta(law.layer_model(), T, delay) == pytest.approx(limit, rel=6e-3)


def test_an_observed_velocity_and_an_integral_need_a_fast_pole():
    """K = 71.2, b m = 1: at 50 rad/s a limit cycle; calm from 130 or, a sample late, 260 on."""
    model = make(Robust).layer_model()
    assert spectral_radius(model, T, 1.0, 0, seen(50.0)) == pytest.approx(1.060, abs=1e-3)
    assert spectral_radius(model, T, 1.0, 0, seen(130.0)) < 1.0
    assert spectral_radius(model, T, 1.0, 0, seen(110.0)) > 1.0
    assert spectral_radius(model, T, 1.0, 1, seen(260.0)) < 1.0
    assert spectral_radius(model, T, 1.0, 1, seen(195.0)) > 1.0
    # the law without the integral is calm with it
    assert spectral_radius(surface_model(2, 1.0, 71.2, 0.85), T, 1.0, 0, seen(50.0)) < 1.0


@pytest.mark.parametrize('delay', [0, 1, 2, 3])
@pytest.mark.parametrize('order', [1, 2, 3])
@pytest.mark.parametrize('observer', [0.0, 120.0])
def test_the_matrix_is_the_loop_stepped_directly(order, delay, observer):
    """Another road: step the chain, the delay line, the observer and the law one by one."""
    if order == 1 and observer:
        pytest.skip('nothing to observe')
    model = integral_model(order, 2.0, 30.0, 1.7, 0, 0.4)
    beta, size = 1.3, order + (2 if observer else 0) + 1 + delay
    state = np.random.default_rng(1).standard_normal(size)
    found = loop_matrix(model, T, beta, delay, seen(observer)) @ state
    x, rest = state[:order].copy(), state[order:]
    measured = x.copy()
    if observer:
        position, velocity, rest = rest[0], rest[1], rest[2:]
        z = math.exp(-observer * T)
        position += T * velocity
        residual = x[order - 2] - position
        position += (1 - z ** 2) * residual
        velocity += (1 - z) ** 2 / T * residual
        measured[order - 1] = velocity
    integral, line = rest[0], list(rest[1:])
    v = model.d @ measured - integral
    weights = np.poly([-2.0] * (order - 1))[::-1] if order > 1 else np.ones(1)
    integral += 0.4 * (weights @ measured)
    acts = line[-1] if delay else v
    moved = [sum(T ** (j - i) / math.factorial(j - i) * x[j] for j in range(i, order))
             + beta * T ** (order - i) / math.factorial(order - i) * acts for i in range(order)]
    expected = [*moved, *((position, velocity) if observer else ()), integral,
                *([v, *line[:-1]] if delay else [])]
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize('delay', [0, 1, 2])
@pytest.mark.parametrize('order', [1, 2, 3])
def test_the_variation_under_noise_is_that_of_the_impulse_responses(order, delay):
    """Another road: σ_Δ² = Σ_i σ_i² Σ_k (h_i,k − h_i,k−1)², h_i stepped one by one."""
    model = make(RobustEso, order, design_delay=1).layer_model()
    beta, sigma = 0.8, np.array([0.3, 0.7, 2.0])[:order]
    assert spectral_radius(model, T, beta, delay) < 1.0
    square = 0.0
    for place in range(order):
        x, z, line, last = np.zeros(order), np.zeros(len(model.c)), [0.0] * delay, 0.0
        for k in range(6000):
            measured = x.copy()
            measured[place] += sigma[place] * (k == 0)
            v = model.d @ measured + model.c @ z
            z = model.a @ z + model.b @ measured
            line.append(v)
            acts = line.pop(0)
            x = held(x, beta * acts)
            square += (v - last) ** 2
            last = v
    expected = math.sqrt(2.0 / math.pi * square) / T
    assert noise_variation(model, T, beta, delay, sigma) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize('delay', [0, 1, 2])
@pytest.mark.parametrize('observed', [False, True])
@pytest.mark.parametrize('order', [1, 2, 3])
def test_the_noise_of_the_surface_is_that_of_the_impulse_responses(order, observed, delay):
    """Another road: σ² = Σ_i σ_i² Σ_k h_i,k² of the s that the law computes."""
    if observed and order == 1:
        pytest.skip('nothing to observe')
    model = make(RobustEso, order, design_delay=1).layer_model()
    beta, sigma = 0.8, np.array([0.3, 0.7, 2.0])[:order]
    observer = seen(400.0 if observed else 0.0)
    if observed and delay == 2:
        assert spectral_radius(model, T, beta, delay, observer) > 1.0
        assert noise_of_surface(model, 2.0, T, beta, delay, sigma, observer) == math.inf
        return
    weights, square = np.array(error_weights(2.0, order)), 0.0
    for place in range(order - observed):
        x, z, line = np.zeros(order), np.zeros(len(model.c)), [0.0] * delay
        estimate = np.zeros(2)
        for k in range(8000):
            measured = x.copy()
            measured[place] += sigma[place] * (k == 0)
            if observed:
                estimate = observer.step @ estimate + observer.gain * measured[-2]
                measured[-1] = estimate[1]
            square += (weights @ measured) ** 2
            v = model.d @ measured + model.c @ z
            z = model.a @ z + model.b @ measured
            line.append(v)
            acts = line.pop(0)
            x = held(x, beta * acts)
    assert noise_of_surface(model, 2.0, T, beta, delay, sigma, observer) == pytest.approx(
        math.sqrt(square), rel=1e-7)


def test_noise_explains_no_variation_of_a_loop_that_is_not_calm():
    model = make(RobustEso).layer_model()
    assert math.isfinite(noise_variation(model, T, 1.09, 2, [1e-3, 1e-2]))
    assert noise_variation(model, T, 1.11, 2, [1e-3, 1e-2]) == math.inf
    assert noise_variation(model, T, 1.09, 2, [0.0, 0.0]) == 0.0


@pytest.mark.parametrize('delay', [1, 2])
def test_largest_gain_and_largest_input_gain_are_one_boundary(delay):
    law = make(Robust)
    gain = largest_gain(law.layer_model, T, 1.25, delay)
    assert largest_beta(law.layer_model(gain), T, delay) == pytest.approx(1.25, rel=1e-6)
    for share, calm in ((0.999, True), (1.001, False)):
        radius = spectral_radius(law.layer_model(share * gain), T, 1.25, delay)
        assert (radius < 1.0) is calm


def test_what_is_calm_nowhere_has_no_margin():
    assert largest_beta(integral_model(2, 1.0, 15.0, 0.0, 0, 0.1 * 15.0 ** 2), 0.1, 2) == 0.0
    assert largest_gain(lambda gain: None, T, 1.0, 1) == 0.0


def test_gains_near_the_largest_number_are_not_calm():
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        assert spectral_radius(surface_model(2, 1.0, 1e308, 1.0), T, 1e308, 0) == np.inf
        assert noise_of_surface(surface_model(2, 1.0, 1e308, 1.0), 1.0, T, 1e308, 0,
                                [1.0, 1.0]) == np.inf


@pytest.mark.parametrize('beta', [1e-15, 1e-16, 1e-17, 1e-18])
def test_a_loop_at_its_limit_but_for_rounding_has_noise_without_bound_or_a_number(beta):
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        assert noise_of_surface(surface_model(2, 1.0, 30.0, 1.0), 1.0, T, beta, 0,
                                [1e-3, 1e-2]) > 0.0


@pytest.mark.parametrize('order', [1, 2, 3])
@pytest.mark.parametrize(('name', 'values'), CONDITIONS)
def test_the_model_is_the_derivative_of_the_kernel_in_the_layer(name, values, order):
    """Finite differences of v and of the memory after the step, about s = 0, far from v = 0."""
    law = make(LAWS.load(name), order, 1, **values)
    model = law.layer_model()
    assert model is not None
    x_d = [0.0] * order + [200.0]

    def step(memory, x):
        after = [0.0] * len(memory)
        terms = [0.0] * (STATUS + 1 + len(law.signal_names))
        v = law.kernel(law.constants, memory, x_d, x, (0.0,), T, after, terms)
        return np.array([v, *(after[place] for place in model.places)]), np.asarray(after)

    rest = list(law.initial_memory())
    # A sample on the reference, so that no first-sample rule applies, then everything at rest.
    rest = step(rest, [0.0] * order)[1].tolist()
    for place in model.places:
        rest[place] = 0.0
    size = 1e-7
    found = []
    for i in range(order):
        x = [0.0] * order
        x[i] = size
        above = step(rest, x)[0]
        x[i] = -size
        found.append((above - step(rest, x)[0]) / (2.0 * size))
    expected = np.vstack((model.d, model.b)).T
    assert np.array(found) == pytest.approx(expected, rel=1e-4, abs=1e-4)
    for column, place in enumerate(model.places):
        memory = list(rest)
        memory[place] += size
        above = step(memory, [0.0] * order)[0]
        memory[place] -= 2.0 * size
        found_one = (above - step(memory, [0.0] * order)[0]) / (2.0 * size)
        assert found_one == pytest.approx(np.append(model.c[column], model.a[:, column]),
                                          rel=1e-4, abs=1e-4)

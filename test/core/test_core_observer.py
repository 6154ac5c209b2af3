# SPDX-License-Identifier: Apache-2.0
"""The velocity observer against what a double pole and a covariance must give."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core.observers import Levant, Luenberger, OBSERVERS, Tracking
from dz_ros.core.observers.base import noise_gain

T = 0.005
REST = (0.0, 0.0, 0.0)


@pytest.mark.parametrize('omega', [20.0, 50.0, 100.0, 300.0])
def test_the_error_has_a_double_pole_at_exp_minus_omega_t(omega):
    observer, errors = Luenberger(omega), []
    observer.step(0.0, REST, 0.0)
    for k in range(1, 60):
        observer.step(2.0 * k * T, REST, T)
        errors.append((observer.memory[1] - 2.0 * k * T, observer.memory[2] - 2.0))
    z = math.exp(-omega * T)
    for column in np.array(errors).T:
        # An observer of a double pole z obeys e_k = 2 z e_(k−1) − z² e_(k−2).
        assert column[2:] == pytest.approx(2 * z * column[1:-1] - z * z * column[:-2], abs=1e-12)
    assert max(map(abs, errors[-1])) < 1e-3 * 2.0 or omega < 50.0


@settings(max_examples=settings.default.max_examples // 2, deadline=None)
@given(st.floats(-10, 10), st.floats(-10, 10), st.floats(-50, 50),
       st.lists(st.floats(0.001, 0.02), min_size=5, max_size=40))
def test_with_the_right_acceleration_it_is_exact_whatever_the_intervals(x, v, a, intervals):
    observer = Luenberger(60.0)
    observer.step(x, (x, v, a), 0.0)
    observer.memory[2] = v
    for interval in intervals:
        x, v = x + interval * v + 0.5 * interval ** 2 * a, v + interval * a
        assert observer.step(x, (x, v, a), interval) == pytest.approx(v, abs=1e-9 * (1 + abs(v)))


@pytest.mark.parametrize('omega', [10.0, 50.0, 100.0, 400.0])
def test_the_noise_it_passes_is_that_of_its_covariance(omega):
    observer = Luenberger(omega)
    noise = np.random.default_rng(3).standard_normal(60000)
    found = np.std([observer.step(float(item), REST, T) for item in noise][2000:])
    assert found == pytest.approx(noise_gain(Luenberger.linear(omega, T)), rel=0.05)


def test_it_passes_far_less_noise_than_a_backward_difference():
    difference = math.sqrt(2.0) / T
    assert noise_gain(Luenberger.linear(50.0, T)) < difference / 20.0
    assert noise_gain(Luenberger.linear(100.0, T)) < difference / 8.0


def test_measured_again_at_the_same_instant_it_only_moves_its_position():
    observer = Luenberger(50.0)
    observer.step(1.0, REST, 0.0)
    assert observer.step(3.0, REST, 0.0) == 0.0
    assert observer.memory[1] == 3.0
    observer.step(3.1, REST, T)
    assert observer.memory[2] > 0.0
    observer.restart()
    assert observer.step(9.0, REST, T) == pytest.approx(0.0)


@pytest.mark.parametrize('kind', [Luenberger, Tracking])
def test_linear_observer_is_the_step_on_the_error(kind):
    """With a reference of its own, at rest or not, the step is F o + g e."""
    observer, linear = kind(60.0), kind.linear(60.0, T)
    generator = np.random.default_rng(5)
    observer.step(0.3, REST, 0.0)
    for _ in range(20):
        before, e = np.array(observer.memory[1:]), float(generator.standard_normal())
        velocity = observer.step(e, REST, T)
        expected = linear.step @ before + linear.gain * e
        assert observer.memory[1:] == pytest.approx(expected, rel=1e-9, abs=1e-9)
        assert velocity == pytest.approx(expected[1])


def test_tracking_observer_has_a_triple_pole_and_no_error_on_the_reference():
    poles = np.linalg.eigvals(Tracking.linear(80.0, T).step)
    assert np.abs(poles - math.exp(-80.0 * T)).max() < 1e-4
    observer = Tracking(80.0)
    for k in range(200):
        t = k * T
        reference = (math.sin(3.0 * t), 3.0 * math.cos(3.0 * t), -9.0 * math.sin(3.0 * t))
        found = observer.step(math.sin(3.0 * t), reference, T if k else 0.0)
        assert found == pytest.approx(3.0 * math.cos(3.0 * t), abs=1e-9)


@pytest.mark.parametrize('name', sorted(OBSERVERS))
def test_every_observer_finds_a_constant_velocity_beside_the_reference(name):
    observer = OBSERVERS[name](80.0)
    for k in range(600):
        found = observer.step(0.05 * k * T, REST, T if k else 0.0)
    assert found == pytest.approx(0.05, abs=0.03 if name == 'levant' else 1e-3)


def test_levant_is_homogeneous():
    """In finite time it is exact but for the discretisation."""
    observer, late = Levant(60.0), []
    for k in range(2000):
        late.append(observer.step(0.02 * k * T, REST, T if k else 0.0) - 0.02)
    assert max(map(abs, late[1000:])) < 2.0 * 1e-3 * 60.0 ** 3 * T ** 2 * 5.0

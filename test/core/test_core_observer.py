"""The velocity observer against what a double pole and a covariance must give."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core.observer import noise_gain, VelocityObserver

T = 0.005


@pytest.mark.parametrize('omega', [20.0, 50.0, 100.0, 300.0])
def test_the_error_has_a_double_pole_at_exp_minus_omega_t(omega):
    observer, errors = VelocityObserver(omega), []
    observer.step(0.0, 0.0, 0.0)
    for k in range(1, 60):
        observer.step(2.0 * k * T, 0.0, T)
        errors.append((observer.position - 2.0 * k * T, observer.velocity - 2.0))
    z = math.exp(-omega * T)
    for column in np.array(errors).T:
        # Whoever has a double pole z obeys e_k = 2 z e_(k−1) − z² e_(k−2).
        assert column[2:] == pytest.approx(2 * z * column[1:-1] - z * z * column[:-2], abs=1e-12)
    assert max(map(abs, errors[-1])) < 1e-3 * 2.0 or omega < 50.0


@settings(max_examples=50, deadline=None)
@given(st.floats(-10, 10), st.floats(-10, 10), st.floats(-50, 50),
       st.lists(st.floats(0.001, 0.02), min_size=5, max_size=40))
def test_with_the_right_acceleration_it_is_exact_whatever_the_intervals(x, v, a, intervals):
    observer = VelocityObserver(60.0)
    observer.step(x, a, 0.0)
    observer.velocity = v
    for interval in intervals:
        x, v = x + interval * v + 0.5 * interval ** 2 * a, v + interval * a
        assert observer.step(x, a, interval) == pytest.approx(v, abs=1e-9 * (1 + abs(v)))


@pytest.mark.parametrize('omega', [10.0, 50.0, 100.0, 400.0])
def test_the_noise_it_passes_is_that_of_its_covariance(omega):
    observer = VelocityObserver(omega)
    noise = np.random.default_rng(3).standard_normal(60000)
    found = np.std([observer.step(float(item), 0.0, T) for item in noise][2000:])
    assert found == pytest.approx(noise_gain(omega, T), rel=0.05)


def test_it_passes_far_less_noise_than_a_backward_difference():
    difference = math.sqrt(2.0) / T
    assert noise_gain(50.0, T) < difference / 20.0
    assert noise_gain(100.0, T) < difference / 8.0


def test_measured_again_at_the_same_instant_it_only_moves_its_position():
    observer = VelocityObserver(50.0)
    observer.step(1.0, 0.0, 0.0)
    assert observer.step(3.0, 0.0, 0.0) == 0.0
    assert observer.position == 3.0
    observer.step(3.1, 0.0, T)
    assert observer.velocity > 0.0
    observer.restart()
    assert observer.step(9.0, 0.0, T) == pytest.approx(0.0)

# SPDX-License-Identifier: Apache-2.0
"""Filtered error, its weights and the set it converges to, against polynomials of numpy."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core.tracking import error_weights, feed_forward_weights, guaranteed_bounds, sat

orders = st.integers(1, 6)
slopes = st.floats(0.1, 20.0)


@given(slopes, orders)
def test_weights_are_those_of_p_plus_lambda_to_the_power(lambda_, order):
    expected = np.poly([-lambda_] * (order - 1))[::-1] if order > 1 else np.ones(1)
    assert error_weights(lambda_, order) == pytest.approx(expected, rel=1e-12)


@given(slopes, orders)
def test_feed_forward_weights_are_one_place_further(lambda_, order):
    weights = feed_forward_weights(lambda_, order)
    assert weights[0] == 0.0
    assert weights[1:] == error_weights(lambda_, order)[:-1]


def test_second_order_is_the_paper_s():
    assert error_weights(3.0, 2) == (3.0, 1.0)
    assert feed_forward_weights(3.0, 2) == (0.0, 3.0)
    assert error_weights(2.0, 3) == (4.0, 4.0, 1.0)


@given(st.floats(-1e6, 1e6))
def test_sat(z):
    assert sat(z) == np.clip(z, -1.0, 1.0)


@pytest.mark.parametrize('order', [1, 2, 3, 4])
def test_the_guaranteed_set_holds_for_the_worst_constant_and_for_random_s(order):
    lambda_, epsilon, step = 2.0, 0.02, 1e-3
    bounds = np.array(guaranteed_bounds(lambda_, epsilon, order))
    assert bounds[0] == pytest.approx(epsilon / lambda_ ** (order - 1))
    generator = np.random.default_rng(3)
    weights = np.array(error_weights(lambda_, order))
    error = np.zeros(order)
    for k in range(30000):
        if k % 300 == 0:
            s = generator.choice([-epsilon, epsilon])
        if order == 1:
            error[0] = s
        else:  # the last component is what makes Λᵀ x̃ equal to s
            error[-1] = s - weights[:-1] @ error[:-1]
            error[:-1] += step * error[1:]
        assert (np.abs(error) <= bounds * (1.0 + 1e-9)).all()

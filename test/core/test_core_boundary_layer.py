# SPDX-License-Identifier: Apache-2.0
"""Where chatter begins: the formulas against polynomials, and against the simulated loop."""


import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.boundary_layer import (
    automatic_epsilon,
    chatter_limit,
    layer_gain,
)
from dz_ros.core.design.linear_loop import largest_beta
from dz_ros.core.laws.robust import Robust
from dz_ros.core.loop.offline import simulate

K_STAR, K_D = 2.5, 10.0


def radius(*coefficients):
    return np.abs(np.roots(coefficients)).max()


@pytest.mark.parametrize(('delay', 'printed'), [(0, 2.0), (1, 1.0), (2, 0.618), (3, 0.445)])
def test_limit_is_where_the_roots_leave_the_unit_circle(delay, printed):
    limit = chatter_limit(delay)
    assert limit == pytest.approx(printed, abs=5e-4)
    for share, stable in ((0.999, True), (1.001, False)):
        polynomial = [1.0, -1.0] + [0.0] * delay
        polynomial[-1] += share * limit
        assert bool(radius(*polynomial) < 1.0) is stable


def test_automatic_epsilon_keeps_its_share():
    epsilon = automatic_epsilon(K_STAR, K_D, 0.85, 1.25, 0.005, 1, 0.5)
    gain = (layer_gain(K_D, K_STAR, epsilon) + 0.85) * 1.25 * 0.005
    assert gain == pytest.approx(0.5 * chatter_limit(1))


def variation(values):
    """Return the total variation of v a second in the second half of a run."""
    found = simulate(Configuration.from_flat({'plant.substeps': 1, **values}))
    half = len(found.v) // 2
    return np.abs(np.diff(found.v[half:])).sum() / (found.t[-1] - found.t[half])


@pytest.mark.parametrize('delay', [0, 1, 2])
@pytest.mark.parametrize('rate', [100.0, 200.0, 400.0])
@pytest.mark.parametrize('b', [0.5, 1.0, 2.0])
def test_chatter_begins_within_5_percent_of_the_prediction(delay, rate, b):
    """The example's plant with its dead-zone: calm 5 % below the predicted gain, wild above."""
    found = []
    for share in (0.95, 1.05):
        steep = share * chatter_limit(delay) * rate / b
        found.append(variation({
            'loop.rate': rate, 'loop.delay': delay, 'plant.b': b, 'loop.duration': 6.0,
            'plant.x0': [0.0, 2.5], 'plant.a3': 0.0, 'controller.theta_0': [1.0 / b],
            'controller.phi_0': 1.0 / b, 'controller.gamma': 0.0, 'controller.eta': 0.0,
            'controller.epsilon': K_STAR / (steep - K_D - 1.0 / b)}))
    assert found[0] < 10.0
    assert found[1] > 4.0 * found[0]


@pytest.mark.parametrize(('delay', 'share', 'calm'), [
    (1, 0.95, True), (1, 1.05, False), (2, 0.93, True), (2, 1.05, False)])
def test_chatter_of_the_adapting_example(delay, share, calm):
    """As the paper runs it, from its initial state, with adaptation and disturbance."""
    epsilon = K_STAR / (share * chatter_limit(delay) * 200.0 - K_D - 1.0)
    found = variation({'loop.delay': delay, 'loop.duration': 10.0, 'controller.epsilon': epsilon})
    assert (found < 20.0) if calm else (found > 40.0)


@pytest.mark.parametrize('delay', [0, 1, 2])
@pytest.mark.parametrize(('share', 'calm'), [(0.95, True), (1.05, False)])
def test_chatter_of_the_recommended_law(delay, share, calm):
    """With its integral, before the guard has stepped."""
    b = share * largest_beta(Robust().layer_model(), 0.005, delay)
    found = variation({
        'controller.law': 'robust', 'loop.delay': delay, 'plant.b': b, 'loop.duration': 2.0,
        'plant.x0': [0.0, 2.5], 'controller.phi_0': max(0.3, 1.0 / b),
        'controller.theta_0': [max(0.1, 1.0 / b)]})
    assert (found < 15.0) if calm else (found > 40.0)

# SPDX-License-Identifier: Apache-2.0
"""The pulse: a push of known size over whole samples, nothing at all where there is none."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.offline import simulate
from dz_ros.errors import ConfigurationError


def run(**values):
    return simulate(Configuration.from_flat({'loop.duration': 1.0, **values}))


@pytest.mark.parametrize('pulse', [[0.5, 0.0, 0.05], [0.5, 20.0, 0.0], [7.0, 20.0, 0.05]])
def test_no_pulse_leaves_every_bit(pulse):
    calm, disturbed = run(), run(**{'plant.disturbance_pulse': pulse})
    for name in ('x', 'v', 'truth', 'terms'):
        assert np.array_equal(getattr(calm, name), getattr(disturbed, name)), name


def test_a_pulse_begins_and_ends_where_it_reports():
    calm, disturbed = run(), run(**{'plant.disturbance_pulse': [0.5, 20.0, 0.05]})
    assert np.array_equal(calm.x[:101], disturbed.x[:101])
    assert disturbed.x[101, 1] - calm.x[101, 1] == pytest.approx(0.1, rel=1e-3)
    pushed = np.flatnonzero(disturbed.truth[:, 2] - calm.truth[:, 2] < -10.0)
    assert pushed.tolist() == list(range(100, 110))


def test_a_pulse_changes_the_speed_by_its_impulse():
    """A plant that nothing else moves gains acceleration times duration."""
    found = run(**{'plant.model': 'first_order', 'controller.law': 'pd', 'controller.k_d': 1e-9,
                   'plant.linear_drag': 0.0, 'plant.quadratic_drag': 0.0, 'plant.wave_force': 0.0,
                   'plant.x0': [0.0], 'trajectory.amplitude': 0.0,
                   'plant.disturbance_pulse': [0.5, -3.0, 0.05]})
    assert found.x[100, 0] == 0.0
    assert found.x[-1, 0] == pytest.approx(-0.15, abs=1e-12)


@given(st.integers(0, 500), st.integers(0, 500), st.sampled_from([100.0, 200.0, 333.0, 1000.0]))
def test_pulse_samples_are_those_that_begin_within_it(first, count, rate):
    c = Configuration.from_flat({'loop.rate': rate,
                                 'plant.disturbance_pulse': [first / rate, 1.0, count / rate]})
    assert c.pulse_samples == (first, first + count, 1.0)


def test_a_pulse_before_the_start_is_refused():
    with pytest.raises(ConfigurationError, match='must not be negative'):
        Configuration.from_flat({'plant.disturbance_pulse': [-1.0, 20.0, 0.05]})

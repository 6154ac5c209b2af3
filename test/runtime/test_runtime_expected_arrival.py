# SPDX-License-Identifier: Apache-2.0
"""When to poll: not before an answer can be there, and never for long."""

import numpy as np
import pytest

from dz_ros.runtime.expected_arrival import ExpectedArrival, LEAD


def test_it_begins_just_before_the_quickest_answers():
    expected = ExpectedArrival(0.005)
    delays = 300e-6 + np.random.default_rng(0).gamma(2.0, 50e-6, 5000)
    for delay in delays:
        expected.add(float(delay))
    began = expected.begin + LEAD
    assert np.quantile(delays, 0.001) < began < np.quantile(delays, 0.1)
    inside = (expected.begin < delays) & (delays < expected.end)
    assert inside.mean() > 0.9


def test_it_follows_a_machine_that_changes():
    expected = ExpectedArrival(0.005)
    for delay in [300e-6] * 100:
        expected.add(delay)
    assert expected.begin == pytest.approx(300e-6 - LEAD, rel=0.01)
    for delay in [200e-6] * 20:
        expected.add(delay)
    assert expected.begin == pytest.approx(200e-6 - LEAD, rel=0.02)
    for delay in [500e-6] * 2000:
        expected.add(delay)
    assert expected.begin == pytest.approx(500e-6 - LEAD, rel=0.02)


@pytest.mark.parametrize(('period', 'window'), [(0.005, 1e-3), (0.001, 2e-4), (1.0, 1e-3)])
def test_it_polls_for_a_bounded_time(period, window):
    expected = ExpectedArrival(period)
    for delay in (-1.0, 0.0, 10.0 * period, 0.3 * period):
        expected.add(delay)
        assert 0.0 <= expected.begin <= period
        assert expected.end - expected.begin == pytest.approx(window + LEAD)


def test_before_the_first_answer_it_does_not_poll_early():
    assert ExpectedArrival(0.005).begin > 0.004

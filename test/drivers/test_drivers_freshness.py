# SPDX-License-Identifier: Apache-2.0
"""One rule of how old a measurement may be, for all drivers of devices."""

import math

from hypothesis import given
from hypothesis import strategies as st
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.freshness import Freshness, SAMPLES


def rule(samples=SAMPLES, **safety):
    return Freshness.of(samples, Configuration.from_flat(
        {'loop.rate': 200.0, **{f'safety.{key}': value for key, value in safety.items()}}))


@given(st.floats(0.1, 50.0), st.integers(1, 100), st.floats(0.0, 1e6), st.floats(0.0, 1.0))
def test_a_measurement_holds_for_its_samples_and_is_lost_when_the_host_has_had_none(
        samples, hold, at, age):
    found, period = rule(samples, state_hold=hold), 0.005
    passed = (at + age) - at        # what is left of the age beside so large an instant
    assert found.holds(at, at + age) == (passed <= samples * period)
    assert found.lost(at, at + age) == (passed > (samples + hold - 1) * period)
    assert not (found.holds(at, at + age) and found.lost(at, at + age))


def test_without_a_hold_nothing_is_lost():
    assert rule(state_hold=0).absent == math.inf


@pytest.mark.parametrize(('age', 'expected'), [(0.004, 1.008), (7.0, 1.02), (-0.004, 0.992),
                                               (-7.0, 0.98)])
def test_a_position_is_moved_by_no_more_than_its_age_may_be(age, expected):
    assert rule().advanced(1.0, 2.0, age) == pytest.approx(expected)


def test_a_position_without_a_velocity_stays():
    assert rule().advanced(1.0, math.nan, 0.004) == 1.0

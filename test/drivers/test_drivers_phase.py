# SPDX-License-Identifier: Apache-2.0
"""The phase of the samples, as drivers learn it."""

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from dz_ros.drivers.phase import Phase

T = 0.005


def distance(instant, phase):
    """Return how far an instant is from the nearest sample at phase + kT."""
    return abs((instant - phase + T / 2.0) % T - T / 2.0)


@settings(deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.0, T), st.floats(0.0, 0.004))
def test_sync_comes_before_a_sample_and_never_twice_in_half_a_period(now, phase, lead):
    found = Phase(T)
    found.sample_ended(phase, 0.0)
    due = found.next(now, lead)
    assert T / 2.0 - 1e-9 <= due - now <= 1.5 * T + 1e-9
    assert distance(due + lead, phase) < 1e-9


def test_without_a_loop_sync_is_free():
    assert Phase(T).next(3.0, 0.001) == pytest.approx(3.0 + T)


@settings(deadline=None, max_examples=3 * settings.default.max_examples // 10)
@given(st.lists(st.floats(0.0, 0.0005), min_size=300, max_size=300),
       st.lists(st.tuples(st.integers(0, 150), st.floats(0.0, 0.02)), max_size=3))
def test_the_phase_is_that_of_the_punctual_samples(late, stalls):
    """Samples are up to half a millisecond late, a few much more: the phase is not taken in."""
    found, late = Phase(T), list(late)
    for place, more in stalls:
        late[place] += more
    for k, error in enumerate(late):
        reported = found.sample_ended(1.0 + k * T + error, k * T)
    assert abs(reported - (1.0 + 299 * T)) < 0.0008
    due = found.next(10.0, 0.0)
    assert distance(due, 1.0) < 0.0008


def test_a_loop_that_begins_again_has_another_phase():
    found = Phase(T)
    for k in range(100):
        found.sample_ended(k * T, k * T)
    assert found.sample_ended(20.0021, 0.0) == 20.0021
    assert distance(found.next(21.0, 0.0), 0.0021) < 1e-9


def test_what_is_asked_late_belongs_to_the_sample_and_without_a_loop_to_now():
    found = Phase(T)
    assert found.near(7.0) == 7.0
    for k in range(100):
        found.sample_ended(k * T, k * T)
    found.sample_ended(100 * T + 0.002, 100 * T)
    assert found.near(100 * T + 0.002) == pytest.approx(100 * T, abs=5e-5)
    assert found.near(100 * T + 0.006) == 100 * T + 0.006

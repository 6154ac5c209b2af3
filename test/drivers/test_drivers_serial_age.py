# SPDX-License-Identifier: Apache-2.0
"""A state of a serial device is brought from its own instant to that of the sample."""

from types import SimpleNamespace

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from dz_ros.drivers.freshness import Freshness
from dz_ros.drivers.serial.device_clock import between, DeviceClock, WINDOW
from dz_ros.drivers.serial.protocol import Mode, State

T, PERIOD_US = 0.005, 1000
"""Period of the loop [s] and of the states [µs]."""


def state(time_us, *values):
    return State(1, 1, time_us % 2 ** 32, 0, Mode.RUN, 0, (0,), (values or (0, 0),))


def instants(late, begin=0, drift=1.0):
    """Return how far off the instants are that a clock gives for states that are so late [s]."""
    clock, found = DeviceClock(), []
    for k, more in enumerate(late):
        true = 7.0 + k * PERIOD_US * 1e-6
        item = state(begin + round(drift * k * PERIOD_US))
        found.append(clock.measured(item, true + more) - true)
    return found


@settings(deadline=None)
@given(st.lists(st.floats(0.0, 0.02), min_size=1, max_size=400), st.integers(0, 2 ** 32 - 1))
def test_no_state_is_older_than_by_its_lateness_against_the_quickest_of_late(late, begin):
    for k, off in enumerate(instants(late, begin)):
        assert -1e-9 <= off <= late[k] + 1e-9
        assert off <= min(late[max(0, k - 70):k + 1]) + 1e-9


def test_a_state_that_is_read_late_is_as_old_as_it_is():
    late = [0.0005] * 300
    late[250] = 0.0045
    assert instants(late) == pytest.approx([0.0005] * 300)


@pytest.mark.parametrize('drift', [0.99, 1.01])
def test_a_clock_that_is_one_percent_off_costs_two_milliseconds_at_most(drift):
    assert max(map(abs, instants([0.0005] * 3000, drift=drift))) <= 0.01 * 2.0 * WINDOW + 0.0006


def test_a_line_that_becomes_slower_for_good_is_followed():
    assert instants([0.0005] * 300 + [0.003] * 300)[-1] == pytest.approx(0.003)


def test_after_silence_the_clock_begins_again():
    clock = DeviceClock()
    assert clock.measured(state(0), 1.0) == 1.0
    assert clock.measured(state(1000), 3.0) == 3.0      # of a device that stood still
    assert between(state(2 ** 32 - 500), state(500)) == pytest.approx(1e-3)


@pytest.fixture
def moving(liar, make, monkeypatch):
    """Return a function that measures at a time a state of an instant, both after a sample [s]."""
    def give(now, instant, **parameters):
        driver, at = make(liar.port, silence=5.0, patience=30.0, fresh=4, **parameters), [100.0]
        times = SimpleNamespace(monotonic=lambda: at[0])
        driver.open()
        try:
            with monkeypatch.context() as patch:
                patch.setattr('dz_ros.drivers.serial.driver.time', times)
                patch.setattr('dz_ros.drivers.serial.board.time', times)
                for k in range(50):
                    at[0] = 100.0 + k * T
                    driver.advance(k * T, k)
                sample, at[0] = at[0], at[0] + now
                patch.setattr(driver.link, 'newest', lambda: (
                    state(0, 100, 2000), at[0], sample + instant))      # 0.1 rad, 2 rad/s
                patch.setattr(driver.link, 'speed', lambda motor: -1000.0)      # -1 rad/s
                return driver.measure()
        finally:
            driver.close()

    return give


@pytest.mark.parametrize(('now', 'instant', 'moved'), [
    (0.0, 0.0, 0.0), (0.0, -0.003, 0.003), (0.002, 0.001, -0.001), (0.004, -0.004, 0.004),
    (0.02, 0.019, 0.001)],      # no loop: now is meant
    ids=['at once', 'an old state', 'a late host', 'both', 'no loop'])
def test_the_position_is_that_of_the_sample(moving, now, instant, moved):
    assert moving(now, instant) == pytest.approx((0.1 + 2.0 * moved, 2.0))
    assert moving(now, instant, extrapolate='false') == pytest.approx((0.1, 2.0))
    assert moving(now, instant, measured=1) == pytest.approx((0.1 - moved,))


def test_it_is_brought_no_further_than_a_measurement_may_be_old():
    rule = Freshness(0.01)
    assert rule.advanced(1.0, 2.0, 0.5) == pytest.approx(1.02)
    assert rule.advanced(1.0, 2.0, -0.5) == pytest.approx(0.98)
    assert rule.advanced(1.0, float('nan'), 0.01) == 1.0


def test_the_speed_of_a_position_is_by_the_device_s_clock_over_four_samples(liar, make, until):
    def moves(frame):
        x = frame.time_us // 1000 % 1000000
        return [State(frame.session, frame.seq, frame.time_us, frame.echo, frame.mode, frame.trips,
                      frame.faults, ((x, 0),))]

    liar.change = moves
    driver = make(liar.port, measured=1, silence=5.0, patience=30.0, fresh=400)
    driver.open()
    try:
        seen = driver.link.counts['states']
        until(lambda: driver.link.counts['states'] > seen + 100)
        speeds = [driver.link.speed(0) for _ in range(5)]
    finally:
        driver.close()
    assert speeds == pytest.approx([1000.0] * 5, rel=0.06)        # a count a ms, rounded down

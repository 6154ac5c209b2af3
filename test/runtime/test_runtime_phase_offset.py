# SPDX-License-Identifier: Apache-2.0
"""Subscribed at a phase offset to the ticks, on a simulated clock."""

import pytest

from dz_ros.runtime.phase_offset import (
    collecting_time,
    MIDDLE_SHARE,
    OFFSET_SHARE,
    PhaseOffset,
    TICK_MAX_AGE,
    TICKS_PER_LEARNING,
    until_middle,
)

T = 0.005


class World:
    """A clock, and ticks that come at offset + k T (1 + skew); receives them as a node would."""

    def __init__(self, offset=100.0, skew=0.0):
        self.now = 0.0
        self.offset, self.skew = offset, skew
        self.offset_clock = PhaseOffset(T, lambda: self.now, self.sleep)

    def sleep(self, seconds):
        assert seconds > 0.0
        self.now += seconds

    def ticks(self, numbers):
        """Return how long after it had come each tick was received; only the newest is kept."""
        late = []
        for k in numbers:
            comes, follows = (self.offset + i * T * (1.0 + self.skew) for i in (k, k + 1))
            if self.now >= follows:
                continue
            self.now = max(self.now, comes) + 1e-5      # the callback itself
            late.append(self.now - comes)
            self.offset_clock.received(k * T, self.now)
            self.offset_clock.rest()
        return late


@pytest.mark.parametrize('skew', [0.0, 1e-4, -1e-4])
def test_ticks_are_received_a_share_of_a_period_late_whatever_the_other_clock(skew):
    late = World(skew=skew).ticks(range(3000))[10:]
    met = sum(OFFSET_SHARE * T * 0.5 < item < OFFSET_SHARE * T * 1.5 for item in late)
    assert met > 0.99 * len(late)
    waited = sum(item < 0.1 * T for item in late)
    assert waited >= len(late) // TICKS_PER_LEARNING - 1    # it goes on learning
    assert max(late) < (OFFSET_SHARE + 0.1) * T


def test_a_clock_that_restarts_is_followed():
    world = World()
    world.ticks(range(100))
    world.now += 3.0
    world.offset = world.now + 0.001
    late = world.ticks(range(100))
    assert max(late[5:]) < (OFFSET_SHARE + 0.1) * T


def test_ticks_that_stop_are_waited_for():
    world = World()
    world.ticks(range(50))
    begin = world.now
    world.offset_clock.rest()      # nothing was received since: no sleep
    assert world.now == begin


@pytest.mark.parametrize('share', [0.2, 0.6, 1.0, 7.3])
def test_a_process_held_up_finds_back(share):
    world = World()
    world.ticks(range(50))
    world.now += share * T
    late = world.ticks(range(50, 50 + 3 * TICKS_PER_LEARNING))
    assert max(late[4:]) < (OFFSET_SHARE + 0.1) * T
    assert len(late) > 3 * TICKS_PER_LEARNING - 12


@pytest.mark.parametrize('least', [0.0, 0.001, 0.05, 0.0512])
@pytest.mark.parametrize('tick', [7.0, 9.9, 10.0, 10.003, 12.0])
@pytest.mark.parametrize('now', [10.0, 10.001, 10.00499])
def test_work_for_several_ticks_begins_between_two_of_them(now, tick, least):
    pause = until_middle(now, tick, T, least)
    assert least - 1e-9 <= pause <= least + T
    share = (now + pause - tick) / T % 1.0
    assert share == pytest.approx(MIDDLE_SHARE, abs=1e-6)


@pytest.mark.parametrize(('rate', 'samples'), [
    (1.0, None), (10.0, None), (20.0, 1), (200.0, 10), (500.0, 5), (1000.0, 2.5), (2000.0, 2),
    (10_000.0, None)])
def test_a_turn_fits_between_two_ticks_where_there_is_room(rate, samples):
    period = 1.0 / rate
    pauses = [collecting_time(10.0 + 0.1 * k * period, 10.0, period, 6e-5, 0.001, 0.05)
              for k in range(10)]
    if samples is None:                                 # no time between two ticks to speak of
        assert pauses == [0.05 if rate < 100.0 else 0.001] * 10
        return
    for k, pause in enumerate(pauses):
        assert samples * period <= pause + 1e-9 <= (samples + 1.5) * period
        assert (0.1 * k + pause / period) % 1.0 == pytest.approx(MIDDLE_SHARE, abs=1e-6)


def test_a_tick_of_long_ago_or_to_come_reports_nothing():
    for tick in (10.0 - 1.1 * TICK_MAX_AGE, 10.0 + 1.1 * TICK_MAX_AGE, -1.7e9):
        assert collecting_time(10.0, tick, T, 6e-5, 0.001, 0.05) == 0.05

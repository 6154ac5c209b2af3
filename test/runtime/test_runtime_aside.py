"""Listening beside a beat, on a simulated clock."""

import pytest

from dz_ros.runtime.aside import Aside, EVERY, FRESH, MIDDLE, SHARE, turn, until_middle

T = 0.005


class World:
    """A clock, and beats that come at offset + k T (1 + skew); hears them as a node would."""

    def __init__(self, offset=100.0, skew=0.0):
        self.now = 0.0
        self.offset, self.skew = offset, skew
        self.aside = Aside(T, lambda: self.now, self.sleep)

    def sleep(self, seconds):
        assert seconds > 0.0
        self.now += seconds

    def beats(self, numbers):
        """Return how long after it had come each beat was heard; only the newest is kept."""
        late = []
        for k in numbers:
            comes, follows = (self.offset + i * T * (1.0 + self.skew) for i in (k, k + 1))
            if self.now >= follows:
                continue
            self.now = max(self.now, comes) + 1e-5      # the callback itself
            late.append(self.now - comes)
            self.aside.heard(k * T, self.now)
            self.aside.rest()
        return late


@pytest.mark.parametrize('skew', [0.0, 1e-4, -1e-4])
def test_beats_are_heard_a_share_of_a_period_late_whatever_the_other_clock(skew):
    late = World(skew=skew).beats(range(3000))[10:]
    met = sum(SHARE * T * 0.5 < item < SHARE * T * 1.5 for item in late)
    assert met > 0.99 * len(late)
    assert sum(item < 0.1 * T for item in late) >= len(late) // EVERY - 1   # it goes on learning
    assert max(late) < (SHARE + 0.1) * T


def test_a_clock_that_starts_anew_is_followed():
    world = World()
    world.beats(range(100))
    world.now += 3.0
    world.offset = world.now + 0.001
    late = world.beats(range(100))
    assert max(late[5:]) < (SHARE + 0.1) * T


def test_beats_that_stop_are_waited_for():
    world = World()
    world.beats(range(50))
    begin = world.now
    world.aside.rest()      # nothing was heard since: no sleep
    assert world.now == begin


@pytest.mark.parametrize('share', [0.2, 0.6, 1.0, 7.3])
def test_a_process_held_up_finds_back(share):
    world = World()
    world.beats(range(50))
    world.now += share * T
    late = world.beats(range(50, 50 + 3 * EVERY))
    assert max(late[4:]) < (SHARE + 0.1) * T
    assert len(late) > 3 * EVERY - 12


@pytest.mark.parametrize('least', [0.0, 0.001, 0.05, 0.0512])
@pytest.mark.parametrize('beat', [7.0, 9.9, 10.0, 10.003, 12.0])
@pytest.mark.parametrize('now', [10.0, 10.001, 10.00499])
def test_work_for_several_beats_begins_between_two_of_them(now, beat, least):
    pause = until_middle(now, beat, T, least)
    assert least - 1e-9 <= pause <= least + T
    share = (now + pause - beat) / T % 1.0
    assert share == pytest.approx(MIDDLE, abs=1e-6)


@pytest.mark.parametrize(('rate', 'samples'), [
    (1.0, None), (10.0, None), (20.0, 1), (200.0, 10), (500.0, 5), (1000.0, 2.5), (2000.0, 2),
    (10_000.0, None)])
def test_a_turn_fits_between_two_beats_where_there_is_room(rate, samples):
    period = 1.0 / rate
    pauses = [turn(10.0 + 0.1 * k * period, 10.0, period, 6e-5, 0.001, 0.05) for k in range(10)]
    if samples is None:                                 # no time between two beats to speak of
        assert pauses == [0.05 if rate < 100.0 else 0.001] * 10
        return
    for k, pause in enumerate(pauses):
        assert samples * period <= pause + 1e-9 <= (samples + 1.5) * period
        assert (0.1 * k + pause / period) % 1.0 == pytest.approx(MIDDLE, abs=1e-6)


def test_a_beat_of_long_ago_or_to_come_tells_nothing():
    for beat in (10.0 - 1.1 * FRESH, 10.0 + 1.1 * FRESH, -1.7e9):
        assert turn(10.0, beat, T, 6e-5, 0.001, 0.05) == 0.05

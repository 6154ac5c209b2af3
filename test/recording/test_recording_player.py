# SPDX-License-Identifier: Apache-2.0
"""Replay without ROS, on a clock of the test's own: what is due when, in which order."""

from hypothesis import given
from hypothesis import strategies as st
import pytest

from dz_ros.errors import ConfigurationError, RecordingError
from dz_ros.recording.cdr import encode_string
from dz_ros.recording.channels import TEXT
from dz_ros.recording.mcap_file import McapFile
from dz_ros.recording.messages import Message
from dz_ros.recording.player import Player, READ_AHEAD
from dz_ros.recording.run_source import open_source
from dz_ros.recording.writer import RunWriter

FIRST = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


class Clock:
    def __init__(self):
        self.now = 77

    def __call__(self):
        return self.now


def messages(*offsets, topic='/state'):
    """Messages logged at these offsets [s], numbered in their payload."""
    return [Message(topic, b'%d' % i, FIRST + round(offset * SECOND), 0)
            for i, offset in enumerate(offsets)]


def player_of(items, clock, batch=3, **options):
    batches = [items[i:i + batch] for i in range(0, len(items), batch)]
    player = Player(lambda since: iter(batches), clock=clock, **options)
    player.begin()
    return player


def play(player, clock, limit=1000):
    """Jump from deadline to deadline; return (instant [ns], payload) of everything played."""
    found = []
    while not player.finished and len(found) < limit:
        while player.low and player.due_ns is None:
            player.read_ahead()
        if player.due_ns is None:
            break
        clock.now = max(clock.now, player.due_ns)
        message = player.take()
        assert message is not None
        found.append((clock.now, int(message.payload)))
    return found


@given(st.lists(st.integers(0, 10**12), min_size=1, max_size=40),
       st.floats(0.01, 100.0), st.integers(1, 7))
def test_order_is_that_of_the_recording_and_deadlines_are_absolute(times, rate, batch):
    items = [Message('/t', b'%d' % i, FIRST + time, 0) for i, time in enumerate(times)]
    clock = Clock()
    found = play(player_of(items, clock, batch, rate=rate), clock)
    assert [number for _, number in found] == list(range(len(times)))
    latest = 0
    for (instant, _), time in zip(found, times, strict=True):
        latest = max(latest, time)      # a log whose clock stepped back stands still
        assert instant - 77 == pytest.approx((latest - times[0]) / rate, abs=1.0, rel=1e-12)


def test_messages_of_the_same_time_keep_their_order_across_chunks():
    clock = Clock()
    found = play(player_of(messages(*[0.5] * 10), clock, batch=4), clock)
    assert found == [(77, i) for i in range(10)]


def test_a_late_message_does_not_move_the_ones_behind_it():
    clock = Clock()
    player = player_of(messages(0.0, 0.1, 0.2, 0.3), clock)
    assert player.take() is not None
    assert player.take() is None
    clock.now = 77 + round(0.25 * SECOND)
    assert [player.take().payload for _ in range(2)] == [b'1', b'2']
    assert player.take() is None
    assert player.due_ns == 77 + round(0.3 * SECOND)
    assert player.late == 2
    assert player.worst_ns == round(0.15 * SECOND)


def test_start_duration_and_topics_choose():
    items = messages(*[0.1 * i for i in range(20)])
    items[::2] = [item._replace(topic='/command') for item in items[::2]]
    clock = Clock()
    player = player_of(items, clock, start=0.5, duration=0.7, topics=('/state',))
    assert play(player, clock) == [(77 + round(0.1 * i * SECOND) - SECOND // 2, i)
                                   for i in (5, 7, 9, 11)]
    assert player.finished


def test_both_ends_of_the_chosen_part_belong_to_it():
    clock = Clock()
    player = player_of(messages(0.0, 1.0, 2.0, 2.0, 2.0, 3.0), clock, batch=1, start=1.0,
                       duration=1.0)
    assert [number for _, number in play(player, clock)] == [1, 2, 3, 4]


@pytest.mark.parametrize(('options', 'error'), [
    ({'start': 5.0}, RecordingError), ({'topics': ('/none',)}, RecordingError),
    ({'rate': 0.0}, ConfigurationError), ({'rate': -1.0}, ConfigurationError),
    ({'rate': float('nan')}, ConfigurationError), ({'rate': float('inf')}, ConfigurationError),
    ({'start': -1.0}, ConfigurationError), ({'duration': float('inf')}, ConfigurationError),
])
def test_nothing_to_play_and_numbers_that_cannot_be(options, error):
    with pytest.raises(error) as caught:
        Player(lambda since: [messages(0.0, 1.0)], **options)
    assert '\n' not in str(caught.value)


def test_an_empty_run_has_nothing_to_play():
    with pytest.raises(RecordingError, match='nothing to play'):
        Player(lambda since: [])


def test_laps_of_a_loop_follow_each_other_without_drift():
    clock = Clock()
    player = player_of(messages(0.0, 0.25, 1.0), clock, loop=True)
    found = play(player, clock, limit=10)
    assert found == [(77 + lap * SECOND + round(offset * SECOND), number)
                     for lap in range(4) for number, offset in enumerate((0.0, 0.25, 1.0))][:10]
    assert not player.finished
    assert player.time_ns == FIRST


def test_laps_of_a_part_last_as_long_as_the_part():
    clock = Clock()
    player = player_of(messages(0.0, 0.2, 1.0, 5.0), clock, loop=True, start=0.1, duration=2.0,
                       rate=2.0)
    assert [instant - 77 for instant, _ in play(player, clock, limit=4)] == [
        round(0.05 * SECOND), round(0.45 * SECOND), round(1.05 * SECOND), round(1.45 * SECOND)]


def test_a_loop_of_one_instant_takes_time_all_the_same():
    clock = Clock()
    player = player_of(messages(3.0), clock, loop=True)
    assert play(player, clock, limit=50)[-1][0] >= 77 + 49 * 1_000_000


def test_pause_holds_time_and_resume_goes_on_from_there():
    clock = Clock()
    player = player_of(messages(0.0, 1.0), clock)
    player.take()
    clock.now += round(0.4 * SECOND)
    player.pause()
    clock.now += 100 * SECOND
    assert player.offset == pytest.approx(0.4)
    assert player.due_ns is None
    assert player.take() is None
    player.pause()
    player.resume()
    player.resume()
    assert player.due_ns == clock.now + round(0.6 * SECOND)
    assert not player.late


def test_steps_are_single_messages_and_only_while_paused():
    clock = Clock()
    player = player_of(messages(0.0, 1.0, 2.0), clock, batch=1, paused=True)
    clock.now += 50 * SECOND
    assert player.step().payload == b'0'
    assert player.step().payload == b'1'
    assert player.offset == 1.0
    player.resume()
    assert player.step() is None
    assert player.due_ns == clock.now + SECOND
    player.pause()
    assert player.step().payload == b'2'
    assert player.step() is None
    assert not player.finished          # it is held: an operator may seek
    assert player.seek(FIRST + SECOND)
    assert player.step().payload == b'1'


@pytest.mark.parametrize('batch', [1, 2, 50])
def test_seek_goes_both_ways(batch):
    clock = Clock()
    player = player_of(messages(*[0.1 * i for i in range(30)]), clock, batch)
    clock.now += SECOND
    assert player.seek(FIRST + round(2.05 * SECOND))
    assert player.due_ns == clock.now + round(0.05 * SECOND)
    assert [number for _, number in play(player, clock)] == list(range(21, 30))
    assert player.seek(FIRST - 5)
    assert player.time_ns == FIRST
    assert [number for _, number in play(player, clock)] == list(range(30))
    assert not player.seek(FIRST + 3 * SECOND)
    assert player.finished


def test_seeking_behind_the_end_of_a_loop_begins_the_next_lap():
    clock = Clock()
    player = player_of(messages(0.0, 1.0), clock, loop=True)
    player.seek(FIRST + 9 * SECOND)
    assert play(player, clock, limit=2)[0] == (77, 0)


def test_the_rate_changes_from_now_on():
    clock = Clock()
    player = player_of(messages(0.0, 1.0, 2.0), clock)
    player.take()
    clock.now += round(0.5 * SECOND)
    player.set_rate(0.25)
    assert player.offset == pytest.approx(0.5)
    assert player.due_ns == clock.now + 2 * SECOND
    with pytest.raises(ConfigurationError, match='rate'):
        player.set_rate(0.0)
    assert player.rate == 0.25


def test_nothing_moves_before_the_beginning():
    clock = Clock()
    player = Player(lambda since: [messages(0.0, 1.0)], clock=clock)
    clock.now += SECOND
    assert player.take() is None
    assert player.offset == 0.0
    player.begin()
    assert player.take().payload == b'0'


def test_no_more_is_read_than_is_needed():
    read = 0

    def batches(since):
        nonlocal read
        for i in range(1000):
            read += 1
            yield [Message('/t', b'%d' % (100 * i + j), FIRST + (100 * i + j) * 10, 0)
                   for j in range(100)]

    clock = Clock()
    player = Player(batches, clock=clock)
    player.begin()
    assert read <= READ_AHEAD // 100 + 1            # once to find the first message
    for _ in range(50_000):
        if player.low:
            player.read_ahead()
        clock.now = max(clock.now, player.due_ns)
        player.take()
    assert read <= 500 + READ_AHEAD // 100 + 2


@pytest.mark.parametrize('offset', [0.0, 0.001, 7.3, 59.999, 60.0, 61.0])
def test_seeking_in_a_file_skips_what_it_need_not_read(tmp_path, offset, monkeypatch):
    run = tmp_path / 'run'
    with RunWriter(run, {}, {}) as writer:
        writer.add_topic('/events', TEXT.name)
        for i in range(6001):
            back = 3 * SECOND if i % 500 == 499 else 0      # now and then the clock steps back
            writer.write('/events', encode_string(f'{i} {"x" * 250}'),
                         FIRST + i * SECOND // 100 - back, 0)
    read = []
    contents = McapFile._contents
    monkeypatch.setattr(McapFile, '_contents', lambda self, data: read.append(len(data))
                        or contents(self, data))
    clock = Clock()

    def played(open_batches):
        read.clear()
        player = Player(open_batches, clock=clock)
        player.begin()
        read.clear()
        player.seek(FIRST + round(offset * SECOND))
        found = []
        while player.low:
            player.read_ahead()
        while player.due_ns is not None:
            clock.now = player.due_ns
            found.append(player.take())
            while player.low:
                player.read_ahead()
        return found, sum(read)

    some, skipping = played(lambda since: open_source(run).batches(since))
    everything, plain = played(lambda since: open_source(run).batches())
    assert some == everything
    assert skipping <= plain * (1.1 - offset / 61.0)

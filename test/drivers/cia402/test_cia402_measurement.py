# SPDX-License-Identifier: Apache-2.0
"""Answers to SYNC: joined whatever their order, followed across wraps, refused where untrue."""

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from dz_ros.drivers.cia402.measurement import (
    Answers,
    FOLLOWS,
    FROZEN,
    LIVE,
    Position,
    REPEATED,
    Repeats,
)
from dz_ros.drivers.cia402.scaling import WHOLE, wrapped
from dz_ros.drivers.cia402.states import INTERNAL_LIMIT

T = 0.005
IN_TIME, LATE, LOST = 'in time', 'late', 'lost'


@pytest.mark.parametrize('order', [(0, 1), (1, 0)])
def test_a_sample_is_complete_in_either_order_and_once(order):
    answers = Answers(2)
    for k in range(10):
        answers.sync(k * T)
        first, second = order
        assert answers.take(first, (first, k)) is None
        assert answers.take(second, (second, k)) == (k * T, [(0, k), (1, k)])
        assert answers.take(first, (first, k)) is None


def test_nothing_is_an_answer_before_the_first_sync():
    answers = Answers(1)
    assert answers.take(0, (1,)) is None


def test_position_and_velocity_of_different_syncs_are_never_joined():
    """The velocity of one SYNC is lost, the position of the next one comes before its own."""
    answers = Answers(2)
    answers.sync(0.0)
    assert answers.take(0, (0,)) is None
    answers.sync(T)
    assert answers.take(1, (1,)) is None
    assert answers.take(0, (1,)) is None        # whether that velocity was late is not known


def fate(words):
    """Return one fate for each SYNC: faults are single, with calm after them."""
    found = []
    for calm, what in words:
        found += [IN_TIME] * (4 + calm) + what
    return found + [IN_TIME] * 6


fates = st.lists(st.tuples(st.integers(0, 5), st.sampled_from(
    ([LATE], [LATE, LATE], [LOST], []))), min_size=1, max_size=6).map(fate)


@settings(deadline=None, max_examples=3 * settings.default.max_examples)
@given(fates, fates, st.booleans())
def test_a_sample_holds_answers_to_one_sync_only(position, velocity, swapped):
    answers, received = Answers(2), []
    streams = [position, velocity]
    number = min(map(len, streams))
    for k in range(number):
        answers.sync(k * T)
        for stream in (1, 0) if swapped else (0, 1):
            due = [k - 1] if k and streams[stream][k - 1] == LATE else []
            due += [k] if streams[stream][k] == IN_TIME else []
            for item in due:
                found = answers.take(stream, (item,))
                if found is not None:
                    received.append(found)
    for synced_at, values in received:
        assert {round(synced_at / T)} == {value for (value,) in values}
    undisturbed = [k for k in range(3, number) if all(
        fates_[j] == IN_TIME for fates_ in streams for j in range(k - 3, k + 1))]
    assert set(undisturbed) <= {round(synced_at / T) for synced_at, _ in received}


def test_two_nodes_that_answer_are_counted_and_one_late_answer_is_not():
    answers = Answers(1)
    for k in range(REPEATED + 1):
        answers.sync(k * T)
        answers.take(0, (k,))
        answers.take(0, (k,))
    assert answers.repeated == REPEATED
    answers = Answers(1)
    for k in range(200):            # every tenth answer is late, by four SYNCs
        answers.sync(k * T)
        for _ in range({6: 0, 0: 2}.get(k % 10, 1) if k else 1):
            answers.take(0, (k,))
        assert answers.repeated == 0


@settings(deadline=None)
@given(st.sampled_from([2 ** 16, 3600, 65536 * 3, 2 ** 24, WHOLE]), st.integers(0, 2 ** 31),
       st.lists(st.floats(-0.4, 0.4), max_size=60), st.booleans())
def test_a_counter_is_followed_across_its_end(modulus, start, turns, measured):
    """Speeds of up to 0.4 of the counter in a sample, changing as they like where measured."""
    turn = float(min(modulus, 65536))
    follow, true, speed = Position(turn, modulus), start % modulus, 0.0
    assert follow.follow(true, 0.0, 0.0)[0] == true
    for k, share in enumerate(turns, 1):
        before, speed = speed, share * turn / T if measured else 0.05 * turn / T
        true += round(0.5 * (before + speed) * T)
        sent = true % modulus if modulus < WHOLE else wrapped(true)
        assert follow.follow(sent, speed if measured else float('nan'), k * T) == (true, '')
    follow.forget()
    assert follow.follow(7, 0.0, 99.0) == (7, '')


def test_a_counter_that_ends_earlier_than_was_reported_is_a_jump():
    follow = Position(65536.0)
    assert follow.follow(65000, 1e5, 0.0)[1] == ''
    counts, wrong = follow.follow(65500 - 65536, 1e5, T)
    assert counts is None
    assert 'jumps by -65036 counts where the velocity gives 500' in wrong
    assert 'driver.position_range' in wrong
    assert follow.lost
    assert follow.follow(500, 1e5, 2 * T) == (None, '')     # reported once, never believed again


def test_a_narrow_counter_is_not_followed_blindly():
    for speed, passed, lost in ((0.0, 0.4, False), (5e3, 0.4, False), (5e4, 0.4, True),
                                (0.0, 6.0, True)):
        follow = Position(65536.0, 65536)
        follow.follow(100, speed, 0.0)
        counts, wrong = follow.follow(round(100 + speed * passed) % 65536, speed, passed)
        assert follow.lost is lost
        assert (counts is None) is lost
        assert wrong.startswith(f'no position for {passed:.2f} s: a counter of 65536') is lost
    wide = Position(65536.0)
    wide.follow(100, 5e4, 0.0)
    assert wide.follow(100 + 300_000, 5e4, 6.0) == (300_100, '')


def again(repeats, answers, speed=0.0, target=lambda _k: 0, number=2 * FROZEN):
    """Return what is reported of one answer that comes again and again."""
    reported = [repeats.look(answers, speed, k * T, target(k)) for k in range(number)]
    assert not any(reported[:FROZEN])
    return reported[-1]


def test_the_same_answer_again_and_again_while_it_reports_that_it_moves():
    repeats = Repeats(100.0)
    assert again(repeats, [(39, 1), (3, 0)], 3000.0) == (
        'the drive repeats one answer: its position stands still at a velocity of 3000 counts/s')
    assert repeats.look([(39, 2), (3, 0)], 3000.0, 1.0, 0) == ''         # another one
    assert again(repeats, [(39, 3), (0, 0)], 0.0, number=1000) == ''       # it stands
    assert again(repeats, [(39, 4)], float('nan'), number=1000) == ''      # unknown


def test_the_same_answer_again_and_again_while_the_target_changes():
    repeats, swinging = Repeats(100.0), lambda k: 300 * (k % 2)
    assert again(repeats, [(39, 1), (0, 0)], target=swinging) == ''        # it reports no torque
    for torque in range(LIVE):
        repeats.look([(39, 1), (0, torque)], 0.0, 0.0, torque)
    assert again(repeats, [(39, 1), (0, 77)], target=lambda k: 50 * (k % 2)) == ''
    assert again(repeats, [(39, 1), (0, 78)], target=swinging) == (
        'the drive repeats one answer: its torque does not change where the target goes from 0 '
        'to 300')
    for torque in range(LIVE):
        repeats.look([(39, 1), (0, torque)], 0.0, 0.0, torque)
    assert again(repeats, [(39 | INTERNAL_LIMIT, 1), (0, 79)], target=swinging) == ''


def test_a_target_that_was_just_given_may_be_later_than_the_answered_sync():
    repeats = Repeats(100.0)
    for torque in range(LIVE):
        repeats.look([(39, 1), (0, torque)], 0.0, 0.0, torque)
    assert again(repeats, [(39, 2), (0, 0)], number=10 * FROZEN) == ''
    seen = [repeats.look([(39, 2), (0, 0)], 0.0, 1.0, 300) for _ in range(FOLLOWS)]
    assert not any(seen[:-1])
    assert seen[-1].startswith('the drive repeats one answer')

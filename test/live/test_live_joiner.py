# SPDX-License-Identifier: Apache-2.0
"""Rows out of messages: whole, in order, each once, whatever order the messages come in."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.live import joiner as joiner_module
from dz_ros.live.columns import DERIVED, Layout
from dz_ros.live.joiner import Joiner, ROW_WAIT
from dz_ros.live.node_configurations import labels_of

CONFIGURATION = Configuration.from_flat({})
LABELS = labels_of(CONFIGURATION)
LAYOUT = Layout(LABELS)
NAMES = {'state': 'x0', 'reference': 'xd0', 'command': 'v', 'terms': 's', 'truth': 'w'}


def message(topic, seq, value):
    """Return the numbers of a message that belongs to state `seq`, one field of them `value`."""
    numbers = dict.fromkeys(LABELS[topic], 0.0)
    numbers.update(seq=float(seq), stamp=0.005 * seq)
    if topic in ('command', 'terms'):       # their own seq counts something else
        numbers.update(seq=float(seq + 7), echo_seq=float(seq))
    numbers[NAMES[topic]] = value
    return tuple(numbers.values())


def put(joiner, topic, seq, value=1.0, now=0.0):
    joiner.put(topic, message(topic, seq, value), 1e9 + 0.005 * seq, now)


def column(rows, name):
    return [row[LAYOUT.place(name)] for row in rows]


def test_columns_are_those_of_the_records():
    assert LAYOUT.names[:3] == ('seq', 'stamp', 'published')
    assert LAYOUT.names[-len(DERIVED):] == DERIVED
    assert LAYOUT.width == LAYOUT.base + len(DERIVED) == len(set(LAYOUT.names))
    assert not any(name.endswith('_before') for name in LAYOUT.names)
    for topic, part in LAYOUT.parts.items():
        for offset, (name, pick) in enumerate(zip(part.names, part.picks, strict=True)):
            assert LABELS[topic][pick] == name == LAYOUT.names[part.start + offset]


def test_units_follow_the_plant():
    c = Configuration.from_flat({'plant.model': 'servo'})
    units = {item['name']: item['unit'] for item in Layout(labels_of(c)).describe(c)}
    assert (units['x0'], units['error'], units['s'], units['v'], units['w']) == (
        'rad', 'rad', 'rad/s', 'A', 'A')
    assert units['round_trip'] == units['interval'] == 's'
    assert {item['unit'] for item in Layout({}).describe(None)} == {'', 's'}


def test_a_row_comes_when_it_is_whole_and_not_before():
    joiner = Joiner(LAYOUT)
    for topic in NAMES:     # each topic has been received once, so that it is waited for
        put(joiner, topic, 0)
    assert len(joiner.take(0.0)) == 1
    put(joiner, 'state', 1, 3.0)
    for topic in ('reference', 'command', 'terms'):
        put(joiner, topic, 1, 4.0)
    assert joiner.take(0.01) == []
    put(joiner, 'truth', 1, 5.0)
    rows = joiner.take(0.01)
    assert [column(rows, name) for name in ('x0', 'xd0', 'v', 's', 'w')] == [
        [3.0], [4.0], [4.0], [4.0], [5.0]]
    assert column(rows, 'seq') == [1.0]
    assert column(rows, 'published') == [1e9 + 0.005]


def test_a_row_that_will_not_become_whole_comes_with_what_it_has():
    joiner = Joiner(LAYOUT)
    for topic in NAMES:
        put(joiner, topic, 0)
    put(joiner, 'state', 1)
    assert column(joiner.take(0.5 * ROW_WAIT), 'seq') == [0.0]
    rows = joiner.take(1.01 * ROW_WAIT)
    assert column(rows, 'seq') == [1.0]
    assert all(map(math.isnan, column(rows, 'v')))


def test_a_topic_that_has_fallen_silent_is_not_waited_for():
    joiner = Joiner(LAYOUT)
    for topic in NAMES:
        put(joiner, topic, 0)
    joiner.take(0.0)
    later = joiner_module.ALIVE + 1.0
    put(joiner, 'state', 1, now=later)
    assert column(joiner.take(later), 'seq') == [1.0]


def test_the_first_answer_to_a_state_is_the_one_shown():
    joiner = Joiner(LAYOUT)
    put(joiner, 'state', 0)
    put(joiner, 'command', 0, 1.0)
    put(joiner, 'command', 0, 2.0)
    assert column(joiner.take(1.0), 'v') == [1.0]


def test_gaps_are_counted_and_a_new_start_is_noticed():
    joiner = Joiner(LAYOUT)
    for seq in (0, 1, 5):
        put(joiner, 'state', seq)
    assert (joiner.lost, joiner.newest, joiner.restarted) == (3, 5, False)
    put(joiner, 'state', 5)         # repeated without an answer
    assert not joiner.restarted
    put(joiner, 'state', 0)
    assert joiner.restarted


def test_messages_of_nonsense_change_nothing():
    joiner = Joiner(LAYOUT)
    put(joiner, 'state', 0)
    for seq in (math.nan, math.inf, -math.inf):
        joiner.put('command', (0.0, 0.0, 1.0, seq, 0.0, 0.0), 0.0, 0.0)
    put(joiner, 'command', -4)
    put(joiner, 'command', 10 ** 12)
    rows = joiner.take(1.0)
    assert column(rows, 'seq') == [0.0]
    assert math.isnan(column(rows, 'v')[0])


@pytest.mark.parametrize(('seq', 'stamp'), [
    (5e9, 0.5), (2.0, math.nan), (2.0, math.inf), (1e300, 1.0), (2.5, 0.0125), (-3.0, 0.0),
    (2.0 ** 60, 1.0)])
def test_one_state_of_nonsense_does_not_make_the_later_ones_look_old(seq, stamp):
    joiner = Joiner(LAYOUT)
    put(joiner, 'state', 0)
    put(joiner, 'state', 1)
    put(joiner, 'reference', 2)
    joiner.put('state', (seq, stamp, *message('state', 0, 0.0)[2:]), 0.0, 0.0)
    put(joiner, 'state', 2)
    put(joiner, 'state', 3)
    assert (joiner.newest, joiner.restarted, joiner.lost) == (3, False, 0)
    assert joiner.stamp == pytest.approx(0.015)
    assert column(joiner.take(1.0), 'seq') == [0.0, 1.0, 2.0, 3.0]


def test_a_first_state_of_nonsense_is_found_out():
    joiner = Joiner(LAYOUT)
    joiner.put('state', (5e9, 0.0, *message('state', 0, 0.0)[2:]), 0.0, 0.0)
    put(joiner, 'state', 10)
    put(joiner, 'state', 11)
    assert joiner.restarted


def test_a_long_pause_is_believed_when_a_second_state_reports_it():
    joiner = Joiner(LAYOUT)
    for seq in (0, 1, 100000, 100001, 100002):
        put(joiner, 'state', seq)
    assert (joiner.newest, joiner.restarted) == (100002, False)
    assert column(joiner.take(1.0), 'seq') == [0.0, 1.0, 100001.0, 100002.0]


@given(st.permutations([(topic, seq) for topic in NAMES for seq in range(6)]))
def test_any_order_of_arrival_gives_the_same_rows(order):
    joiner = Joiner(LAYOUT)
    for topic, seq in order:
        put(joiner, topic, seq, value=10.0 * seq + list(NAMES).index(topic))
    rows = joiner.take(1.0)
    first = [seq for topic, seq in order if topic == 'state']
    if first != sorted(first):      # a state that came before an earlier one looks like a restart
        assert joiner.restarted
        return
    assert column(rows, 'seq') == [float(seq) for seq in range(6)]
    for place, name in enumerate(NAMES.values()):
        assert column(rows, name) == [10.0 * seq + place for seq in range(6)]


@pytest.mark.parametrize('topic', ['command', 'terms', 'reference', 'truth'])
def test_answers_to_states_that_never_come_are_forgotten(topic, monkeypatch):
    monkeypatch.setattr(joiner_module, 'MAX_ROWS', 50)
    joiner = Joiner(LAYOUT)
    for seq in range(2000):
        if seq % 2:
            put(joiner, 'state', seq)
        put(joiner, topic, seq)
        joiner.take(0.0)
    assert len(joiner) <= 101
    assert np.isfinite(joiner.stamp)

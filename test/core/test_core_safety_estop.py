# SPDX-License-Identifier: Apache-2.0
"""The record of the publishers that press the e-stop, against a list that forgets nothing."""

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from dz_ros.core.safety.estop import MAX_REMEMBERED, NOT_NUMBERED, Presses

A, B = b'a' * 16, b'b' * 16


def test_the_release_of_one_does_not_free_what_another_presses():
    presses = Presses()
    assert presses.receive(A, 1, True)
    assert not presses.receive(B, 1, False)
    assert presses.held_by({A, B}) == {A}
    assert not presses.receive(A, 2, False)
    assert presses.held_by({A, B}) == set()


def test_the_press_of_one_that_is_gone_is_held_until_it_is_asked_for():
    presses = Presses()
    presses.receive(A, 1, True)
    presses.receive(B, 1, True)
    assert presses.holders == {A, B}
    assert presses.held_by({B}) == {B}
    assert presses.held_by({A, B}) == {B}       # what is forgotten does not come back


def test_a_message_that_comes_twice_is_one_and_a_repaired_press_counts():
    presses = Presses()
    assert not presses.receive(A, 6, False)
    assert presses.receive(A, 5, True)          # lost at first, repeated later
    assert not presses.receive(A, 5, True)
    assert not presses.receive(A, 6, False)
    assert presses.held_by({A}) == set()        # its newest message is a release


def test_without_the_publisher_no_release_counts_while_any_is_there():
    presses = Presses()
    assert presses.receive(None, 0, True)
    assert not presses.receive(None, 0, False)
    assert presses.held_by({A, B}) == {A, B}
    assert presses.held_by({B}) == {B}
    assert presses.held_by(set()) == set()
    assert presses.held_by({A}) == set()


def test_without_numbers_every_press_counts_and_no_release():
    presses = Presses()
    for _ in range(3):
        assert presses.receive(A, NOT_NUMBERED, True)
        assert not presses.receive(A, NOT_NUMBERED, False)
    assert presses.held_by({A, B}) == {A, B}
    assert presses.held_by(set()) == set()


def test_memory_is_bounded_and_the_newest_press_is_remembered():
    presses = Presses()
    for number in range(3 * MAX_REMEMBERED):
        publisher = number.to_bytes(16, 'big')
        assert presses.receive(publisher, 1, True)
        assert not presses.receive(publisher, 1, True)
        presses.receive(publisher, 2, False)
    assert presses.holders == set()
    assert max(len(value) for value in vars(presses).values()
               if hasattr(value, '__len__')) <= MAX_REMEMBERED


@settings(max_examples=2 * settings.default.max_examples)
@given(st.lists(st.tuples(st.sampled_from([A, B]), st.booleans()), max_size=30), st.data())
def test_each_press_counts_once_in_whatever_order_copies_come(sent, data):
    messages, numbers = [], {A: 0, B: 0}
    for publisher, pressed in sent:
        numbers[publisher] += 1
        messages.append((publisher, numbers[publisher], pressed))
    copies = data.draw(st.permutations(messages * 3))
    presses = Presses()
    counted = [message for message in copies if presses.receive(*message)]
    assert sorted(counted) == sorted(message for message in messages if message[2])
    last = {publisher: pressed for publisher, _, pressed in messages}
    assert presses.held_by({A, B}) == {publisher for publisher in last if last[publisher]}


@pytest.mark.parametrize('publisher', [A, None])
def test_a_press_is_a_press_though_releases_surround_it(publisher):
    presses = Presses()
    found = [presses.receive(publisher, number, number == 500) for number in range(1000)]
    assert found == [number == 500 for number in range(1000)]

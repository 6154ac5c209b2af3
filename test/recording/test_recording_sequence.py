from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
import pytest

from dz_ros.recording.cdr import ArrayCodec, encode_string
from dz_ros.recording.sequence import SequenceCounter, TopicCounter


def count(numbers):
    counter = SequenceCounter()
    for number in numbers:
        counter.add(float(number))
    return counter.missing, counter.duplicates, counter.reordered, counter.restarts


@pytest.mark.parametrize(('numbers', 'expected'), [
    ([], (0, 0, 0, 0)),
    ([0, 1, 2, 3], (0, 0, 0, 0)),
    ([7, 8, 9], (0, 0, 0, 0)),                  # a recorder that came late misses nothing
    ([0, 1, 4, 5], (2, 0, 0, 0)),
    ([0, 1, 1, 2], (0, 1, 0, 0)),
    ([0, 2, 1, 3], (0, 0, 1, 0)),
    ([0, 1, 3, 4, 2, 2], (0, 1, 1, 0)),
    ([0, 1, 2, 0, 1, 2], (0, 0, 0, 1)),
    ([5, 6, 0, 2], (1, 0, 0, 1)),
    ([0, 0, 1], (0, 1, 0, 0)),
    ([0, float('nan'), 1], (0, 0, 0, 0)),
    ([0, float('inf'), 0.5, 1], (0, 0, 0, 0)),
    ([0, 1e300], (int(1e300) - 1, 0, 0, 0)),    # no list of all of them is made
])
def test_by_hand(numbers, expected):
    assert count(numbers) == expected


@given(st.lists(st.integers(1, 60), min_size=1))
def test_against_sets(numbers):
    missing, duplicates, reordered, restarts = count(numbers)
    first, highest = numbers[0], max(numbers)
    seen = {number for number in numbers if number >= first}
    assert missing == highest - first + 1 - len(seen)
    early = [number for number in numbers if number < first]
    assert duplicates == len(numbers) - len(early) - len(seen) + len(early)
    late = sum(number > first and number not in numbers[:place]
               and number < max(numbers[:place]) for place, number in enumerate(numbers) if place)
    assert reordered == late
    assert restarts == 0


def test_topic_counter_reads_seq_where_there_is_one():
    counter = TopicCounter('std_msgs/msg/Float64MultiArray', True)
    codec, other = ArrayCodec(('seq', 'stamp')), ArrayCodec(('xxx', 'stamp'))
    sizes = 0
    for payload in (codec.encode([0, 0]), codec.encode([1, 0]), other.encode([9, 9]),
                    codec.encode([3, 0]), b'garbage'):
        counter.add(payload)
        sizes += len(payload)
    found = counter.summary()
    assert (found.messages, found.bytes, found.missing, found.duplicates) == (5, sizes, 1, 0)


def test_topic_counter_leaves_text_alone():
    counter = TopicCounter('std_msgs/msg/String', False)
    for text in ('0', '5', '5'):
        counter.add(encode_string(text))
    assert counter.summary().missing == counter.summary().duplicates == 0

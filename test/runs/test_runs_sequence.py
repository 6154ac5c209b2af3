# SPDX-License-Identifier: Apache-2.0
"""Counting seq against plain loops over sets, and message by message against all at once."""

from __future__ import annotations

import math

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.runs.sequence import (
    count_sequence,
    DISORDER,
    first_of_each,
    longest_stretch,
    SequenceCounter,
    starts,
)

UNTIMED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])

NO_COUNTS = st.sampled_from([math.nan, math.inf, 0.5, 1e300, -1.0])
SEQS = st.lists(st.one_of(st.integers(1, 30).map(float), NO_COUNTS), max_size=40)
ANY = st.lists(st.one_of(st.integers(0, 8), st.integers(0, 5 * DISORDER)).map(float)
               | NO_COUNTS, max_size=40)


def one_by_one(seqs):
    counter = SequenceCounter()
    for seq in seqs:
        counter.add(float(seq))
    return counter.count()


@UNTIMED
@given(SEQS)
def test_counts_equal_a_plain_loop(seqs):
    found = count_sequence(np.array(seqs, dtype=float))
    seen, repeated, reordered, unreadable = set(), 0, 0, 0
    for seq in seqs:
        if not math.isfinite(seq) or seq != int(seq) or not 0 <= seq < 2 ** 53:
            unreadable += 1
        elif seq in seen:
            repeated += 1
        else:
            reordered += bool(seen) and seq < max(seen)
            seen.add(seq)
    missing = len(set(range(int(min(seen)), int(max(seen)) + 1)) - seen) if seen else 0
    assert (found.messages, found.missing, found.repeated, found.reordered, found.unreadable) == (
        len(seqs), missing, repeated, reordered, unreadable)
    assert found.clean == (missing == repeated == reordered == unreadable == 0)
    assert (found.first, found.last) == ((min(seen), max(seen)) if seen else (None, None))


@UNTIMED
@given(ANY)
def test_message_by_message_gives_the_same_counts(seqs):
    for end in range(len(seqs) + 1):
        assert one_by_one(seqs[:end]) == count_sequence(np.array(seqs[:end], dtype=float))


@pytest.mark.parametrize(('numbers', 'missing', 'repeated', 'reordered', 'restarts'), [
    ([], 0, 0, 0, 0),
    ([0, 1, 2, 3], 0, 0, 0, 0),
    ([7, 8, 9], 0, 0, 0, 0),                    # a recorder that came late misses nothing
    ([0, 1, 4, 5], 2, 0, 0, 0),
    ([0, 1, 1, 2], 0, 1, 0, 0),
    ([0, 2, 1, 3], 0, 0, 1, 0),
    ([0, 1, 3, 4, 2, 2], 0, 1, 1, 0),
    ([0, 1, 2, 0, 1, 2], 0, 0, 0, 1),
    ([5, 6, 0, 2], 1, 0, 0, 1),
    ([0, 0, 1], 0, 1, 0, 0),
    ([0, 1, 2, 0, 3, 4], 0, 1, 0, 0),           # 0 came again, late
    ([0, 1, 2, 0], 0, 0, 0, 1),                 # nothing contradicts it
    ([0, 1, 2, 0, 0, 1], 0, 1, 0, 1),
    ([500, 501, 7, 8, 9], 0, 0, 0, 1),          # the first ones after the restart are missing
    ([0, 300, 10, 301], 298, 0, 1, 0),
    ([0, 2.0 ** 39], 2 ** 39 - 1, 0, 0, 0),     # no list of all of them is made
])
def test_examples(numbers, missing, repeated, reordered, restarts):
    for found in (one_by_one(numbers), count_sequence(np.array(numbers, dtype=float))):
        assert (found.missing, found.repeated, found.reordered, found.restarts) == (
            missing, repeated, reordered, restarts)


def test_a_long_run_remembers_only_so_much_of_what_is_missing():
    found = one_by_one([*range(0, 60_000, 2), 1, 60_000, 59_997])
    assert (found.missing, found.reordered, found.repeated) == (29_999, 1, 1)


@UNTIMED
@given(SEQS)
def test_first_of_each_names_the_row_where_a_seq_came_first(seqs):
    distinct, rows = first_of_each(np.array(seqs, dtype=float))
    assert list(distinct) == sorted(set(distinct))
    for seq, row in zip(distinct, rows, strict=True):
        assert row == seqs.index(float(seq))


def test_a_clean_topic_is_clean():
    found = count_sequence(np.arange(7.0))
    assert found.clean
    assert found.to_dict() == {'messages': 7, 'first': 0, 'last': 6, 'missing': 0, 'repeated': 0,
                               'reordered': 0, 'unreadable': 0, 'restarts': 0}


def test_restarts_are_counted_from_the_first_message_on():
    assert starts(np.array([0, 1, 2, 0, 1, 0, 1, 2])).tolist() == [0, 0, 0, 1, 1, 1, 1, 1]
    assert starts(np.array([3, 900, 0, 1])).tolist() == [0, 0, 1, 1]
    assert starts(np.empty(0, dtype=np.int64)).tolist() == []


def test_the_longest_stretch_between_restarts_is_taken_of_every_channel(
        simulated, over_topics, keep):
    run = over_topics(simulated({'loop.duration': 2.0}))
    rows = np.concatenate([np.arange(100), np.arange(401)])
    times = np.arange(501) * 5_000_000
    again = keep(run, **dict.fromkeys(run.channels, rows))
    for channel in again.channels.values():
        channel.log_time[:] = times
    found, restarts = longest_stretch(again)
    assert restarts == 1
    for name, channel in found.channels.items():
        assert np.array_equal(channel.values, run.channels[name].values)


def test_a_repeated_first_sample_is_no_restart(simulated, keep):
    run = keep(simulated({'loop.duration': 2.0}), state=[0, 1, 0, 2, 3, 4])
    assert longest_stretch(run) == (run, 0)

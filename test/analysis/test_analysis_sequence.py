"""Counting seq against plain loops over sets."""

from __future__ import annotations

import math

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np

from dz_ros.analysis.sequence import count_sequence, first_of_each, longest_stretch

UNTIMED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])

SEQS = st.lists(st.one_of(st.integers(-5, 30).map(float),
                          st.sampled_from([math.nan, math.inf, 0.5, 1e300])), max_size=40)


@UNTIMED
@given(SEQS)
def test_counts_equal_a_plain_loop(seqs):
    found = count_sequence(np.array(seqs, dtype=float))
    seen, duplicated, reordered, unreadable = set(), 0, 0, 0
    for seq in seqs:
        if not math.isfinite(seq) or seq != int(seq) or abs(seq) > 2 ** 53:
            unreadable += 1
        elif seq in seen:
            duplicated += 1
        else:
            reordered += bool(seen) and seq < max(seen)
            seen.add(seq)
    missing = len(set(range(int(min(seen)), int(max(seen)) + 1)) - seen) if seen else 0
    assert (found.messages, found.lost, found.duplicated, found.reordered, found.unreadable) == (
        len(seqs), missing, duplicated, reordered, unreadable)
    assert found.clean == (missing == duplicated == reordered == unreadable == 0)
    assert (found.first, found.last) == ((min(seen), max(seen)) if seen else (None, None))


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
    assert found.to_dict() == {'messages': 7, 'first': 0, 'last': 6, 'lost': 0, 'duplicated': 0,
                               'reordered': 0, 'unreadable': 0}


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

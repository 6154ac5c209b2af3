# SPDX-License-Identifier: Apache-2.0
"""The ring of rows: what is kept, what a viewer gets, what it costs."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np

from dz_ros.live.history import ANSWER, CHUNK, HEAD, History, LIVE, pack

BATCHES = st.lists(st.integers(0, 40), max_size=30)


def rows_of(frame, width):
    kind, number, count, run, now = HEAD.unpack_from(frame)
    rows = np.frombuffer(frame, '<f8', offset=HEAD.size).reshape(-1, width)
    assert len(rows) == count
    return kind, number, run, now, rows


@given(st.integers(1, 50), BATCHES)
def test_the_last_rows_are_kept_in_order(capacity, sizes):
    history = History(2, capacity)
    reported = []
    for size in sizes:
        batch = np.arange(len(reported), len(reported) + size, dtype=float)
        history.append(np.column_stack([batch, -batch]))
        reported += batch.tolist()
        assert history.head == len(reported)
        assert len(history) == min(len(reported), capacity)
    kept = history.rows(0, history.head)
    assert kept[:, 0].tolist() == reported[-capacity:][:len(kept)] if reported else len(kept) == 0
    assert np.array_equal(kept[:, 1], -kept[:, 0])


@given(st.integers(1, 60), BATCHES, st.integers(1, 5))
def test_a_viewer_that_keeps_up_gets_every_row_once(capacity, sizes, every):
    history = History(1, capacity)
    cursor, got, reported = 0, [], 0
    for turn, size in enumerate(sizes):
        history.append(np.arange(reported, reported + size, dtype=float)[:, None])
        reported += size
        if turn % every == 0:
            behind = history.head - cursor
            while cursor < history.head:
                frame, cursor = history.frame(cursor, 1.5)
                kind, number, run, now, rows = rows_of(frame, 1)
                assert (kind, number, run, now) == (LIVE, 0, 0, 1.5)
                got += rows[:, 0].tolist()
            if behind <= capacity:
                assert got[len(got) - behind:] == list(range(reported - behind, reported))
    assert got == sorted(set(got))


def test_viewers_at_the_same_row_share_one_frame():
    history = History(3, 100)
    history.append(np.ones((10, 3)))
    first, _ = history.frame(4, 1.0)
    again, _ = history.frame(4, 2.0)
    assert first is again
    history.append(np.ones((1, 3)))
    assert history.frame(4, 3.0)[0] is not first


def test_a_long_past_goes_out_in_pieces():
    history = History(1, 3 * CHUNK)
    history.append(np.arange(3.0 * CHUNK)[:, None])
    cursor, sizes = history.begin(2.5 * CHUNK), []
    while cursor < history.head:
        frame, cursor = history.frame(cursor, 0.0)
        sizes.append(len(rows_of(frame, 1)[-1]))
    assert sizes == [CHUNK, CHUNK, CHUNK // 2]


def test_begin_stays_within_what_is_kept():
    history = History(1, 10)
    history.append(np.zeros((4, 1)))
    assert [history.begin(rows) for rows in (-1, 0, 3, 4, 5, 1e300)] == [4, 4, 1, 0, 0, 0]


def test_memory_is_taken_at_once():
    history = History(5, 1000)
    before = history.nbytes
    for _ in range(50):
        history.append(np.ones((333, 5)))
    assert history.nbytes == before
    assert len(history) == 1000


def test_an_answer_reports_what_it_answers():
    frame = pack(ANSWER, 77, np.array([[1.0, np.nan]]), 1, 2.5)
    kind, number, run, now, rows = rows_of(frame, 2)
    assert (kind, number, run, now) == (ANSWER, 77, 1, 2.5)
    assert rows[0, 0] == 1.0
    assert np.isnan(rows[0, 1])

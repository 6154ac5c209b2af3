# SPDX-License-Identifier: Apache-2.0
"""Log times of messages stamped by a wall clock that is stepped while they wait to be taken."""

from hypothesis import given
from hypothesis import strategies as st
import pytest

from dz_ros.recording.arrivals import Arrivals

EPOCH, MS, HOUR = 1_700_000_000_000_000_000, 1_000_000, 3_600_000_000_000
PERIOD, POLL_PERIOD = 5 * MS, 50 * MS


def recorded(step_ns, at_ns, end_ns=1000 * MS, offset=0):
    """Return (true time, log time) of messages every 5 ms, taken every 50, across a step."""
    def epoch(now):
        return EPOCH + (step_ns if now >= at_ns else 0)

    arrivals, found, taken = Arrivals(EPOCH, 0), [], 0
    for now in range(POLL_PERIOD, end_ns + 1, POLL_PERIOD):
        came = range(taken + offset, now, PERIOD)
        batch = [(epoch(t) + t, 'state', b'', t) for t in came]
        taken = (came[-1] + PERIOD - offset) if came else taken
        found += [(published, log) for log, _, _, published in arrivals.settle(
            batch, epoch(now), now - MS, now)]
    return found


def test_without_a_step_a_message_is_logged_when_it_came():
    found = recorded(0, 0)
    assert len(found) == 200
    assert all(log == EPOCH + true for true, log in found)


@pytest.mark.parametrize('step', [HOUR, -HOUR, 30 * MS, -30 * MS])
def test_a_step_moves_no_message_out_of_its_batch_and_none_after_it(step):
    found = recorded(step, 512 * MS)
    logs = [log for _, log in found]
    assert logs == sorted(logs)
    for true, log in found:
        error = abs(log - EPOCH - true)
        assert error <= (POLL_PERIOD + MS if 500 * MS <= true < 550 * MS else 0)


@given(st.integers(-10 * HOUR, 10 * HOUR), st.integers(0, 1000 * MS), st.integers(0, PERIOD - 1))
def test_any_step_at_any_time_keeps_order_and_error_bounded(step, at, offset):
    found = recorded(step, at, offset=offset)
    logs = [log for _, log in found]
    assert logs == sorted(logs)
    assert all(abs(log - EPOCH - true) <= POLL_PERIOD + MS for true, log in found)


def test_what_was_repaired_stays_in_the_order_of_its_topic():
    arrivals = Arrivals(EPOCH, 0)
    found = arrivals.settle([(EPOCH + 30, 'a', b'1', 0), (EPOCH + 20, 'a', b'2', 0),
                             (EPOCH + 25, 'b', b'3', 0)], EPOCH, 0, 100)
    assert [(log - EPOCH, payload) for log, _, payload, _ in found] == [
        (25, b'3'), (30, b'1'), (30, b'2')]


def test_a_message_without_a_stamp_came_when_it_was_taken():
    found = Arrivals(EPOCH, 0).settle([(0, 'a', b'', 0)], EPOCH, 40, 50)
    assert found[0][0] == EPOCH + 50

# SPDX-License-Identifier: Apache-2.0
"""The process that shows whether the machine was late."""

import os
import signal
import time

import pytest

from dz_ros.drivers.conformance.machine import lateness, MachineWatch, overlap


def test_a_process_that_was_not_run_is_a_stall():
    with MachineWatch() as watch:
        watch.stalls()
        begin = time.monotonic()
        os.kill(watch.process.pid, signal.SIGSTOP)
        time.sleep(0.2)
        end = time.monotonic()
        os.kill(watch.process.pid, signal.SIGCONT)
        found = watch.stalls()
        assert overlap(found, begin, end) > 0.15
        assert lateness(found).startswith('the machine was late too')
        assert overlap(watch.stalls(), begin, end) == 0.0       # each is given once
        pid = watch.process.pid
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_watch_that_has_ended_knows_of_no_stall():
    with MachineWatch() as watch:
        watch.process.kill()
        watch.process.wait()
        assert watch.stalls() == ()
    assert lateness(()) == ''


def test_overlap_is_the_time_that_both_share():
    assert overlap([(1.0, 2.0), (3.0, 5.0)], 1.5, 4.0) == pytest.approx(1.5)
    assert overlap([(1.0, 2.0)], 2.0, 3.0) == 0.0

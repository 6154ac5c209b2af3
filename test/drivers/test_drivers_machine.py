# SPDX-License-Identifier: Apache-2.0
"""The process that shows whether the machine was late."""

import os
import signal
import subprocess
import sys
import time

import pytest

from dz_ros.drivers.conformance.machine import lateness, MachineWatch, overlap, RunQueue


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


def test_a_thread_that_is_ready_waits_in_the_queue_and_one_that_sleeps_does_not():
    with RunQueue() as queue:
        if not queue.waited():
            pytest.skip('this system does not report how long a thread waits for a core')
        before, begin = queue.waited(), time.monotonic()
        time.sleep(0.05)
        assert time.monotonic() - begin - (queue.waited() - before) > 0.049
        cores = os.sched_getaffinity(0)
        rival = subprocess.Popen([sys.executable, '-c', 'while True: pass'])
        try:
            for pid in (0, rival.pid):
                os.sched_setaffinity(pid, {min(cores)})
            deadline = time.monotonic() + 60.0
            before = queue.waited()
            while queue.waited() - before < 0.05:
                assert time.monotonic() < deadline
        finally:
            os.sched_setaffinity(0, cores)
            rival.kill()
            rival.wait()
    assert queue.waited() == 0.0        # closed: it is not known


def test_overlap_is_the_time_that_both_share():
    assert overlap([(1.0, 2.0), (3.0, 5.0)], 1.5, 4.0) == pytest.approx(1.5)
    assert overlap([(1.0, 2.0)], 2.0, 3.0) == 0.0

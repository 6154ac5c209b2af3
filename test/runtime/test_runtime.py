# SPDX-License-Identifier: Apache-2.0
"""Deadlines, claims and process set-up, with a clock that the test moves."""

import gc
import os
import signal
import subprocess
import sys
import threading

import pytest

from dz_ros.runtime import os_signals
from dz_ros.runtime.claim import claim, ClaimedError, domain_topic
from dz_ros.runtime.deadlines import Deadlines
from dz_ros.runtime.os_signals import ENDS, held_ends, stop_on_signals
from dz_ros.runtime.process import settle, SWITCH_INTERVAL


class Clock:
    def __init__(self):
        self.now = 1_000

    def __call__(self):
        return self.now


def test_deadlines_are_absolute_and_do_not_drift():
    clock = Clock()
    ticks = Deadlines(0.005, 1_000, clock)
    for k in range(1, 1001):
        clock.now += round(ticks.remaining() * 1e9) + 300_000  # each tick begins 0.3 ms late
        assert ticks.begin() == k
        assert clock.now - 1_000 == k * 5_000_000 + 300_000
    assert (ticks.late, ticks.skipped) == (0, 0)


def test_an_overrun_skips_whole_periods_and_is_counted():
    clock = Clock()
    ticks = Deadlines(0.005, 1_000, clock)
    clock.now += 5_000_000 + 12_000_000
    assert ticks.remaining() == pytest.approx(-0.012)
    assert ticks.begin() == 3
    assert (ticks.late, ticks.skipped) == (1, 2)
    clock.now = 1_000 + 4 * 5_000_000
    assert ticks.begin() == 4
    assert (ticks.late, ticks.skipped) == (1, 2)


def test_a_claim_is_exclusive_names_its_holder_and_dies_with_it():
    name = f'test/{os.getpid()}'
    held = claim(name)
    with pytest.raises(ClaimedError) as error:
        claim(name)
    assert error.value.pid == os.getpid()
    for _ in range(50):         # each of those that are refused asks for it
        with pytest.raises(ClaimedError, match=f'is claimed: process {os.getpid()}$'):
            claim(name)
    held.close()
    claim(name).close()

    program = (f'from dz_ros.runtime.claim import claim; import time; c = claim({name!r}); '
               'print("held", flush=True); time.sleep(600)')
    child = subprocess.Popen([sys.executable, '-c', program], stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout.readline() == 'held\n'
        with pytest.raises(ClaimedError) as error:
            claim(name)
        assert error.value.pid == child.pid
    finally:
        child.kill()
        child.wait()
        child.stdout.close()
    claim(name).close()


def test_claims_of_different_domains_do_not_meet(monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '3')
    assert domain_topic('/state') == '3/state'
    monkeypatch.delenv('ROS_DOMAIN_ID')
    assert domain_topic('/ns/state') == '0/ns/state'


@pytest.mark.parametrize('given', ['-1', '233', 'abc', '1.0', '²'])
def test_a_domain_that_does_not_exist_is_named(monkeypatch, given):
    monkeypatch.setenv('ROS_DOMAIN_ID', given)
    with pytest.raises(ValueError, match=r'ROS_DOMAIN_ID = .* 0 to 232'):
        domain_topic('/state')


@pytest.mark.slow
def test_settling_keeps_the_collector_and_other_threads_out():
    interval = sys.getswitchinterval()
    try:
        settle()
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
        assert sys.getswitchinterval() == pytest.approx(SWITCH_INTERVAL)
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
        gc.enable()


@pytest.fixture
def handled():
    """Have signals noted; return their numbers."""
    found = []
    earlier = {number: signal.signal(number, lambda n, _: found.append(n)) for number in ENDS}
    yield found
    for number, handler in earlier.items():
        signal.signal(number, handler)


@pytest.mark.parametrize('number', ENDS)
@pytest.mark.parametrize('deliver', [True, False])
def test_signals_are_held_back_and_the_first_one_acts_afterwards(handled, number, deliver):
    with held_ends(deliver):
        for _ in range(3):
            with held_ends():       # within another one
                os.kill(os.getpid(), number)
            assert handled == []
    assert handled == ([number] if deliver else [])
    os.kill(os.getpid(), number)
    assert handled[-1] == number


def test_where_no_signal_can_interrupt_none_is_held_back():
    def work():
        with held_ends():
            found.append(signal.getsignal(signal.SIGINT))

    found = []
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [signal.getsignal(signal.SIGINT)]


@pytest.mark.parametrize('number', ENDS)
def test_a_signal_is_a_reason_to_stop_and_a_second_one_an_interrupt(handled, number):
    with stop_on_signals() as stopping:
        os.kill(os.getpid(), number)
        assert stopping.reason == number.name
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
    os.kill(os.getpid(), number)
    assert handled == [number]


def test_a_hangup_that_is_ignored_stays_so(handled):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)        # as nohup arranges
    with stop_on_signals() as stopping:
        os.kill(os.getpid(), signal.SIGHUP)
        assert stopping.reason == ''
    assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    assert handled == []


def test_a_signal_that_comes_while_its_handler_is_replaced_by_the_system_s_is_not_python_s(
        monkeypatch):
    taken = []
    earlier = os_signals.on_ends(lambda number, _frame: taken.append(number))
    replace = signal.signal
    try:
        signal.raise_signal(signal.SIGTERM)
        assert taken == [signal.SIGTERM]        # came before
        with monkeypatch.context() as patch:
            patch.setattr(signal, 'signal', lambda number, handler: (
                signal.raise_signal(number), replace(number, handler))[1])
            os_signals.ignore_ends()
        assert taken == [signal.SIGTERM]
        assert {signal.getsignal(number) for number in ENDS} == {signal.SIG_IGN}
    finally:
        os_signals.restore_handlers(earlier)
    assert {number: signal.getsignal(number) for number in earlier} == earlier

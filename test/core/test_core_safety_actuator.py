# SPDX-License-Identifier: Apache-2.0
"""Guards, limiter, watchdogs and states one by one."""

import math

import pytest

from dz_ros.core.records import Command
from dz_ros.core.safety.actuator_guard import ActuatorGuard
from dz_ros.core.safety.message_guards import RIVALS
from dz_ros.core.safety.modes import Mode
from dz_ros.core.safety.settings import SafetySettings

T = 0.005


# --- the actuator's end

class Actuator:
    """An active guard that is sent one command a sample."""

    def __init__(self, **settings):
        self.guard = ActuatorGuard(SafetySettings(**{'fault_after': 80, **settings}), T)
        for name in ('configure', 'activate'):
            self.guard.transition(name, 0.0)
        self.seq = -1

    def send(self, v=1.0, t=None, **changes):
        self.seq += 1
        t = self.seq * T if t is None else t
        fields = {'seq': self.seq, 'stamp': t, 'v': v, 'echo_seq': self.seq, 'echo_stamp': t}
        return self.guard.command(Command(**{**fields, **changes}).numbers(), self.seq, t)

    @property
    def mode(self):
        return self.guard.supervisor.mode


def test_silence_ends_in_the_safe_command_after_the_hold_and_in_a_fault_later():
    actuator = Actuator(command_hold=3, fault_after=80)
    assert actuator.send(2.0) == actuator.guard.output == 2.0
    assert actuator.guard.poll(3 * T) is None
    assert actuator.guard.poll(3.2 * T) == (0.0, pytest.approx(3 * T))
    assert actuator.mode is Mode.LOST
    assert actuator.send(2.0, t=10 * T, echo_stamp=9 * T) == 2.0
    assert actuator.guard.poll(14 * T) is not None
    assert actuator.guard.poll(91 * T) is None
    assert (actuator.mode, actuator.guard.supervisor.reason) == (Mode.FAULT, 'no command')
    assert actuator.send(2.0, t=92 * T) is None
    assert actuator.guard.output == 0.0


def test_a_process_that_slept_finds_both_at_once():
    actuator = Actuator()
    actuator.send(2.0)
    assert actuator.guard.poll(5.0) == (0.0, pytest.approx(3 * T))
    assert actuator.mode is Mode.FAULT


@pytest.mark.parametrize('changes', [
    {'v': math.nan}, {'v': math.inf}, {'seq': 0}, {'seq': 10 ** 7}, {'echo_seq': 99},
    {'echo_stamp': -1.0}, {'seq': 2.5}])
def test_bad_commands_neither_act_nor_feed_the_watchdog(changes):
    actuator = Actuator()
    for _ in range(3):
        actuator.send(2.0)
    for _ in range(4):
        assert actuator.send(**{'v': 9.0, **changes}) is None
    assert actuator.guard.output == 2.0
    assert actuator.guard.poll(actuator.seq * T) is not None
    assert sum(actuator.guard.guard.rejected().values()) == 4


def test_a_second_controller_is_a_fault_where_the_graph_shows_one():
    actuator = Actuator()
    for k in range(2 * RIVALS):
        actuator.send(1.0)
        rival = Command(k // 2, 0.0, 3.0, actuator.seq, actuator.seq * T)
        assert k == 0 or actuator.guard.command(rival.numbers(), actuator.seq,
                                                actuator.seq * T) is None
    now = actuator.seq * T
    assert actuator.guard.poll(now, senders=1) is None
    assert actuator.guard.poll(now, senders=2) == (0.0, now)
    assert actuator.guard.supervisor.reason == '2 publishers of commands'


def test_reset_needs_a_fresh_command_and_a_released_button():
    actuator = Actuator()
    assert actuator.guard.reset(0.0) == 'nothing is latched'
    actuator.send(2.0)
    assert actuator.guard.estop(0.0) == 0.0
    assert 'pressed' in actuator.guard.reset(T)
    actuator.guard.estop(T, pressed=False)
    assert actuator.mode is Mode.ESTOP      # released is not reset
    assert 'no command' in actuator.guard.reset(10.0)
    assert actuator.send(2.0, t=10.0) is None
    assert actuator.guard.reset(10.0) == ''
    assert actuator.mode is Mode.WAITING
    assert actuator.send(2.0, t=10.0 + T) == 2.0


def test_after_a_fault_of_the_device_no_command_can_have_come():
    actuator = Actuator()
    actuator.send(2.0)
    actuator.guard.fault('the drive has restarted', T)
    assert 'no command' in actuator.guard.held_by(10.0)
    assert actuator.guard.held_by(10.0, command_required=False) == ''
    actuator.guard.estop(10.0)
    assert 'pressed' in actuator.guard.reset(10.0, command_required=False)
    actuator.guard.estop(10.0, pressed=False)
    assert actuator.guard.reset(10.0, command_required=False) == ''
    assert actuator.mode is Mode.WAITING    # safe until a command comes
    assert actuator.guard.output == 0.0


def test_an_orderly_end_is_no_fault():
    actuator = Actuator()
    actuator.send(2.0)
    assert actuator.guard.end(T) == 0.0
    assert actuator.guard.poll(100.0) is None
    assert actuator.mode is Mode.WAITING


# --- the controller's end

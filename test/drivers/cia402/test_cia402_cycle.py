# SPDX-License-Identifier: Apache-2.0
"""The thread of the cycle: when SYNC goes out, what is sent, in which order."""

from dataclasses import replace
from itertools import pairwise
import struct
import threading
import time

import pytest

from dz_ros.drivers.cia402.bus import DriveBus
from dz_ros.drivers.cia402.cycle import SharedCycle
from dz_ros.drivers.cia402.objects import layout
from dz_ros.drivers.cia402.settings import Cia402Parameters
from dz_ros.drivers.cia402.shared_bus import SharedBus
from dz_ros.drivers.cia402.states import DriveState, Goal

T = 0.005


class Bus:
    """Takes frames and remembers them; reports what state the drive is in."""

    def __init__(self, **values):
        self.parameters = replace(Cia402Parameters(), **values)
        self.command = layout('torque', False, True)[0]
        self.state = DriveState.ENABLED
        self.fault = ''
        self.received_at = self.synced_at = 0.0
        self.measurement = None
        self.frames = []
        self.watched = 0
        self._news = threading.Condition()

    def send(self, identifier, data):
        with self._news:
            self.frames.append((time.monotonic(), identifier, bytes(data)))
            self._news.notify_all()

    def sync(self, drives):
        self.synced = list(drives)
        self.synced_at = time.monotonic()
        self.send(0x80, b'')

    def complain(self, text):
        self.fault = self.fault or text

    def watch(self, now):
        self.watched += 1

    def wait(self, condition):
        with self._news:
            assert self._news.wait_for(condition, 30.0)

    def commands(self):
        return [struct.unpack('<Hh', data) for _, identifier, data in self.frames
                if identifier == 0x201]

    def count(self, wanted):
        return sum(identifier == wanted for _, identifier, _ in self.frames)


@pytest.fixture
def run():
    """Yield a function that starts a cycle on a bus."""
    started = []

    def start(**values):
        bus = Bus(**values)
        cycle = SharedCycle(bus, T).serve(bus)
        started.append(cycle)
        return bus, cycle

    yield start
    for cycle in started:
        cycle.stop()


def test_a_command_goes_out_at_once_and_is_repeated_until_the_next(run):
    bus, cycle = run(command_hold=60.0)
    cycle.want(Goal.ENABLED, 123)
    bus.wait(lambda: bus.commands().count((0x0F, 123)) > 5)
    cycle.want(Goal.ENABLED, -7)
    bus.wait(lambda: (0x0F, -7) in bus.commands())
    first = bus.commands().index((0x0F, -7))
    assert (0x0F, 123) not in bus.commands()[first:]


def test_each_sync_has_a_command_before_it_and_heartbeats_go_out(run):
    bus, _cycle = run(heartbeat=0.01, heartbeat_hold=0.1)
    bus.wait(lambda: bus.count(0x80) > 20 and bus.count(0x77F) > 5)
    kinds = [identifier for _, identifier, _ in bus.frames if identifier != 0x77F]
    for before, after in pairwise(kinds):
        assert not (before == after == 0x80)
    assert {data for _, identifier, data in bus.frames if identifier == 0x77F} == {b'\x05'}
    assert bus.watched > 20


def test_no_target_leaves_before_the_drive_is_enabled(run):
    bus, cycle = run(command_hold=60.0)
    bus.state = DriveState.DISABLED
    cycle.want(Goal.ENABLED, 500)
    for state, word in ((DriveState.DISABLED, 0x06), (DriveState.READY, 0x07),
                        (DriveState.SWITCHED_ON, 0x0F)):
        bus.state = state
        bus.wait(lambda word=word: bus.commands()[-1][0] == word)
    assert {target for _, target in bus.commands()} == {0}
    bus.state = DriveState.ENABLED
    bus.wait(lambda: bus.commands()[-1] == (0x0F, 500))


def test_a_fault_stops_the_drive_whatever_the_loop_reports(run):
    bus, cycle = run(command_hold=60.0)
    cycle.want(Goal.ENABLED, 500)
    bus.wait(lambda: (0x0F, 500) in bus.commands())
    bus.fault = 'something'
    bus.wait(lambda: (0x02, 0) in bus.commands())
    sent = len(bus.commands())
    for target in range(100, 120):
        cycle.want(Goal.ENABLED, target)
    bus.wait(lambda: len(bus.commands()) > sent + 5)
    assert set(bus.commands()[sent:]) == {(0x02, 0)}


def test_fault_reset_is_an_edge_and_only_in_fault(run):
    bus, cycle = run(command_hold=60.0)
    bus.state = DriveState.FAULT
    cycle.want(Goal.SAFE)
    cycle.reset_fault(True)
    bus.wait(lambda: {0x80, 0x00} <= {word for word, _ in bus.commands()})
    bus.state = DriveState.DISABLED
    sent = len(bus.commands())
    bus.wait(lambda: len(bus.commands()) > sent + 5)
    assert {word for word, _ in bus.commands()[sent + 1:]} == {0x02}


def test_stopping_twice():
    cycle = SharedCycle(Bus(), T).serve(Bus())
    cycle.stop()
    cycle.stop()


class Silent:
    """A bus without nodes."""

    def __init__(self):
        p = replace(Cia402Parameters(), heartbeat_hold=0.2)
        self.bus = DriveBus(p, T, SharedBus(p, T))

    def heartbeat(self, now, monkeypatch):
        monkeypatch.setattr('time.monotonic', lambda: now)
        self.bus._on_heartbeat(0x701, bytearray((5,)), 0.0)


def test_a_heartbeat_that_stays_away_is_a_fault_but_our_own_sleep_is_not(monkeypatch):
    silent = Silent()
    bus = silent.bus
    bus.watch(0.0)
    assert bus.fault == ''            # none has ever come: there is nothing to miss
    silent.heartbeat(1.0, monkeypatch)
    for now in range(100, 120):
        bus.watch(now / 100.0)
    bus.watch(5.0)                      # slept for almost four seconds
    assert bus.fault == ''
    bus.watch(5.01)
    bus.watch(5.02)
    assert bus.fault == 'no heartbeat for 0.2 s'

# SPDX-License-Identifier: Apache-2.0
"""Drives of several axes on one bus: one SYNC, one thread, and what one reports stops all.

Over 300 lines: all of it needs the same machine of three drives.
"""

import itertools
import threading

import can
import pytest

from dz_ros.core import schema
from dz_ros.drivers.beside import Beside
from dz_ros.drivers.cia402.emulator import Cia402Emulator, EmulatedParameters, FAULTS
from dz_ros.drivers.cia402.states import DriveState
from dz_ros.drivers.conformance import driver_checks
from dz_ros.drivers.conformance.driver_checks import check_contract, check_together
from dz_ros.drivers.emulators import Fault
from dz_ros.drivers.hosted_axes import HostedDrivers
from dz_ros.errors import ConfigurationError, DriverError
from dz_ros.files.configurations import load_configuration

S = DriveState
NAMES = ('base', 'shoulder', 'elbow')
TIME_OUT = 60.0
_channels = itertools.count()


def configured(**overrides):
    """Return the machine on a bus of its own in this process."""
    return load_configuration('cia402_axes').replace(**{
        'driver.interface': 'virtual', 'driver.channel': f'axes-{next(_channels)}',
        'driver.bus_options': [], 'driver.answer_limit': 2.0, 'driver.heartbeat_hold': 1.0,
        'driver.command_hold': 1.0, 'driver.transition_limit': 10.0, 'safety.state_hold': 400,
        'safety.fault_after': 5000,
        **{key.replace('__', '.'): value for key, value in overrides.items()}})


class Machine:
    """Simulated drives that run in this process, and what holds their drivers."""

    def __init__(self, **overrides):
        self.configuration = configured(**overrides)
        self.emulator = Cia402Emulator.of_axes(schema.build(EmulatedParameters, {}),
                                               self.configuration, 0, ())
        self.place = self.emulator.open()
        self.log = []
        self._end = threading.Event()
        self._thread = threading.Thread(target=self.emulator.run,
                                        args=(self._end.is_set, self.log.append))
        self._thread.start()
        p = self.configuration.driver_parameters
        self.watch = can.Bus(interface=p.interface, channel=p.channel)
        self._opened = []

    def node(self, name):
        return self.emulator.drives[name].node

    def states(self):
        return [self.node(name).device.state for name in NAMES]

    def fault(self, name, fault, value=0, duration=1.0):
        self.emulator.drives[name].ask(list(FAULTS).index(fault) + 1, value, duration)

    def hosted(self):
        """Return what holds the drivers, opened."""
        found = HostedDrivers(self.configuration)
        self._opened.append(found)
        found.open()
        return found

    def driver(self, name):
        """Return the driver of one axis alone."""
        found = self.configuration.axis(name).make_driver()
        self._opened.append(found)
        return found

    def received(self, count):
        """Return the identifiers of this number of frames from now on."""
        while self.watch.recv(0) is not None:
            pass
        return [self.watch.recv(TIME_OUT).arbitration_id for _ in range(count)]

    def close(self):
        for item in self._opened:
            item.close()
        self.watch.shutdown()
        self._end.set()
        self._thread.join(TIME_OUT)
        self.emulator.close()


@pytest.fixture
def machine():
    """Yield a function that starts a machine."""
    started = []

    def start(**overrides):
        started.append(Machine(**overrides))
        return started[-1]

    yield start
    for item in started:
        item.close()


@pytest.fixture
def drive_all(until):
    """Return a function that commands all axes until a condition holds."""
    def go(hosted, condition, v=(2.0, 2.0, -2.0), what='the condition'):
        clock = itertools.count()

        def step():
            hosted.command(v, next(clock) * 0.005)
            return condition()

        until(step, what)

    return go


def moving(m, drive_all):
    """Return what holds the drivers, all enabled and commanded."""
    hosted = m.hosted()
    hosted.enable()

    def running(condition):
        if hosted.fault():      # a machine that stands still for longer than a drive waits
            hosted.recover()
        return condition()

    drive_all(hosted, lambda: running(lambda: all(m.node(name).motor.target for name in NAMES)))
    drive_all(hosted, lambda: running(lambda: all(item.driver.cycle.walk.arrived
                                                  for item in hosted.each)))
    return hosted


# One bus.


def test_one_sync_and_one_heartbeat_serve_all_drives(machine, drive_all, until):
    m = machine()
    hosted = moving(m, drive_all)
    assert len({id(item.driver.shared) for item in hosted.each}) == 1
    assert sum(item.name == 'cia402' for item in threading.enumerate()) == 1
    frames = m.received(400)
    syncs = frames.count(0x80)
    assert syncs > 20
    for node in (1, 2, 3):      # one answer of each kind to each of them, late on a busy machine
        for answer in (0x180, 0x280):
            assert 0.5 * syncs < frames.count(answer + node) < 1.5 * syncs
    hosted.measure(0.0)
    until(lambda: hosted.measure(0.0) is not None)
    answered = [item.driver.bus for item in hosted.each]
    until(lambda: len({bus.measurement.synced_at for bus in answered}) == 1)    # the same SYNC


def test_each_axis_has_its_own_node_numbers_and_motor(machine, drive_all):
    m = machine()
    hosted = moving(m, drive_all)
    assert [m.node(name).motor.target for name in NAMES] == [400, 400, 400]     # elbow: reversed
    drive_all(hosted, lambda: [m.node(name).motor.target for name in NAMES] == [200, 0, 600],
              (1.0, 0.0, -3.0))
    drive_all(hosted, lambda: all(row[1] for row in hosted.measure(0.0) or [(0, 0)]))
    assert hosted.measure(0.0)[2][1] < 0.0


def test_opening_and_enabling_one_after_the_other_keeps_the_sync(machine, monkeypatch, until):
    """Set-up waits for a drive that answers only after ten more SYNCs: they go out meanwhile."""
    m = machine(driver__answer_limit=10.0)
    found = HostedDrivers(m.configuration)
    m._opened.append(found)
    found.each[0].open()
    shared = found.each[0].driver.shared
    counted, real = [], shared.sync
    opened, before = [], []

    def sync(drives):
        counted.append(len(drives))
        real(drives)

    monkeypatch.setattr(shared, 'sync', sync)

    def slow(index, subindex, od):
        if index == 0x1017:         # one that is just kept
            wanted = len(counted) + 10
            until(lambda: len(counted) >= wanted)
            before.append((len(opened), max(counted)))

    for name in NAMES[1:]:
        m.node(name).canopen.add_read_callback(slow)
    for item in found.each[1:]:
        item.open()
        opened.append(item)
    assert len(counted) >= 20
    assert set(before) == {(0, 1), (1, 2)}     # none is served before it is configured
    for item in found.each:
        item.enable()
    until(lambda: counted[-1] == 3)


def test_what_is_enabled_first_is_stopped_until_the_loop_commands(machine):
    m = machine()
    hosted = m.hosted()
    hosted.each[0].enable()
    assert m.node('base').device.state in (S.ENABLED, S.QUICK_STOP)
    hosted.each[1].enable()
    assert m.node('base').device.state is S.QUICK_STOP


def test_the_bus_is_left_with_the_last_drive_and_opened_again(machine, drive_all):
    m = machine()
    hosted = m.hosted()
    shared = hosted.each[0].driver.shared
    for item in hosted.each[:2]:
        item.close()
    assert [drive.parameters.node_id for drive in shared.drives] == [3]
    assert m.received(10)
    hosted.close()
    assert shared.drives == ()
    assert shared.served == 0
    hosted.open()
    hosted.enable()
    drive_all(hosted, lambda: all(m.node(name).motor.target for name in NAMES))


def test_a_drive_that_is_missing_leaves_none_open(machine, until):
    m = machine(axes__elbow__driver__node_id=9, driver__answer_limit=0.2)
    m.emulator.drives['elbow'].node.leave()
    hosted = HostedDrivers(m.configuration)
    with pytest.raises(DriverError, match=r'axis elbow: .*node 9: no answer within 0\.2 s'):
        hosted.open()
    assert hosted.each[0].driver.shared.drives == ()
    until(lambda: all(m.node(name).canopen.nmt.state == 'PRE-OPERATIONAL'
                      for name in NAMES[:2]))


# Faults of one.


@pytest.mark.parametrize(('fault', 'words', 'state'), [
    ('emcy', 'axis shoulder: EMCY 2310h (Current), error register 01h', S.FAULT),
    ('heartbeat', 'axis shoulder: no heartbeat for 1 s', S.QUICK_STOP),
    ('torque-off', 'axis shoulder: the drive has left operation enabled by itself: switch on '
     'disabled', S.DISABLED),
    ('mode', 'axis shoulder: the drive is in another mode: modes of operation display (6061h) = '
     '1, not 10', S.QUICK_STOP)])
def test_a_fault_of_one_stops_all_before_the_host_acts(machine, drive_all, fault, words, state):
    m = machine()
    hosted = moving(m, drive_all)
    m.fault('shoulder', fault, duration=5.0)
    # The loop goes on commanding: the thread of the bus stops all by itself.
    drive_all(hosted, lambda: m.states() == [S.QUICK_STOP, state, S.QUICK_STOP])
    assert hosted.fault() == words
    m.node('shoulder').canopen.nmt.start_heartbeat(50)
    assert hosted.recover() == ''
    assert hosted.fault() == ''
    drive_all(hosted, lambda: m.states() == [S.ENABLED] * 3)


def test_a_drive_that_leaves_operational_stops_the_others(machine, drive_all):
    m = machine()
    hosted = moving(m, drive_all)
    m.fault('elbow', 'pre-operational')
    drive_all(hosted, lambda: m.states() == [S.QUICK_STOP] * 3)     # its own by SDO
    assert hosted.fault().startswith('axis elbow: the drive has left NMT state operational')
    assert hosted.recover() == ''
    drive_all(hosted, lambda: m.states() == [S.ENABLED] * 3)


@pytest.mark.slow
def test_a_reset_that_one_refuses_leaves_the_others_stopped(machine, drive_all, until):
    m = machine(driver__transition_limit=0.3)
    hosted = moving(m, drive_all)
    m.fault('base', 'stuck', duration=3.0)
    drive_all(hosted, lambda: m.states() == [S.FAULT, S.QUICK_STOP, S.QUICK_STOP])
    assert 'axis base: ' in hosted.recover()
    until(lambda: m.states() == [S.FAULT, S.QUICK_STOP, S.QUICK_STOP])
    until(lambda: any('end of fault stuck' in text for text in m.log))
    assert hosted.recover() == ''
    drive_all(hosted, lambda: m.states() == [S.ENABLED] * 3)


def test_a_bus_that_goes_is_a_fault_of_each_and_opened_once(machine, drive_all, monkeypatch):
    m = machine()
    hosted = moving(m, drive_all)
    shared = hosted.each[0].driver.shared
    shared.error_frame(0x40)
    drive_all(hosted, lambda: m.states() == [S.QUICK_STOP] * 3)
    assert hosted.fault() == (
        'axes base, shoulder, elbow: bus off: too many errors on the CAN bus')
    opened, real = [], can.Bus

    def counted(*words, **more):
        opened.append(real(*words, **more))
        return opened[-1]

    monkeypatch.setattr(can, 'Bus', counted)
    assert hosted.recover() == ''
    assert len(opened) == 1
    drive_all(hosted, lambda: m.states() == [S.ENABLED] * 3)
    assert hosted.fault() == ''


def test_disabling_stops_all_before_it_waits_for_one(machine, drive_all, monkeypatch):
    m = machine()
    hosted = moving(m, drive_all)
    goals, first = [], hosted.each[0].driver
    real = first.disable

    def disable():
        goals.extend(item.driver.cycle._goal.name for item in hosted.each)
        real()

    monkeypatch.setattr(first, 'disable', disable)
    assert hosted.disable((0.0, 0.0, 0.0), 1.0) == ''
    assert goals == ['SAFE'] * 3
    assert m.states() == [S.DISABLED] * 3


# One axis alone.


def test_one_axis_alone_leaves_the_other_drives_as_they_are(machine, until):
    m = machine()
    driver = m.driver('shoulder')
    driver.open()
    driver.enable()
    until(lambda: driver.command(2.0, 0.0) or (driver.measure() or (0.0, 0.0))[1] > 0.1)
    for name in ('base', 'elbow'):
        node = m.node(name)
        assert node.device.state is S.DISABLED
        assert node.canopen.nmt.state == 'PRE-OPERATIONAL'
        assert not node.moved
    driver.disable()


@pytest.mark.slow
def test_the_kit_checks_each_driver_beside_the_others(machine, monkeypatch):
    monkeypatch.setattr(driver_checks, 'RUN_DURATION', 0.3)
    m = machine()
    hosts = HostedDrivers(m.configuration)
    for place, name in enumerate(NAMES):
        results = {item.name: item for item in check_contract(
            m.configuration.axis(name), 1.0, False, hosted=Beside(hosts, place))}
        for key in ('declaration', 'opens', 'no fault', 'safe command', 'stop and reset',
                    'restart', 'reconnect'):       # the others are about time
            assert results[key].passed, (name, results[key])
    together = {item.name: item for item in check_together(m.configuration, (1.0,) * 3)}
    assert set(together) == {'opens', 'measurement', 'answers at once', 'no fault', 'restart'}
    for key in ('opens', 'no fault', 'restart'):
        assert together[key].passed, together[key]
    assert m.states() == [S.DISABLED] * 3


def test_the_kit_names_the_axis_that_does_not_open_beside_the_others(machine):
    m = machine(axes__elbow__driver__node_id=9, driver__answer_limit=0.2)
    m.emulator.drives['elbow'].node.leave()
    (found,) = check_together(m.configuration, (0.1,) * 3)
    assert found.passed is False
    assert found.words.startswith('axis elbow: ')


# What is refused.


@pytest.mark.parametrize(('key', 'value', 'words'), [
    ('node_id', 2, 'axes.elbow.driver.node_id = 2: must differ from that of axis shoulder'),
    ('bitrate', 500_000, 'axes.elbow.driver.bitrate = 500000: must be 1000000 as of axis base'),
    ('heartbeat', 0.02, 'axes.elbow.driver.heartbeat = 0.02: must be 0.05'),
    ('sync_lead', 0.001, 'axes.elbow.driver.sync_lead = 0.001: must be 0.0025'),
    ('master_id', 126, 'axes.elbow.driver.master_id = 126: must be 127'),
    ('bus_options', ['port=1'], "axes.elbow.driver.bus_options = ['port=1']: must be []")])
def test_drives_that_cannot_be_on_one_bus(key, value, words):
    machine = configured()
    with pytest.raises(ConfigurationError) as caught:
        machine.replace(**{f'axes.elbow.driver.{key}': value})
    assert str(caught.value).startswith(words)
    other = machine.replace(**{f'axes.elbow.driver.{key}': value,
                               'axes.elbow.driver.channel': 'another'})
    first, second, third = (driver.shared for driver in other.make_drivers())
    assert first is second is not third


# The simulated drives.


def test_drives_by_number_have_ids_seeds_and_motors_of_their_own():
    machine = load_configuration('cia402').replace(**{
        'driver.interface': 'virtual', 'driver.channel': f'axes-{next(_channels)}',
        'driver.bus_options': []})
    parameters = schema.build(EmulatedParameters, {})
    faults = (Fault('emcy', 1.0, device='2'), Fault('local', 2.0))
    found = Cia402Emulator.of_axes(parameters, machine, 3, faults)
    assert list(found.drives) == ['1', '2', '3']
    assert [item.configuration.driver_parameters.node_id for item in found.drives.values()] == [
        1, 2, 3]
    assert len({item.configuration.loop.seed for item in found.drives.values()}) == 3
    assert [len(item.pending) for item in found.drives.values()] == [1, 2, 1]
    with pytest.raises(ConfigurationError, match='the drives are 1, 2, 3'):
        Cia402Emulator.of_axes(parameters, machine, 3, (Fault('emcy', 1.0, device='4'),))
    with pytest.raises(ConfigurationError, match='must be from 1 to 126'):
        Cia402Emulator.of_axes(parameters, machine, 127, ())
    with pytest.raises(ConfigurationError, match=r'master_id .*must not be that of the drive'):
        Cia402Emulator.of_axes(parameters, machine.replace(**{'driver.master_id': 3}), 3, ())
    with pytest.raises(ConfigurationError, match='--nodes = 2: must be 3'):
        Cia402Emulator.of_axes(parameters, configured(), 2, ())


@pytest.mark.slow
def test_a_scripted_fault_is_of_its_axis(machine, drive_all):
    m = machine()
    m.emulator.drives['shoulder'].pending = [Fault('emcy', 0.0)]
    hosted = moving_until_fault(m, drive_all)
    assert hosted.fault().startswith('axis shoulder: EMCY')
    assert any(text == 'shoulder: fault emcy' for text in m.log)


def moving_until_fault(m, drive_all):
    hosted = m.hosted()
    hosted.enable()
    drive_all(hosted, lambda: bool(hosted.fault()))
    return hosted

# SPDX-License-Identifier: Apache-2.0
"""Faults on a script, the bytes they touch, and the verb that starts emulators."""

import os
import signal

from hypothesis import given
from hypothesis import strategies as st
import pytest

from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.drivers.emulators import Emulator, EMULATORS, Fault
from dz_ros.drivers.serial.cable import Cable
from dz_ros.drivers.serial.emulated_devices import EmulatedDevice
from dz_ros.errors import ConfigurationError, DriverError
from dz_ros.files.configurations import load_configuration

KNOWN = {'unplug': '', 'corrupt': ''}
EMULATE = ('-m', 'dz_ros', 'driver', 'emulate')


@pytest.mark.parametrize(('text', 'expected'), [
    ('unplug@2', Fault('unplug', 2.0)),
    ('unplug@2.5+0.25', Fault('unplug', 2.5, 0.25)),
    ('corrupt@0+1=0.5', Fault('corrupt', 0.0, 1.0, 0.5)),
    ('left_arm:unplug@2', Fault('unplug', 2.0, device='left_arm')),
    ('3:corrupt@2=0.5', Fault('corrupt', 2.0, value=0.5, device='3')),
])
def test_faults_are_read(text, expected):
    found = Fault.parse(text, KNOWN)
    assert repr(found) == repr(expected)


@given(st.text(max_size=12) | st.from_regex(r'(unplug|x)@[0-9.+=]{0,8}', fullmatch=True))
def test_what_is_no_fault_is_an_error_of_one_line(text):
    try:
        found = Fault.parse(text, KNOWN)
    except ConfigurationError:
        return
    assert found.name in KNOWN
    assert found.start >= 0.0


@pytest.mark.parametrize(('text', 'words'), [
    ('soon', 'must be NAME@START'), ('burn@2', 'is none of unplug, corrupt'),
    ('unplug@1.2.3', 'must be NAME@START'), ('unplug@-1', 'must be NAME@START')])
def test_mistakes_are_named(text, words):
    with pytest.raises(ConfigurationError, match=words):
        Fault.parse(text, KNOWN)


def test_a_fault_lasts_as_long_as_it_reports():
    fault = Fault('unplug', 1.0, 0.5)
    assert [fault.active(t) for t in (0.99, 1.0, 1.49, 1.5)] == [False, True, True, False]


def test_an_emulator_of_one_device_refuses_several():
    class One(Emulator):
        name = 'one'
        open = run = close = None

    axes = Configuration.from_flat({'loop.axes': ['surge', 'yaw']})
    with pytest.raises(ConfigurationError, match='one emulates a device of one axis; choose it'):
        One.of_axes(None, axes, 0, ())
    with pytest.raises(ConfigurationError, match=r'--nodes = 2: one emulates one device'):
        One.of_axes(None, Configuration.from_flat({}), 2, ())


@pytest.mark.parametrize(('words', 'text'), [
    (['cia402', '--fault', '2:emcy@1'], 'there is one device, no 2'),
    (['cia402', '--nodes', '2', '--fault', '3:emcy@1'], 'the drives are 1, 2'),
    (['cia402', 'cia402_axes', '--fault', 'wrist:emcy@1'], 'the drives are base, shoulder'),
    (['cia402', 'cia402_axes', '--nodes', '2'], 'must be 3, that of loop.axes'),
    (['cia402', '--nodes', '-1'], 'must be from 1 to 126')])
def test_devices_that_are_not_there_are_one_line(words, text, capsys):
    assert main(['driver', 'emulate', *words]) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count('\n') == 1


@pytest.mark.parametrize('name', [name for name, found in EMULATORS.all().items()
                                  if not isinstance(found, Exception)])
def test_every_emulator_reports_what_it_is(name, capsys):
    kind = EMULATORS.load(name)
    assert issubclass(kind, Emulator)
    assert kind.name == name
    assert main(['driver', 'emulate', name, '--list']) == 0
    reported = capsys.readouterr().out
    assert all(f'--fault {fault}@  {what}' in reported for fault, what in kind.faults.items())
    assert kind.summary in reported


def test_emulators_are_listed(capsys):
    assert main(['driver', 'emulate', '--list']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(EMULATORS.all())


@pytest.mark.parametrize(('words', 'message'), [
    ([], "KIND = '': must be one of serial"),
    (['none'], "KIND = 'none': no such emulator"),
    (['serial', 'servo', '-o', 'limit'], "--option = 'limit': must be KEY=VALUE"),
    (['serial', 'servo', '-o', 'limit=0'], '--option limit = 0'),
    (['serial', 'servo', '-o', 'limit=[1'], '--option limit'),
    (['serial', 'servo', '-o', 'lmit=1'], 'did you mean --option limit?'),
    (['serial', 'servo', '-o', 'values=3'], 'values = 3: must be at most 2'),
    (['serial', 'servo', '--fault', 'x@1'], "--fault = 'x@1': is none of unplug"),
    (['serial', 'servo', '-o', 'program=/nowhere/at/all'], 'cannot be started'),
    (['serial', 'no_such_file'], 'no_such_file'),
])
def test_mistakes_on_the_command_line(words, message, capsys):
    assert main(['driver', 'emulate', *words]) == 2
    reported = capsys.readouterr().err
    assert message in reported
    assert reported.count('\n') == 1


def test_bytes_are_hit_as_often_as_asked_for():
    cable = Cable('', 1)
    data = bytes(range(256)) * 40
    hit = [a ^ b for a, b in zip(data, cable.corrupt(data, 0.1), strict=True) if a != b]
    assert 0.08 < len(hit) / len(data) < 0.12
    assert all(bit.bit_count() == 1 for bit in hit)
    assert 0.88 < len(cable.lose(data, 0.1)) / len(data) < 0.92
    assert cable.corrupt(data, 0.0) == cable.lose(data, 0.0) == data
    assert len(cable.noise(100)) == 100


def test_a_port_keeps_its_name_through_being_unplugged(tmp_path):
    link = tmp_path / 'port'
    cable = Cable(str(link), 0)
    cable.write(b'a peer is missing')
    assert cable.read() == b''
    for _ in range(2):
        cable.plug()
        # Not as a terminal that controls this process: the hang-up would end it.
        with open(link, 'r+b', buffering=0, opener=lambda name, flags: os.open(
                name, flags | os.O_NOCTTY)) as port:
            port.write(b'up\0\n')
            assert cable.read() == b'up\0\n'
            cable.write(b'down')
            assert port.read(4) == b'down'
            cable.unplug()
            assert not link.is_symlink()
            try:
                left = port.read(1)
            except OSError:
                left = b''
            assert left == b''
    cable.unplug()


def test_what_is_no_link_is_never_replaced(tmp_path):
    file = tmp_path / 'precious'
    file.write_text('data')
    with pytest.raises(DriverError, match='is no symbolic link'):
        Cable(str(file), 0).plug()
    assert file.read_text() == 'data'
    with pytest.raises(DriverError, match='No such file'):
        Cable(str(tmp_path / 'none' / 'port'), 0).plug()


def test_the_plant_behind_an_emulated_device_is_the_configured_one():
    configuration = Configuration.from_flat({'plant.model': 'servo', 'plant.x0': [0.1, 0.0]})
    device = EmulatedDevice([configuration], (1e-3, 1e-6, 1e-6), 30000)
    device.step(b'', 10_000_000)        # without commands it stands still
    assert device.measure() == ([[100000, 0]], [0])
    device.actuate((3000,))
    for k in range(1, 201):
        device.step(b'', 10_000_000 + 1000 * k)
    simulated = configuration.make_driver()
    simulated.command(3.0, 0.0)
    for k in range(1, 201):
        simulated.advance(1e-3 * k, 0)
    expected = [value * 1e6 for value in simulated.measure()]
    assert device.measure()[0][0] == pytest.approx(expected, abs=2)
    device.trip(4, None)
    assert device.measure()[1] == [4]


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_an_emulator_ends_in_order_and_takes_its_port_away(processes, tmp_path, number):
    link = tmp_path / 'port'
    process = processes(*EMULATE, 'serial', 'servo', '-o', f'link={link}')
    assert process.wait_for_line('serial device on').endswith(str(link))
    assert link.readlink().exists()
    process.signal(number)
    assert process.wait() == 0
    assert not link.is_symlink()
    assert 'Traceback' not in process.output


def test_a_program_that_ends_is_reported(processes, tmp_path):
    process = processes(*EMULATE, 'serial', 'servo', '-o', 'program=/bin/true')
    assert process.wait() == 2
    assert 'has ended (exit code 0)' in process.output.splitlines()[-1]


AXES = {'driver.name': 'serial', 'driver.port': '/dev/a', 'plant.model': 'servo',
        'loop.axes': ['x', 'y', 'z'], 'axes.x.plant.x0': [0.1, 0.0], 'axes.y.plant.x0': [0.2, 0.0],
        'axes.z.plant.x0': [0.3, 0.0]}


@pytest.mark.parametrize(('keys', 'options', 'found'), [
    ({}, {}, (0.1, 0.2, 0.3)),
    ({}, {'motors': 2}, (0.1, 0.2)),
    ({}, {'motors': 5}, (0.1, 0.2, 0.3, 0.1, 0.2)),
    ({'axes.x.driver.motor': 2, 'axes.z.driver.motor': 0}, {}, (0.3, 0.2, 0.1)),
    ({'axes.y.driver.port': '/dev/b'}, {'link': '/dev/a'}, (0.1, 0.3)),
    ({'axes.y.driver.port': '/dev/b'}, {'link': '/dev/b'}, (0.2,)),
    ({'driver.name': 'simulated'}, {}, (0.1, 0.2, 0.3)),
])
def test_each_motor_has_the_plant_of_its_axis(keys, options, found, monkeypatch):
    monkeypatch.setattr(Cable, 'plug', lambda self: None)
    flat = {**AXES, **keys}
    if flat['driver.name'] == 'simulated':
        del flat['driver.port']
    kind = EMULATORS.load('serial')
    emulator = kind(kind.Parameters(**options), Configuration.from_flat(flat))
    emulator.open()
    rows, codes = emulator._device.measure()
    assert [row[0] * 1e-6 for row in rows] == pytest.approx(found)
    assert codes == [0] * len(found)


@pytest.mark.parametrize(('keys', 'options', 'message'), [
    ({'axes.y.driver.port': '/dev/b'}, {}, "--option link = '': must be a driver.port of the "
                                           'axes: one of /dev/a, /dev/b'),
    ({'loop.axes': [f'a{k}' for k in range(9)], 'driver.name': 'simulated'}, {},
     'are more than the 8 motors of a device'),
    ({'plant.model': 'two_link_arm', 'loop.axes': ['x', 'y']}, {'motors': 3},
     '--option motors = 3: must be 2: the plant couples as many'),
])
def test_axes_that_make_no_device_are_named(keys, options, message):
    flat = {**AXES, **keys}
    if 'loop.axes' in keys:
        del flat['driver.port']
        flat = {key: value for key, value in flat.items() if not key.startswith('axes.')}
    kind = EMULATORS.load('serial')
    with pytest.raises(ConfigurationError) as caught:
        kind(kind.Parameters(**options), Configuration.from_flat(flat))
    assert message in str(caught.value)


def test_a_coupled_plant_moves_behind_the_motors_as_it_is_simulated():
    c = load_configuration('two_link_arm')
    device = EmulatedDevice(c.each, (1e-3, 1e-8, 1e-8), 10 ** 6)
    simulated_each = c.make_drivers()
    device.step(b'', 0)
    device.actuate((20_000, -5_000))
    for simulated, v in zip(simulated_each, (20.0, -5.0), strict=True):
        simulated.command(v, 0.0)
    for k in range(1, 101):
        device.step(b'', 1000 * k)
        for simulated in simulated_each:
            simulated.advance(1e-3 * k, k)
    expected = [[value * 1e8 for value in simulated.measure()] for simulated in simulated_each]
    for row, wanted in zip(device.measure()[0], expected, strict=True):
        assert row == pytest.approx(wanted, abs=2)
    assert abs(expected[0][1]) > 1e5

# SPDX-License-Identifier: Apache-2.0
"""The loop through a serial device, as processes: ours in Python and the firmware in C.

Over 300 lines: one device and one loop, of one axis and of several, for every test.
"""

import json
from pathlib import Path
import re

import pytest

from dz_ros.files.configurations import load_configuration

pytest.importorskip('serial', reason="pyserial is not installed: pip install 'dz_ros[serial]'")
pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / 'config' / 'serial.yaml'
NODE = ('-m', 'dz_ros.nodes.main')


@pytest.fixture
def loop(serial_device, processes, watcher):
    """Return a function that starts device and loop and returns them once the loop runs.

    `wait=False`: at once; on a busy machine a fault of the device may come before all is received.
    """
    def start(*faults, silence='3.0', wait=True, **driver):
        started = serial_device(*faults)
        own = ('-p', f'driver.silence:={silence}', '-p', f'driver.port:={serial_device.port}',
               *(word for key, value in driver.items()
                 for word in ('-p', f'driver.{key}:={value}')),
               # A reset comes here wherever the reference is.
               '-p', 'safety.error_limit:=0.0')
        nodes = {name: processes(*NODE, name, '--ros-args', '--params-file', CONFIG,
                                 *watcher.patient, *own)
                 for name in ('actuator_node', 'controller_node', 'trajectory_node')}
        wait_until_taken(processes, watcher, nodes)
        if wait:
            watcher.running()
        return started, nodes

    return start


NOT_TAKEN = 'the device does not take power|nothing that speaks the protocol answers'
"""How a node ends where the machine does not let the device answer in time."""


def wait_until_taken(processes, watcher, nodes):
    """Wait until a node has the device and publishes its mode; one that ended starts again."""
    def taken():
        node = nodes['actuator_node']
        if node.poll() == 2 and re.search(NOT_TAKEN, node.output):
            nodes['actuator_node'] = node = processes(*node.command)
        assert node.poll() is None, node.output
        return 'actuator_node' in watcher.modes()

    watcher.wait(taken)


def wait_until_begun(watcher, device, fault):
    """Wait until a fault of the device's script has latched the loop; return the reason.

    The script runs from the first command that moves the device: a machine that stalls before it
    latches the loop, and neither the command nor the fault would ever come. So a stall's fault is
    reset; where the script's begins meanwhile, that reset is of both, and the stall's is returned.
    """
    begun = f'{fault.partition("@")[0].rpartition(":")[2]} begins'
    stalled = ''

    def reached():
        nonlocal stalled
        mode, reason = watcher.modes()['actuator_node']
        if begun in device.output:
            return True
        stalled = reason if mode == 'fault' else ''
        if stalled:
            watcher.recovered()
        return False

    watcher.wait(reached)
    if stalled:
        return stalled
    watcher.wait_for_mode(actuator_node='fault')
    return watcher.modes()['actuator_node'][1]


def end(nodes):
    for node in nodes.values():
        assert node.interrupt() == 0
        assert 'Traceback' not in node.output


def test_the_adaptive_loop_tracks_through_the_line(loop, watcher):
    device, nodes = loop()
    # The layer's bound is 8 mrad, less is usual at 200 Hz on a quiet machine.
    watcher.tracked(load_configuration(CONFIG).trajectory, 0.01)
    end(nodes)
    assert device.poll() is None
    assert device.interrupt() == 0


@pytest.mark.parametrize(('fault', 'reason'), [
    ('unplug@3+1', 'the line has gone'),
    ('mute@3+1', 'sent nothing'),
    ('freeze@3+1', 'sent nothing'),
    ('restart@3', 'has restarted'),
    ('trip@3+1', 'reports fault 7'),
])
def test_a_fault_of_the_device_is_latched_and_a_reset_goes_on(loop, watcher, fault, reason):
    device, nodes = loop(fault, silence='0.3', wait=False)
    reported = wait_until_begun(watcher, device, fault)
    # Whichever of the limits is the first to see that nothing comes may report it.
    assert reason in reported or 'no measurement for' in reported or 'sent nothing' in reported
    device.wait_for_line(f'{fault.partition("@")[0]} ends')
    watcher.wait(watcher.recovered)
    watcher.wait_for_mode(actuator_node='running', controller_node='running')
    watcher.running(50)
    # It moves: the law is at work on what the device measures.
    seen = len(watcher.states)
    watcher.wait(lambda: len({data[2] for data in watcher.states[seen:]}) > 20)
    end(nodes)


@pytest.mark.parametrize(('fault', 'reason'), [
    ('deaf@3+3', 'the commands do not reach it'),
    ('repeat@3+4', 'the device repeats its last state'),
    ('unsent@3+1', 'which was not sent to it'),
    ('mode@3+1', 'is in mode safe, asked for run'),
])
def test_a_device_that_lies_or_receives_nothing_gets_no_power_before_a_reset(loop, watcher, fault,
                                                                             reason):
    device, nodes = loop(fault, silence='1.0', wait=False, watchdog='0.1', fresh='20.0')
    name = fault.partition('@')[0]
    reported = wait_until_begun(watcher, device, fault)
    stopped = len(device.output.splitlines())
    # On a busy machine a stall may be the first that is seen.
    assert any(text in reported for text in (reason, 'has tripped', 'no measurement', 'no command',
                                             'sent nothing', 'does not run again')), reported
    device.wait_for_line(f'{name} ends')
    seen = len(watcher.states)
    watcher.wait(lambda: len(watcher.states) > seen + 100)
    lines = device.output.splitlines()
    # Of what was on its way when the node stopped a run may remain, nothing after it.
    assert lines[stopped:].count('mode run') <= 1
    assert lines[-1] != 'mode run'
    # It stays where the fault has left it; one state repeated once drove it to -20 rad.
    assert all(abs(data[2]) < 2.0 for data in watcher.states[seen:])
    assert watcher.modes()['actuator_node'][0] == 'fault'
    watcher.wait(watcher.recovered)
    watcher.wait_for_mode(actuator_node='running', controller_node='running')
    watcher.wait(lambda: device.output.splitlines()[-1] == 'mode run')
    end(nodes)


def test_damage_on_the_line_does_not_stop_the_loop(loop, watcher):
    # A busy machine holds the host for long: only what the damage does is judged.
    device, nodes = loop('corrupt@2+2=0.003', 'lose@2+2=0.002', 'garbage@3=3000', watchdog='1.0',
                         fresh='400.0')
    device.wait_for_line('corrupt ends')
    watcher.running(100)
    assert 'fault' not in {event.get('mode') for event in watcher.events
                           if event['node'] == '/actuator_node'}
    positions = [data[2] for data in watcher.states]
    # Speeds stay below 3 rad/s: no step of the angle that a wrong number would be.
    stamps = [data[1] for data in watcher.states]
    for place in range(1, len(positions)):
        span = max(stamps[place] - stamps[place - 1], 0.0) + 0.25
        assert abs(positions[place] - positions[place - 1]) < 6.0 * span
    end(nodes)


def test_a_killed_actuator_node_leaves_a_device_that_another_one_can_take(
        loop, watcher, processes):
    _, nodes = loop()
    watcher.running(400)

    def starts():
        return sum(event['event'] == 'started' and event['node'] == '/actuator_node'
                   for event in watcher.events)

    watcher.wait(lambda: starts() == 1)
    nodes['actuator_node'].signal(9)
    nodes['actuator_node'].wait()
    # The port is free again, and another one greets the device and goes on.
    started = []

    def taken():
        # A machine that does not let the device answer in time ends it: again.
        if not started or started[-1].poll() == 2:
            started.append(processes(*nodes['actuator_node'].command))
        # On a busy machine it comes so late that the controller has given up.
        return watcher.recovered() and starts() == 2

    watcher.wait(taken)
    received = len(watcher.states)
    watcher.wait(lambda: len(watcher.states) > received + 20)
    assert started[-1].interrupt() == 0
    for node in started[:-1]:
        assert re.search(NOT_TAKEN, node.output), node.output


def test_the_conformance_kit_finds_nothing_wrong(kit, serial_device, ros_domain):
    serial_device()
    found = kit('serial', '--config', CONFIG, '--saturate', *(word for text in (
        f'driver.port={serial_device.port}', 'driver.silence=3.0', 'driver.fresh=100',
        'safety.command_hold=20') for word in ('--set', text)))
    assert {key for key, item in found.items() if item['passed'] is None} == set()


# Several axes at one device.

GOALS = {'pan': 1.5, 'tilt': 1.3, 'roll': -1.2}
ALL = {f'axes.{axis}.trajectory.goal': goal for axis, goal in GOALS.items()}


def nodes_of(processes, watcher, port, axes, *names):
    """Start nodes of a loop of some axes at a port, each with a goal of its own."""
    own = ('-p', 'driver.silence:=3.0', '-p', f'driver.port:={port}', '-p',
           f'loop.axes:=[{", ".join(axes)}]', *(word for axis in axes for word in (
               '-p', f'axes.{axis}.trajectory.goal:={GOALS[axis]}')))
    return {name: processes(*NODE, name, '--ros-args', '--params-file', CONFIG, *watcher.patient,
                            *own) for name in names or (
        'actuator_node', 'controller_node', 'trajectory_node')}


@pytest.fixture
def machine(serial_device, processes, watcher):
    """Return a function that starts a device and a loop of three axes."""
    def start(*faults):
        device = serial_device(*faults, motors=3)
        nodes = nodes_of(processes, watcher, serial_device.port, serial_device.axes)
        wait_until_taken(processes, watcher, nodes)
        return device, nodes

    return start


def test_three_axes_track_through_one_line(machine, watcher):
    device, nodes = machine()
    watcher.running()
    configuration = load_configuration(CONFIG, [
        f'loop.axes=[{", ".join(GOALS)}]', *(f'{key}={value}' for key, value in ALL.items())])
    for row, axis in enumerate(configuration.each):
        watcher.tracked(axis.trajectory, 0.01, row=row)
    end(nodes)
    assert device.interrupt() == 0


def test_a_trip_of_one_motor_stops_all_and_names_its_axis(machine, watcher):
    device, nodes = machine('tilt:trip@3+2')
    reported = wait_until_begun(watcher, device, 'tilt:trip@3+2')
    # On a busy machine a stall may be the first that is seen.
    assert reported == 'axis tilt: the device reports fault 7' or any(
        text in reported for text in ('has tripped', 'no measurement', 'no command',
                                      'sent nothing')), reported
    device.wait_for_line('trip ends')
    lines = device.output.splitlines()
    begun = next(at for at, line in enumerate(lines) if 'trip begins' in line)
    assert 'mode fault' in lines[begun:]
    assert 'mode run' not in lines[begun:]
    assert watcher.modes()['actuator_node'][0] == 'fault'
    watcher.wait(watcher.recovered)
    watcher.wait_for_mode(actuator_node='running', controller_node='running')
    watcher.wait(lambda: device.output.splitlines()[-1] == 'mode run')
    end(nodes)


def test_a_device_that_dies_stops_every_axis_until_the_reset(machine, serial_device, watcher):
    device, nodes = machine()
    watcher.running()
    # First what it would leave behind: another test's terminal may get the number it points to.
    serial_device.port.unlink()
    device.signal(9)
    device.wait()
    watcher.wait_for_mode(actuator_node='fault', controller_node='fault')
    reported = watcher.modes()['actuator_node'][1]
    assert 'axes pan, tilt, roll: ' in reported
    again = serial_device('restart@1000', motors=3)     # the script makes it log its modes
    again.wait_for_line('mode disabled')
    states = len(watcher.states)
    watcher.wait(lambda: len(watcher.states) > states + 100)    # it is measured, and has no power
    assert again.output.splitlines()[-1] == 'mode disabled'
    assert watcher.modes()['actuator_node'][0] == 'fault'
    watcher.wait(watcher.recovered)
    watcher.wait(lambda: again.output.splitlines()[-1] == 'mode run')
    end(nodes)


@pytest.mark.parametrize(('motors', 'axes', 'words'), [
    (3, 2, 'the device has 3 motors (version 2 of the protocol), at this port are 2 axes'),
    (1, 2, 'the device has 1 motor (version 1 of the protocol), at this port are 2 axes'),
    (2, 1, 'the device has 2 motors (version 2 of the protocol), at this port is 1 axis'),
])
def test_another_number_of_axes_is_one_line(serial_device, processes, watcher, motors, axes,
                                            words):
    serial_device(motors=motors)
    nodes = nodes_of(processes, watcher, serial_device.port, serial_device.axes[:axes],
                     'actuator_node')
    assert nodes['actuator_node'].wait() == 2
    output = nodes['actuator_node'].output
    assert f'{serial_device.port}: another number of axes: {words}' in output
    assert 'Traceback' not in output


def test_the_conformance_kit_finds_nothing_wrong_with_three_axes(serial_device, processes,
                                                                 ros_domain):
    serial_device(motors=3)
    keys = (f'driver.port={serial_device.port}', f'loop.axes=[{", ".join(GOALS)}]',
            'driver.silence=3.0', 'driver.fresh=100', 'safety.command_hold=20')
    process = processes('-m', 'dz_ros', 'driver', 'check', CONFIG, '--saturate', '--yes',
                        '--json', *(word for key in keys for word in ('--set', key)))
    process.wait(300.0)
    found = {item['name']: item for item in map(json.loads, filter(
        lambda line: line.startswith('{'), process.output.splitlines()))}
    assert {f'{axis}: {check}' for axis in (*GOALS, 'all axes') for check in (
        'opens', 'restart', 'measurement')} <= set(found), process.output
    # What a busy machine may fail.
    late = {f'{axis}: {check}' for axis in (*GOALS, 'all axes') for check in (
        'measurement', 'answers at once', 'no fault')}
    assert {key for key, item in found.items() if item['passed'] is False} <= late, found
    # The device is that of all axes: a node of one alone cannot have it.
    assert {key for key, item in found.items() if item['passed'] is None} == {
        f'{axis}: as a node' for axis in GOALS}

# SPDX-License-Identifier: Apache-2.0
"""`dz driver identify` of one motor of a serial board of several, in Python and in C."""

import json
from pathlib import Path
import re
import time

import pytest

from dz_ros.drivers.hosted_axes import HostedDrivers
from dz_ros.files.configurations import load_configuration

pytest.importorskip('serial', reason="pyserial is not installed: pip install 'dz_ros[serial]'")
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

CONFIG = Path(__file__).parents[2] / 'config' / 'serial.yaml'
BANDS = {'pan': (0.3, -0.8), 'tilt': (0.7, -0.35)}
"""Break points of the two motors [A]: no bound of the one holds those of the other."""
COUNT = 1e-6
"""One count of the angle, of either device [rad]."""
# A machine that others use as well stalls for longer than the defaults allow.
PATIENT = ('driver.fresh=40', 'driver.silence=3.0', 'driver.watchdog=0.2', 'driver.patience=30.0',
           'safety.state_hold=100')


def keys_of(port):
    """Return the changed keys of a machine of both motors at a port."""
    return f'loop.axes=[{", ".join(BANDS)}]', f'driver.port={port}', *PATIENT


def words_of(keys):
    return [word for key in keys for word in ('--set', key)]


def angles(port):
    """Return axis → angle of its motor now [rad]; no power is asked for."""
    hosted = HostedDrivers(load_configuration(CONFIG, keys_of(port)))
    hosted.open()
    try:
        while (found := hosted.measure(0.0)) is None:
            assert not hosted.fault()
            time.sleep(0.01)
        return {axis: row[0] for axis, row in zip(hosted.names, found, strict=True)}
    finally:
        hosted.close()


def identify(processes, port, axis, *more):
    return processes('-m', 'dz_ros', 'driver', 'identify', CONFIG, '--axis', axis, '--travel',
                     '1.5', '--speed', '1', '--effort', '4', '--repeats', '4', '--ramp', '2',
                     '--pause', '0.3', '--yes', *more, *words_of(keys_of(port)))


def test_each_motor_is_identified_while_the_other_one_rests(serial_device, processes, tmp_path):
    serial_device(motors=2, bands=tuple(BANDS.values()))
    port, found = serial_device.port, {}
    for axis, other in (('pan', 'tilt'), ('tilt', 'pan')):
        before = angles(port)
        out = tmp_path / axis
        process = identify(processes, port, axis, '--out', out)
        code = process.wait(300.0)
        assert code in (0, 1), process.output       # 1: a design rule finds an error in it
        assert (f'its device is that of {other} too: enabled with it, at the safe command'
                in process.output)
        after = angles(port)
        assert abs(after[other] - before[other]) <= COUNT
        assert abs(after[axis] - before[axis]) > 1e3 * COUNT
        found[axis] = json.loads((out / 'identified.json').read_text())['parameters']
    for axis, own in BANDS.items():
        theirs = BANDS['tilt' if axis == 'pan' else 'pan']
        for name, true, another in zip(('b_r', 'b_l'), own, theirs, strict=True):
            bounds = found[axis][name]
            assert bounds['low'] <= true <= bounds['high'], (axis, name, bounds)
            # A busy machine makes the interval wide, not another motor's.
            assert abs(bounds['value'] - true) < abs(bounds['value'] - another), (
                axis, name, bounds)
        for name in ('b·m_r', 'b·m_l'):
            assert found[axis][name]['low'] <= 1.0 <= found[axis][name]['high'], (axis, name)


STALLED = ('has tripped', 'no measurement', 'sent nothing')
"""Parts of the faults that a machine which stands still makes of a device that is all right."""
TRIES = 10


def left_in(device, mode):
    """Wait until the newest mode that the board has reported, before another greeting, is this."""
    deadline = time.monotonic() + 60.0
    while not (modes := re.findall('^mode (.*)$', device.output, re.MULTILINE)) or (
            modes[-1] != mode):
        assert time.monotonic() < deadline, modes
        time.sleep(0.05)
    return modes


def test_a_trip_of_the_other_motor_stops_the_moves(serial_device, processes, tmp_path):
    for _ in range(TRIES):
        device = serial_device('tilt:trip@2+1000', motors=2)
        process = identify(processes, serial_device.port, 'pan', '--out', tmp_path / 'found')
        assert process.wait(120.0) == 2, process.output
        error = process.output.splitlines()[-1]
        if not any(text in error for text in STALLED):
            break
        device.end()
    assert error == 'dz: error: axis tilt: the device reports fault 7'
    assert not (tmp_path / 'found').exists()
    device.wait_for_line('trip begins')
    modes = left_in(device, 'fault')        # without power
    assert 'run' in modes
    assert modes.index('fault') == len(modes) - 1


def test_after_ctrl_c_no_motor_has_power(serial_device, processes, tmp_path):
    for _ in range(TRIES):
        device = serial_device('garbage@100000', motors=2)      # with a script it names modes
        process = identify(processes, serial_device.port, 'pan', '--out', tmp_path / 'found')
        device.wait_for_line('running: the script begins')
        code = process.interrupt()
        if code != 2 or not any(text in process.output for text in STALLED):
            break
        device.end()
    assert code == 130, process.output
    assert process.output.splitlines()[-1] == (
        'dz: interrupted: the device has had its safe command and is disabled; nothing is kept; '
        'the same command begins again')
    assert 'run' in left_in(device, 'disabled')     # not the watchdog's, which is safe

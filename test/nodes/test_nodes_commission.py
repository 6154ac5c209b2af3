# SPDX-License-Identifier: Apache-2.0
"""`dz driver commission` on emulated devices: it ends in a loop that tracks."""

import json
from pathlib import Path

import pytest

from dz_ros.recording.reader import read_run

pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.usefixtures('ros_domain')]

ROOT = Path(__file__).parents[2]
DZ = ('-m', 'dz_ros')
LIMITS = ('--travel', '2', '--speed', '2', '--effort', '6', '--repeats', '8', '--ramp', '2',
          '--pause', '0.2', '--loop-duration', '12', '--yes')
# A rate and holds for a machine that is busy with other tests.
PATIENT = ('loop.rate=100', 'safety.state_hold=200', 'safety.command_hold=100',
           'safety.echo_limit=300', 'safety.reference_hold=300', 'safety.fault_after=5000')
STEPS = ['limits', 'sign', 'sensor', 'identify', 'propose', 'check', 'loop', 'report']


@pytest.fixture
def commission(processes, tmp_path):
    """Return a function that commissions a device; again from a step that a stall spoilt."""
    def do(config, *settings):
        out = tmp_path / 'first'
        shared = [word for text in (*PATIENT, *settings) for word in ('--set', text)]
        words = [config, *shared, *LIMITS, '--out', str(out)]
        for _ in range(4):
            done = processes(*DZ, 'driver', 'commission', *words)
            code = done.wait(600.0)
            assert (out / 'commissioning.jsonl').exists(), done.output
            attempts = [json.loads(line) for line in
                        (out / 'commissioning.jsonl').read_text().splitlines()]
            if code == 0:
                return out, attempts
            last = attempts[-1]
            # Measured late or not at all: what this machine had no time for, and no other reason.
            assert last['outcome'] == 'failed', done.output
            assert last['step'] in ('sensor', 'identify', 'loop'), done.output
            words = [*words[:-2], '--from', last['step'], *words[-2:]]
        pytest.fail(done.output)
        return None

    return do


def tracks(out, attempts):
    """Check that every step was done and left what it should, and that the loop tracks."""
    done = [item for item in attempts if item['outcome'] == 'done']
    assert list(dict.fromkeys(item['step'] for item in done)) == STEPS
    newest = {item['step']: item for item in done}
    assert newest['sign']['result']['left'] < 0.0 < newest['sign']['result']['right']
    assert newest['loop']['result']['error'] <= 0.1 * newest['limits']['result']['amplitude']
    assert newest['loop']['words'].startswith('it tracks')
    for step in ('sign', 'sensor', 'identify', 'loop'):
        assert len(read_run(out / newest[step]['folder'] / 'run').channels['state']) > 100
    assert (out / newest['report']['result']['page']).is_file()


@pytest.mark.parametrize('serial_device', ['emulated'], indirect=True)
def test_a_serial_device(commission, serial_device):
    pytest.importorskip('serial', reason='pyserial is not installed')
    serial_device()
    tracks(*commission('serial', f'driver.port={serial_device.port}', 'driver.silence=3.0',
                       'driver.fresh=4.0', 'driver.watchdog=1.0'))


def test_a_cia402_drive(commission, processes, ros_domain):
    pytest.importorskip('canopen', reason='canopen is not installed')
    can = pytest.importorskip('can', reason='python-can is not installed')
    port = 43200 + ros_domain
    try:
        can.Bus(interface='udp_multicast', channel='239.74.163.2', port=port,
                hop_limit=0).shutdown()
    except can.CanError as error:
        pytest.skip(f'no multicast on this machine: {error}')
    own = ('driver.heartbeat_hold=2.0', 'driver.command_hold=2.0', 'driver.answer_limit=1.0',
           f'driver.bus_options=[port={port}, hop_limit=0]')
    drive = processes(*DZ, 'driver', 'emulate', 'cia402', 'cia402',
                      *(word for text in (*PATIENT, *own) for word in ('--set', text)))
    drive.wait_for_line('simulated drive, node 1 on udp_multicast')
    tracks(*commission('cia402', *own))


def test_a_joint_of_ros2_control(commission, processes):
    device = Path(__file__).with_name('ros2_control_emulator.py')
    processes(str(device), str(ROOT / 'config' / 'joint.yaml'), 'effort', 'active=1',
              PYTHONPATH=str(ROOT)).wait_for_line('controllers are loaded')
    tracks(*commission('joint', 'driver.fresh=4.0'))

# SPDX-License-Identifier: Apache-2.0
"""`dz driver commission` on emulated devices: it ends in a loop that tracks."""

import json

import pytest

from dz_ros.recording.reader import read_run

pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.usefixtures('ros_domain')]

DZ = ('-m', 'dz_ros')
LIMITS = ('--travel', '2', '--speed', '2', '--effort', '6', '--repeats', '4', '--ramp', '2',
          '--pause', '0.2', '--loop-duration', '12', '--yes')
STEPS = ['limits', 'sign', 'sensor', 'identify', 'propose', 'check', 'loop', 'report']


@pytest.fixture
def commission(processes, tmp_path):
    """Return a function that commissions a device; again from a step that a stall spoilt."""
    def do(config, settings):
        out = tmp_path / 'first'
        shared = [word for text in settings for word in ('--set', text)]
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
            # A loop that a stall ended has left the device elsewhere than it was identified.
            again = 'identify' if '--from identify' in last['words'] else last['step']
            words = [config, *shared, *LIMITS, '--from', again, '--out', str(out)]
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
def test_a_serial_device(commission, serial_device, serial_settings):
    tracks(*commission('serial', serial_settings))


def test_a_cia402_drive(commission, cia402_settings):
    tracks(*commission('cia402', cia402_settings))


def test_a_joint_of_ros2_control(commission, joint_settings):
    tracks(*commission('joint', joint_settings))

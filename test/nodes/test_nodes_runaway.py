# SPDX-License-Identifier: Apache-2.0
"""The runaway guard in a loop over topics whose machine has no time for it."""

import json

import pytest

from dz_ros.recording.reader import read_run

pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

# Whatever else a stall spoils is no finding here.
PATIENT = ('safety.fault_after=100000', 'safety.error_limit=0.0', 'safety.command_limit=13')
BURNERS = """trap 'kill 0' INT; for each in 1 2 3 4; do (while :; do :; done) & done; wait"""
"""Four that compute, in one session: what else runs keeps its share of the cores."""


@pytest.fixture
def loaded(processes, tmp_path):
    """Run the servo beside processes that compute; return the process and its run."""
    def run(duration, *settings):
        burners = processes('sh', '-c', BURNERS)
        words = [word for text in (*PATIENT, *settings) for word in ('--set', text)]
        done = processes('-m', 'dz_ros', 'run', 'servo', '--duration', str(duration), '--quiet',
                         '--record', tmp_path / 'run', *words)
        done.wait(400.0)
        burners.end()
        return done, read_run(tmp_path / 'run')

    return run


def faults(data):
    """Return the reasons of faults of the guard."""
    events = [json.loads(text) for _, _, text in data.events]
    return [event['reason'] for event in events
            if event['event'] == 'mode' and 'runaway' in event['reason']]


@pytest.mark.slow
def test_load_is_no_runaway(loaded):
    # A healthy servo is never against its command for longer than a sample.
    done, data = loaded(20, 'safety.runaway_time=0.1')
    assert faults(data) == [], done.output
    active = data.channels['terms']['dt'] > 0.0
    assert active.sum() > 1000      # it was the law that acted


@pytest.mark.slow
def test_a_wrong_sign_is_found_beside_load(loaded):
    done, data = loaded(20, 'driver.name=mock', 'driver.script=["0- reversed"]')
    assert faults(data), done.output
    assert 'runaway' in done.output
    assert data.channels['command']['v'][-1] == 0.0

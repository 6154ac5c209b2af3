# SPDX-License-Identifier: Apache-2.0
"""Chosen runs of the comparison through ROS nodes equal the loop offline, bit for bit."""

import numpy as np
import pytest

from dz_ros.cli.arena_ros import difference
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import Channel, from_run, RunData
from dz_ros.core.loop.offline import simulate


def changed(data, name, label, place, value):
    """Return a run with one number replaced."""
    channel = data.channels[name]
    values = np.array(channel.values)
    values[place, channel.labels.index(label)] = value
    return RunData({**data.channels, name: Channel(channel.labels, values, channel.log_time,
                                                   channel.publish_time)}, data.configuration)


@pytest.fixture(scope='module')
def offline():
    return from_run(simulate(Configuration.from_flat({'loop.duration': 0.5})))


def test_equal_runs_do_not_differ(offline):
    assert difference(offline, offline) == ''


@pytest.mark.parametrize(('name', 'label'), [('state', 'x1'), ('command', 'v'), ('terms', 'phi')])
def test_one_number_is_found(offline, name, label):
    reported = difference(changed(offline, name, label, 42, 0.125), offline)
    assert reported.startswith(f'{name}.{label} differs from sample 42 on: ')
    assert '0.125' in reported


def test_a_message_that_came_again_is_the_same_sample(offline):
    state = offline.channels['state']
    rows = np.r_[0:43, 42, 42, 43:len(state)]
    again = RunData({**offline.channels, 'state': Channel(
        state.labels, state.values[rows], state.log_time[rows], state.publish_time[rows])})
    assert difference(again, offline) == ''
    reported = difference(changed(again, 'state', 'x0', 43, 0.125), offline)
    assert reported.startswith('state.x0 differs from sample 42 on: ')


def test_what_is_missing_is_found(offline):
    rest = {name: channel for name, channel in offline.channels.items() if name != 'terms'}
    assert difference(RunData(rest), offline) == 'terms was not recorded'
    assert 'samples' in difference(changed(offline, 'command', 'seq', 3, 7.0), offline)


@pytest.mark.ros
@pytest.mark.usefixtures('ros_domain')
def test_a_pulse_through_ros_is_the_pulse_offline(processes):
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    run = processes('-m', 'dz_ros', 'arena', '--ros', '--laws', 'fuzzy', '--scenarios',
                    'disturbance pulse;delay 2', '--duration', '2')
    assert run.wait(120) == 0, run.output
    assert run.output.count('equal, bit for bit') == 2

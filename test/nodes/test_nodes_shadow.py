# SPDX-License-Identifier: Apache-2.0
"""The shadow controller over real DDS."""

from dataclasses import replace
import json

import numpy as np
import pytest

from dz_ros.recording.reader import read_run
from dz_ros.recording.run_source import open_source
from dz_ros.recording.save import save_run

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

DZ = ('-m', 'dz_ros', 'bag', 'replay')


@pytest.mark.parametrize('law', ['wang2004', 'pd'])
def test_a_live_controller_of_the_same_build_answers_alike(processes, samples, tmp_path, law):
    recorded = processes('-m', 'dz_ros', 'run', 'robust', '--lockstep', '--duration', '2',
                         '--quiet', '--set', f'controller.law={law}', '--record', tmp_path / 'run')
    assert recorded.wait() == 0, recorded.output
    shadow = processes(*DZ, tmp_path / 'run', '--into', 'controller', '--record',
                       tmp_path / 'live')
    assert shadow.wait() == 0, shadow.output
    assert '401 of 401 recorded commands compared' in shadow.output
    assert 'largest |Δv| 0\n' in shadow.output
    live, first = (samples(read_run(tmp_path / name).channels['command'])
                   for name in ('live', 'run'))
    assert np.array_equal(live['v'], first['v'])
    topics = open_source(tmp_path / 'live')
    list(topics.batches())
    assert all(name.startswith('/shadow/') for name in topics.topics)


def test_a_live_controller_repeats_a_real_time_run_too(processes, tmp_path, patient):
    # Fed in lockstep, a controller cannot know when a busy machine made the other one stop.
    off = [word for key in ('state_hold', 'reference_hold', 'echo_limit')
           for word in ('--set', f'safety.{key}=0')]
    recorded = processes('-m', 'dz_ros', 'run', '--duration', '3', '--quiet', '--namespace',
                         'left', '--record', tmp_path / 'run', *patient, *off)
    assert recorded.wait() == 0, recorded.output
    shadow = processes(*DZ, tmp_path / 'run', '--into', 'controller', '--json')
    assert shadow.wait() == 0, shadow.output
    found = json.loads('{' + shadow.output.partition('\n{')[2])
    assert found['same']
    assert found['compared'] == found['recorded']
    assert found['command']['largest'] == 0.0


def test_a_controller_that_differs_is_reported_by_sample_and_term(processes, run, tmp_path):
    shadow = processes(*DZ, run, '--into', 'controller', '--set', 'controller.k_d=9')
    assert shadow.wait() == 1, shadow.output
    assert 'first command beyond 0: seq 0, t = 0 s' in shadow.output
    assert 'v_damping' in shadow.output
    data = read_run(run)
    command = data.channels['command']
    values = command.values.copy()
    values[123, 2] += 1e-9
    save_run(replace(data, channels={**data.channels, 'command': replace(
        command, values=values)}), tmp_path / 'changed')
    tampered = processes(*DZ, tmp_path / 'changed', '--into', 'controller')
    assert tampered.wait() == 1, tampered.output
    assert 'first command beyond 0: seq 123' in tampered.output


def test_a_paced_shadow_answers_in_real_time(processes, run):
    shadow = processes(*DZ, run, '--into', 'controller', '--paced', '--tolerance', '1000')
    assert shadow.wait() in (0, 1), shadow.output       # on a busy machine samples are skipped
    assert 'of 201 recorded commands compared' in shadow.output
    assert 'Traceback' not in shadow.output

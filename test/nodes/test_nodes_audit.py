# SPDX-License-Identifier: Apache-2.0
"""Gains changed in a live loop are in its recording, and the audit follows them bit for bit."""

from dataclasses import replace

import pytest

from dz_ros.recording.reader import read_run
from dz_ros.replay.audit.audit import audit

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

PROGRESS = '   late '
"""In every line of progress and in no other."""


def set_parameters(**values):
    """Set parameters of the controller one by one; return whether each was taken."""
    from rcl_interfaces.srv import SetParameters
    context = rclpy.Context()
    context.init()
    node = rclpy.create_node('setter', context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        client = node.create_client(SetParameters, '/controller_node/set_parameters')
        assert client.wait_for_service(60.0)
        taken = []
        for name, value in values.items():
            message = rclpy.parameter.Parameter(f'controller.{name}', value=value)
            future = client.call_async(
                SetParameters.Request(parameters=[message.to_parameter_msg()]))
            executor.spin_until_future_complete(future, 60.0)
            taken.append(future.result().results[0].successful)
        return taken
    finally:
        executor.shutdown()
        node.destroy_node()
        context.shutdown()


def test_live_gain_changes_are_followed_by_the_audit(processes, tmp_path, patient):
    run = processes('-m', 'dz_ros', 'run', 'wang2004', *patient, '--duration', '0', '--record',
                    tmp_path / 'run')
    run.wait_for_line(PROGRESS)
    assert set_parameters(k_d=14.0, gamma=-1.0) == [True, False]
    # Two changes at once might fall between the same two samples.
    run.wait_for_line(PROGRESS, nth=run.output.count(PROGRESS) + 1)
    assert set_parameters(epsilon=0.03) == [True]
    run.wait_for_line(PROGRESS, nth=run.output.count(PROGRESS) + 2)     # a second or two with it
    assert run.interrupt() == 0, run.output
    result = audit(read_run(tmp_path / 'run'))
    assert result.passed, result
    assert len(result.spans) >= 3      # one more wherever the loop had to take over again


def test_samples_without_a_measurement_are_no_missing_messages(processes, tmp_path, patient):
    script = '["100-101 none", "150 none", "200-260 none"]'
    run = processes('-m', 'dz_ros', 'run', 'servo', '--duration', '2', '--set', 'driver.name=mock',
                    '--set', f'driver.script={script}', *patient, '--set', 'safety.error_limit=0',
                    '--record', tmp_path / 'run')
    assert run.wait() == 0, run.output
    data = read_run(tmp_path / 'run')
    seq = data.channels['state']['seq'].astype(int).tolist()
    absent = sorted(set(range(seq[-1] + 1)) - set(seq))
    assert absent == [100, 101, 150, *range(200, 261)]
    result = audit(data)
    assert result.passed, result
    assert ('state: the device had no measurement for 64 sample(s), which have no state: seq '
            '100 … 101, 150, 200 … 260') in result.notes
    # What is lost besides is still missing.
    states = data.channels['state']
    keep = states['seq'] != 120
    cut = replace(states, values=states.values[keep], log_time=states.log_time[keep],
                  publish_time=states.publish_time[keep])
    found = audit(replace(data, channels={**data.channels, 'state': cut}))
    assert 'state: 1 message(s) missing: seq 120' in found.findings

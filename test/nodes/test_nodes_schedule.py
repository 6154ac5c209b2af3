# SPDX-License-Identifier: Apache-2.0
"""A scheduling variable by a topic of another process: law and simulated dead-zone follow it."""

import math

import numpy as np
import pytest

from dz_ros.core.deadzone import dead_zone, Schedule
from dz_ros.files.configurations import load_configuration
from dz_ros.recording.reader import read_run
from dz_ros.replay.audit.audit import audit

pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

TOPIC = 'battery/voltage'
KNOWN = [f'controller.{name}={value}' for name, value in (
    ('law', 'scheduled'), ('table_points', '[10.0, 12.0, 16.0, 20.0]'), ('psi_0', 20.0),
    ('m_r_known', '[0.572, 0.717, 1.0, 1.241]'), ('m_l_known', '[0.455, 0.566, 0.779, 0.931]'),
    ('b_r_known', '[44.0, 40.0, 32.0, 28.0]'), ('b_l_known', '[-44.0, -40.0, -32.0, -28.0]'),
    ('m_bounds', '[0.6, 1.25]'), ('b_r_bounds', '[26.0, 46.0]'), ('b_l_bounds', '[-46.0, -26.0]'),
    ('override_checks', 'true'))]
SETTINGS = ['loop.schedule_values=[20.0]', 'loop.schedule_times=[]',
            f'loop.schedule_topic={TOPIC}', *KNOWN, 'safety.state_hold=200',
            'safety.command_hold=100', 'safety.echo_limit=200', 'safety.fault_after=4000',
            'safety.runaway_time=0.0', 'plant.wave_force=0.0']


@pytest.fixture
def reports(watcher):
    """Return node → (level, message, values), as they come."""
    from diagnostic_msgs.msg import DiagnosticArray
    found = {}
    watcher.node.create_subscription(
        DiagnosticArray, '/diagnostics', lambda message: found.update({
            item.name.strip('/'): (item.level[0], item.message,
                                   {pair.key: pair.value for pair in item.values})
            for item in message.status}), 50)
    return found


@pytest.fixture
def voltage(watcher, reports):
    """Publish a voltage until both ends use it; a reliable publisher, or one that is not.

    `spans` has (voltage, first, last seq) of the samples in which both did.
    """
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float64

    publishers = {reliable: watcher.node.create_publisher(Float64, TOPIC, QoSProfile(
        depth=1, reliability=ReliabilityPolicy.RELIABLE if reliable
        else ReliabilityPolicy.BEST_EFFORT)) for reliable in (True, False)}

    def used():
        return [message.data[-1] for message in watcher.received['terms'][-1:]]

    def in_use(value):
        return used() == [value] and all(
            reports.get(node, (0, '', {}))[2].get('scheduling variable') == f'{value:g}'
            for node in ('plant_node', 'controller_node'))

    def answered():     # the count of commands is another where the machine stalled
        newest = watcher.received['terms'][-1]
        return newest.data[newest.layout.dim[0].label.split(',').index('echo_seq')]

    def held(value):
        first = answered()
        watcher.wait(lambda: answered() > first + 100)
        # The samples after the last command that was received may have the next voltage.
        give.spans.append((value, first, answered() - 5))

    def give(value, expected=None, reliable=True):
        wanted = value if expected is None else expected

        def settled():
            publishers[reliable].publish(Float64(data=value))
            return in_use(wanted)

        watcher.wait(settled)
        held(wanted)

    give.used, give.held, give.spans = used, held, []
    return give


def test_law_and_dead_zone_follow_a_topic_of_another_process(processes, watcher, voltage,
                                                             reports, tmp_path):
    words = [word for text in SETTINGS for word in ('--set', text)]
    run = processes('-m', 'dz_ros', 'run', 'thruster', '--duration', '0', '--quiet', '--record',
                    tmp_path / 'run', *words)
    watcher.wait_for_mode(plant_node='running', controller_node='running')
    # Before its first message the configured value holds, and both ends warn.
    watcher.wait(lambda: voltage.used() == [20.0])
    voltage.held(20.0)
    for node in ('plant_node', 'controller_node'):
        watcher.wait(lambda node=node: 'nothing has come on battery/voltage'
                     in reports.get(node, (0, '', {}))[1])
    voltage(12.0)
    # What is no voltage is counted and changes nothing; nor does silence, which is a warning.
    for value in (math.nan, math.inf):
        voltage(value, 12.0)
    run.wait_for_line('loop.schedule_topic: not finite')
    for node in ('plant_node', 'controller_node'):
        watcher.wait(lambda node=node: 'has been silent for' in reports[node][1])
        assert reports[node][2]['scheduling variable'] == '12'
    assert voltage.used() == [12.0]
    voltage(14.0, reliable=False)       # as sensors publish
    voltage(99.0)                       # beyond the tables their last point holds
    assert run.interrupt() == 0, run.output

    data = read_run(tmp_path / 'run')
    psi = data.channels['terms']['psi_before']
    assert list(dict.fromkeys(psi.tolist())) == [20.0, 12.0, 14.0, 99.0]
    # The simulated dead-zone is that of the voltage.
    c = load_configuration('thruster', SETTINGS)
    command, truth = data.channels['command'], data.channels['truth']
    checked = 0
    assert {value for value, _, _ in voltage.spans} == {20.0, 12.0, 14.0, 99.0}
    outputs = np.unique(np.round(command['v'])).tolist()
    for value, first, last in voltage.spans:
        w = truth['w'][(truth['seq'] >= first) & (truth['seq'] <= last)]
        w = w[w != 0.0]
        checked += len(w)
        # Outputs are those of whole microseconds by the tables of this voltage, and of no other;
        # but for those of a ramp to the safe command and back, where the machine stalled.
        share = {}
        for other in (12.0, 14.0, 20.0):
            numbers = c.dead_zone.numbers(Schedule((0.0,), (other,)))
            possible = np.array([dead_zone(v, 0.0, numbers) for v in outputs])
            share[other] = np.mean(np.abs(w[:, None] - possible).min(axis=1) < 1e-9)
        assert len(w) == 0 or share[min(value, 20.0)] > 0.5, (value, share)
        assert len(w) == 0 or sorted(share.values())[-2] < 0.5, (value, share)
    assert checked > 100
    result = audit(data)
    assert result.passed, result

# SPDX-License-Identifier: Apache-2.0
"""Nodes with several axes: lockstep is offline, faults name their axis and stop all."""

from pathlib import Path
import signal

import numpy as np
import pytest

from dz_ros.core.axes import MAX_AXES
from dz_ros.core.dataset import from_runs
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.records import Command
from dz_ros.files.configurations import load_configuration
from dz_ros.recording.reader import read_run
from dz_ros.replay.audit.audit import audit
from dz_ros.runs.axes import each_axis
from dz_ros.runs.history import RunHistory

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

NODE = ('-m', 'dz_ros.nodes.main')
CONFIG = Path(__file__).parents[2] / 'config' / 'six_axes.yaml'
AXES = ('base', 'shoulder', 'elbow', 'roll', 'pitch', 'yaw')
ARGUMENTS = ('--ros-args', '--params-file', CONFIG, '-p', 'loop.duration:=0.0')
NAMES = ('trajectory_node', 'controller_node', 'actuator_node')


@pytest.mark.parametrize(('name', 'names'), [
    ('six_axes', AXES), ('two_link_arm', ('shoulder', 'elbow')),
    ('rov_planar', ('surge', 'sway', 'yaw'))])
def test_lockstep_over_dds_is_offline_and_audited_bit_for_bit(processes, tmp_path, name, names):
    out = tmp_path / 'run'
    run = processes('-m', 'dz_ros', 'run', name, '--lockstep', '--duration', '1', '--quiet',
                    '--record', out)
    assert run.wait() == 0, run.output
    recorded = read_run(out)
    assert recorded.axes == names
    c = RunHistory.of(recorded).configuration
    offline = from_runs(simulate_axes(c), c)
    for topic, channel in offline.channels.items():
        rows = recorded.channels[topic].values      # references may be sent again at the start
        found = rows[np.unique(rows[:, 0], return_index=True)[1]][:len(channel)]
        assert np.array_equal(found, channel.values), topic
    runs = each_axis(recorded)
    for axis, of_axis in runs.items():
        others = [item for other, item in runs.items() if other != axis]
        assert audit(of_axis, others=others).passed, axis


@pytest.fixture
def start(processes, operator):
    """Return ``start(*arguments)``: the nodes of a loop without end, by name, that runs."""
    def begin(*arguments):
        nodes = {name: processes(*NODE, name, *ARGUMENTS, *arguments) for name in NAMES}
        operator.wait(lambda: len(operator.heard['state']) > 50)
        return nodes

    return begin


def stop(nodes):
    """Interrupt the nodes, the actuator's first; see that each ends in order."""
    for name in reversed(NAMES):
        nodes[name].signal(signal.SIGINT)
        assert nodes[name].wait() == 0, nodes[name].output
        assert 'Traceback' not in nodes[name].output


def test_a_driver_that_dies_is_named_and_stops_every_axis(start, operator):
    nodes = start('-p', 'driver.name:=mock', '-p', 'axes.roll.driver.script:=["300- fault burnt"]')
    operator.wait_for_mode(actuator_node='fault')
    assert operator.modes()['actuator_node'][1].startswith('axis roll: burnt')
    seen = len(operator.heard['state'])
    operator.wait(lambda: len(operator.heard['state']) > seen + 20)
    assert operator.life('/actuator_node') == 'active'
    stop(nodes)


def test_a_limit_of_one_axis_is_a_fault_of_all_until_the_reset(start, operator):
    nodes = start()
    assert not operator.set('/controller_node', controller__lambda=2.0).successful
    assert operator.set('/controller_node', axes__yaw__controller__lambda=8.0).successful
    assert operator.set('/controller_node', axes__pitch__safety__error_limit=1e-9).successful
    operator.wait_for_mode(controller_node='fault')
    assert operator.modes()['controller_node'][1].startswith('axis pitch: error ')
    width = len(Command.labels())
    operator.wait(lambda: not any(operator.heard['command'][-1].data[2::width]))
    assert len(operator.heard['command'][-1].data) == width * len(AXES)
    assert operator.set('/controller_node', axes__pitch__safety__error_limit=0.0).successful
    assert operator.call('/controller_node/reset').success
    operator.wait_for_mode(controller_node='running')
    stop(nodes)


@pytest.mark.parametrize(('arguments', 'wanted'), [
    (('-p', 'axes.yaw.controller.lamda:=2.0'), 'axes.yaw.controller.lamda'),
    (('-p', 'axes.jaw.controller.lambda:=2.0'), 'not jaw'),
    (('-p', 'axes.yaw.controller.law:=pid'), 'two loops'),
    (('-p', 'loop.axes:=[yaw, yaw]'), 'names yaw twice'),
    (('-p', f'loop.axes:=[{", ".join(f"a{i}" for i in range(MAX_AXES + 1))}]'), 'at most'),
])
def test_axes_that_cannot_be_are_one_line(processes, arguments, wanted):
    node = processes(*NODE, 'controller_node', *ARGUMENTS, *arguments)
    assert node.wait() == 2
    assert wanted in node.output
    assert 'Traceback' not in node.output


def test_the_configuration_is_the_one_of_the_file():
    assert load_configuration(CONFIG).axis_names == AXES

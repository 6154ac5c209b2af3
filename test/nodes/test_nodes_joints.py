# SPDX-License-Identifier: Apache-2.0
"""The driver `joint` of several axes: the joints of one controller in one command, one state.

Over 300 lines: one process replaces the controllers of all of it.
"""

import math
from pathlib import Path
import re
import time
import types

import numpy as np
import pytest
import yaml

from dz_ros.core.axes_keys import axis_key
from dz_ros.core.records import State
from dz_ros.drivers.hosted_axes import HostedDrivers
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration
from dz_ros.nodes.joint_states import JointStates

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / 'config' / 'joint.yaml'
AXES = {'upper': 'joint1', 'fore': 'joint2', 'hand': 'joint3'}
TWO = {
    'upper': {'driver': {'joint': 'joint1'}},
    'fore': {'driver': {'joint': 'joint2'}, 'trajectory': {'goal': -1.0, 'duration': 2.5},
             'plant': {'dead_zone': {'b_r': 0.3, 'b_l': -0.35, 'm_r': 1.1}}}}
"""What two axes have of their own."""


def configuration(*more, axes=AXES):
    """Return that of a loop of such axes, each a joint of its own."""
    return load_configuration(CONFIG, [
        f'loop.axes=[{", ".join(axes)}]',
        *(f'{axis_key(name, "driver.joint")}={joint}' for name, joint in axes.items()), *more])


# The configuration.

@pytest.mark.parametrize(('more', 'key', 'words'), [
    (['axes.hand.driver.joint=joint1'], 'axes.hand.driver.joint', 'is the joint of axis upper'),
    (['axes.fore.driver.interface=velocity'], 'axes.fore.driver.interface',
     "must be 'effort' as of axis upper: one controller commands both, on "
     '/effort_controller/commands'),
    (['axes.hand.driver.state_topic=/hand/states'], 'axes.hand.driver.state_topic', 'axis upper'),
    (['axes.hand.driver.patience=9'], 'axes.hand.driver.patience', 'must be 5.0 as of axis upper'),
])
def test_joints_that_do_not_go_together_are_refused_by_name(more, key, words):
    with pytest.raises(ConfigurationError) as caught:
        configuration(*more)
    assert caught.value.key == key
    assert words in str(caught.value)


def test_axes_without_joints_of_their_own_are_refused():
    with pytest.raises(ConfigurationError, match=r"axes\.fore\.driver\.joint = 'joint1': is the "
                       'joint of axis upper; each axis has one of its own'):
        load_configuration(CONFIG, ['loop.axes=[upper, fore]'])


def test_controllers_of_their_own_share_nothing():
    c = configuration('axes.hand.driver.command_topic=/hand/commands',
                      'axes.hand.driver.interface=velocity')
    upper, fore, hand = c.make_drivers()
    assert upper.group is fore.group
    assert hand.group is not upper.group
    assert upper.device is fore.device is upper.group
    assert hand.device is None


# What is sent and taken, without ROS.

class Published(list):
    """A publisher that keeps what it is given."""

    topic_name = '/effort_controller/commands'
    subscribers = 1

    def publish(self, message):
        self.append(list(message.data))

    def get_subscription_count(self):
        return self.subscribers

    def wait_for_all_acked(self, duration):
        return True


class Answer:
    """A parameter that the controller is asked for."""

    def __init__(self, value):
        self._value = value

    def result(self):
        return types.SimpleNamespace(values=[types.SimpleNamespace(
            string_array_value=self._value, string_value=self._value)])

    def add_done_callback(self, call):
        call(self)


class Node:
    """The host's node as the drivers need it, and a controller that answers it."""

    def __init__(self, joints, interface='effort'):
        self.parameters = {'joints': joints, 'interface_name': interface}
        self.published, self.logged = Published(), []
        self.time = time.monotonic()    # stands still: nothing grows old by itself

    def get_clock(self):        # another one than the stamps'
        return types.SimpleNamespace(now=lambda: types.SimpleNamespace(nanoseconds=0))

    def create_publisher(self, *_):
        return self.published

    def create_client(self, *_):
        return types.SimpleNamespace(
            service_is_ready=lambda: True, remove_pending_request=lambda future: None,
            call_async=lambda request: Answer(self.parameters[request.names[0]]))

    def create_timer(self, period, call, clock):
        self.tick = call

    def count_publishers(self, topic):
        return 1

    def get_logger(self):
        return types.SimpleNamespace(warning=self.logged.append, error=self.logged.append)

    def __getattr__(self, name):
        return lambda *_, **__: None


@pytest.fixture
def hosted(monkeypatch):
    """Return ``make(joints, *more)``: machine and node, enabled, with a controller of these."""
    pytest.importorskip('rclpy', reason='rclpy is not installed')
    monkeypatch.setattr(JointStates, 'subscribe', lambda states: None)

    def make(joints=('joint1', 'joint2', 'joint3'), *more, interface='effort'):
        machine = HostedDrivers(configuration(
            'driver.extrapolate=false', 'driver.fresh=1000', f'driver.interface={interface}',
            *more))
        node = Node(joints, interface)
        monkeypatch.setattr('dz_ros.nodes.joint_group.time',
                            types.SimpleNamespace(monotonic=lambda: node.time))
        machine.open(node)
        machine.enable()
        node.tick()
        return machine, node

    return make


@pytest.mark.parametrize(('joints', 'sent'), [
    (('joint1', 'joint2', 'joint3'), [1.0, 2.0, 3.0]),
    (('joint3', 'joint1', 'joint2'), [3.0, 1.0, 2.0]),
    (('gripper', 'joint3', 'joint2', 'joint1', 'head'), [0.0, 3.0, 2.0, 1.0, 0.0]),
])
def test_a_sample_is_one_message_in_the_order_of_the_controller(hosted, joints, sent):
    machine, node = hosted(joints)
    machine.command((1.0, 2.0, 3.0), 0.0)
    assert node.published == [sent]
    machine.safe((0.1, 0.2, 0.3), 0.005)
    assert [round(10 * v) for v in node.published[1]] == [round(v) for v in sent]


def test_the_safe_command_of_all_is_repeated_and_the_end_sends_no_half(hosted):
    machine, node = hosted()
    machine.command((1.0, 2.0, 3.0), 0.0)
    node.time += 1.0
    node.tick()
    assert len(node.published) == 1     # while the law acts nothing is repeated
    machine.safe((0.0, 0.0, 0.0), 0.005)
    node.time += 1.0
    node.tick()
    assert node.published[1:] == [[0.0, 0.0, 0.0]] * 2
    machine.command((1.0, 2.0, 3.0), 0.01)
    assert machine.disable((-0.1, -0.2, -0.3), 0.015) == ''
    assert node.published[3] == [1.0, 2.0, 3.0]
    ended = node.published[4:]
    assert ended == [[-0.1, -0.2, -0.3]] * len(ended) != []
    node.time += 1.0
    node.tick()
    assert len(node.published) == 4 + len(ended)


def test_a_driver_that_alone_is_given_commands_does_not_wait_for_ever(hosted):
    machine, node = hosted()
    first = machine.each[0]
    for v in (1.0, 2.0, 3.0):
        first.command(v, 0.0)
    assert node.published == [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    machine.command((5.0, 6.0, 7.0), 0.0)       # a sample is one message again
    assert node.published[2:] == [[3.0, 0.0, 0.0], [5.0, 6.0, 7.0]]
    machine.each[2].command(4.0, 0.0)
    machine.command((5.0, 6.0, 7.0), 0.0)
    assert node.published[4:] == [[5.0, 6.0, 4.0], [5.0, 6.0, 7.0]]


def test_asking_one_joint_alone_does_not_tear_a_sample_apart(hosted):
    machine, node = hosted()
    machine.driver.states.receive(state(['joint1', 'joint2', 'joint3']), 1)
    machine.measure(0.0)
    machine.each[2].measure(0.005)
    machine.recover()                   # which judges each joint twice
    machine.driver.states.receive(
        state(['joint1', 'joint2', 'joint3'], (2, 0), position=[5.0, 6.0, 7.0]), 2)
    assert [x[0] for x in machine.measure(0.01)] == [5.0, 6.0, 7.0]
    assert machine.fault() == ''
    node.published.subscribers = 0
    assert machine.fault() == ('axes upper, fore, hand: no node subscribes to '
                               '/effort_controller/commands: is the controller loaded?')


def test_nothing_is_sent_before_the_controller_has_answered_again(hosted):
    machine, node = hosted()
    machine.driver.states.receive(state(['joint1', 'joint2', 'joint3']), 1)
    assert machine.measure(0.0) is not None
    machine.close()                     # without being disabled, as after an error
    machine.open(node)
    machine.enable()
    machine.command((1.0, 2.0, 3.0), 0.0)
    assert node.published == []
    assert machine.measure(0.0) is None
    assert machine.fault() == ''        # it has time to answer
    node.tick()
    machine.command((1.0, 2.0, 3.0), 0.0)
    assert node.published == [[1.0, 2.0, 3.0]]


def state(names, stamp=(1, 0), **more):
    """Return a joint state: joint N is at N/10 and moves with -N."""
    number = [float(name[5:]) if name.startswith('joint') else 9.0 for name in names]
    stamp = types.SimpleNamespace(sec=stamp[0], nanosec=stamp[1])
    return types.SimpleNamespace(**{
        'name': list(names), 'position': [x / 10.0 for x in number],
        'velocity': [-x for x in number],
        'header': types.SimpleNamespace(stamp=stamp), **more})


def test_joints_are_found_by_name_and_all_are_of_one_message(hosted):
    machine, _ = hosted()
    machine.driver.states.receive(state(['joint3', 'head', 'joint1', 'joint2']), 1)
    wanted = ((0.1, -1.0), (0.2, -2.0), (0.3, -3.0))
    assert machine.measure(0.0) == wanted
    # A newer one that arrives between two axes belongs to the next sample.
    assert machine.each[0].measure(0.005) == wanted[0]
    machine.driver.states.receive(
        state(['joint1', 'joint2', 'joint3'], (2, 0), position=[5.0, 6.0, 7.0]), 2)
    assert machine.each[1].measure(0.005) == wanted[1]
    assert machine.measure(0.01) == ((5.0, -1.0), (6.0, -2.0), (7.0, -3.0))


@pytest.mark.parametrize(('message', 'words', 'cause'), [
    (state(['joint1', 'head', 'joint3'], (2, 0)), "joint 'joint2' is not among those of "
     '/joint_states: joint1, head, joint3', 'joint states without one of the joints'),
    (state(['joint2'], (2, 0)), "joints 'joint1', 'joint3' are not among those",
     'joint states without one of the joints'),
    (state(['joint1', 'joint2', 'joint1', 'joint3'], (2, 0)), "/joint_states names joint 'joint1' "
     'twice', 'joint states that name a joint twice'),
    (state(['joint1', 'joint2', 'joint3'], (2, 0), position=[0.0, 0.0]),
     "/joint_states has no position of 'joint3'", 'joint states without position'),
    (state(['joint1', 'joint2', 'joint3'], (2, 0), velocity=[0.0, math.nan, 0.0]),
     "the velocity of 'joint2' is nan", 'joint states whose velocity is not finite'),
    (state(['head', 'foot'], (2, 0)), "joints 'joint1', 'joint2', 'joint3' are not among those of "
     '/joint_states: head, foot', None),
])
def test_what_one_joint_lacks_is_no_measurement_of_the_machine(
        hosted, message, words, cause):
    machine, _ = hosted()
    machine.driver.states.receive(message, 1)
    assert machine.measure(0.0) is None
    assert words in machine.absence()
    assert machine.absence().startswith('axes upper, fore, hand: ')
    assert machine.refused() == ({f'upper: {cause}': 1} if cause else {})


def test_no_measurement_is_a_fault_of_all_that_is_worded_once(hosted):
    machine, node = hosted(('joint1', 'joint2', 'joint3'), 'safety.state_hold=3',
                           'driver.patience=1000')
    machine.driver.states.receive(state(['joint1', 'joint2', 'joint3']), 1)
    assert machine.measure(0.0) is not None
    machine.driver.states.receive(state(['joint1', 'joint3'], (2, 0)), 2)
    node.time += 60.0
    for k in range(3):
        assert machine.fault() == ''
        assert machine.measure(0.005 * k) is None
    assert machine.fault() == (
        "axes upper, fore, hand: no measurement for 3 samples: joint 'joint2' is not among those "
        'of /joint_states: joint1, joint3')


def test_each_joint_has_its_own_velocity_and_limit(hosted):
    machine, node = hosted(('joint2', 'joint1', 'joint3'), 'axes.fore.driver.measured=1',
                           'axes.fore.driver.limit=1.5')
    assert [item.observing for item in machine.each] == [False, True, False]
    machine.driver.states.receive(
        state(['joint1', 'joint2', 'joint3'], velocity=[-1.0, math.nan, -3.0]), 1)
    upper, fore, hand = machine.measure(0.0)
    assert (upper, fore[0], hand) == ((0.1, -1.0), 0.2, (0.3, -3.0))
    assert machine.command((2.0, 2.0, 2.0), 0.0) == (2.0, 1.5, 2.0)
    assert node.published == [[1.5, 2.0, 2.0]]


# The controller's answer.

def test_a_joint_that_no_axis_has_is_named_once(hosted):
    machine, node = hosted(['head', 'joint3', 'joint1', 'joint2', 'foot'])
    assert machine.fault() == ''
    machine.disable((0.0, 0.0, 0.0), 0.0)
    machine.enable()
    node.tick()
    assert node.logged == ['/effort_controller commands head, foot as well, which no axis has: '
                           'commanded 0']


@pytest.mark.parametrize(('joints', 'interface', 'fault'), [
    (['joint1', 'head'], 'effort', "axes fore, hand: /effort_controller does not command "
     "driver.joint = 'joint2', 'joint3'; its joints: joint1, head"),
    (['joint3', 'joint1'], 'effort', "axis fore: /effort_controller does not command "
     "driver.joint = 'joint2'; its joints: joint3, joint1"),
    (['joint1', 'joint2', 'joint3', 'joint1'], 'effort',
     "axes upper, fore, hand: /effort_controller names joint 'joint1' twice"),
    (['joint1', 'joint2', 'joint3', 'head'], 'position', 'axes upper, fore, hand: '
     '/effort_controller commands head as well, which no axis has: no position is safe for it; '
     'give the controller the joints of the axes alone'),
    ([], 'effort', 'axes upper, fore, hand: /effort_controller has no parameter joints: it is no '
     'forward_command_controller or effort controller'),
])
def test_other_joints_are_refused_by_name_and_nothing_is_sent(hosted, joints, interface, fault):
    machine, node = hosted(joints, interface=interface)
    machine.driver.states.receive(state(['joint1', 'joint2', 'joint3']), 1)
    machine.command((1.0, 2.0, 3.0), 0.0)
    machine.safe((0.0, 0.0, 0.0), 0.005)
    assert node.published == []
    assert machine.measure(0.0) is None
    assert machine.fault() == fault
    assert machine.recover() != ''


# Everything as processes.

@pytest.fixture
def two(tmp_path):
    """A parameter file of two joints with dead-zones and motions of their own."""
    content = yaml.safe_load(CONFIG.read_text(encoding='utf-8'))
    parameters = content['/**']['ros__parameters']
    parameters['loop']['axes'] = list(TWO)
    parameters['axes'] = TWO
    path = tmp_path / 'two.yaml'
    path.write_text(yaml.safe_dump(content), encoding='utf-8')
    return path


@pytest.mark.ros
def test_both_joints_track_behind_a_controller_of_another_order_with_a_joint_of_no_axis(
        robot, watcher, two):
    nodes = robot.start(
        *(word for key, value in {
            'command_topic': '/left/effort_controller/commands',
            'state_topic': '/left/joint_states',
            'activity_topic': '/left/controller_manager/activity'}.items()
          for word in ('-p', f'driver.{key}:={value}')),
        config=two, options=['joints=joint2,gripper,joint1', 'namespace=/left'])
    width = len(State.labels(2))
    for place, axis in enumerate(load_configuration(two).each):
        watcher.tracked(axis.trajectory, 0.01, row=place)
    assert all(len(data) == 2 * width for data in watcher.states)
    assert {held[1] for _, held, *_ in robot.interface} == {0.0}
    for node in nodes.values():
        assert node.interrupt() == 0
        assert 'Traceback' not in node.output
    assert nodes['actuator_node'].output.count(
        '/left/effort_controller commands gripper as well, which no axis has: commanded 0') == 1
    watcher.wait(lambda: robot.held == [0.0, 0.0, 0.0])     # the safe command is what is held


TRIES = 5
NO_USE = {
    'part': ('whole', "joint 'joint2' is not among those of /joint_states: shoulder, joint1"),
    'nan': ('number', "the position of 'joint2' is nan")}
"""What the emulator is commanded → what ends it, and what is reported of it."""


@pytest.mark.ros
def test_what_one_joint_lacks_stops_both_and_so_does_a_controller_that_leaves_active(
        robot, watcher, two):
    nodes = robot.start(config=two)
    for word, (back, reason) in NO_USE.items():
        watcher.running()
        robot.do(word)
        watcher.wait_for_mode(actuator_node='fault')
        reported = watcher.modes()['actuator_node'][1]
        assert reported.startswith('axes upper, fore: no measurement for ')
        assert reason in reported
        watcher.wait(lambda: robot.held == [0.0, 0.0])
        robot.do(back)
        watcher.wait(watcher.recovered)
        watcher.wait(lambda: watcher.modes()['actuator_node'][0] == 'running')
        watcher.wait(lambda: all(robot.held))
    left_behind = []
    for _ in range(TRIES):              # a stall may have had the safe command out just then
        watcher.wait(lambda: all(robot.held))
        robot.do('deactivate')
        watcher.wait_for_mode(actuator_node='fault')
        reported = watcher.modes()['actuator_node'][1]
        assert reported.startswith('axes upper, fore: the controller /effort_controller is ')
        assert reported.endswith(': it takes no commands')
        left_behind = robot.held        # by the forwarding controller
        robot.do('activate')            # it has forgotten every command
        watcher.wait(lambda: robot.held == [0.0, 0.0])
        watcher.wait(watcher.recovered)
        watcher.running()
        if any(left_behind):
            break
    assert any(left_behind)
    assert all(math.isfinite(number) for data in watcher.states for number in data)
    assert nodes['actuator_node'].interrupt() == 0
    watcher.wait(lambda: robot.held == [0.0, 0.0])


@pytest.mark.ros
def test_a_controller_without_the_joint_of_an_axis_is_never_commanded(robot, watcher, two):
    nodes = robot.start(config=two, options=['joints=joint1,gripper'])
    watcher.wait_for_mode(actuator_node='fault')
    assert watcher.modes()['actuator_node'][1] == (
        "axis fore: /effort_controller does not command driver.joint = 'joint2'; its joints: "
        'joint1, gripper')
    assert not watcher.call('actuator_node/reset').success
    assert not watcher.states
    assert nodes['actuator_node'].interrupt() == 0
    assert all(active and held == [0.0, 0.0] for active, held, *_ in robot.interface[-100:])


@pytest.mark.ros
def test_one_joint_is_identified_while_the_controller_holds_the_other_at_its_safe_command(
        robot, watcher, processes, two, tmp_path):
    robot.emulator(config=two)
    out = tmp_path / 'found'
    process = processes('-m', 'dz_ros', 'driver', 'identify', two, '--axis', 'fore', '--travel',
                        '3', '--speed', '2', '--effort', '4', '--repeats', '4', '--ramp', '2',
                        '--pause', '0.3', '--yes', '--out', out, '--set', 'driver.fresh=20',
                        '--set', 'safety.state_hold=10000', '--set', 'safety.fault_after=20000')
    watcher.wait(lambda: process.poll() is not None, 400.0)
    code = process.poll()
    assert 'its device is that of upper too' in process.output
    watcher.wait(lambda: robot.held == [0.0, 0.0])      # the last thing it was given
    held = np.array([held for _, held, *_ in robot.interface])
    assert not held[:, 0].any()
    assert held[:, 1].max() > 1.0
    assert held[:, 1].min() < -1.0
    assert held[-1].tolist() == [0.0, 0.0]
    # A machine that stalls may lose too many states for an answer, or leave old ones.
    assert code in (0, 1) or re.search('is not a number in|of the states are lost|is not the rate',
                                       process.output), process.output

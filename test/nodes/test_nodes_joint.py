# SPDX-License-Identifier: Apache-2.0
"""The driver `joint` against a process that behaves as ros2_control's controllers do.

Over 300 lines: one driver, without ROS and in the loop.
"""

import itertools
import json
import math
from pathlib import Path
import re
import sys
import time
import types

import pytest

from dz_ros.drivers.hosted import HostedDriver
from dz_ros.errors import ConfigurationError, DriverError
from dz_ros.files.configurations import load_configuration
from dz_ros.nodes.joint_controller import ForwardingController
from dz_ros.nodes.joint_sources import JointSources
from dz_ros.nodes.joint_states import JointSample, JointStates

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / 'config' / 'joint.yaml'


def make(**driver):
    return load_configuration(CONFIG, [f'driver.{key}={value}' for key, value
                                       in driver.items()]).make_driver()


# What a joint state reports of the joint, without ROS.

def state(names=('shoulder', 'joint1'), position=(9.0, 0.25), velocity=(8.0, -0.5), stamp=(1, 0)):
    stamp = types.SimpleNamespace(sec=stamp[0], nanosec=stamp[1])
    return types.SimpleNamespace(name=list(names), position=list(position),
                                 velocity=list(velocity),
                                 header=types.SimpleNamespace(stamp=stamp))


def subscribed(**parameters):
    """Return a driver that thinks it is open, and waited for its joint for long."""
    driver = make(**{'patience': 0.1, 'extrapolate': 'false', **parameters})
    driver.group._publisher = types.SimpleNamespace(get_subscription_count=lambda: 1)
    driver.group._since = time.monotonic() - 1.0
    return driver


def test_the_named_joint_is_taken_wherever_it_stands():
    driver = subscribed(fresh=1000)
    driver.states.receive(state(), 1)
    assert driver.measure() == (0.25, -0.5)
    driver.states.receive(state(('joint1', 'shoulder'), (0.5, 9.0), (1.0, 8.0), (1, 1)), 2)
    assert driver.measure() == (0.5, 1.0)
    assert driver.fault() == ''


@pytest.mark.parametrize(('message', 'words'), [
    (state(names=('shoulder', 'elbow')), "joint 'joint1' is not among those of /joint_states: "
     'shoulder, elbow'),
    (state(names=('\x1b[2J' * 9, *'abcdefghijklmnopqrstuvwxyz' * 900)), 'joint_states: \\x1b[2J'),
    (state(names=()), "joint 'joint1' is not among those of /joint_states: none"),
    (state(position=()), "/joint_states has no position of 'joint1'"),
    (state(velocity=()), "/joint_states has no velocity of 'joint1': set driver.measured to 1"),
    (state(position=(9.0, math.nan)), "the position of 'joint1' is nan"),
    (state(velocity=(8.0, math.nan)),
     "the velocity of 'joint1' is nan: set driver.measured to 1 to have it observed"),
    (state(velocity=(9.0, -math.inf)), "the velocity of 'joint1' is -inf"),
])
def test_what_is_wrong_with_a_joint_state_is_reported(message, words):
    driver = subscribed()
    driver.states.receive(message)
    assert driver.measure() is None
    assert words in driver.fault()
    assert len(driver.fault()) < 500
    with pytest.raises(DriverError, match='joint'):
        driver.recover()
    assert sum(driver.refused.values()) + driver.states.counts['joint states of others'] == 1


def test_nothing_at_all_is_reported():
    assert subscribed().fault() == 'nothing arrives on /joint_states'


def test_others_joints_and_a_stamp_that_stands_still_are_no_measurement():
    driver = subscribed(fresh=1000, patience=1000)
    driver.states.receive(state())
    first = driver.measure()
    for message in (state(position=(1.0, 2.0)), state(names=('a', 'b'), stamp=(2, 0)),
                    state(position=(math.nan,) * 2, stamp=(2, 0))):
        driver.states.receive(message)
        assert driver.measure() == first
    driver.states.receive(state(position=(1.0, 2.0), stamp=(3, 0)))
    assert driver.measure() == (2.0, -0.5)
    unstamped = state(stamp=(0, 0))         # a broadcaster without a time
    for _ in range(2):
        driver.states.receive(unstamped)
        assert driver.measure() == (0.25, -0.5)


def test_an_older_state_of_the_same_publisher_is_no_measurement():
    driver = subscribed(fresh=1000, patience=1000)
    driver.states.receive(state(position=(1.0, 2.0), stamp=(3, 0)), 1)
    driver.states.receive(state(position=(1.0, 3.0), stamp=(2, 10 ** 9 - 1)), 2)
    assert driver.measure() == (2.0, -0.5)
    assert driver.absence() == 'the stamp of /joint_states goes back'
    assert driver.refused == {'joint states whose stamp goes back': 1}
    driver.states.receive(state(position=(1.0, 4.0), stamp=(1, 0)), 3)     # the clock was set
    assert driver.measure() == (4.0, -0.5)


def test_publishers_are_distinguished_by_their_count_and_not_mixed():
    sources = JointSources(memory=5.0)
    steady = [sources.take('a', number, 0, 0.002 * number) for number in range(1, 50)]
    assert all(steady)
    assert not sources.take('a', 7_000_000, 0, 0.101)       # another's count
    assert not sources.mixed(0.101)                         # the first may have ended
    assert sources.take('a', 50, 0, 0.102)
    assert sources.mixed(0.102)
    assert not sources.mixed(5.2)


@pytest.mark.parametrize('ahead', [2, 50, 300, 900])
def test_a_publisher_of_another_form_is_not_taken_whatever_its_count(ahead):
    sources = JointSources(memory=5.0)
    assert all(sources.take('a', number, 0, 0.002 * number) for number in range(1, 50))
    assert not sources.take('b', 49 + ahead, 0, 0.099)
    assert sources.take('a', 50, 0, 0.1)
    assert sources.mixed(0.1)


def test_a_publisher_that_was_started_again_takes_its_own_place():
    sources = JointSources(memory=5.0)
    assert all(sources.take('a', 1000 + k, 0, 0.002 * k) for k in range(10))
    taken = [sources.take('a', 1 + k, 0, 0.1 + 0.01 * k) for k in range(100)]
    assert not any(taken[:40])
    assert all(taken[60:])
    assert not sources.mixed(1.1)


def test_the_position_is_advanced_by_the_age_of_the_state():
    driver = subscribed(fresh=200, extrapolate='true')
    now_ns = 5_000_000_000
    clock = types.SimpleNamespace(now=lambda: types.SimpleNamespace(nanoseconds=now_ns))
    driver.attach(types.SimpleNamespace(get_clock=lambda: clock))
    for number, (stamp, age) in enumerate((((4, 996_000_000), 0.004), ((3, 0), 0.0),
                                           ((6, 0), 0.0))):
        begun = time.monotonic()
        driver.states.receive(state(stamp=stamp), number)    # the others are of another clock
        x, speed = driver.measure()
        waited = time.monotonic() - begun
        assert speed == -0.5
        assert 0.25 - 0.5 * (age + waited + 1e-9) <= x <= 0.25 - 0.5 * (age - 1e-9), stamp
    assert driver.states.counts['joint states whose stamp is of another clock, or late'] == 2


def test_the_position_is_that_of_the_sample_however_late_it_is_asked(monkeypatch):
    driver = subscribed(fresh=4, extrapolate='true')
    at = [100.0]
    monkeypatch.setattr('dz_ros.nodes.joint_group.time',
                        types.SimpleNamespace(monotonic=lambda: at[0]))
    for k in range(50):
        at[0] = 100.0 + 0.005 * k
        driver.advance(0.005 * k, k)
    sample, at[0] = at[0], at[0] + 0.003        # the host is late, the state newer than the sample
    for off in (0.002, -0.002):
        monkeypatch.setattr(JointStates, 'newest', JointSample(((0.25, -0.5),), at[0],
                                                               sample + off))
        assert driver.measure() == pytest.approx((0.25 + 0.5 * off, -0.5))


class Graph:
    """A node and a publisher as a controller's watch needs them, without ROS."""

    topic_name = '/left/effort_controller/commands'
    publishers = (('actuator_node', '/left'),)

    def __init__(self):
        self.errors = []

    def __getattr__(self, name):
        return lambda *_, **__: types.SimpleNamespace(error=self.errors.append)

    def get_name(self):
        return 'actuator_node'

    def get_namespace(self):
        return '/left'

    def get_subscription_count(self):
        return 1

    def count_publishers(self, _topic):
        return len(self.publishers)

    def get_publishers_info_by_topic(self, topic):
        assert topic == 'commands'      # the middleware's name would be remapped again
        return [types.SimpleNamespace(node_name=name, node_namespace=space)
                for name, space in self.publishers]


def watching(name=''):
    pytest.importorskip('rclpy', reason='rclpy is not installed')
    graph = Graph()
    return graph, ForwardingController(graph, graph, 'commands', name, ['joint1'],
                                       'effort', '/activity')


def test_the_manager_s_activity_shows_the_state_of_the_controller():
    graph, controller = watching()
    controller.verified = True

    def activity(**states):
        return types.SimpleNamespace(controllers=[
            types.SimpleNamespace(name=name, state=types.SimpleNamespace(id=number, label=label))
            for name, (number, label) in states.items()])

    controller.receive_activity(activity(joint_state_broadcaster=(3, 'active')))
    assert controller.problem() == ''       # another manager's
    controller.receive_activity(activity(effort_controller=(3, 'active')))
    assert (controller.state, controller.problem()) == ('active', '')
    controller.receive_activity(activity(effort_controller=(2, 'inactive')))
    assert controller.problem() == ('the controller /left/effort_controller is inactive: it takes '
                                    'no commands')
    assert len(graph.errors) == 1
    controller.receive_activity(activity(joint_state_broadcaster=(3, 'active')))
    assert 'is not loaded' in controller.problem()


def test_rival_publishers_of_commands_are_named_but_not_one_that_was_killed():
    graph, controller = watching()
    controller.verified = True
    graph.publishers = (('actuator_node', '/left'),) * 2
    controller.look()
    assert controller.problem() == ''
    graph.publishers = (('actuator_node', '/left'), ('rqt', '/'), ('pid', '/right'))
    controller.look()
    assert controller.problem() == ('3 publishers of /left/effort_controller/commands: this node '
                                    'and /right/pid, /rqt')


def test_a_controller_that_is_not_to_be_asked_is_not():
    _, controller = watching('-')
    assert controller.takes_commands
    assert controller.problem() == ''


def test_it_is_known_without_rclpy(processes):
    found = processes(sys.executable, '-c',
                      'import sys, dz_ros.nodes.joint_driver; print(*sys.modules)')
    assert found.wait() == 0
    assert 'dz_ros.nodes.joint_group' in found.output.split()
    assert 'rclpy' not in found.output.split()


def test_units_are_the_joint_s():
    assert (make().state_units, make().command_unit) == (('rad', 'rad/s'), 'N m')
    slide = make(unit='m', interface='velocity')
    assert (slide.state_units, slide.command_unit) == (('m', 'm/s'), 'm/s')


def test_an_old_joint_state_is_none():
    driver = subscribed(fresh=2.0)
    driver.states.receive(state())
    driver.states.receive(state(stamp=(2, 0)), arrived=time.monotonic() - 0.011)
    assert driver.measure() is None


def test_the_velocity_is_observed_where_it_is_not_measured():
    hosted = HostedDriver(load_configuration(CONFIG, ['driver.measured=1', 'driver.fresh=1000',
                                                      'driver.extrapolate=false']))
    assert hosted.observing
    for k in range(400):
        hosted.driver.states.receive(state(position=(0.0, 0.4 * k * 0.005), velocity=(),
                                           stamp=(1, k)))
        x = hosted.measure(k * 0.005)
    assert x == pytest.approx((0.4 * 399 * 0.005, 0.4), rel=1e-3)


@pytest.mark.parametrize(('parameters', 'key'), [
    ({'joint': '""'}, 'driver.joint'), ({'measured': 3}, 'driver.measured'),
    ({'limit': -1}, 'driver.limit'), ({'patience': 0}, 'driver.patience')])
def test_mistakes_are_named(parameters, key):
    with pytest.raises(ConfigurationError) as caught:
        make(**parameters)
    assert caught.value.key == key


def test_limit_is_the_configured_one():
    assert make(limit=3.0).limit == 3.0
    assert make(limit=0).limit == math.inf


# Everything as processes.

@pytest.mark.ros
@pytest.mark.parametrize('measured', [2, 1])
def test_the_adaptive_loop_tracks_through_the_controllers(
        watcher, robot, measured):
    nodes = robot.start('-p', f'driver.measured:={measured}')
    # The layer's bound is 8 mrad, less is usual at 200 Hz on a quiet machine.
    watcher.tracked(load_configuration(CONFIG).trajectory, 0.01)
    for node in nodes.values():
        assert node.interrupt() == 0
        assert 'Traceback' not in node.output
    watcher.wait(lambda: robot.held == 0.0)   # the safe command is what is held


NO_USE = {
    'silence': ('speak', 'nothing arrives on /joint_states'),
    'nan': ('number', "the position of 'joint1' is nan"),
    'rename': ('name', "joint 'joint1' is not among those of /joint_states"),
    'freeze': ('run', 'the stamp of /joint_states stands still'),
    'positions': ('all', "has no velocity of 'joint1': set driver.measured to 1"),
    'blind': ('seeing', "the velocity of 'joint1' is nan: set driver.measured to 1")}
"""What the emulator is commanded → what ends it, and what is reported of it."""


@pytest.mark.ros
def test_joint_states_of_no_use_are_a_fault_and_a_reset_goes_on(watcher, robot):
    robot.start()
    for word, (back, reason) in NO_USE.items():
        watcher.running()
        robot.do(word)
        watcher.wait_for_mode(actuator_node='fault')
        reported = watcher.modes()['actuator_node'][1]
        assert reported.startswith('no measurement for ')
        assert reason in reported, word
        watcher.wait(lambda: robot.held == 0.0)
        robot.do(back)
        watcher.start_again('actuator_node')
        watcher.wait(lambda: robot.held != 0.0)
    assert all(math.isfinite(number) for data in watcher.states for number in data)


@pytest.mark.ros
def test_a_joint_of_another_name_never_starts_and_reports_which_there_are(
        watcher, robot):
    nodes = robot.start('-p', 'driver.joint:=knee', '-p', 'driver.patience:=10.0',
                        options=['joints=knee'])
    watcher.wait_for_mode(actuator_node='fault')
    assert watcher.modes()['actuator_node'][1] == (
        "joint 'knee' is not among those of /joint_states: shoulder, joint1, wrist")
    assert not watcher.states
    assert nodes['actuator_node'].interrupt() == 0


@pytest.mark.ros
@pytest.mark.parametrize(('options', 'words'), [
    (['joints=joint2'], "/effort_controller commands joint 'joint2', but driver.joint = 'joint1'"),
    (['joints=joint1,joint2'], '/effort_controller commands 2 joints (joint1, joint2), the driver '
     'sends one number: give it one joint'),
    (['interface=velocity'], "/effort_controller commands the interface 'velocity', but "
     "driver.interface = 'effort'"),
])
def test_a_controller_of_another_joint_is_refused_before_anything_is_sent(
        watcher, robot, options, words):
    nodes = robot.start(options=options)
    begun = len(robot.interface)        # active by then
    watcher.wait_for_mode(actuator_node='fault')
    assert watcher.modes()['actuator_node'][1] == words
    assert not watcher.call('actuator_node/reset').success
    assert not watcher.states
    assert nodes['actuator_node'].interrupt() == 0
    ended = len(robot.interface)
    watcher.wait(lambda: len(robot.interface) > ended + 20)
    # A command of one number would have deactivated the controller of two joints.
    assert all(active and held == 0.0 for active, held, *_ in robot.interface[begun:])


@pytest.mark.ros
def test_a_controller_that_leaves_active_is_a_fault_and_gets_the_safe_command_when_it_is_back(
        watcher, robot):
    nodes = robot.start()
    watcher.running()
    watcher.wait(lambda: abs(robot.held) > 0.3)
    robot.do('deactivate')
    watcher.wait_for_mode(actuator_node='fault')
    assert re.fullmatch('the controller /effort_controller is (deactivating|inactive): it takes '
                        'no commands', watcher.modes()['actuator_node'][1])
    assert robot.held != 0.0            # what the forwarding controller leaves behind
    assert watcher.call('actuator_node/estop').success
    watcher.wait_for_mode(actuator_node='estop')
    assert not watcher.call('actuator_node/reset').success
    robot.do('activate')                # it has forgotten every command
    watcher.wait(lambda: robot.held == 0.0)
    watcher.start_again('actuator_node')
    watcher.running()
    watcher.wait(lambda: abs(robot.held) > 0.3)
    robot.do('deactivate')
    watcher.wait_for_mode(actuator_node='fault')
    assert nodes['actuator_node'].interrupt() == 0
    assert ('no controller takes the safe command: the controller /effort_controller is inactive'
            in nodes['actuator_node'].output)
    assert robot.held != 0.0


@pytest.mark.ros
def test_another_publisher_of_commands_is_a_fault_that_names_it(watcher, robot):
    robot.start()
    watcher.running()
    rival = watcher.node.create_publisher(watcher.array, '/effort_controller/commands', 10)
    watcher.wait_for_mode(actuator_node='fault')
    assert watcher.modes()['actuator_node'][1] == (
        '2 publishers of /effort_controller/commands: this node and /operator')
    # Two numbers for one joint: the controller is deactivated, with what it was given last.
    rival.publish(watcher.array(data=[5.0, 5.0]))
    watcher.wait(lambda: not robot.interface[-1][0])
    watcher.node.destroy_publisher(rival)
    assert not watcher.call('actuator_node/reset').success
    robot.do('activate')
    watcher.wait(watcher.recovered)
    watcher.running()


@pytest.mark.ros
@pytest.mark.parametrize('measured', [2, 1])
def test_another_publisher_of_the_joint_is_a_fault_that_names_it(
        watcher, robot, measured):
    robot.start('-p', f'driver.measured:={measured}')
    watcher.running()
    watcher.wait(lambda: watcher.states[-1][2] > 0.5)
    before = len(watcher.states)
    robot.do('another')                 # it reports 0
    watcher.wait_for_mode(actuator_node='fault')
    assert watcher.modes()['actuator_node'][1] == (
        "more than one publisher publishes joint 'joint1' on /joint_states "
        '(/joint_state_broadcaster, /joint_state_publisher): none is taken for the other')
    watcher.wait(lambda: len(watcher.states) > before + 100)
    # No jump to 0; a machine that stalls lets the joint move on meanwhile.
    assert all(abs(b[2] - a[2]) < 0.4 + 3.0 * (b[1] - a[1])
               for a, b in itertools.pairwise(watcher.states[before:]))


@pytest.mark.ros
def test_frozen_values_with_running_stamps_end_at_the_error_limit(watcher, robot):
    limit = load_configuration(CONFIG).safety.error_limit
    robot.start('-p', f'safety.error_limit:={limit}')
    watcher.running()
    watcher.wait(lambda: abs(watcher.states[-1][3]) < 1e-3)     # at rest
    robot.do('stuck')
    watcher.wait_for_mode(controller_node='fault')
    assert f'beyond safety.error_limit {limit:g}' in watcher.modes()['controller_node'][1]
    watcher.wait(lambda: robot.held == 0.0)
    # No state beyond the limit is answered by anything else: it would go on to accelerate.
    trajectory = load_configuration(CONFIG).trajectory

    def beyond(data):
        return abs(data[2] - trajectory(data[1])[0]) > limit + 0.05

    watcher.wait(lambda: beyond(watcher.states[-1]))
    seqs = {data[0] for data in watcher.states if beyond(data)}
    assert not [message.data for message in watcher.received['command']
                if message.data[3] in seqs and message.data[2] != 0.0]


@pytest.mark.ros
def test_commands_of_an_inactive_controller_do_nothing_and_are_forgotten(
        watcher, robot):
    sent, limit = [], ('-p', 'safety.error_limit:=0.5')
    commands = watcher.node.create_subscription(
        watcher.array, '/effort_controller/commands',
        lambda message: sent.append(message.data[0]), 10)
    robot.emulator(active=False)
    robot.node('actuator_node', *limit)
    watcher.wait(lambda: commands.get_publisher_count() > 0)    # before there is a command
    for name in ('controller_node', 'trajectory_node'):
        robot.node(name, *limit)
    # Only the error that grows shows it: that is what error_limit is for.
    watcher.wait_for_mode(controller_node='fault')
    assert watcher.modes()['controller_node'][1].startswith('error ')
    # A machine that stalls has commands of before the fault on their way still.
    watcher.wait(lambda: len(sent) > 50 and not any(sent[-50:]))
    assert any(sent)
    received = len(robot.interface)
    watcher.wait(lambda: len(robot.interface) > received + 50)
    assert {held for _, held, *_ in robot.interface} == {0.0}
    robot.do('activate')
    received = len(robot.interface)
    watcher.wait(lambda: len(robot.interface) > received + 50)
    assert {held for _, held, *_ in robot.interface} == {0.0}


@pytest.mark.ros
def test_a_dead_process_leaves_the_last_command_in_the_controller(
        watcher, robot):
    # What docs/ros2_control.md warns of, and why the hardware needs a watchdog.
    nodes = robot.start()
    watcher.running()
    watcher.wait(lambda: robot.held != 0.0)
    nodes['actuator_node'].signal(9)
    nodes['actuator_node'].wait()
    received = len(robot.interface)

    def held():
        return {command for _, command, *_ in robot.interface[-100:]}

    # What was sent before is still on its way where the machine is busy.
    watcher.wait(lambda: len(robot.interface) > received + 200 and len(held()) == 1)


@pytest.mark.ros
def test_the_conformance_kit_finds_nothing_wrong(kit, watcher, robot):
    robot.emulator()
    found = kit('joint', '--config', CONFIG, '--set', 'driver.fresh=100', '--set',
                'safety.command_hold=20')
    # ros2_control's controllers do not report which command they hold.
    assert {key for key, item in found.items() if item['passed'] is None} == {
        'safe command', 'limit', 'stop and reset', 'saturation'}


@pytest.mark.ros
def test_its_dead_zone_is_found(processes, watcher, robot, tmp_path):
    robot.emulator()
    # A machine that stalls may lose too many states for an answer, or leave old ones.
    for attempt in range(4):
        out = tmp_path / f'found{attempt}'
        found = processes('-m', 'dz_ros', 'driver', 'identify', CONFIG, '--travel', '3', '--speed',
                          '2', '--effort', '4', '--repeats', '4', '--ramp', '2', '--pause', '0.3',
                          '--yes', '--out', out,
                          '--set', 'driver.fresh=20', '--set', 'safety.state_hold=10000',
                          '--set', 'safety.fault_after=20000')
        code = found.wait(300.0)
        if code != 2 or not re.search('is not a number in|of the states are lost|is not the rate',
                                      found.output):
            break
    assert code in (0, 1), found.output     # 1: a design rule finds an error in it
    numbers = json.loads((out / 'identified.json').read_text())['parameters']
    # A busy machine delays what the law of motion is fitted to; on a quiet one it is 0.02.
    assert numbers['b_r']['value'] == pytest.approx(0.5, abs=0.2)
    assert numbers['b_l']['value'] == pytest.approx(-0.6, abs=0.2)

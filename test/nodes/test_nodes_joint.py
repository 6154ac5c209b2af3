"""The driver `joint` against a process that behaves as ros2_control's controllers do."""

import json
import math
from pathlib import Path
import time
import types

import pytest

from dz_ros.core.safety.health import Report
from dz_ros.drivers.hosted import HostedDriver
from dz_ros.errors import ConfigurationError, DriverError
from dz_ros.files import load_configuration

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / 'config' / 'joint.yaml'
STAND_IN = Path(__file__).with_name('ros2_control_stand_in.py')
NODE = ('-m', 'dz_ros.nodes.main')


def make(**driver):
    return load_configuration(CONFIG, [f'driver.{key}={value}' for key, value
                                       in driver.items()]).make_driver()


# What a joint state says of the joint, without ROS.

def state(names=('shoulder', 'joint1'), position=(9.0, 0.25), velocity=(8.0, -0.5), stamp=(1, 0)):
    stamp = types.SimpleNamespace(sec=stamp[0], nanosec=stamp[1])
    return types.SimpleNamespace(name=list(names), position=list(position),
                                 velocity=list(velocity),
                                 header=types.SimpleNamespace(stamp=stamp))


def listening(**parameters):
    """Return a driver that thinks it is open, and waited for its joint for long."""
    driver = make(**{'patience': 0.1, **parameters})
    driver._publisher = types.SimpleNamespace(get_subscription_count=lambda: 1)
    driver._since = time.monotonic() - 1.0
    return driver


def test_the_named_joint_is_taken_wherever_it_stands():
    driver = listening(fresh=1000)
    driver._hear(state())
    assert driver.measure() == (0.25, -0.5)
    driver._hear(state(('joint1',), (0.5,), (1.0,), (1, 1)))
    assert driver.measure() == (0.5, 1.0)
    assert driver.trouble() == ''


@pytest.mark.parametrize(('message', 'words'), [
    (state(names=('shoulder', 'elbow')), "joint 'joint1' is not among those of /joint_states: "
     'shoulder, elbow'),
    (state(names=()), "joint 'joint1' is not among those of /joint_states: none"),
    (state(position=()), "/joint_states has no position of 'joint1'"),
    (state(velocity=()), "/joint_states has no velocity of 'joint1': set driver.measured to 1"),
    (state(position=(9.0, math.nan)), "the position of 'joint1' is nan"),
    (state(velocity=(9.0, -math.inf)), "the velocity of 'joint1' is -inf"),
])
def test_what_is_wrong_with_a_joint_state_is_said(message, words):
    driver = listening()
    driver._hear(message)
    assert driver.measure() is None
    assert words in driver.trouble()
    with pytest.raises(DriverError, match='joint'):
        driver.recover()
    report = Report()
    driver.report(report)
    assert sum(int(value) for key, value in report.values.items() if key.startswith('joint states')
               and key != 'joint states') == 1


def test_nothing_at_all_is_said():
    assert listening().trouble() == 'nothing arrives on /joint_states'


def test_a_controller_that_is_not_there_is_said():
    driver = listening()
    driver._publisher.get_subscription_count = lambda: 0
    driver._hear(state())
    assert driver.trouble() == ('nobody listens to /effort_controller/commands: is the controller '
                                'loaded?')


def test_others_joints_and_a_stamp_that_stands_still_are_no_measurement():
    driver = listening(fresh=1000, patience=1000)
    driver._hear(state())
    first = driver._state
    for message in (state(position=(1.0, 2.0)), state(names=('a', 'b'), stamp=(2, 0)),
                    state(position=(math.nan,) * 2, stamp=(2, 0))):
        driver._hear(message)
        assert driver._state is first
    driver._hear(state(position=(1.0, 2.0), stamp=(3, 0)))
    assert driver.measure() == (2.0, -0.5)
    unstamped = state(stamp=(0, 0))         # a broadcaster that does not say when
    for _ in range(2):
        driver._hear(unstamped)
        assert driver.measure() == (0.25, -0.5)


def test_an_old_joint_state_is_none():
    driver = listening(fresh=2.0)
    driver._hear(state())
    driver._state = driver._state[0], time.monotonic() - 0.011
    assert driver.measure() is None


def test_the_velocity_is_observed_where_it_is_not_measured():
    hosted = HostedDriver(load_configuration(CONFIG, ['driver.measured=1', 'driver.fresh=1000']))
    assert hosted.observing
    for k in range(400):
        hosted.driver._hear(state(position=(0.0, 0.4 * k * 0.005), velocity=(), stamp=(1, k)))
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

class Robot:
    """What the test says to the stand-in, and what the stand-in says of its hardware."""

    def __init__(self, watcher):
        from std_msgs.msg import String
        self._watcher, self._string = watcher, String
        self.interface = []     # (controller active, command that the hardware holds)
        watcher.node.create_subscription(String, '/stand_in/interface', lambda message:
                                         self.interface.append(json.loads(message.data)), 1000)
        self._do = watcher.node.create_publisher(String, '/stand_in/do', 10)

    def do(self, word):
        self._watcher.wait(lambda: self._do.get_subscription_count() > 0)
        self._do.publish(self._string(data=word))

    @property
    def held(self):
        return self.interface[-1][1]


@pytest.fixture
def robot(watcher):
    return Robot(watcher)


def start(processes, watcher, robot, *more, kind='forward', active=True):
    """Start stand-in and loop; return the loop's nodes once it runs."""
    stand_in = processes(str(STAND_IN), CONFIG, kind, PYTHONPATH=str(ROOT))
    stand_in.wait_for_line('controllers are loaded')
    if active:
        robot.do('activate')
        watcher.wait(lambda: robot.interface and robot.interface[-1][0])
    nodes = {name: processes(*NODE, name, '--ros-args', '--params-file', CONFIG, *watcher.patient,
                             *more)
             for name in ('actuator_node', 'controller_node', 'trajectory_node')}
    return nodes


@pytest.mark.ros
@pytest.mark.parametrize('measured', [2, 1])
def test_the_adaptive_loop_tracks_through_the_controllers(
        processes, watcher, robot, measured):
    nodes = start(processes, watcher, robot, '-p', f'driver.measured:={measured}')
    # The layer's bound is 8 mrad, less is usual at 200 Hz on a quiet machine.
    watcher.tracked(load_configuration(CONFIG).trajectory, 0.01)
    for node in nodes.values():
        assert node.interrupt() == 0
        assert 'Traceback' not in node.output
    watcher.wait(lambda: robot.held == 0.0)   # the safe command is what is held


@pytest.mark.ros
@pytest.mark.parametrize(('word', 'back', 'reason'), [
    ('silence', 'speak', 'no measurement for'),
    ('nan', 'number', 'no measurement for'),
    ('rename', 'name', 'no measurement for'),
    ('freeze', 'run', 'no measurement for'),
    ('positions', 'all', 'no measurement for'),
])
def test_joint_states_of_no_use_are_a_fault_and_a_reset_goes_on(
        processes, watcher, robot, word, back, reason):
    start(processes, watcher, robot)
    watcher.running()
    robot.do(word)
    watcher.wait_for_mode(actuator_node='fault')
    assert reason in watcher.modes()['actuator_node'][1]
    watcher.wait(lambda: robot.held == 0.0)
    assert all(math.isfinite(number) for data in watcher.states for number in data)
    robot.do(back)
    watcher.wait(watcher.recovered)
    watcher.wait(lambda: watcher.modes()['actuator_node'][0] == 'running')
    watcher.wait(lambda: robot.held != 0.0)


@pytest.mark.ros
def test_a_joint_of_another_name_never_starts_and_says_which_there_are(
        processes, watcher, robot):
    nodes = start(processes, watcher, robot, '-p', 'driver.joint:=knee',
                  '-p', 'driver.patience:=10.0')
    watcher.wait_for_mode(actuator_node='fault')
    assert watcher.modes()['actuator_node'][1] == (
        "joint 'knee' is not among those of /joint_states: shoulder, joint1")
    assert not watcher.states
    assert nodes['actuator_node'].interrupt() == 0


@pytest.mark.ros
def test_commands_of_an_inactive_controller_do_nothing_and_are_forgotten(
        processes, watcher, robot):
    start(processes, watcher, robot, '-p', 'safety.error_limit:=0.5', active=False)
    # Nobody can tell but by the error that grows: that is what error_limit is for.
    watcher.wait_for_mode(controller_node='fault')
    assert watcher.modes()['controller_node'][1].startswith('error ')
    watcher.wait(lambda: robot.interface)
    assert {held for _, held in robot.interface} == {0.0}
    robot.do('activate')
    heard = len(robot.interface)
    watcher.wait(lambda: len(robot.interface) > heard + 50)
    assert {held for _, held in robot.interface} == {0.0}


@pytest.mark.ros
def test_a_dead_process_leaves_the_last_command_in_the_controller(
        processes, watcher, robot):
    # What docs/ros2_control.md warns of, and why the hardware needs a watchdog.
    nodes = start(processes, watcher, robot)
    watcher.running()
    watcher.wait(lambda: robot.held != 0.0)
    nodes['actuator_node'].signal(9)
    nodes['actuator_node'].wait()
    heard = len(robot.interface)
    watcher.wait(lambda: len(robot.interface) > heard + 200)
    held = {command for _, command in robot.interface[-100:]}
    assert len(held) == 1


@pytest.mark.ros
def test_the_conformance_kit_finds_nothing_wrong(kit, processes, watcher, robot):
    processes(str(STAND_IN), CONFIG, 'forward', PYTHONPATH=str(ROOT)).wait_for_line('controllers')
    robot.do('activate')
    watcher.wait(lambda: robot.interface and robot.interface[-1][0])
    found = kit('joint', '--config', CONFIG, '--set', 'driver.fresh=100', '--set',
                'safety.command_hold=20')
    # ros2_control's controllers do not tell which command they hold.
    assert {key for key, item in found.items() if item['passed'] is None} == {
        'safe command', 'limit', 'stop and reset', 'saturation'}


@pytest.mark.ros
def test_its_dead_zone_is_found(processes, watcher, robot, tmp_path):
    processes(str(STAND_IN), CONFIG, 'forward', PYTHONPATH=str(ROOT)).wait_for_line('controllers')
    robot.do('activate')
    watcher.wait(lambda: robot.interface and robot.interface[-1][0])
    found = processes('-m', 'dz_ros', 'driver', 'identify', CONFIG, '--travel', '3', '--speed',
                      '2', '--effort', '4', '--repeats', '4', '--yes', '--out', tmp_path / 'found',
                      '--set', 'driver.fresh=100', '--set', 'safety.state_hold=100')
    assert found.wait(300.0) in (0, 1), found.output     # 1: a design rule finds an error in it
    numbers = json.loads((tmp_path / 'found' / 'identified.json').read_text())['parameters']
    # A busy machine delays what the law of motion is fitted to; on a quiet one it is 0.02.
    assert numbers['b_r']['value'] == pytest.approx(0.5, abs=0.2)
    assert numbers['b_l']['value'] == pytest.approx(-0.6, abs=0.2)

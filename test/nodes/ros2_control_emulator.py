# SPDX-License-Identifier: Apache-2.0
"""Behaves as ros2_control 4.46 is documented to, with the joints of a configuration behind it.

controller_manager, joint_state_broadcaster, one forward_command_controller ('forward') or
effort_controllers/JointGroupEffortController ('effort'), each a node of its own name:

- `~/commands` that are not finite are dropped; one whose length is not the number of joints
  deactivates the controller at the next cycle; a command is held for ever; an inactive controller
  takes none, and forgets what came before it was activated; the effort controller writes 0 when it
  is deactivated, the other leaves the last command in the interface;
- `~/get_parameters` reports `joints` and `interface_name`, `~/transition_event` each change;
- `/controller_manager/activity` has the state of each controller, latched;
- the broadcaster's message has position, velocity and effort of every joint, NaN where the
  hardware has no such interface, in an order of its own, stamped with the time of the cycle.

Usage: CONFIG KIND [KEY=VALUE ...], with rate (of the manager [Hz]), joints (of the controller,
separated by commas), interface, active (1 from the start), delay (of the joint states after their
stamp [s]), log (file of lines "instant positions", written at the end), namespace, activity (1 =
published, in place of transition events). What the test wants is on the topic `do`, one word:
activate, deactivate, unload (with activity), silence, speak, nan, number, rename, name, freeze,
run, positions, all, blind, seeing (velocity NaN or not), stuck, moving (values frozen, stamps
running), part, whole (the last joint left out or not), another (a joint_state_publisher of 0
begins), home (the joints are brought back to 0, at rest, as by a person); nan, rename and blind
are of the last joint. What the hardware holds is on `interface`: [active, command, position,
instant [s of the steady clock]]; of several joints lists, commands in the order of the controller,
positions in that of the axes.
"""

from collections import deque
import contextlib
import itertools
import json
import math
from pathlib import Path
import sys
import time

from lifecycle_msgs.msg import State, TransitionEvent
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from dz_ros.drivers.simulated import SimulatedActuator, SimulatedParameters
from dz_ros.files.configurations import load_configuration

CONFIG, KIND = sys.argv[1], sys.argv[2]
OPTIONS = {'rate': '250', 'joints': '', 'interface': 'effort', 'delay': '0',
           'log': '', 'active': '0', 'namespace': '', 'activity': '0',
           **dict(word.split('=', 1) for word in sys.argv[3:])}
OTHERS = ('shoulder', 'wrist')
OPPOSITE = {'speak': 'silence', 'number': 'nan', 'name': 'rename', 'run': 'freeze',
            'all': 'positions', 'seeing': 'blind', 'moving': 'stuck', 'whole': 'part'}


def make_node(name):
    """Return a node in the manager's namespace."""
    return rclpy.create_node(name, namespace=OPTIONS['namespace'])


class Controller:
    """The controller that forwards commands."""

    def __init__(self, joints):
        self.node = make_node('effort_controller')
        self.joints = OPTIONS['joints'].split(',') if OPTIONS['joints'] else joints
        self.node.declare_parameter('joints', self.joints)
        self.node.declare_parameter('interface_name', OPTIONS['interface'])
        self.active, self.loaded = OPTIONS['active'] == '1', True
        self.interface = [0.0] * len(self.joints)       # what the hardware holds
        self._buffer = None
        self._events = self._activity = None
        if OPTIONS['activity'] == '1':
            from controller_manager_msgs.msg import ControllerManagerActivity
            self._activity = self.node.create_publisher(
                ControllerManagerActivity, 'controller_manager/activity',
                QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
            self.report()
        else:
            self._events = self.node.create_publisher(TransitionEvent, '~/transition_event', 10)
        self.node.create_subscription(Float64MultiArray, '~/commands', self.command, 10)

    def command(self, message):
        if all(map(math.isfinite, message.data)):
            self._buffer = list(message.data)

    def change(self, active):
        states = [State(id=State.PRIMARY_STATE_INACTIVE, label='inactive'),
                  State(id=State.TRANSITION_STATE_ACTIVATING, label='activating'),
                  State(id=State.PRIMARY_STATE_ACTIVE, label='active')]
        if not active:
            states.reverse()
            states[1] = State(id=State.TRANSITION_STATE_DEACTIVATING, label='deactivating')
        for start, goal in itertools.pairwise(states) if self._events is not None else ():
            self._events.publish(TransitionEvent(start_state=start, goal_state=goal))
        self.active, self._buffer = active, None
        if not active and KIND == 'effort':
            self.interface = [0.0] * len(self.joints)
        if self._activity is not None:
            self.report()

    def report(self):
        """Publish the states of all controllers, as the manager does."""
        from controller_manager_msgs.msg import ControllerManagerActivity, NamedLifecycleState
        active = State(id=State.PRIMARY_STATE_ACTIVE, label='active')
        own = active if self.active else State(id=State.PRIMARY_STATE_INACTIVE, label='inactive')
        listed = [NamedLifecycleState(name='joint_state_broadcaster', state=active),
                  NamedLifecycleState(name='effort_controller', state=own)]
        self._activity.publish(ControllerManagerActivity(controllers=listed[:1 + self.loaded]))

    def update(self):
        if not self.active or self._buffer is None:
            return
        if len(self._buffer) != len(self.joints):
            self.change(active=False)
        else:
            self.interface = self._buffer


class Robot:
    """Manager, controller, broadcaster, and the joints behind them."""

    def __init__(self, executor):
        each = load_configuration(CONFIG).each
        self._joints = [item.driver_parameters.joint for item in each]
        self._plants = [SimulatedActuator(SimulatedParameters(), item) for item in each]
        self._start = None
        self._words = set()
        self._late = deque()
        self._stuck = None
        self._stamp = None
        self.rows = []
        manager = make_node('controller_manager')
        self._controller = Controller(self._joints)
        broadcaster = make_node('joint_state_broadcaster')
        self._another = make_node('joint_state_publisher')
        for node in (manager, self._controller.node, broadcaster, self._another):
            executor.add_node(node)
        self._clock = manager.get_clock()
        self._states = broadcaster.create_publisher(JointState, 'joint_states', 10)
        self._reported = manager.create_publisher(String, '/emulator/interface', 10)
        manager.create_subscription(String, '/emulator/do', self.do, 10)
        manager.create_timer(1.0 / float(OPTIONS['rate']), self.update)

    def do(self, message):
        word = message.data
        if word in ('activate', 'deactivate', 'unload'):
            self._controller.loaded = word != 'unload'
            self._controller.change(word == 'activate')
        elif word == 'home':
            for plant in self._plants:
                plant.x = [0.0] * len(plant.x)
        elif word == 'another':
            states = self._another.create_publisher(JointState, 'joint_states', 10)
            self._another.create_timer(0.1, lambda: states.publish(self.stamped(JointState(
                name=self._joints, position=[0.0] * len(self._joints)))))
        else:
            opposite = OPPOSITE.get(word)
            self._words = self._words - {opposite} if opposite else self._words | {word}

    def stamped(self, message):
        message.header.stamp = self._clock.now().to_msg()
        return message

    def update(self):
        now = time.monotonic()
        held = self._controller.interface
        if self._start is None and any(held):
            self._start = now       # nothing moves before the first command
        if self._start is not None:
            for plant in self._plants:
                plant.advance(now - self._start, 0)
        x, speed = zip(*(plant.measure() for plant in self._plants), strict=True)
        if OPTIONS['log']:
            self.rows.append((now, *x))
        if 'silence' not in self._words:
            self._late.append((now, self.message(list(x), list(speed))))
        while self._late and self._late[0][0] <= now - float(OPTIONS['delay']):
            self._states.publish(self._late.popleft()[1])
        self._controller.update()
        held = self._controller.interface
        if self._start is not None:
            given = dict(zip(self._controller.joints, held, strict=True))
            for joint, plant in zip(self._joints, self._plants, strict=True):
                # A controller of another joint would be seen to move it all the same.
                plant.command(given.get(joint, held[0]), now - self._start)
        one = len(self._joints) == 1
        self._reported.publish(String(data=json.dumps(
            [self._controller.active, held[0] if one else held, x[0] if one else x, now])))

    def message(self, x, speed):
        if 'stuck' in self._words:
            x, speed = self._stuck = self._stuck or (x, speed)
            x, speed = list(x), list(speed)
        else:
            self._stuck = None
        if 'nan' in self._words:
            x[-1] = math.nan
        if 'blind' in self._words:
            speed[-1] = math.nan
        names = list(self._joints)
        if 'rename' in self._words:
            names[-1] = 'elbow'
        count = len(names) - ('part' in self._words)
        # The last axis first: an order of its own.
        names, x, speed = ([*values[:count]][::-1] for values in (names, x, speed))
        message = JointState(
            name=[OTHERS[0], *names, OTHERS[1]], position=[9.0, *x, 7.0],
            effort=[math.nan] * (count + 2))
        if 'positions' not in self._words:
            message.velocity = [8.0, *speed, math.nan]
        if self._stamp is None or 'freeze' not in self._words:
            self._stamp = self._clock.now().to_msg()
        message.header.stamp = self._stamp
        return message


def main():
    rclpy.init()
    executor = SingleThreadedExecutor()
    robot = Robot(executor)
    sys.stdout.write('controllers are loaded\n')
    sys.stdout.flush()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()
    if OPTIONS['log']:
        Path(OPTIONS['log']).write_text(
            ''.join(f'{" ".join(map(repr, row))}\n' for row in robot.rows), encoding='utf-8')


if __name__ == '__main__':
    main()

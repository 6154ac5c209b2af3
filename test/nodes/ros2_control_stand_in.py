"""Behaves as ros2_control's controllers are documented to, with a joint behind them.

controller_manager with joint_state_broadcaster and one forward_command_controller or
effort_controllers/JointGroupEffortController, of one joint: `~/commands` of another size than the
joints are not taken; a command is held for ever; an inactive controller takes none, and forgets
what came before it was activated; the effort controller writes 0 when it is deactivated. What the
test wants is said on the topic `do`, one word: activate, deactivate, silence, speak, nan, number,
rename, name, freeze, run, positions, all.
"""

import contextlib
import json
import math
import sys
import time

import rclpy
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from dz_ros.drivers.simulated import SimulatedActuator, SimulatedParameters
from dz_ros.files import load_configuration

CONFIG, KIND = sys.argv[1], sys.argv[2]
RATE = 500.0
OTHER = 'shoulder'


class Robot:
    """Joint, controllers and broadcaster."""

    def __init__(self, node):
        configuration = load_configuration(CONFIG)
        self._node = node
        self._joint = configuration.driver_parameters.joint
        self._plant = SimulatedActuator(SimulatedParameters(), configuration)
        self._start = None
        self._active = False
        self._buffer = None
        self._interface = 0.0       # what the hardware holds
        self._words = set()
        self._stamp = None
        self._states = node.create_publisher(JointState, '/joint_states', 10)
        self._told = node.create_publisher(String, '/stand_in/interface', 10)
        node.create_subscription(Float64MultiArray, '/effort_controller/commands', self.command,
                                 10)
        node.create_subscription(String, '/stand_in/do', self.do, 10)
        node.create_timer(1.0 / RATE, self.update)

    def command(self, message):
        if len(message.data) == 1:
            self._buffer = message.data[0]

    def do(self, message):
        word = message.data
        if word == 'activate':
            self._active, self._buffer = True, None
        elif word == 'deactivate':
            self._active = False
            if KIND == 'effort':
                self._interface = 0.0
        else:
            opposite = {'speak': 'silence', 'number': 'nan', 'name': 'rename', 'run': 'freeze',
                        'all': 'positions'}.get(word)
            self._words = self._words - {opposite} if opposite else self._words | {word}

    def update(self):
        now = time.monotonic()
        if self._active and self._buffer is not None:
            self._interface = self._buffer
        if self._start is None and self._interface != 0.0:
            self._start = now       # nothing moves before the first command
        if self._start is not None:
            self._plant.advance(now - self._start, 0)
            self._plant.command(self._interface, now - self._start)
        self._told.publish(String(data=json.dumps([self._active, self._interface])))
        if 'silence' not in self._words:
            self.broadcast()

    def broadcast(self):
        x, speed = self._plant.measure()
        if 'nan' in self._words:
            x = math.nan
        if self._stamp is None or 'freeze' not in self._words:
            self._stamp = self._node.get_clock().now().to_msg()
        message = JointState(name=[OTHER, 'elbow' if 'rename' in self._words else self._joint],
                             position=[9.0, x])
        message.header.stamp = self._stamp
        if 'positions' not in self._words:
            message.velocity = [8.0, speed]
        self._states.publish(message)


def main():
    rclpy.init()
    node = rclpy.create_node('controller_manager')
    Robot(node)
    sys.stdout.write('controllers are loaded\n')
    sys.stdout.flush()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    main()

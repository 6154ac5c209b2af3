# SPDX-License-Identifier: Apache-2.0
"""A joint of ros2_control as an actuator: the driver `joint` (ours).

    command   std_msgs/Float64MultiArray, data = [v]    → ~/commands of forward_command_controller/
              ForwardCommandController or effort_controllers/JointGroupEffortController, one joint
    state     sensor_msgs/JointState                    ← joint_state_broadcaster

The unit of v is that of the claimed command interface: N m or N for `effort`, rad/s or m/s for
`velocity`. Positions and velocities are the joint's own, in rad or m.

Nothing is sent, and nothing measured, before the controller has confirmed that it commands this
joint alone by this interface (``joint_controller.py``). Those controllers hold the last command
for ever, ignore what arrives while they are inactive and forget it when they are activated; so the
safe command is repeated. What stops the joint when this process has died must be in its hardware.

It lies in ``nodes`` because it uses ROS; it knows the host's node through `attach` alone. What it
receives: ``joint_states.py``. Where nothing hosts it, as in `dz driver identify`, it has a node of
its own, served by a thread.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
import threading
import time
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.safety.health import Level, Report
from dz_ros.core.schema import parameter
from dz_ros.drivers.freshness import fresh_parameter
from dz_ros.errors import ConfigurationError, DriverError, MissingDependencyError
from dz_ros.nodes.joint_controller import ForwardingController
from dz_ros.nodes.joint_states import JointStates

REPEAT_PERIOD = 0.1
"""The safe command is sent again after each of these [s]."""
ACKNOWLEDGE_TIME_OUT = 0.5
"""Longest wait for the controller to have the last safe command [s]."""
UNITS = {'effort': {'rad': 'N m', 'm': 'N'}, 'velocity': {'rad': 'rad/s', 'm': 'm/s'},
         'position': {'rad': 'rad', 'm': 'm'}, 'acceleration': {'rad': 'rad/s^2', 'm': 'm/s^2'}}
"""Command interface → unit of the joint's position → unit of the command."""


@dataclass(frozen=True)
class JointParameters:
    """The joint, its controller and its topics."""

    joint: str = parameter('joint1', '', 'name of the joint in the joint states', structural=True)
    unit: str = parameter('rad', '', 'unit of its position: rad of a revolute joint, m of a '
                          'prismatic one', choices=('rad', 'm'), structural=True)
    interface: str = parameter('effort', '', 'command interface that the controller claims',
                               choices=tuple(UNITS), structural=True)
    command_topic: str = parameter('/effort_controller/commands', '', 'topic of the controller '
                                   'that forwards the command', structural=True)
    controller: str = parameter('', '', 'node of that controller, which is asked for its joints '
                                'and interface; empty = as the command topic implies; - = not '
                                'asked',
                                structural=True)
    activity_topic: str = parameter('/controller_manager/activity', '', 'activity of the '
                                    'controller manager', structural=True)
    state_topic: str = parameter('/joint_states', '', 'topic of the joint states',
                                 structural=True)
    measured: int = parameter(0, '1', '1 = the position alone is taken and the velocity '
                              'observed, 2 = both; 0 = as many as the plant has', minimum=0,
                              maximum=2, structural=True)
    extrapolate: bool = parameter(True, '', 'advance the position from the instant of its header '
                                  'stamp to that of the sample')
    limit: float = parameter(0.0, 'actuator unit', 'largest |v|; 0 = none', minimum=0.0)
    fresh: float = fresh_parameter('joint state')
    patience: float = parameter(5.0, 's', 'a joint or a controller that is not there for that '
                                'long is a fault', minimum=0.1)


class Joint(JointStates):
    """A joint of ros2_control."""

    name = 'joint'
    summary = 'a joint of ros2_control: forwarded command, joint states'
    order = 0
    requires = ('rclpy', 'sensor_msgs', 'std_msgs')
    Parameters = JointParameters

    def __init__(self, parameters: Any, configuration: Configuration) -> None:
        super().__init__(parameters, configuration)
        if not parameters.joint:
            raise ConfigurationError('driver.joint', '', 'must be the name of a joint')
        if parameters.measured > configuration.plant.order:
            raise ConfigurationError('driver.measured', parameters.measured, 'must be at most '
                                     f'{configuration.plant.order}, the order of the plant')
        self._own: _OwnNode | None = None
        self._publisher: Any = None
        self._timer: Any = None
        self._controller: ForwardingController | None = None
        self._enabled = self._ready = False
        self._safe: float | None = None
        self._sent_at = 0.0
        self._since = 0.0

    @property
    def command_unit(self) -> str:
        """Unit of the command interface."""
        return UNITS[self.parameters.interface][self.parameters.unit]

    @property
    def limit(self) -> float:
        """Largest |v| [command unit]."""
        return self.parameters.limit or math.inf

    # Lifecycle.

    def attach(self, node: Any) -> None:
        """Set the node whose publishers and subscriptions are used."""
        self._node = node

    def open(self) -> None:
        """Offer commands, subscribe to joint states; whether they come shows later.

        Raises:
            DriverError: A topic's name is none, or names no controller.
            MissingDependencyError: rclpy is not installed.
        """
        if self._node is None:
            self._own = _OwnNode()
            self._node = self._own.node
        from rclpy.clock import Clock, ClockType
        from rclpy.qos import QoSProfile
        from std_msgs.msg import Float64MultiArray
        p = self.parameters
        self._message = Float64MultiArray
        for key in ('command_topic', 'state_topic'):
            try:
                if key == 'command_topic':      # reliable reaches every subscription there can be
                    self._publisher = self._node.create_publisher(self._message, p.command_topic,
                                                                  QoSProfile(depth=1))
                else:
                    self._subscribe()
            except Exception as error:
                raise DriverError(f'driver.{key} = {getattr(p, key)!r}: '
                                  f'{str(error).strip().splitlines()[0]}') from error
        self._controller = ForwardingController(
            self._node, self._publisher, p.command_topic, p.controller, p.joint, p.interface,
            p.activity_topic)
        self._timer = self._node.create_timer(
            REPEAT_PERIOD, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def enable(self) -> None:
        """Begin to wait for joint and controller."""
        self._since = time.monotonic()
        self._enabled, self._ready = True, False
        if self._controller is not None:
            self._controller.restart()

    def disable(self) -> None:
        """Repeat the safe command no more, once the controller has it.

        Raises:
            DriverError: No controller takes the safe command.
        """
        self._enabled, self._safe = False, None
        if self._controller is None:
            return
        if self._ready and not self._controller.wrong:
            from rclpy.duration import Duration
            deaf = self._controller.deaf()
            if not deaf and not self._publisher.wait_for_all_acked(
                    Duration(seconds=ACKNOWLEDGE_TIME_OUT)):
                deaf = f'{self._publisher.topic_name} is not acknowledged'
            if deaf:
                raise DriverError(f'no controller takes the safe command: {deaf}; the hardware '
                                  'keeps what it was given last')

    def close(self) -> None:
        """Withdraw from the topics."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        if self._controller is not None:
            self._controller.close()
        if self._publisher is not None:
            self._node.destroy_publisher(self._publisher)
        self._unsubscribe()
        self._publisher = self._controller = self._timer = None
        if self._own is not None:
            self._own.close()
            self._own = self._node = None

    # Each sample.

    def command(self, v: float, t: float) -> None:  # noqa: ARG002
        """Publish [v]."""
        self._safe = None
        self._publish(v)

    def safe(self, v: float, t: float) -> None:  # noqa: ARG002
        """Publish [v], and again every `REPEAT_PERIOD` until the next command."""
        self._safe = v
        self._publish(v)

    def fault(self) -> str:
        """Return what is wrong with joint or controller; once it has lasted where it may come."""
        if self._publisher is None:
            return ''
        now, p = time.monotonic(), self.parameters
        self._take(now)
        controller = self._controller
        if controller is not None and controller.wrong:
            return controller.wrong
        if self._sources.mixed(now):
            return self._mixed()
        found = controller.problem() if controller is not None else ''
        if found and (self._is_ready() or now - self._since > p.patience):
            return found
        seen = max(self._since, self._samples[-1].arrived) if self._samples else self._since
        if now - seen > p.patience:
            return self.absence()
        return ''

    def recover(self) -> None:
        """Wait for joint and controller again.

        Raises:
            DriverError: They have not come.
        """
        if self.fault():
            raise DriverError(self.fault())

    def report(self, report: Report) -> None:
        """Add what was received."""
        if self._samples:
            now, sample = time.monotonic(), self._samples[-1]
            report.put('age of the joint state [ms]', (now - sample.taken) * 1e3, '.3f')
        if self._publisher is not None:
            report.put(f'listeners of {self.parameters.command_topic}',
                       self._publisher.get_subscription_count(), 'd')
        if self._controller is not None:
            report.put('controller', self._controller.name or 'not asked')
            report.put('state of the controller', self._controller.state or 'unknown')
            if self._ready and self._controller.deaf():
                report.summarize(Level.ERROR, self._controller.deaf())
        for what, count in self.counts.items():
            report.put(what, count, 'd')

    # Commands.

    def _publish(self, v: float) -> None:
        """Publish [v] if the controller is known to be the right one."""
        if self._publisher is not None and (self._controller is None
                                            or self._controller.takes_commands):
            self._publisher.publish(self._message(data=[v]))
            self._sent_at = time.monotonic()

    def _tick(self) -> None:
        """Check the controller; repeat the safe command, which it may have forgotten."""
        if self._controller is not None:
            self._controller.look()
        v = self._safe
        if self._enabled and v is not None and (time.monotonic() - self._sent_at
                                                >= REPEAT_PERIOD / 2):
            self._publish(v)

    def _is_ready(self) -> bool:
        """Whether the controller has been all right since it was enabled."""
        self._ready = self._ready or self._controller is None or not self._controller.problem()
        return self._ready


class _OwnNode:
    """A node for a driver that nothing hosts, served by a thread.

    Raises:
        MissingDependencyError: rclpy is not installed.
    """

    def __init__(self) -> None:
        try:
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
        except ImportError:
            raise MissingDependencyError("driver.name = 'joint' needs rclpy, of ROS 2 Jazzy or "
                                         "pip install 'dz_ros[ros]'") from None
        self._context = rclpy.Context()
        self._context.init()
        self.node = rclpy.create_node('joint_driver', context=self._context,
                                      start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and the node."""
        self._executor.shutdown()
        self._thread.join()
        self.node.destroy_node()
        self._context.shutdown()

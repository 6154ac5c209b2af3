"""A joint of ros2_control as an actuator: the driver `joint` (ours).

    command   std_msgs/Float64MultiArray, data = [v]    → ~/commands of forward_command_controller/
              ForwardCommandController or effort_controllers/JointGroupEffortController, one joint
    state     sensor_msgs/JointState                    ← joint_state_broadcaster

The unit of v is that of the claimed command interface: N m or N for `effort`, rad/s or m/s for
`velocity`. Positions and velocities are the joint's own, in rad or m.

Those controllers take whatever has one number, hold the last command for ever, and ignore what
arrives while they are inactive, without a word: what stops the joint when this process has died
must be in its hardware. It lies in ``nodes`` because it speaks ROS; it knows the host's node
through `attach` alone, and its messages are served between two samples. Where nothing hosts it, as
in `dz driver identify`, it has a node of its own, served by a thread.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
import threading
import time
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.driver import Driver
from dz_ros.core.safety.health import Report
from dz_ros.core.schema import parameter
from dz_ros.errors import ConfigurationError, DriverError, MissingDependencyError


@dataclass(frozen=True)
class JointParameters:
    """The joint and its topics."""

    joint: str = parameter('joint1', '', 'name of the joint in the joint states', structural=True)
    command_topic: str = parameter('/effort_controller/commands', '', 'topic of the controller '
                                   'that forwards the command', structural=True)
    state_topic: str = parameter('/joint_states', '', 'topic of the joint states',
                                 structural=True)
    measured: int = parameter(0, '1', '1 = the position alone is taken and the velocity '
                              'observed, 2 = both; 0 = as many as the plant has', minimum=0,
                              maximum=2, structural=True)
    limit: float = parameter(0.0, 'actuator unit', 'largest |v|; 0 = none', minimum=0.0)
    fresh: float = parameter(2.0, 'samples', 'an older joint state is none', minimum=0.1)
    patience: float = parameter(5.0, 's', 'a joint or a controller that is not there for so long '
                                'is trouble', minimum=0.1)


class Joint(Driver):
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
        self._node: Any = None
        self._own: _OwnNode | None = None
        self._publisher: Any = None
        self._subscription: Any = None
        self._state: tuple[tuple[float, ...], float] | None = None
        self._stamp = (0, 0)
        self._since = 0.0
        self._problem = ''
        self._counts: dict[str, int] = {'joint states': 0}

    @property
    def measured(self) -> int:
        """How many of position and velocity are taken."""
        return self.parameters.measured or min(self.configuration.plant.order, 2)

    @property
    def limit(self) -> float:
        """Largest |v| [command unit]."""
        return self.parameters.limit or math.inf

    # Its life.

    def attach(self, node: Any) -> None:
        """Hear of the node whose publishers and subscriptions are used."""
        self._node = node

    def open(self) -> None:
        """Offer commands, listen to joint states; whether they come shows later.

        Raises:
            DriverError: A topic's name is none.
            MissingDependencyError: rclpy is not installed.
        """
        if self._node is None:
            self._own = _OwnNode()
            self._node = self._own.node
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray
        p = self.parameters
        self._message = Float64MultiArray
        # Reliable reaches every subscription there can be, best effort hears every publisher.
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        for key, name in (('command_topic', p.command_topic), ('state_topic', p.state_topic)):
            try:
                if key == 'command_topic':
                    self._publisher = self._node.create_publisher(self._message, name,
                                                                  QoSProfile(depth=1))
                else:
                    self._subscription = self._node.create_subscription(JointState, name,
                                                                        self._hear, newest)
            except Exception as error:
                raise DriverError(f'driver.{key} = {name!r}: '
                                  f'{str(error).strip().splitlines()[0]}') from error

    def enable(self) -> None:
        """Begin to wait for joint and controller."""
        self._since = time.monotonic()

    def close(self) -> None:
        """Withdraw from the topics."""
        if self._publisher is not None:
            self._node.destroy_publisher(self._publisher)
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self._publisher = self._subscription = self._state = None
        if self._own is not None:
            self._own.close()
            self._own = self._node = None

    # Each sample.

    def command(self, v: float, t: float) -> None:  # noqa: ARG002
        """Publish [v]."""
        if self._publisher is not None:
            self._publisher.publish(self._message(data=[v]))

    def measure(self) -> tuple[float, ...] | None:
        """Return position and, if wanted, velocity, shape (measured,); None if none is fresh."""
        if self._state is None:
            return None
        x, arrived = self._state
        limit = self.parameters.fresh * self.configuration.loop.period
        return x if time.monotonic() - arrived <= limit else None

    def trouble(self) -> str:
        """Return which of joint and controller is not there, once that has lasted."""
        if self._publisher is None:
            return ''
        now, p = time.monotonic(), self.parameters
        seen = self._since if self._state is None else max(self._since, self._state[1])
        if now - seen > p.patience:
            return self._problem or f'nothing arrives on {p.state_topic}'
        if now - self._since > p.patience and self._publisher.get_subscription_count() == 0:
            return f'nobody listens to {p.command_topic}: is the controller loaded?'
        return ''

    def recover(self) -> None:
        """Wait for joint and controller anew.

        Raises:
            DriverError: They have not come.
        """
        if self.trouble():
            raise DriverError(self.trouble())

    def report(self, report: Report) -> None:
        """Add what was heard."""
        if self._state is not None:
            report.put('age of the joint state [ms]',
                       (time.monotonic() - self._state[1]) * 1e3, '.3f')
        if self._publisher is not None:
            report.put(f'listeners of {self.parameters.command_topic}',
                       self._publisher.get_subscription_count(), 'd')
        for what, count in self._counts.items():
            report.put(what, count, 'd')

    def _hear(self, message: Any) -> None:
        """Take a joint state, if it says what is needed of the joint."""
        p = self.parameters
        names = list(message.name)
        if p.joint not in names:
            # Several broadcasters may share the topic: others' joints are no fault.
            self._refuse('joint states of others', f'joint {p.joint!r} is not among those of '
                         f'{p.state_topic}: {", ".join(names) or "none"}')
            return
        place = names.index(p.joint)
        wanted = (('position', message.position), ('velocity', message.velocity))[:self.measured]
        x: list[float] = []
        for kind, values in wanted:
            if len(values) <= place:
                hint = ': set driver.measured to 1 to have it observed' if x else ''
                self._refuse(f'joint states without {kind}',
                             f'{p.state_topic} has no {kind} of {p.joint!r}{hint}')
                return
            if not math.isfinite(values[place]):
                self._refuse(f'joint states whose {kind} is not finite',
                             f'the {kind} of {p.joint!r} is {values[place]}')
                return
            x.append(float(values[place]))
        stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
        if stamp == self._stamp != (0, 0):
            self._refuse('joint states whose stamp stands still',
                         f'the stamp of {p.state_topic} stands still')
            return
        self._stamp, self._problem = stamp, ''
        self._state = tuple(x), time.monotonic()
        self._counts['joint states'] += 1

    def _refuse(self, what: str, problem: str) -> None:
        self._counts[what] = self._counts.get(what, 0) + 1
        self._problem = problem


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
        self.node = rclpy.create_node('joint_driver', context=self._context)
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

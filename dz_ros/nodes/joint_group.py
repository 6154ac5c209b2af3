# SPDX-License-Identifier: Apache-2.0
"""The joints of one controller of ros2_control, each the driver of an axis (ours).

    command   std_msgs/Float64MultiArray, data = [v_1, …]   in the controller's own order
    state     sensor_msgs/JointState                        by the names of the joints

The host calls the drivers axis by axis. What it gives them goes out as one message when the last
of them has been given its own; what it measures of one sample is one message, taken when the first
of them is asked.

Over 300 lines: lifecycle, commands and measurements of the joints are one object's.
"""

from __future__ import annotations

from collections.abc import Sequence
import threading
import time
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.safety.health import Level, Report
from dz_ros.drivers.freshness import Freshness
from dz_ros.drivers.phase import Phase
from dz_ros.errors import DriverError, MissingDependencyError
from dz_ros.nodes.joint_controller import ForwardingController
from dz_ros.nodes.joint_states import JointSample, JointStates

REPEAT_PERIOD = 0.1
"""The safe command is sent again after each of these [s]."""
ACKNOWLEDGE_TIME_OUT = 0.5
"""Longest wait for the controller to have the last safe command [s]."""
ABSENT = 0.0
"""Command of a joint that no axis has [unit of the command interface]: no force, no speed."""


class JointGroup:
    """The joints that one controller commands, with what they share.

    Args:
        each: Configurations of their axes; the keys of `joint_driver.SHARED` are the same.

    Attributes:
        states: What is received of them.
        joints: Their names, in the order of the axes.
    """

    def __init__(self, each: Sequence[Configuration]) -> None:
        self._each = list(each)
        self._shared: Any = each[0].driver_parameters
        self.states = JointStates(each)
        self._own: _OwnNode | None = None
        self._node: Any = None
        self._publisher: Any = None
        self._timer: Any = None
        self._controller: ForwardingController | None = None
        self._opened: set[int] = set()
        self._enabled: set[int] = set()
        self._ready = False
        self._values = {item.driver_parameters.joint: item.safety.safe_command for item in each}
        self.joints = tuple(self._values)
        self._given: set[int] = set()       # since the last message
        self._safe: set[int] = set()        # whose command is the safe one
        self._sent_at = self._since = 0.0
        self._measuring, self._judging, self._advancing = _Round(), _Round(), _Round()
        self._phase = Phase(each[0].loop.period)
        self._sample: JointSample | None = None
        self._asked_at = 0.0
        self._fault = ''

    # Lifecycle.

    def attach(self, node: Any) -> None:
        """Set the node whose publishers and subscriptions are used."""
        self._node = self.states.node = node

    def open(self, place: int) -> None:
        """Offer commands, subscribe to joint states, with the first joint that is opened.

        Raises:
            DriverError: A topic's name is none, or names no controller.
            MissingDependencyError: rclpy is not installed.
        """
        self._opened.add(place)
        if len(self._opened) > 1:
            return
        if self._node is None:
            self._own = _OwnNode()
            self.attach(self._own.node)
        from rclpy.clock import Clock, ClockType
        from rclpy.qos import QoSProfile
        from std_msgs.msg import Float64MultiArray
        p = self._shared
        self._message = Float64MultiArray
        for key in ('command_topic', 'state_topic'):
            try:
                if key == 'command_topic':      # reliable reaches every subscription there can be
                    self._publisher = self._node.create_publisher(self._message, p.command_topic,
                                                                  QoSProfile(depth=1))
                else:
                    self.states.subscribe()
            except Exception as error:
                raise DriverError(f'driver.{key} = {getattr(p, key)!r}: '
                                  f'{str(error).strip().splitlines()[0]}') from error
        self._controller = ForwardingController(
            self._node, self._publisher, p.command_topic, p.controller, self.joints,
            p.interface, p.activity_topic)
        self._timer = self._node.create_timer(
            REPEAT_PERIOD, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def enable(self, place: int) -> None:
        """Begin to wait for joints and controller, with the first joint that is enabled."""
        if not self._enabled:
            self._since, self._ready = time.monotonic(), False
            if self._controller is not None:
                self._controller.restart()
        self._enabled.add(place)

    def disable(self, place: int) -> None:
        """Repeat the safe command no more, once the controller has it, with the last joint.

        Raises:
            DriverError: No controller takes the safe command.
        """
        self._enabled.discard(place)
        self._safe.discard(place)
        if self._enabled or self._controller is None:
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

    def close(self, place: int) -> None:
        """Withdraw from the topics, with the last joint that was opened."""
        self._opened.discard(place)
        self._enabled.discard(place)        # also after an error, without `disable`
        if self._opened:
            return
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        if self._controller is not None:
            self._controller.close()
        if self._publisher is not None:
            self._node.destroy_publisher(self._publisher)
        self.states.unsubscribe()
        self._publisher = self._controller = self._timer = None
        if self._own is not None:
            self._own.close()
            self._own = None
            self.attach(None)

    def configure(self, place: int, configuration: Configuration) -> None:
        """Use other parameters for a joint from now on."""
        self._each[place] = configuration
        if place == 0:
            self._shared = configuration.driver_parameters
            self.states.freshness = Freshness.of(self._shared.fresh, configuration)

    # Each sample.

    def give(self, place: int, v: float, safe: bool) -> None:
        """Take the command of a joint, the safe one or not; send when each has been given one."""
        if self._given and (place == 0 or place in self._given):
            self._send()                # others were given none: what there is
        self._values[self.joints[place]] = v
        (self._safe.add if safe else self._safe.discard)(place)
        self._given.add(place)
        if self._given >= self._enabled:
            self._send()

    def advance(self, place: int, t: float) -> None:
        """Learn when samples end: what is measured is brought there."""
        if self._advancing.begins(place):
            self._phase.sample_ended(time.monotonic(), t)

    def measure(self, place: int) -> tuple[float, ...] | None:
        """Return position and, if wanted, velocity of a joint; None if none is fresh.

        None as well before the controller has confirmed its joints: nothing may move.
        """
        if self._measuring.begins(place):
            self._asked_at = time.monotonic()
            self.states.take(self._asked_at)
            self._sample = self.states.newest if self._is_ready() else None
        sample, freshness = self._sample, self.states.freshness
        if sample is None or not freshness.holds(sample.arrived, self._asked_at):
            return None
        x = sample.x[place]
        if not self._each[place].driver_parameters.extrapolate:
            return x
        velocity = x[1] if len(x) > 1 else self.states.velocity(place)
        return (freshness.advanced(x[0], velocity,
                                   self._phase.near(self._asked_at) - sample.taken), *x[1:])

    def fault(self, place: int) -> str:
        """Return what is wrong with a joint or the controller; '' = nothing."""
        if self._judging.begins(place):
            self._fault = self._found_fault()
        lacking = self._controller.lacking if self._controller is not None else ()
        return self._fault if not lacking or self.joints[place] in lacking else ''

    def _found_fault(self) -> str:
        """Return what is wrong; once it has lasted where it may come."""
        if self._publisher is None:
            return ''
        now, patience = time.monotonic(), self._shared.patience
        self.states.take(now)
        controller = self._controller
        if controller is not None and controller.wrong:
            return controller.wrong
        if self.states.mixed(now):
            return self.states.mixed_text()
        found = controller.problem() if controller is not None else ''
        if found and (self._is_ready() or now - self._since > patience):
            return found
        newest = self.states.newest
        seen = max(self._since, newest.arrived) if newest is not None else self._since
        return self.states.absence() if now - seen > patience else ''

    def report(self, report: Report) -> None:
        """Add what was received."""
        newest = self.states.newest
        if newest is not None:
            report.put('age of the joint state [ms]',
                       (time.monotonic() - newest.taken) * 1e3, '.3f')
        if self._publisher is not None:
            report.put(f'listeners of {self._shared.command_topic}',
                       self._publisher.get_subscription_count(), 'd')
        if self._controller is not None:
            report.put('controller', self._controller.name or 'not asked')
            report.put('state of the controller', self._controller.state or 'unknown')
            if self._ready and self._controller.deaf():
                report.summarize(Level.ERROR, self._controller.deaf())
        for what, count in self.states.counts.items():
            report.put(what, count, 'd')

    def _send(self) -> None:
        """Publish the commands if the controller is known to be the right one."""
        self._given.clear()
        if self._publisher is not None and (self._controller is None
                                            or self._controller.takes_commands):
            order = self._controller.joints if self._controller is not None else self._values
            self._publisher.publish(self._message(
                data=[self._values.get(joint, ABSENT) for joint in order]))
            self._sent_at = time.monotonic()

    def _tick(self) -> None:
        """Check the controller; repeat the safe command, which it may have forgotten."""
        if self._controller is not None:
            self._controller.look()
        if self._enabled and self._safe >= self._enabled and (
                time.monotonic() - self._sent_at >= REPEAT_PERIOD / 2):
            self._send()

    def _is_ready(self) -> bool:
        """Whether the controller has been all right since it was enabled."""
        self._ready = self._ready or self._controller is None or not self._controller.problem()
        return self._ready


class _Round:
    """The joints asked about one sample; it begins with the first, or with one asked again."""

    def __init__(self) -> None:
        self._seen: set[int] = set()

    def begins(self, place: int) -> bool:
        """Return whether asking this joint begins another sample."""
        begins = place == 0 or not self._seen or place in self._seen
        if begins:
            self._seen.clear()
        self._seen.add(place)
        return begins


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

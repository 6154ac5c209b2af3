# SPDX-License-Identifier: Apache-2.0
"""The controller of ros2_control that forwards the commands of the driver `joint` (ours).

What it reports of itself, so that a command never reaches another joint, and a safe command that
no controller takes is not called safe:

    ~/get_parameters                 `joints`, `interface_name`: asked before the first command
    ~/transition_event               lifecycle_msgs/TransitionEvent; sent at changes only, so the
                                     state before the first one is not known from it
    /controller_manager/activity     controller_manager_msgs/ControllerManagerActivity, latched;
                                     used where that package is installed
    the graph                        whether it subscribes, and which other nodes command it
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
import importlib
import time
from typing import Any

from dz_ros.core.text import LONGEST, printable
from dz_ros.errors import DriverError

ACTIVE = 3
"""lifecycle_msgs/State.PRIMARY_STATE_ACTIVE."""
UNCONFIGURED = 1
"""lifecycle_msgs/State.PRIMARY_STATE_UNCONFIGURED."""
ANSWER_TIME_OUT = 1.0
"""A controller that has not answered within this is asked again [s]."""
LEASE = 30.0
"""Longest time for which DDS shows a publisher of a killed process [s]; its default is 20 s."""
MAX_LABEL = 40
"""Letters of a state's name that are shown."""
NOT_ASKED = '-'
"""Value of `driver.controller` that leaves the controller unasked."""


class ForwardingController:
    """What is known of the controller.

    Args:
        node: Node whose client and subscriptions are used.
        publisher: Publisher of the commands.
        topic: Their topic, as the node names it: before remapping.
        name: Name of the controller's node; '' = that of the command topic, '-' = not asked.
        joints: Joints that it must command: one alone, or several, perhaps beside others.
        interface: Command interface that it must claim.
        activity_topic: Activity of the controller manager.

    Attributes:
        name: Full name of the controller's node; '' where it is not asked.
        wrong: Why no command may be sent to it; '' = nothing known.
        lacking: Joints that it should command and does not, where that is what is wrong.
        verified: Whether it has confirmed that it commands these joints by this interface.
        joints: All joints that it commands, in its order; where it is not asked, those it must.

    Raises:
        DriverError: The command topic names no controller.
    """

    def __init__(self, node: Any, publisher: Any, topic: str, name: str, joints: Sequence[str],
                 interface: str, activity_topic: str) -> None:
        from lifecycle_msgs.msg import TransitionEvent
        from rcl_interfaces.srv import GetParameters
        self._node, self._publisher, self._topic = node, publisher, topic
        self._wanted, self._interface = tuple(joints), interface
        self.joints: tuple[str, ...] = self._wanted
        self.lacking: tuple[str, ...] = ()
        self._absent: tuple[str, ...] = ()
        self._request = GetParameters.Request
        self.name = publisher.topic_name.rpartition('/')[0] if not name else (
            '' if name == NOT_ASKED else '/' + name.strip('/'))
        if not (self.name or name):
            raise DriverError(f'{publisher.topic_name} names no controller: set driver.controller '
                              f'to its node, or to {NOT_ASKED} for one that is not to be asked')
        self.wrong = ''
        self.verified = not self.name
        self._state = ''                # '' = not known
        self._listed = False
        self._answers: dict[str, Any] = {}
        self._futures: list[Any] = []
        self._asked_at = -ANSWER_TIME_OUT
        self._since = time.monotonic()
        self._rivals = ''
        self._client: Any = None
        self._subscriptions: list[Any] = []
        if not self.name:
            return
        self._client = node.create_client(GetParameters, f'{self.name}/get_parameters')
        self._subscriptions.append(node.create_subscription(
            TransitionEvent, f'{self.name}/transition_event', self._on_transition, 10))
        try:        # not a dependency: it is there wherever a controller manager is
            messages = importlib.import_module('controller_manager_msgs.msg')
        except ImportError:     # then its transitions alone report it
            return
        from rclpy.qos import DurabilityPolicy, QoSProfile
        self._subscriptions.append(node.create_subscription(
            messages.ControllerManagerActivity, activity_topic, self.receive_activity,
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)))

    def close(self) -> None:
        """Destroy client and subscriptions."""
        self._forget_answers()
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()
        if self._client is not None:
            self._node.destroy_client(self._client)
            self._client = None

    def restart(self) -> None:
        """Ask for its joint again, before anything is sent to it."""
        self._since = time.monotonic()
        self._forget_answers()
        self._answers.clear()
        self._asked_at = -ANSWER_TIME_OUT
        self.wrong, self.lacking, self.verified = '', (), not self.name

    # What is known.

    @property
    def state(self) -> str:
        """Lifecycle state as text; '' = not known."""
        return self._state

    @property
    def takes_commands(self) -> bool:
        """Whether a command may be sent."""
        return self.verified and not self.wrong

    def problem(self) -> str:
        """Return why commands do not reach the joint, or not ours alone; '' = nothing known."""
        return self.wrong or self.deaf() or self._rivals

    def deaf(self) -> str:
        """Return why no command is taken, the safe one included; '' = nothing known."""
        topic = self._publisher.topic_name
        if self._publisher.get_subscription_count() == 0:
            return f'no node subscribes to {topic}: is the controller loaded?'
        if self._state not in ('', 'active'):
            return f'the controller {self.name} is {self._state}: it takes no commands'
        if not self.verified:
            return (f'the controller {self.name} does not answer: {self.name}/get_parameters '
                    'must name the joint that it commands')
        return ''

    # What comes.

    def look(self) -> None:
        """Ask what has not been answered, find other publishers of commands; about every 0.1 s.

        One whose subscription has gone may come back as another: it is asked again.
        """
        now = time.monotonic()
        if self.verified and self.name and self._publisher.get_subscription_count() == 0:
            since = self._since
            self.restart()
            self._since = since
        if (not self.verified and not self.wrong and self._client is not None
                and now - self._asked_at >= ANSWER_TIME_OUT and self._client.service_is_ready()):
            self._ask(now)
        self._rivals = self._find_rivals(now)

    def _ask(self, now: float) -> None:
        """Ask for the parameters one by one: an unknown one leaves the answer to all empty."""
        self._forget_answers()
        self._answers.clear()
        self._asked_at = now
        for name in ('joints', 'interface_name'):
            future = self._client.call_async(self._request(names=[name]))
            self._futures.append(future)
            future.add_done_callback(partial(self._answered, name))

    def _forget_answers(self) -> None:
        for future in self._futures:
            self._client.remove_pending_request(future)
        self._futures.clear()

    def _answered(self, name: str, future: Any) -> None:
        if future not in self._futures:
            return
        values = future.result().values
        self._answers[name] = values[0] if values else None
        if len(self._answers) < 2:
            return
        self._futures.clear()
        joints = getattr(self._answers['joints'], 'string_array_value', None)
        interface = getattr(self._answers['interface_name'], 'string_value', '')
        joints = tuple(joints or ())
        if not joints:
            self.wrong = (f'{self.name} has no parameter joints: it is no '
                          'forward_command_controller or effort controller')
        else:
            self.wrong = self._other_joints(joints)
        if not self.wrong and interface and interface != self._interface:
            self.wrong = (f'{self.name} commands the interface {interface!r}, but '
                          f'driver.interface = {self._interface!r}')
        self.joints = joints
        self.verified = True

    def _other_joints(self, joints: tuple[str, ...]) -> str:
        """Return why its joints are not the ones it must command; '' = they are.

        Those of several axes may have others beside them, which it would have to be given a
        command for as well; one joint must be alone, so that its driver knows of no other.
        """
        listed = ', '.join(joints)
        if len(self._wanted) == 1:
            if len(joints) > 1:
                return (f'{self.name} commands {len(joints)} joints ({listed}), the driver sends '
                        'one number: give it one joint')
            return '' if joints == self._wanted else (
                f'{self.name} commands joint {joints[0]!r}, but driver.joint = '
                f'{self._wanted[0]!r}')
        self.lacking = tuple(joint for joint in self._wanted if joint not in joints)
        if self.lacking:
            return (f'{self.name} does not command driver.joint = '
                    f'{", ".join(map(repr, self.lacking))}; its joints: {listed}')
        if twice := [joint for joint in joints if joints.count(joint) > 1]:
            return f'{self.name} names joint {twice[0]!r} twice'
        absent = tuple(joint for joint in joints if joint not in self._wanted)
        if absent and self._interface == 'position':
            return (f'{self.name} commands {", ".join(absent)} as well, which no axis has: no '
                    'position is safe for it; give the controller the joints of the axes alone')
        if absent not in ((), self._absent):
            self._node.get_logger().warning(
                f'{self.name} commands {printable(", ".join(absent), LONGEST)} as well, which no '
                f'axis has: commanded 0')
        self._absent = absent
        return ''

    def _on_transition(self, event: Any) -> None:
        if event.start_state.id == UNCONFIGURED:
            since = self._since
            self.restart()              # it may have been configured for another joint
            self._since = since
        self._enter('active' if event.goal_state.id == ACTIVE else event.goal_state.label)

    def receive_activity(self, message: Any) -> None:
        """Receive the states of all controllers of the manager."""
        own = self.name.rpartition('/')[2]
        found = next((item.state for item in message.controllers if item.name == own), None)
        if found is not None:
            self._listed = True
            self._enter('active' if found.id == ACTIVE else found.label)
        elif self._listed:              # else it may be another manager's
            self._enter('not loaded')

    def _enter(self, state: str) -> None:
        state = printable(state, MAX_LABEL)
        left, self._state = self._state in ('', 'active') and state != 'active', state
        if left:
            self._node.get_logger().error(f'{self.deaf()}, not even the safe one; the hardware '
                                          'keeps what it was given last')

    def _find_rivals(self, now: float) -> str:
        """Return the other publishers of commands, as text."""
        topic = self._publisher.topic_name
        if self._node.count_publishers(topic) < 2:
            return ''
        own = self._node.get_name(), self._node.get_namespace()
        names = [(item.node_name, item.node_namespace)
                 for item in self._node.get_publishers_info_by_topic(self._topic)]
        if own in names:
            names.remove(own)
        if now - self._since < LEASE:   # one that was killed, whose place this process has taken
            names = [name for name in names if name != own]
        if not names:
            return ''
        others = ', '.join(sorted(f'{space.rstrip("/")}/{name}' for name, space in names))
        return f'{len(names) + 1} publishers of {topic}: this node and {others}'

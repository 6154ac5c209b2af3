# SPDX-License-Identifier: Apache-2.0
"""A joint of ros2_control as an actuator: the driver `joint` (ours).

    command   std_msgs/Float64MultiArray   → ~/commands of forward_command_controller/
              ForwardCommandController or effort_controllers/JointGroupEffortController
    state     sensor_msgs/JointState       ← joint_state_broadcaster

The unit of v is that of the claimed command interface: N m or N for `effort`, rad/s or m/s for
`velocity`. Positions and velocities are the joint's own, in rad or m.

Nothing is sent, and nothing measured, before the controller has confirmed which joints it commands
by this interface (``joint_controller.py``). Those controllers hold the last command
for ever, ignore what arrives while they are inactive and forget it when they are activated; so the
safe command is repeated. What stops the joint when this process has died must be in its hardware.

It lies in ``nodes`` because it uses ROS; it knows the host's node through `attach` alone. The
drivers of the axes whose joints one controller commands share what there is of it
(``joint_group.py``); one axis is a group of one. What it receives: ``joint_states.py``. Where
nothing hosts it, as in `dz driver identify`, it has a node of its own, served by a thread.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.axes_keys import axis_key
from dz_ros.core.configuration import Configuration
from dz_ros.core.records import Truth
from dz_ros.core.safety.health import Report
from dz_ros.core.schema import parameter
from dz_ros.drivers.contract import Driver
from dz_ros.drivers.freshness import fresh_parameter
from dz_ros.errors import ConfigurationError, DriverError
from dz_ros.nodes.joint_group import JointGroup

SHARED = ('controller', 'interface', 'activity_topic', 'state_topic', 'fresh', 'patience')
"""Parameters that joints of one command topic have in common."""
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


class Joint(Driver):
    """A joint of ros2_control.

    Args:
        parameters: Its own.
        configuration: That of its axis.
        group: The joints of its controller; None = it is alone.
        place: Which of them it is.

    Attributes:
        group: The joints of its controller.
        states: What is received of them.
    """

    name = 'joint'
    summary = 'a joint of ros2_control: forwarded command, joint states'
    order = 0
    requires = ('rclpy', 'sensor_msgs', 'std_msgs')
    Parameters = JointParameters

    def __init__(self, parameters: Any, configuration: Configuration,
                 group: JointGroup | None = None, place: int = 0) -> None:
        super().__init__(parameters, configuration)
        if not parameters.joint:
            raise ConfigurationError('driver.joint', '', 'must be the name of a joint')
        if parameters.measured > configuration.plant.order:
            raise ConfigurationError('driver.measured', parameters.measured, 'must be at most '
                                     f'{configuration.plant.order}, the order of the plant')
        self.group = JointGroup([configuration]) if group is None else group
        self.states = self.group.states
        self._place = place

    @classmethod
    def check_axes(cls, axes: Mapping[str, Configuration]) -> None:
        """Check that each axis has a joint of its own, and one controller one set of topics.

        Raises:
            ConfigurationError: They have not.
        """
        joints: dict[tuple[str, str], str] = {}
        first: dict[str, tuple[str, Any]] = {}
        for name, item in axes.items():
            p = item.driver_parameters
            owner = joints.setdefault((p.state_topic, p.joint), name)
            if owner != name:
                raise ConfigurationError(axis_key(name, 'driver.joint'), p.joint, 'is the joint '
                                         f'of axis {owner}; each axis has one of its own')
            other, wanted = first.setdefault(p.command_topic, (name, p))
            for key in SHARED:
                if getattr(p, key) != getattr(wanted, key):
                    raise ConfigurationError(
                        axis_key(name, f'driver.{key}'), getattr(p, key),
                        f'must be {getattr(wanted, key)!r} as of axis {other}: one controller '
                        f'commands both, on {p.command_topic}')

    @classmethod
    def for_axes(cls, each: Sequence[Configuration]) -> Sequence[Driver]:
        """Return the drivers of all axes; those with one command topic share a group."""
        topics = [item.driver_parameters.command_topic for item in each]
        groups = {topic: JointGroup([item for item, own in zip(each, topics, strict=True)
                                     if own == topic]) for topic in dict.fromkeys(topics)}
        return [cls(item.driver_parameters, item, groups[topic], topics[:place].count(topic))
                for place, (item, topic) in enumerate(zip(each, topics, strict=True))]

    @property
    def device(self) -> JointGroup | None:
        """The joints of its controller, where these are of other axes too."""
        return self.group if len(self.group.joints) > 1 else None

    @property
    def measured(self) -> int:
        """Number of states taken of a message: position, and velocity if wanted."""
        return self.parameters.measured or min(self.configuration.plant.order, 2)

    @property
    def state_units(self) -> tuple[str, ...]:
        """Units of position, velocity, … of the joint, shape (n,)."""
        unit = self.parameters.unit
        return (unit, f'{unit}/s', f'{unit}/s^2', f'{unit}/s^3')[:self.configuration.plant.order]

    @property
    def command_unit(self) -> str:
        """Unit of the command interface."""
        return UNITS[self.parameters.interface][self.parameters.unit]

    @property
    def limit(self) -> float:
        """Largest |v| [command unit]."""
        return self.parameters.limit or math.inf

    @property
    def refused(self) -> Mapping[str, int]:
        """Joint states of the group that were not taken, by cause; the first joint has them."""
        return {} if self._place else self.states.refused

    def configure(self, configuration: Configuration) -> None:
        """Use another safe hold and freshness from now on."""
        super().configure(configuration)
        self.group.configure(self._place, configuration)

    def attach(self, node: Any) -> None:
        """Set the node whose publishers and subscriptions are used."""
        self.group.attach(node)

    def open(self) -> None:
        """Offer commands, subscribe to joint states; whether they come shows later.

        Raises:
            DriverError: A topic's name is none, or names no controller.
            MissingDependencyError: rclpy is not installed.
        """
        self.group.open(self._place)

    def enable(self) -> None:
        """Begin to wait for joint and controller."""
        self.group.enable(self._place)

    def disable(self) -> None:
        """Repeat the safe command no more, once the controller has it.

        Raises:
            DriverError: No controller takes the safe command.
        """
        self.group.disable(self._place)

    def close(self) -> None:
        """Withdraw from the topics."""
        self.group.close(self._place)

    def command(self, v: float, t: float) -> None:  # noqa: ARG002
        """Publish v, with the commands of the group's other joints."""
        self.group.give(self._place, v, safe=False)

    def safe(self, v: float, t: float) -> None:  # noqa: ARG002
        """Publish v as `command` does, and again every `REPEAT_PERIOD` until the next command."""
        self.group.give(self._place, v, safe=True)

    def advance(self, t: float, seq: int) -> Truth | None:  # noqa: ARG002
        """Learn when samples end: what is measured is brought there."""
        self.group.advance(self._place, t)
        return None

    def measure(self) -> tuple[float, ...] | None:
        """Return position and, if wanted, velocity, shape (measured,); None if none is fresh."""
        return self.group.measure(self._place)

    def absence(self) -> str:
        """Return why there is no measurement."""
        return self.states.absence()

    def fault(self) -> str:
        """Return what is wrong with joint or controller; once it has lasted where it may come."""
        return self.group.fault(self._place)

    def recover(self) -> None:
        """Wait for joint and controller again.

        Raises:
            DriverError: They have not come.
        """
        if self.fault():
            raise DriverError(self.fault())

    def report(self, report: Report) -> None:
        """Add what was received of the group, once."""
        if not self._place:
            self.group.report(report)

# SPDX-License-Identifier: Apache-2.0
"""What the driver `joint` receives of its joint: sensor_msgs/JointState of a broadcaster (ours).

A joint state has the age of its header: the position is advanced by that age with the velocity,

    x(t) = x(t_s) + (t - t_s) x'(t_s)

where t_s is the header's stamp on this machine's clock. A state whose stamp is not of this clock,
or older than `driver.fresh`, counts as new when it arrives. One whose stamp stands still or goes
back a little is none. Joint states of more than one
publisher are not mixed (``joint_sources.py``). They are taken when the host asks for a sample.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
import math
import time
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.counted_log import Counted
from dz_ros.core.text import LONGEST, printable
from dz_ros.drivers.contract import Driver
from dz_ros.drivers.freshness import Freshness
from dz_ros.nodes.joint_sources import JointSources
from dz_ros.nodes.ros.graph import publishers

QUEUE_DEPTH = 10
"""Joint states kept between two samples: both publishers of a joint must be seen."""
MAX_NAMES = 20
"""Names of other joints that are published."""
CLOCKS_AGREE = 0.001
"""A stamp that is further in the future is not of this machine's clock [s]."""
CLOCK_SET = 1.0
"""A stamp that goes back by less belongs to an older state; by more, the clock was set [s]."""
TAKEN, OTHERS, UNAGED = ('joint states', 'joint states of others',
                         'joint states whose stamp is of another clock, or late')
"""What is counted without being a fault: several broadcasters may share the topic."""
BASELINE = 4
"""Samples over which a velocity that is not measured is taken, to advance the position."""


@dataclass(frozen=True)
class JointSample:
    """What a joint state holds of the joint.

    Attributes:
        x: Position and, if wanted, velocity, shape (measured,).
        arrived: When it arrived [s of the steady clock].
        taken: The instant it describes, by its header [s of the steady clock].
    """

    x: tuple[float, ...]
    arrived: float
    taken: float


class JointStates(Driver):
    """The receiving half of the driver; the other one fills in when it is ready."""

    def __init__(self, parameters: Any, configuration: Configuration) -> None:
        super().__init__(parameters, configuration)
        self._node: Any = None
        self._subscription: Any = None
        self._polled = 0.0
        self._samples: deque[JointSample] = deque(maxlen=32)
        self._sources = JointSources(parameters.patience)
        self._stamp = (0, 0)
        self._problem = ''
        self.counts = dict.fromkeys((TAKEN, OTHERS, UNAGED), 0)
        self._refused = Counted()
        self._freshness = Freshness.of(parameters.fresh, configuration)

    def configure(self, configuration: Configuration) -> None:
        """Use another safe hold and freshness from now on."""
        super().configure(configuration)
        self._freshness = Freshness.of(self.parameters.fresh, configuration)

    @property
    def refused(self) -> Mapping[str, int]:
        """Joint states of this joint that were not taken, by cause."""
        return self._refused.counts

    @property
    def measured(self) -> int:
        """Number of states taken of a message: position, and velocity if wanted."""
        return self.parameters.measured or min(self.configuration.plant.order, 2)

    @property
    def state_units(self) -> tuple[str, ...]:
        """Units of position, velocity, … of the joint, shape (n,)."""
        unit = self.parameters.unit
        return (unit, f'{unit}/s', f'{unit}/s^2', f'{unit}/s^3')[:self.configuration.plant.order]

    def measure(self) -> tuple[float, ...] | None:
        """Return position and, if wanted, velocity, shape (measured,); None if none is fresh.

        None as well before the controller has confirmed its joint: nothing may move.
        """
        now = time.monotonic()
        self._take(now)
        if not self._is_ready() or not self._samples:
            return None
        sample = self._samples[-1]
        if not self._freshness.holds(sample.arrived, now):
            return None
        if not self.parameters.extrapolate:
            return sample.x
        velocity = sample.x[1] if len(sample.x) > 1 else self._velocity()
        return (self._freshness.advanced(sample.x[0], velocity, now - sample.taken),
                *sample.x[1:])

    def absence(self) -> str:
        """Return why there is no measurement."""
        return self._problem or f'nothing arrives on {self.parameters.state_topic}'

    def _is_ready(self) -> bool:
        """Whether the controller is the right one, so that the loop may begin."""
        return True

    def _subscribe(self) -> None:
        """Subscribe to joint states.

        No executor knows of the subscription: it is taken with the middleware's publication
        number, which the quickest executor cannot hand over.
        """
        from rclpy.impl.implementation_singleton import rclpy_implementation
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from rclpy.type_support import check_is_valid_msg_type
        from sensor_msgs.msg import JointState
        self._joint_state = JointState
        check_is_valid_msg_type(JointState)
        # Best effort receives from every publisher.
        newest = QoSProfile(depth=QUEUE_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        with self._node.handle:
            self._subscription = rclpy_implementation.Subscription(
                self._node.handle, JointState, self.parameters.state_topic,
                newest.get_c_qos_profile())

    def _unsubscribe(self) -> None:
        """Withdraw from the topic; forget what was received."""
        if self._subscription is not None:
            self._subscription.destroy_when_not_in_use()
        self._subscription = None
        self._samples.clear()

    @property
    def _state(self) -> tuple[tuple[float, ...], float] | None:
        """The newest measurement and when it arrived; None = none yet."""
        return (self._samples[-1].x, self._samples[-1].arrived) if self._samples else None

    def _take(self, now: float) -> None:
        """Take the joint states that have arrived since the last call."""
        if self._subscription is None:
            return
        for _ in range(2 * QUEUE_DEPTH):
            taken = self._subscription.take_message(self._joint_state, False)
            if taken is None:
                break
            message, info = taken
            # The time of arrival is of the wall clock, which may have been set meanwhile.
            waited = (time.time_ns() - info['received_timestamp']) * 1e-9
            self.receive(message, info['publication_sequence_number'],
                         now - min(max(waited, 0.0), now - self._polled))
        self._polled = now

    def receive(self, message: Any, number: int | None = None,
                arrived: float | None = None) -> None:
        """Take a joint state, if it has what is needed of the joint."""
        p = self.parameters
        arrived = time.monotonic() if arrived is None else arrived
        names = list(message.name)
        if p.joint not in names:
            received = printable(', '.join(names[:MAX_NAMES]), LONGEST) or 'none'
            self.counts[OTHERS] += 1
            more = ' …' if len(names) > MAX_NAMES else ''
            self._problem = (f'joint {p.joint!r} is not among those of {p.state_topic}: '
                             f'{received}{more}')
            return
        place = names.index(p.joint)
        stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
        form = tuple(names), len(message.position), len(message.velocity)
        if not self._sources.take(form, number, stamp[0] * 10 ** 9 + stamp[1], arrived):
            self._refuse('joint states of another publisher', self._mixed())
            return
        wanted = (('position', message.position), ('velocity', message.velocity))[:self.measured]
        x: list[float] = []
        for kind, values in wanted:
            hint = ': set driver.measured to 1 to have it observed' if x else ''
            if len(values) <= place:
                self._refuse(f'joint states without {kind}',
                             f'{p.state_topic} has no {kind} of {p.joint!r}{hint}')
                return
            if not math.isfinite(values[place]):
                # The broadcaster publishes nan for an interface that the hardware does not export.
                self._refuse(f'joint states whose {kind} is not finite',
                             f'the {kind} of {p.joint!r} is {values[place]}'
                             f'{hint if math.isnan(values[place]) else ""}')
                return
            x.append(float(values[place]))
        passed = stamp[0] - self._stamp[0] + (stamp[1] - self._stamp[1]) * 1e-9
        if (0, 0) not in (stamp, self._stamp) and -CLOCK_SET < passed <= 0.0:
            what = 'stamp goes back' if passed else 'stamp stands still'
            self._refuse(f'joint states whose {what}',
                         f'the {what.replace(" ", f" of {p.state_topic} ", 1)}')
            return
        self._stamp, self._problem = stamp, ''
        self._samples.append(JointSample(tuple(x), arrived, arrived - self._age(stamp, arrived)))
        self.counts[TAKEN] += 1

    def _age(self, stamp: tuple[int, int], arrived: float) -> float:
        """Return how old a joint state was when it arrived, by its header [s]; 0 = not known."""
        if self._node is None or stamp == (0, 0):
            return 0.0
        now = self._node.get_clock().now().nanoseconds
        age: float = (now - stamp[0] * 10 ** 9 - stamp[1]) * 1e-9 - (time.monotonic() - arrived)
        if -CLOCKS_AGREE <= age <= self._freshness.limit:
            return max(age, 0.0)
        self.counts[UNAGED] += 1
        return 0.0

    def _velocity(self) -> float:
        """Return the velocity of a joint whose position alone is received, over some samples."""
        newest = self._samples[-1]
        since = newest.taken - BASELINE * self.configuration.loop.period
        oldest = next(item for item in self._samples if item.taken >= since)
        passed = newest.taken - oldest.taken
        return (newest.x[0] - oldest.x[0]) / passed if passed > CLOCKS_AGREE else 0.0

    def _mixed(self) -> str:
        """Return the publishers of the joint's state, as text."""
        p, names = self.parameters, ''
        if self._node is not None and self._subscription is not None:
            names = ', '.join(publishers(self._node, p.state_topic))
        return (f'more than one publisher publishes joint {p.joint!r} on {p.state_topic}'
                f'{f" ({names})" if names else ""}: none is taken for the other')

    def _refuse(self, what: str, problem: str) -> None:
        self._refused.add(what)
        self._problem = problem

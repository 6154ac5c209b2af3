# SPDX-License-Identifier: Apache-2.0
"""What the driver `joint` receives of its joints: sensor_msgs/JointState of a broadcaster (ours).

A joint state has the age of its header: the position is advanced by that age with the velocity,

    x(t) = x(t_s) + (t - t_s) x'(t_s)

where t_s is the header's stamp on this machine's clock. A state whose stamp is not of this clock,
or older than `driver.fresh`, counts as new when it arrives. One whose stamp stands still or goes
back a little is none. Joint states of more than one
publisher are not mixed (``joint_sources.py``). They are taken when the host asks for a sample.

The joints of one controller are one measurement: a message that lacks one of them, or what is
wanted of one, is none for all of them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
import time
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.counted_log import Counted
from dz_ros.core.text import LONGEST, printable
from dz_ros.drivers.freshness import BASELINE, Freshness
from dz_ros.nodes.joint_sources import JointSources

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


@dataclass(frozen=True)
class JointSample:
    """What a joint state holds of the joints.

    Attributes:
        x: Position and, if wanted, velocity of each, shape (joints, measured).
        arrived: When it arrived [s of the steady clock].
        taken: The instant it describes, by its header [s of the steady clock].
    """

    x: tuple[tuple[float, ...], ...]
    arrived: float
    taken: float


class JointStates:
    """The joint states of some joints, which one publisher publishes in one message.

    Args:
        each: Configurations of the joints' axes; they have topic, freshness and patience in
            common.

    Attributes:
        node: Whose clock and graph are used; None = none yet.
        freshness: When a joint state is a measurement still.
        counts: Joint states by what they were, without being a fault.
        refused: Joint states of these joints that were not taken, by cause.
    """

    def __init__(self, each: Sequence[Configuration]) -> None:
        first = each[0].driver_parameters
        self._joints = [item.driver_parameters.joint for item in each]
        self._measured = [item.driver_parameters.measured or min(item.plant.order, 2)
                          for item in each]
        self._topic: str = first.state_topic
        self._period = each[0].loop.period
        self.node: Any = None
        self._subscription: Any = None
        self._polled = 0.0
        self._samples: deque[JointSample] = deque(maxlen=32)
        self._sources = JointSources(first.patience)
        self._stamp = (0, 0)
        self._problem = ''
        self.counts = dict.fromkeys((TAKEN, OTHERS, UNAGED), 0)
        self._refused = Counted()
        self.freshness = Freshness.of(first.fresh, each[0])

    @property
    def refused(self) -> Mapping[str, int]:
        """Joint states of these joints that were not taken, by cause."""
        return self._refused.counts

    @property
    def newest(self) -> JointSample | None:
        """The newest joint state; None = none yet."""
        return self._samples[-1] if self._samples else None

    def absence(self) -> str:
        """Return why there is no measurement."""
        return self._problem or f'nothing arrives on {self._topic}'

    def subscribe(self) -> None:
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
        with self.node.handle:
            self._subscription = rclpy_implementation.Subscription(
                self.node.handle, JointState, self._topic, newest.get_c_qos_profile())

    def unsubscribe(self) -> None:
        """Withdraw from the topic; forget what was received."""
        if self._subscription is not None:
            self._subscription.destroy_when_not_in_use()
        self._subscription = None
        self._samples.clear()

    def take(self, now: float) -> None:
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
        """Take a joint state, if it has what is needed of the joints."""
        arrived = time.monotonic() if arrived is None else arrived
        names = list(message.name)
        if missing := [joint for joint in self._joints if joint not in names]:
            self._lacks(missing, names)
            return
        stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
        form = tuple(names), len(message.position), len(message.velocity)
        if not self._sources.take(form, number, stamp[0] * 10 ** 9 + stamp[1], arrived):
            self._refuse('joint states of another publisher', self.mixed_text())
            return
        x = []
        for joint, measured in zip(self._joints, self._measured, strict=True):
            if len(self._joints) > 1 and names.count(joint) > 1:
                self._refuse('joint states that name a joint twice',
                             f'{self._topic} names joint {joint!r} twice')
                return
            found = self._numbers(message, joint, names.index(joint), measured)
            if found is None:
                return
            x.append(found)
        passed = stamp[0] - self._stamp[0] + (stamp[1] - self._stamp[1]) * 1e-9
        if (0, 0) not in (stamp, self._stamp) and -CLOCK_SET < passed <= 0.0:
            what = 'stamp goes back' if passed else 'stamp stands still'
            self._refuse(f'joint states whose {what}',
                         f'the {what.replace(" ", f" of {self._topic} ", 1)}')
            return
        self._stamp, self._problem = stamp, ''
        self._samples.append(JointSample(tuple(x), arrived, arrived - self._age(stamp, arrived)))
        self.counts[TAKEN] += 1

    def _lacks(self, missing: Sequence[str], names: Sequence[str]) -> None:
        """Keep that a message has not all the joints, which is a fault if it has some."""
        what = ', '.join(map(repr, missing))
        what = f'joint {what} is' if len(missing) == 1 else f'joints {what} are'
        received = printable(', '.join(names[:MAX_NAMES]), LONGEST) or 'none'
        more = ' …' if len(names) > MAX_NAMES else ''
        problem = f'{what} not among those of {self._topic}: {received}{more}'
        if len(missing) < len(self._joints):
            self._refuse('joint states without one of the joints', problem)
            return
        self.counts[OTHERS] += 1
        self._problem = problem

    def _numbers(self, message: Any, joint: str, place: int,
                 measured: int) -> tuple[float, ...] | None:
        """Return position and, if wanted, velocity of one joint; None if they are not there."""
        x: list[float] = []
        for kind, values in (('position', message.position),
                             ('velocity', message.velocity))[:measured]:
            hint = ': set driver.measured to 1 to have it observed' if x else ''
            if len(values) <= place:
                self._refuse(f'joint states without {kind}',
                             f'{self._topic} has no {kind} of {joint!r}{hint}')
                return None
            if not math.isfinite(values[place]):
                # The broadcaster publishes nan for an interface that the hardware does not export.
                self._refuse(f'joint states whose {kind} is not finite',
                             f'the {kind} of {joint!r} is {values[place]}'
                             f'{hint if math.isnan(values[place]) else ""}')
                return None
            x.append(float(values[place]))
        return tuple(x)

    def _age(self, stamp: tuple[int, int], arrived: float) -> float:
        """Return how old a joint state was when it arrived, by its header [s]; 0 = not known."""
        if self.node is None or stamp == (0, 0):
            return 0.0
        now = self.node.get_clock().now().nanoseconds
        age: float = (now - stamp[0] * 10 ** 9 - stamp[1]) * 1e-9 - (time.monotonic() - arrived)
        if -CLOCKS_AGREE <= age <= self.freshness.limit:
            return max(age, 0.0)
        self.counts[UNAGED] += 1
        return 0.0

    def velocity(self, place: int) -> float:
        """Return the velocity of a joint whose position alone is received, over some samples."""
        newest = self._samples[-1]
        since = newest.taken - BASELINE * self._period
        oldest = next(item for item in self._samples if item.taken >= since)
        passed = newest.taken - oldest.taken
        return ((newest.x[place][0] - oldest.x[place][0]) / passed if passed > CLOCKS_AGREE
                else 0.0)

    def mixed(self, now: float) -> bool:
        """Return whether two publishers sent states of the joints of late."""
        return self._sources.mixed(now)

    def mixed_text(self) -> str:
        """Return the publishers of the joints' state, as text."""
        names = ''
        if self.node is not None and self._subscription is not None:
            from dz_ros.nodes.ros.graph import publishers

            names = ', '.join(publishers(self.node, self._topic))
        joints = ', '.join(map(repr, self._joints))
        return (f'more than one publisher publishes joint{"s" if len(self._joints) > 1 else ""} '
                f'{joints} on {self._topic}{f" ({names})" if names else ""}: none is taken for '
                'the other')

    def _refuse(self, what: str, problem: str) -> None:
        self._refused.add(what)
        self._problem = problem

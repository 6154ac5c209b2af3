# SPDX-License-Identifier: Apache-2.0
"""The least there can be: processes that take and publish the loop's messages and compute nothing.

    python bare.py ROLE [options]

    ping      publishes `state` on absolute deadlines, waits for `command`; prints JSON
    pong      answers each `state` with a `command`
    plant, trajectory, controller
              publish what the nodes of these names publish, when they do, computing nothing
    stand_in  takes the place of controller_node among the nodes: answers as it must, v = 0
    ticks     an absolute-deadline loop without ROS; prints JSON

`--way` is how: `plain` is what the tutorials show (typed messages, a timer, `rclpy.spin`),
`events` and `wait` take and publish bytes by the executor of the nodes, or by a wait set on the
one subscription.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import json
from pathlib import Path
import signal
import struct
import sys
import time
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from dz_ros.core.records import Command, Reference, State, Terms, Truth  # noqa: E402
from dz_ros.recording.cdr import ArrayCodec  # noqa: E402
from dz_ros.runtime.process import end_with_parent, settle  # noqa: E402

LABELS = {'state': State.labels(2), 'command': Command.labels(), 'truth': Truth.labels(),
          'reference': Reference.labels(2), 'terms': Terms.labels(('theta1', 'theta2', 'phi'))}
PAYLOADS = {name: ArrayCodec(labels).encode([0.0] * len(labels))
            for name, labels in LABELS.items()}
ROLES: dict[str, tuple[tuple[str, ...], str, tuple[str, ...]]] = {
    'ping': (('command',), 'tick', ('state',)),
    'pong': (('state',), 'state', ('command',)),
    'plant': (('command',), 'tick', ('state', 'truth')),
    'trajectory': (('state',), 'state', ('reference',)),
    'controller': (('state', 'reference'), 'state', ('command', 'terms')),
    'stand_in': (('state', 'reference'), 'state', ('command', 'terms')),
}
"""Role → what it hears, what makes it speak, what it says."""
SETTLED = 1.0
"""Round trips of the first second are not counted [s]."""


class Bare:
    """One process of them.

    Args:
        arguments: Role and way.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        import rclpy
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from rclpy.signals import SignalHandlerOptions
        from std_msgs.msg import Float64MultiArray

        hears, self.speaks_on, says = ROLES[arguments.role]
        self.way, self.period = arguments.way, 1.0 / arguments.rate
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.stands_in = arguments.role == 'stand_in'
        self.node = rclpy.create_node('controller_node' if self.stands_in
                                      else f'bare_{arguments.role}')
        if self.way == 'plain':
            taken = given = QoSProfile(depth=10)
        else:
            taken = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            given = QoSProfile(depth=1000) if arguments.reliable else taken
        self.peers = arguments.peers
        self.executor: Any = None
        if self.way == 'events':
            from dz_ros.nodes.ros.base import quickest_executor
            self.executor = quickest_executor()
            self.executor.add_node(self.node)
        self.publishers = [self.node.create_publisher(Float64MultiArray, name, given)
                           for name in says]
        self.payloads: list[Any] = [PAYLOADS[name] for name in says]
        if self.way == 'plain':
            from rclpy.serialization import deserialize_message
            self.payloads = [deserialize_message(item, Float64MultiArray)
                             for item in self.payloads]
        self.round_trips: list[int] = []
        self.asked_ns = self.heard = 0
        self.subscriptions = [self.node.create_subscription(
            Float64MultiArray, name, self._callback(name), taken, raw=self.way != 'plain')
            for name in hears]

    def say(self) -> None:
        """Publish one of each."""
        for publisher, payload in zip(self.publishers, self.payloads, strict=True):
            publisher.publish(payload)

    def name_what_is_answered(self, state: bytes) -> None:
        """Write seq and stamp of a state into what is published next."""
        numbers = struct.unpack_from('<2d', state, len(state) - 8 * len(LABELS['state']))
        command, terms = (bytearray(item) for item in self.payloads)
        begin = len(command) - 8 * len(LABELS['command'])
        struct.pack_into('<5d', command, begin, *numbers, 0.0, *numbers)
        struct.pack_into('<2d', terms, len(terms) - 8 * len(LABELS['terms']), *numbers)
        self.payloads = [bytes(command), bytes(terms)]

    def _callback(self, name: str) -> Callable[[Any], None]:
        def answer(message: Any) -> None:
            if self.stands_in:
                self.name_what_is_answered(message)
            self.say()

        def note(_message: Any) -> None:
            if self.asked_ns:
                self.round_trips.append(time.monotonic_ns() - self.asked_ns)
                self.asked_ns = 0
            self.heard += 1

        return answer if name == self.speaks_on else note

    def tick(self) -> None:
        """Ask once."""
        self.asked_ns = time.monotonic_ns()
        self.say()

    def spin(self, seconds: float) -> None:
        """Serve one message, or wait."""
        if self.way == 'events':
            self.executor.spin_once(timeout_sec=seconds)
        else:
            self._wait(seconds)

    def _wait(self, seconds: float) -> None:
        from rclpy.impl.implementation_singleton import rclpy_implementation

        if not hasattr(self, 'wait_set'):
            self.wait_set = rclpy_implementation.WaitSet(len(self.subscriptions), 0, 0, 0, 0, 0,
                                                         self.node.context.handle)
        self.wait_set.clear_entities()
        for subscription in self.subscriptions:
            self.wait_set.add_subscription(subscription.handle)
        self.wait_set.wait(max(0, int(seconds * 1e9)))
        for index, subscription in enumerate(self.subscriptions):
            if self.wait_set.is_ready('subscription', index):
                found = subscription.handle.take_message(subscription.msg_type, True)
                if found is not None:
                    subscription.callback(found[0])

    def matched(self) -> bool:
        """Whether everybody is there."""
        return (all(item.get_subscription_count() >= self.peers for item in self.publishers)
                and all(self.node.count_publishers(item.topic_name)
                        for item in self.subscriptions))

    def drive(self, duration: float) -> None:
        """Ask at absolute deadlines once everybody is there."""
        while not self.matched():
            self.spin(0.02)
        self.spin(0.3)
        settle()
        start, index = time.monotonic() + SETTLED / 2, 0
        while not ENDED and index * self.period < duration:
            index += 1
            while not ENDED and (left := start + index * self.period - time.monotonic()) > 0.0:
                self.spin(min(left, 0.05))
            self.tick()
        self.spin(self.period)

    def drive_plainly(self, duration: float) -> None:
        """Do the same with a timer and `rclpy.spin_once`, as `rclpy.spin` does."""
        import rclpy

        while not self.matched():
            rclpy.spin_once(self.node, timeout_sec=0.02)
        executor = rclpy.get_global_executor()
        executor.add_node(self.node)
        self.node.create_timer(self.period, self.tick)
        end = time.monotonic() + duration
        while not ENDED and time.monotonic() < end:
            executor.spin_once()

    def answer(self) -> None:
        """Answer until told to end."""
        settle()
        while not ENDED:
            self.spin(0.05)

    def answer_plainly(self) -> None:
        """Answer by `rclpy.spin`."""
        import rclpy

        executor = rclpy.get_global_executor()
        executor.add_node(self.node)
        while not ENDED:
            executor.spin_once(timeout_sec=0.5)


ENDED: list[int] = []


def ticks(rate: float, duration: float) -> None:
    """Print when an absolute-deadline loop woke up: deviations of its periods [ns]."""
    settle()
    period = 1.0 / rate
    start = time.monotonic()
    woke = []
    for k in range(1, round(duration * rate) + 1):
        left = start + k * period - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        woke.append(time.monotonic_ns())
    print(json.dumps({'woke_ns': woke}))


def main() -> int:
    """Play one role."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('role', choices=(*ROLES, 'ticks'))
    parser.add_argument('--way', default='events', choices=('plain', 'events', 'wait'))
    parser.add_argument('--rate', type=float, default=200.0)
    parser.add_argument('--duration', type=float, default=5.0)
    parser.add_argument('--reliable', action='store_true', help='offer what the nodes offer')
    parser.add_argument('--peers', type=int, default=1, help='listeners to wait for')
    arguments = parser.parse_args()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _frame: ENDED.append(number))
    end_with_parent()
    if arguments.role == 'ticks':
        ticks(arguments.rate, arguments.duration)
        return 0
    import rclpy

    bare = Bare(arguments)
    plain = bare.way == 'plain'
    if bare.speaks_on == 'tick':
        (bare.drive_plainly if plain else bare.drive)(arguments.duration + SETTLED)
        print(json.dumps({'round_trips_ns': bare.round_trips[round(SETTLED * arguments.rate):],
                          'threads': sorted({item.read_text().strip() for item in
                                             Path('/proc/self/task').glob('*/comm')})}))
    else:
        (bare.answer_plainly if plain else bare.answer)()
    bare.node.destroy_node()
    rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())

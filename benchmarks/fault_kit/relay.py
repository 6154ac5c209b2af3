# SPDX-License-Identifier: Apache-2.0
"""A network between two halves of a loop that loses, delays, reorders and doubles messages.

    relay.py '{"loss": 0.05, "delay": 0.005, "jitter": 0.0, "duplicate": 0.0, "reorder": 0.0}'

`state` of the plant goes from plant_state to state, the controller's `command` from command to
plant_command. It hands on at once until SIGUSR1, does its worst until SIGUSR2. Seeded, so that a
run can be repeated as far as a real-time loop can.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import json
import random
import signal
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray


def main() -> None:
    """Relay until told to end."""
    faults: dict[str, float] = {}
    worst = json.loads(sys.argv[1])
    signal.signal(signal.SIGUSR1, lambda *_: faults.update(worst))
    signal.signal(signal.SIGUSR2, lambda *_: faults.clear())
    random.seed(1)
    rclpy.init()
    node = rclpy.create_node('relay')
    qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
    waiting: list[tuple[float, int, object, bytes]] = []
    number = itertools.count()

    def relay(source: str, goal: str) -> None:
        publisher = node.create_publisher(Float64MultiArray, goal, 100)

        def received(payload: bytes) -> None:
            if random.random() < faults.get('loss', 0.0):
                return
            for _ in range(2 if random.random() < faults.get('duplicate', 0.0) else 1):
                delay = faults.get('delay', 0.0) + random.uniform(0.0, faults.get('jitter', 0.0))
                if random.random() < faults.get('reorder', 0.0):
                    delay += 0.008
                heapq.heappush(waiting, (time.monotonic() + delay, next(number), publisher,
                                         payload))

        node.create_subscription(Float64MultiArray, source, received, qos, raw=True)

    relay('plant_state', 'state')
    relay('command', 'plant_command')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while rclpy.ok():
        remaining = waiting[0][0] - time.monotonic() if waiting else 0.05
        executor.spin_once(timeout_sec=min(max(remaining, 0.0), 0.05))
        while waiting and waiting[0][0] <= time.monotonic():
            _, _, publisher, payload = heapq.heappop(waiting)
            publisher.publish(payload)


if __name__ == '__main__':
    with contextlib.suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        main()

# SPDX-License-Identifier: Apache-2.0
"""plant_node or controller_node with a bare echo in the idle time of its own process.

    python interleaved.py plant_node|controller_node --ros-args …

Loop and echo have the same processes, cores, caches and neighbours, and take turns sample by
sample: late in each period, when the loop rests, the plant's process publishes the bytes of a
state, best effort, depth 1, and the controller's process publishes the bytes of a command as soon
as it has them. The plant's process prints the echo's round trips as JSON when it ends. Without
`process.poll`, which would take the idle time.
"""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import sys
import time
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.speed_kit.bare import PAYLOADS  # noqa: E402
from dz_ros.nodes.main import run_node  # noqa: E402

BEFORE = 0.25
"""Share of a period before the next sample at which the echo is asked: the trajectory works a
third of a period after a sample, the recorder in the middle."""
QUESTION, ANSWER = 'echo_state', 'echo_command'
ROUND_TRIPS: list[int] = []


class Asking:
    """Asks once in each period.

    Args:
        node: The plant's node.
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        self._before = BEFORE * node.configuration.loop.period
        self._spin_until: Callable[..., None] = node.spin_until
        self._asked_ns = 0
        self._publisher, self._subscription = endpoints(node, QUESTION, ANSWER, self._note)
        node.spin_until = self.spin_until

    def spin_until(self, deadline: float, done: Callable[[], bool] = lambda: False) -> None:
        """Serve callbacks as the node does; ask on the way to the deadline of a sample."""
        ask_at = deadline - self._before
        if self._node.clock.start_ns is not None and time.monotonic() < ask_at:
            self._spin_until(ask_at, done)
            if not (done() or self._node.halted):
                self._asked_ns = time.monotonic_ns()
                self._publisher.publish(PAYLOADS['state'])
        self._spin_until(deadline, done)

    def _note(self, _message: bytes) -> None:
        if self._asked_ns:
            ROUND_TRIPS.append(time.monotonic_ns() - self._asked_ns)
            self._asked_ns = 0


def endpoints(node: Any, published: str, subscribed: str,
              callback: Callable[[bytes], None]) -> tuple[Any, Any]:
    """Return publisher and subscription of one side of the echo."""
    from std_msgs.msg import Float64MultiArray

    from dz_ros.nodes.ros.topics import NEWEST

    return (node.create_publisher(Float64MultiArray, published, NEWEST),
            node.create_subscription(Float64MultiArray, subscribed, callback, NEWEST, raw=True))


def answering(node: Any) -> Any:
    """Let the controller's node answer."""
    publisher, _ = endpoints(node, ANSWER, QUESTION,
                             lambda _message: publisher.publish(PAYLOADS['command']))
    return node


def main() -> int:
    """Run the node."""
    name = sys.argv.pop(1)
    if name == 'plant_node':
        from dz_ros.nodes import plant_node

        make = plant_node.make_plant_node

        def asking() -> Any:
            node = make()
            Asking(node)
            return node

        plant_node.make_plant_node = asking
    else:
        from dz_ros.nodes import controller_node

        made: Any = controller_node.ControllerNode
        vars(controller_node)['ControllerNode'] = lambda: answering(made())
    code = run_node(name)
    if name == 'plant_node':
        print(json.dumps({'round_trips_ns': ROUND_TRIPS}))
    return code


if __name__ == '__main__':
    sys.exit(main())

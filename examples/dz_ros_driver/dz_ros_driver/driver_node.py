# SPDX-License-Identifier: Apache-2.0
"""The bench as a node that knows docs/topics.md of dz_ros and nothing else of it."""

import json
import math
import time

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from rclpy.qos import qos_profile_sensor_data as newest
from std_msgs.msg import Bool, Float64MultiArray, MultiArrayDimension, String
from std_srvs.srv import Trigger

from dz_ros_driver.bench import Bench

T, HOLD, SAFE = 0.005, 0.015, 0.0   # period [s], age of a stale command [s], safe command [N]
STATE = 'seq,stamp,x0,echo_seq,echo_stamp,round_trip'
COMMAND = 'seq,stamp,v,echo_seq,echo_stamp,hold'
EVERY = QoSProfile(history=HistoryPolicy.KEEP_ALL)
KEPT = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class DriverNode(Node):
    """Publishes `state` at 200 Hz, obeys `command` and `estop`, tells its mode on `events`."""

    def __init__(self):
        super().__init__('driver_node')
        self.bench, self.mode, self.echo = Bench(), 'waiting', (-1.0, 0.0)
        self.k = self.seq = self.start = self.fed = self.sent_at = self.trip = 0.0
        self.states = self.create_publisher(Float64MultiArray, 'state', 1000)
        self.events = self.create_publisher(String, 'events', KEPT)
        self.create_subscription(Float64MultiArray, 'command', self.on_command, newest)
        for qos in (newest, EVERY, KEPT):   # BEST_EFFORT publishers, bursts, earlier latched ones
            self.create_subscription(Bool, 'estop', self.on_estop, qos)
        self.create_service(Trigger, '~/reset', self.on_reset)
        self.create_timer(T, self.sample)

    def sample(self):
        """Publish a state; sample 0 again and again until the first command."""
        now = time.monotonic()
        if self.mode == 'running' and now - self.fed > HOLD:
            self.change('lost')
        if self.start:
            self.k, self.seq = max(round((now - self.start) / T), self.k + 1), self.seq + 1.0
        x, self.sent_at = self.bench.read(), time.monotonic()
        state = Float64MultiArray(data=[self.seq, self.k * T, x, *self.echo, self.trip])
        state.layout.dim = [MultiArrayDimension(label=STATE, size=6, stride=6)]
        self.states.publish(state)

    def on_command(self, message):
        """Let a good command act."""
        if [item.label for item in message.layout.dim] != [COMMAND] or len(message.data) != 6:
            return
        seq, stamp, v, answers = message.data[:4]
        stale = self.mode == 'running' and not 0.0 < seq - self.echo[0] <= 1000.0
        if (stale or seq < 0.0 or answers > self.seq or self.mode == 'estop'
                or not all(map(math.isfinite, message.data))):
            return
        self.fed, self.echo = time.monotonic(), (seq, stamp)
        self.start = self.start or self.fed
        self.trip = self.fed - self.sent_at + (self.seq - answers) * T
        if self.mode != 'running':
            self.change('running')
        self.bench.write(v)

    def change(self, mode):
        """Go to another mode, by way of the safe command."""
        self.mode = mode
        self.bench.write(SAFE)
        self.events.publish(String(data=json.dumps(
            {'node': self.get_fully_qualified_name(), 'event': 'mode', 'mode': mode})))

    def on_estop(self, message):
        """Stop until the reset; a `false` releases nothing: another publisher may still press."""
        if message.data and self.mode != 'estop':
            self.change('estop')

    def on_reset(self, _request, response):
        """Leave the stop."""
        response.success = True
        self.change('waiting')
        return response


def main():
    """Run until told to end, by SIGINT or SIGTERM; leave the device with the safe command."""
    rclpy.init()
    node = DriverNode()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception:
        if rclpy.ok():      # else the signal came in the middle of a callback
            raise
    node.bench.write(SAFE)


if __name__ == '__main__':
    main()

"""The bench as a node that knows docs/topics.md of dz_ros and nothing else of it."""

import contextlib
import json
import math
import signal
import time

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool, Float64MultiArray, MultiArrayDimension, String
from std_srvs.srv import Trigger

from dz_ros_driver.bench import Bench

T, HOLD, SAFE = 0.005, 0.015, 0.0   # period [s], age of a stale command [s], safe command [N]
STATE = 'seq,stamp,x0,echo_seq,echo_stamp,round_trip'
COMMAND = 'seq,stamp,v,echo_seq,echo_stamp,hold'
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
KEPT = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class DriverNode(Node):
    """Publishes `state` at 200 Hz, obeys `command` and `estop`, tells its mode on `events`."""

    def __init__(self):
        super().__init__('driver_node')
        self.bench, self.mode, self.pressed = Bench(), 'waiting', False
        self.start, self.fed, self.last, self.echo = None, None, -1, (-1.0, 0.0)
        self.k, self.seq, self.sent_at, self.trip = 0, 0, 0.0, 0.0
        self.states = self.create_publisher(Float64MultiArray, 'state', 1000)
        self.events = self.create_publisher(String, 'events', KEPT)
        self.create_subscription(Float64MultiArray, 'command', self.on_command, NEWEST)
        self.create_subscription(Bool, 'estop', self.on_estop, KEPT)
        self.create_service(Trigger, '~/reset', self.on_reset)
        self.create_timer(T, self.sample)

    def sample(self):
        """Publish a state; sample 0 again and again until the first command."""
        now = time.monotonic()
        if self.mode == 'running' and now - self.fed > HOLD:
            self.change('lost')
        if self.fed is not None:
            self.start = self.start or now - T
            if round((now - self.start) / T) <= self.k:     # a timer that catches up
                return
            self.k, self.seq = round((now - self.start) / T), self.seq + 1
        message = Float64MultiArray(data=[float(self.seq), self.k * T, self.bench.read(),
                                          *self.echo, self.trip])
        message.layout.dim = [MultiArrayDimension(label=STATE, size=6, stride=6)]
        self.sent_at = time.monotonic()
        self.states.publish(message)

    def on_command(self, message):
        """Let a good command act."""
        if [item.label for item in message.layout.dim] != [COMMAND] or len(message.data) != 6:
            return
        seq, stamp, v, answers = message.data[:4]
        if not all(map(math.isfinite, message.data)) or answers > self.seq or self.mode == 'estop':
            return
        if seq < 0 or (self.mode == 'running' and not self.last < seq <= self.last + 1000):
            return
        self.fed, self.last, self.echo = time.monotonic(), seq, (seq, stamp)
        if answers == self.seq:
            self.trip = self.fed - self.sent_at
        if self.mode != 'running':
            self.change('running')
        self.bench.write(v)

    def change(self, mode):
        """Go to another mode; the safe command acts in all but `running`."""
        self.mode = mode
        if mode != 'running':
            self.bench.write(SAFE)
        self.events.publish(String(data=json.dumps(
            {'node': self.get_fully_qualified_name(), 'event': 'mode', 'mode': mode})))

    def on_estop(self, message):
        """Stop while the button is pressed, and until the reset."""
        self.pressed = message.data
        if message.data:
            self.change('estop')

    def on_reset(self, _request, response):
        """Leave the stop."""
        response.success = not self.pressed
        response.message = 'the e-stop is still pressed' if self.pressed else 'reset'
        if not self.pressed:
            self.change('waiting')
        return response


def main():
    """Run until told to end, by SIGINT or SIGTERM; leave the device with the safe command."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node = DriverNode()
    with contextlib.suppress(KeyboardInterrupt):
        rclpy.spin(node)
    node.change('waiting')


if __name__ == '__main__':
    main()

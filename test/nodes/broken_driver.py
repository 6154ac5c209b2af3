# SPDX-License-Identifier: Apache-2.0
"""The example's driver node with one flaw, named on the command line; run by tests alone."""

from __future__ import annotations

import sys

from dz_ros_driver import driver_node
from dz_ros_driver.driver_node import DriverNode
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

FLAW = sys.argv[1]


class Broken(DriverNode):
    """Right but for the flaw."""

    def __init__(self) -> None:
        super().__init__()
        self.truths = self.create_publisher(Float64MultiArray, 'truth', 10)
        publish = self.states.publish

        def changed(message: Float64MultiArray) -> None:
            data = list(message.data)
            if FLAW == 'labels':
                message.layout.dim[0].label = 'seq,stamp,x0,x1,echo_seq,echo_stamp'
            elif FLAW == 'seq':
                data[0] = float(int(data[0]) // 2)
            elif FLAW == 'stamps':
                data[1] += 0.002 * (data[0] > 0.0)
            elif FLAW == 'echo':
                data[4] += 1e-3
            elif FLAW == 'latency':
                data[5] = 0.0
            elif FLAW == 'made-up latency':
                data[5] = 1e-5      # no controller answers so quickly
            elif FLAW == 'saturation':
                self.report(1000.0, data[1])
            message.data = data
            publish(message)

        self.states.publish = changed

    def report(self, v: float, stamp: float) -> None:
        """Publish the truth of an actuator that holds v."""
        message = Float64MultiArray(data=[0.0, stamp, v, 0.0, 0.0])
        message.layout.dim = [MultiArrayDimension(label='seq,stamp,w,d,disturbance', size=5,
                                                  stride=5)]
        self.truths.publish(message)

    def on_command(self, message: Float64MultiArray) -> None:
        """Take a command, or more than one should."""
        seq = message.data[0]
        if FLAW == 'bad messages' and len(message.data) == 6 and seq > self.echo[0]:
            self.echo = (seq, message.data[1])
            self.fed = driver_node.time.monotonic()
        if FLAW == 'restart' and seq <= self.echo[0]:
            return      # one that counts from 0 again is ignored for ever
        if FLAW == 'disconnect' and self.mode == 'lost':
            self.change('estop')    # latched, and no reset leads out
        super().on_command(message)

    def on_estop(self, message: object) -> None:
        """Receive the button, or not."""
        if FLAW != 'e-stop':
            super().on_estop(message)

    def on_reset(self, request: object, response: object) -> object:
        """Leave the stop, or not."""
        if FLAW in ('reset', 'disconnect'):
            response.success, response.message = False, 'not today'
            return response
        return super().on_reset(request, response)


if FLAW == 'stale':
    driver_node.HOLD = 1e9
if FLAW == 'rate':
    driver_node.T = 0.01
driver_node.DriverNode = Broken
driver_node.main()

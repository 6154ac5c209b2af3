"""The simulated plant behind its dead-zone as a node: the loop's clock.

Publishes `state` and `truth`, subscribes `command`. Sample 0 is published when all peers are
there; loop time starts when its command arrives, so the loop starts from x(0) for everybody. From
then on each sample is measured at its absolute deadline; a command acts from the instant at which
it arrives. The twin without ROS is ``drivers/simulated.py``.
"""

from __future__ import annotations

import time

from dz_ros.core.records import Command, State, Truth
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.nodes.base import LoopNode
from dz_ros.nodes.parameters import configure
from dz_ros.runtime.deadlines import Deadlines

REPEAT = 0.25
"""Sample 0 is published again after each of these until it is answered [s]."""


class PlantNode(LoopNode):
    """Simulated actuator and plant."""

    def __init__(self) -> None:
        super().__init__('plant_node')
        self.configuration = configure(self, 'loop', 'plant')
        order = self.configuration.plant.order
        self._actuator = SimulatedActuator(self.configuration)
        self._publish_state = self.offer('state', State.labels(order))
        self._publish_truth = self.offer('truth', Truth.labels())
        self._start_ns: int | None = None
        self._published_ns = 0
        self._seq = 0
        self._answer = Command(-1, 0.0, 0.0)
        self._round_trip = 0.0
        self.take('command', Command.labels(), self._on_command)
        self.announce('loop', 'plant')

    def run(self) -> None:
        """Run from sample 0 to the last one of the configured duration, or until told to end."""
        if not self.wait_for_peers(self._no_commander):
            return
        while self._start_ns is None and not self.stopping:
            self._publish()
            self.spin_until(time.monotonic() + REPEAT, self._answered)
        if self._start_ns is None:
            return
        loop = self.configuration.loop
        ticks = Deadlines(loop.period, self._start_ns)
        self.event('started', stamp=0.0)
        last = loop.samples or float('inf')
        while not self.stopping and ticks.index < last:
            self.spin_until(time.monotonic() + ticks.remaining())
            if self.stopping:
                break
            stamp = ticks.begin() * loop.period
            self._publish_truth(self._actuator.advance(stamp, self._seq).numbers())
            self._seq += 1
            self._publish()
        self.spin_until(time.monotonic() + 1.0, self._answered)
        self._publish_truth(self._actuator.advance(self._actuator.t, self._seq).numbers())
        self.event('finished', seq=self._seq, late=ticks.late, skipped=ticks.skipped)
        self.get_logger().info(f'{self._seq + 1} samples, {ticks.late} late by more than 1 ms, '
                               f'{ticks.skipped} skipped')

    def _publish(self) -> None:
        """Measure and publish the state of the present sample."""
        state = State(self._seq, self._actuator.t, self._actuator.measure(), self._answer.seq,
                      self._answer.stamp, self._round_trip)
        self._published_ns = time.monotonic_ns()
        self._publish_state(state.numbers())

    def _on_command(self, numbers: tuple[float, ...]) -> None:
        """Let a command act from now on; the first one starts the clock."""
        now = time.monotonic_ns()
        command = Command.from_numbers(numbers)
        if command.echo_seq > self._seq:
            return
        if self._start_ns is None:
            self._start_ns = now
        if command.echo_seq == self._seq:
            self._round_trip = (now - self._published_ns) * 1e-9
        self._answer = command
        self._actuator.command(command.v, (now - self._start_ns) * 1e-9)

    def _answered(self) -> bool:
        """Whether the present sample has its command."""
        return self._answer.echo_seq == self._seq

    def _no_commander(self) -> list[str]:
        """Say so if nobody publishes commands."""
        return [] if self.count_publishers('command') else ['a publisher of command']

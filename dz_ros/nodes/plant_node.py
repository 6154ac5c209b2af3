"""The simulated plant behind its dead-zone as a node: the loop's clock.

Publishes `state` and `truth`, subscribes `command`. Sample 0 is published when all peers are
there; loop time starts when its command arrives, so the loop starts from x(0) for everybody.

- realtime: each further sample is measured at its absolute deadline; a command acts from the
  instant at which it arrives.
- lockstep: sample k + 1 follows when the command for sample k has arrived, stamp = k T, and that
  command acts from k T on: no wall clock in any number. `/clock` is published.

The twin without ROS is ``drivers/simulated.py``.
"""

from __future__ import annotations

import time

from rosgraph_msgs.msg import Clock

from dz_ros.core.records import Command, State, Truth
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.errors import LoopError
from dz_ros.nodes.base import LoopNode
from dz_ros.nodes.parameters import configure
from dz_ros.runtime.deadlines import Deadlines

REPEAT = 0.25
"""A state that waits for its command is published again after each of these [s]."""
GONE = 10.0
"""In lockstep, a command that does not come within this means that its sender is gone [s]."""


class PlantNode(LoopNode):
    """Simulated actuator and plant."""

    def __init__(self) -> None:
        super().__init__('plant_node')
        self.configuration = configure(self, 'loop', 'plant')
        order = self.configuration.plant.order
        self._period = self.configuration.loop.period
        self._actuator = SimulatedActuator(self.configuration)
        self._publish_state = self.offer('state', State.labels(order))
        self._publish_truth = self.offer('truth', Truth.labels())
        self._start_ns: int | None = None
        self._published_ns = 0
        self._seq = 0
        self._measured: tuple[float, ...] = ()
        self._measured_seq = -1
        self._answer = Command(-1, 0.0, 0.0)
        self._round_trip = 0.0
        self.take('command', Command.labels(),
                  self._on_command_in_lockstep if self.lockstep else self._on_command)
        self.announce('loop', 'plant')

    def run(self) -> None:
        """Run from sample 0 to the last one of the configured duration, or until told to end.

        Raises:
            LoopError: In lockstep, a command did not come.
        """
        if not self.wait_for_peers(self._no_commander):
            return
        while self._answer.echo_seq < 0 and not self.stopping:
            self._publish()
            self.spin_until(time.monotonic() + REPEAT, self._answered)
        if self._answer.echo_seq < 0:
            return
        self.event('started', stamp=0.0)
        last = self.configuration.loop.samples or float('inf')
        if self.lockstep:
            self._run_lockstep(last)
        else:
            self._run_realtime(last)

    def _run_realtime(self, last: float) -> None:
        """Measure at absolute deadlines from the first command on."""
        assert self._start_ns is not None
        ticks = Deadlines(self._period, self._start_ns)
        while not self.stopping and ticks.index < last:
            self.spin_until(time.monotonic() + ticks.remaining())
            if self.stopping:
                break
            self._next(ticks.begin() * self._period)
        self.spin_until(time.monotonic() + 1.0, self._answered)
        self._finish(late=ticks.late, skipped=ticks.skipped)
        self.get_logger().info(f'{self._seq + 1} samples, {ticks.late} late by more than 1 ms, '
                               f'{ticks.skipped} skipped')

    def _run_lockstep(self, last: float) -> None:
        """Measure when the command for the sample before has arrived."""
        clock = self.create_publisher(Clock, '/clock', 10)
        started = time.monotonic()
        while not self.stopping:
            asked = time.monotonic()
            while not (self._answered() or self.stopping):
                self.spin_until(time.monotonic() + REPEAT, self._answered)
                if self._answered():
                    break
                if time.monotonic() - asked > GONE:
                    raise LoopError(f'no command for sample {self._seq} within {GONE:g} s: the '
                                    'controller is gone, or waits for a trajectory that is')
                self._publish()
            if self.stopping or self._seq >= last:
                break
            message = Clock()
            stamp_ns = round((self._seq + 1) * self._period * 1e9)
            message.clock.sec, message.clock.nanosec = divmod(stamp_ns, 1_000_000_000)
            clock.publish(message)
            self._next((self._seq + 1) * self._period)
        self._finish()
        elapsed = time.monotonic() - started
        self.get_logger().info(f'{self._seq + 1} samples in lockstep, {self._seq / elapsed:.0f} '
                               'per second')

    def _next(self, stamp: float) -> None:
        """Advance the plant to a stamp and publish it."""
        self._publish_truth(self._actuator.advance(stamp, self._seq).numbers())
        self._seq += 1
        self._publish()

    def _finish(self, **details: int) -> None:
        """Publish what is left of the last sample."""
        self._publish_truth(self._actuator.advance(self._actuator.t, self._seq).numbers())
        self.event('finished', seq=self._seq, **details)

    def _publish(self) -> None:
        """Measure and publish the state of the present sample."""
        if self._measured_seq != self._seq:
            self._measured = self._actuator.measure()
            self._measured_seq = self._seq
        state = State(self._seq, self._actuator.t, self._measured, self._answer.seq,
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

    def _on_command_in_lockstep(self, numbers: tuple[float, ...]) -> None:
        """Let the command for the present sample act from its stamp on; ignore any other."""
        command = Command.from_numbers(numbers)
        if command.echo_seq == self._seq and not self._answered():
            self._answer = command
            self._actuator.command(command.v, self._actuator.t)

    def _answered(self) -> bool:
        """Whether the present sample has its command."""
        return self._answer.echo_seq == self._seq

    def _no_commander(self) -> list[str]:
        """Say so if nobody publishes commands."""
        return [] if self.count_publishers('command') else ['a publisher of command']

"""The actuator's end of the loop as a node, whatever the driver: the loop's clock.

Sample 0 is published when all peers are there; loop time starts when its command arrives.

- realtime: each further sample is measured at its absolute deadline; a command acts from the
  instant at which it arrives.
- lockstep (simulated ones): sample k + 1 follows when the command for sample k has arrived,
  stamp = k T, and that command acts from k T on: no wall clock in any number. `/clock` is
  published.

What is done at each of these instants: ``hosting.py``.
"""

from __future__ import annotations

import time

from rosgraph_msgs.msg import Clock

from dz_ros.errors import LoopError
from dz_ros.nodes.base import PATIENCE
from dz_ros.nodes.hosting import Hosting
from dz_ros.nodes.topics import PACE
from dz_ros.recording.cdr import encode_clock
from dz_ros.runtime.deadlines import Deadlines

REPEAT = 0.25
"""A state that waits for its command is published again after each of these [s]."""
SHOW = 50
"""In lockstep every sample of so many is also published on `pace`, for the trajectory."""
GONE = 10.0
"""In lockstep, a command that does not come within this means that its sender is gone [s]."""


class ActuatorHost(Hosting):
    """Hosts a driver and keeps the loop's time."""

    def set_up(self) -> None:
        """Offer states, listen to commands; in lockstep also say where the loop is."""
        super().set_up()
        if self.lockstep:
            self._publish_pace = self.offer('pace', PACE)

    def work(self) -> bool:
        """Run to the last sample of the configured duration, or while active.

        Raises:
            LoopError: In lockstep, a command did not come.
        """
        if not self.wait_for_peers(self._no_commander):
            return False
        said = time.monotonic()
        while not (self._answered() or self.halted):
            if self._publish():
                self._show()
                self.spin_until(time.monotonic() + REPEAT, self._answered)
            else:
                self.spin_until(time.monotonic() + self._period)
                if time.monotonic() - said > PATIENCE:
                    self.get_logger().info('waiting for a measurement of the device')
                    said = time.monotonic()
            self._ask(self._now())
            self.diagnosing.look()
        if self.halted:
            return False
        self.event('started', stamp=self._t)
        last = self.configuration.loop.samples or float('inf')
        return self._run_lockstep(last) if self.lockstep else self._run_realtime(last)

    def _run_realtime(self, last: float) -> bool:
        """Measure at absolute deadlines from the first command on."""
        assert self._start_ns is not None
        ticks = Deadlines(self._period, self._start_ns)
        ticks.index = round(self._t / self._period)
        while not self.halted and ticks.index < last:
            self.spin_until(time.monotonic() + ticks.remaining())
            if self.halted:
                break
            stamp = ticks.begin() * self._period
            self._look(stamp)
            self._next(stamp)
            self._skipped = ticks.skipped
            self._pace.sample(time.monotonic(), stamp)
            self.diagnosing.look()
        if ticks.index >= last:
            self.spin_until(time.monotonic() + 1.0, self._answered)
        if not (ticks.index >= last or self.stopping):
            return False
        self._finish(late=ticks.late, skipped=ticks.skipped)
        self.get_logger().info(f'{self._seq + 1} samples, {ticks.late} late by more than 1 ms, '
                               f'{ticks.skipped} skipped')
        return True

    def _run_lockstep(self, last: float) -> bool:
        """Measure when the command for the sample before has arrived."""
        clock = self.create_publisher(Clock, '/clock', 10)
        started = time.monotonic()
        while not self.halted:
            asked = time.monotonic()
            while not (self._answered() or self._measured is None or self.halted):
                self.spin_until(time.monotonic() + REPEAT, self._answered)
                if self._answered():
                    break
                if time.monotonic() - asked > GONE:
                    raise LoopError(f'no command for sample {self._seq} within {GONE:g} s: the '
                                    'controller is gone, or waits for a trajectory that is')
                self._publish()
                self._show()
            if self.halted or self._seq >= last:
                break
            self._next((self._seq + 1) * self._period)
            if self._seq % SHOW == 0:
                self._show()
            clock.publish(encode_clock(round(self._seq * self._period * 1e9)))
            self.diagnosing.look()
        self.destroy_publisher(clock)
        if not (self._seq >= last or self.stopping):
            return False
        self._finish()
        elapsed = time.monotonic() - started
        self.get_logger().info(f'{self._seq + 1} samples in lockstep, {self._seq / elapsed:.0f} '
                               'per second')
        return True

    def _show(self) -> None:
        """In lockstep, say where the loop is to whoever sends ahead."""
        if self.lockstep:
            self._publish_pace((self._seq, self._t))

    def _finish(self, **details: int) -> None:
        """Publish what is left of the last sample."""
        self._tell(self._end_sample(self._t))
        self._finished = True
        if not self.lockstep:
            self.event('latency', hop='round trip', **self._latency.summary())
        self.event('finished', ends=['state'], seq=self._seq,
                   ignored=self._guard.guard.rejected(), **details)

    def _no_commander(self) -> list[str]:
        """Say so if nobody publishes commands."""
        return [] if self.count_publishers('command') else ['a publisher of command']

# SPDX-License-Identifier: Apache-2.0
"""Clocks of the loop, one of which an actuator's node has: when its samples are due.

Loop time stands still until the command for the first sample arrives.

- realtime: each further sample is due at its absolute deadline; a command acts from the instant
  at which it arrives.
- lockstep (simulated devices): sample k + 1 is due when the command for sample k has arrived,
  stamp = k T, and that command acts from k T on: no wall clock in any number. `/clock` is
  published.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
import time
from typing import Any

from rosgraph_msgs.msg import Clock

from dz_ros.core.lateness import LATE_COUNT
from dz_ros.core.loop.latency import Latency
from dz_ros.core.safety.actuator_guard import ActuatorGuard
from dz_ros.core.safety.health import Pace, Report
from dz_ros.errors import LoopError
from dz_ros.nodes.ros.topics import PACE
from dz_ros.recording.cdr import encode_clock
from dz_ros.runtime.deadlines import Deadlines
from dz_ros.runtime.expected_arrival import ExpectedArrival

STATE_REPEAT_PERIOD = 0.25
"""A state that waits for its command is published again after each of these [s]."""
LAST_STRETCH = (3e-4, 0.06)
"""Time before a deadline, and share of a period, in which `process.poll` sleeps outside the
executor, which takes longer to wake up; nothing is served meanwhile [s]."""
REMEMBERED_STATES = 64
"""States whose instant is remembered, so that a late answer is measured as what it is."""
PACE_SAMPLES = 50
"""In lockstep every sample of this number is also published on `pace`, for the trajectory."""
COMMAND_TIMEOUT = 10.0
"""In lockstep, a command that does not come within this means that its sender is gone [s]."""


class LoopClock(ABC):
    """Calls its node at each sample.

    Args:
        node: An `ActuatorNode`.
        guard: Its guard.

    Attributes:
        round_trip: From publishing a state to the arrival of its command, the newest [s].
        latency: Round trips so far.
        start_ns: In real time, zero of loop time by the steady clock; None = it stands still [ns].
    """

    def __init__(self, node: Any, guard: ActuatorGuard) -> None:
        self._node = node
        self._guard = guard
        self._period: float = node.configuration.loop.period
        self._pace = Pace(self._period)
        self._skipped = 0
        self.start_ns: int | None = None
        self.round_trip = 0.0
        self.latency = Latency(self._period)

    def report(self, report: Report) -> None:
        """Add rate and latency; they are judged where they are the wall's."""
        judged = isinstance(self, RealTimeClock)
        self._pace.report(report, judged)
        self.latency.report(report, 'round trip', judged)
        report.put('periods skipped', self._skipped, 'd')

    def set_up(self) -> None:  # noqa: B027
        """Publish what this clock publishes."""

    def stop(self) -> None:  # noqa: B027
        """Let loop time stand still until the next command."""

    def published(self, seq: int) -> None:  # noqa: B027
        """Note that the state of a sample is being published."""

    def show(self) -> None:  # noqa: B027
        """Publish where the loop is, for a trajectory that sends ahead."""

    @abstractmethod
    def now(self) -> float:
        """Return loop time now [s]."""

    @abstractmethod
    def command(self, numbers: tuple[float, ...]) -> None:
        """Take a message of the topic `command`."""

    @abstractmethod
    def run(self, last: float) -> bool:
        """Run from the first command to a last sample, or while active; return True at its end."""


class RealTimeClock(LoopClock):
    """Samples at absolute deadlines of the steady clock."""

    def __init__(self, node: Any, guard: ActuatorGuard) -> None:
        super().__init__(node, guard)
        self._published_ns = [0] * REMEMBERED_STATES
        self._expected = (ExpectedArrival(self._period) if node.polls('plant', 'both')
                          else None)
        self._last_stretch = min(LAST_STRETCH[0], LAST_STRETCH[1] * self._period)

    def stop(self) -> None:
        """Let loop time stand still until the next command."""
        self.start_ns = None

    def published(self, seq: int) -> None:
        """Note that the state of a sample is being published."""
        self._published_ns[seq % REMEMBERED_STATES] = time.monotonic_ns()

    def now(self) -> float:
        """Return loop time now [s]."""
        t: float = self._node.t
        if self.start_ns is None:
            return t
        return max(t, (time.monotonic_ns() - self.start_ns) * 1e-9)

    def command(self, numbers: tuple[float, ...]) -> None:
        """Let a command act from now on; the first one starts the clock."""
        now_ns = time.monotonic_ns()
        node, guard = self._node, self._guard
        now, before = self.now(), guard.newest_command
        if self.start_ns is not None:
            node.check_deadlines(now)
        v = guard.command(numbers, node.seq, now)
        if guard.newest_command is before:
            return
        assert guard.newest_command is not None
        answered = guard.newest_command.echo_seq
        if node.seq - REMEMBERED_STATES < answered <= node.seq:
            self.round_trip = (now_ns - self._published_ns[answered % REMEMBERED_STATES]) * 1e-9
            self.latency.add(self.round_trip)
            if self._expected is not None:
                self._expected.add(self.round_trip)
        if answered == node.seq:
            node.answered_seq = answered
            if self.start_ns is None:
                self.start_ns = now_ns - round(node.t * 1e9)
        if v is not None:
            node.drive(v, now)

    def run(self, last: float) -> bool:
        """Run from the first command to a last sample, or while active; return True at its end."""
        assert self.start_ns is not None
        node, ticks = self._node, Deadlines(self._period, self.start_ns)
        ticks.index = round(node.t / self._period)
        while not node.halted and ticks.index < last:
            self._await_answer(ticks)
            # Not before the answer: it would take a core from the controller.
            node.publish_truth()
            node.diagnostics.publish_if_due()
            if self._expected is not None:
                self._sleep_to_the_end(ticks)
            node.spin_until(time.monotonic() + ticks.remaining())
            if node.halted:
                break
            stamp = ticks.begin() * self._period
            node.check_deadlines(stamp)
            node.next_sample(stamp)
            self._skipped = ticks.skipped
            self._pace.sample(time.monotonic(), stamp)
        node.publish_truth()
        if ticks.index >= last:
            node.spin_until(time.monotonic() + 1.0, node.answered)
        if not (ticks.index >= last or node.stopping):
            return False
        node.finish(late=ticks.late, skipped=ticks.skipped)
        node.get_logger().info(f'{node.seq + 1} samples, {ticks.late} {LATE_COUNT}, '
                               f'{ticks.skipped} skipped')
        return True

    def _await_answer(self, ticks: Deadlines) -> None:
        """Wait for the command, for half a period at most; poll for it when it is due."""
        node, last, expected = self._node, time.monotonic() + ticks.remaining(), self._expected
        half = last - 0.5 * self._period
        if expected is not None:
            last -= self._last_stretch
            asked = self._published_ns[node.seq % REMEMBERED_STATES] * 1e-9
            node.spin_until(min(asked + expected.begin, last), node.answered)
            node.poll_until(min(asked + expected.end, last), node.answered)
        node.spin_until(min(last, half), node.answered)

    def _sleep_to_the_end(self, ticks: Deadlines) -> None:
        """Serve callbacks until shortly before the next deadline, then sleep outside of them."""
        node = self._node
        node.spin_until(time.monotonic() + ticks.remaining() - self._last_stretch)
        if not node.halted and (left := ticks.remaining()) > 0.0:
            time.sleep(min(left, self._last_stretch))


class LockstepClock(LoopClock):
    """Each sample when the command for the one before has arrived."""

    def set_up(self) -> None:
        """Publish what this clock publishes."""
        self._publish_pace = self._node.offer('pace', PACE)

    def show(self) -> None:
        """Publish where the loop is, for a trajectory that sends ahead."""
        self._publish_pace((self._node.seq, self._node.t))

    def now(self) -> float:
        """Return loop time now [s]."""
        t: float = self._node.t
        return t

    def command(self, numbers: tuple[float, ...]) -> None:
        """Let the command for the present sample act from its stamp on; ignore any other."""
        node, guard = self._node, self._guard
        if numbers[3] != node.seq or node.answered():
            return
        before = guard.newest_command
        guard.command(numbers, node.seq, node.t)
        if guard.newest_command is not before:
            node.answered_seq = node.seq
            node.drive(guard.output, node.t)

    def run(self, last: float) -> bool:
        """Run from the first command to a last sample, or while active; return True at its end.

        Raises:
            LoopError: A command did not come.
        """
        node = self._node
        clock = node.create_publisher(Clock, '/clock', 10)
        started = time.monotonic()
        while not node.halted:
            self._wait_for_command()
            if node.halted or node.seq >= last:
                break
            node.next_sample((node.seq + 1) * self._period)
            node.publish_truth()
            if node.seq % PACE_SAMPLES == 0:
                self.show()
            clock.publish(encode_clock(round(node.seq * self._period * 1e9)))
            node.diagnostics.publish_if_due()
        node.destroy_publisher(clock)
        if not (node.seq >= last or node.stopping):
            return False
        node.finish()
        elapsed = time.monotonic() - started
        node.get_logger().info(f'{node.seq + 1} samples in lockstep, {node.seq / elapsed:.0f} '
                               'per second')
        return True

    def _wait_for_command(self) -> None:
        node, asked = self._node, time.monotonic()
        while not (node.answered() or node.measured is None or node.halted):
            node.spin_until(time.monotonic() + STATE_REPEAT_PERIOD, node.answered)
            if node.answered():
                return
            if time.monotonic() - asked > COMMAND_TIMEOUT:
                raise LoopError(f'no command for sample {node.seq} within {COMMAND_TIMEOUT:g} s: '
                                'the controller is gone, or waits for a trajectory that is')
            node.publish()
            self.show()

"""The simulated plant behind its dead-zone as a node: the loop's clock.

Publishes `state` and `truth`, subscribes `command`. Sample 0 is published when all peers are
there; loop time starts when its command arrives, so the loop starts from x(0) for everybody.

- realtime: each further sample is measured at its absolute deadline; a command acts from the
  instant at which it arrives.
- lockstep: sample k + 1 follows when the command for sample k has arrived, stamp = k T, and that
  command acts from k T on: no wall clock in any number. `/clock` is published.

A command that stays away, is bad, or comes while the e-stop is pressed does not act
(``core/safety/actuator_guard.py``); the safe command then acts from the very instant at which the
hold ended, also if this process slept through it. The twin without ROS is
``drivers/simulated.py``.
"""

from __future__ import annotations

import time

from rosgraph_msgs.msg import Clock

from dz_ros.core.records import Command, State, Truth
from dz_ros.core.safety.actuator_guard import ActuatorGuard
from dz_ros.core.safety.health import Pace, percentiles, Rejections, Report, say_state
from dz_ros.core.safety.supervisor import Supervisor
from dz_ros.errors import LoopError
from dz_ros.nodes.guarded import GuardedNode
from dz_ros.runtime.deadlines import Deadlines

REPEAT = 0.25
"""A state that waits for its command is published again after each of these [s]."""
GONE = 10.0
"""In lockstep, a command that does not come within this means that its sender is gone [s]."""


class PlantNode(GuardedNode):
    """Simulated actuator and plant."""

    partner = 'command'

    def __init__(self) -> None:
        super().__init__('plant_node', 'loop', 'plant', 'safety')
        self._period = self.configuration.loop.period
        self._actuator = self.configuration.make_driver()
        self._guard = ActuatorGuard(self.configuration.safety, self._period, not self.lockstep,
                                    self.changed)
        self._start_ns: int | None = None
        self._published_ns = 0
        self._seq = 0
        self._measured: tuple[float, ...] = ()
        self._measured_seq = -1
        self._answered_seq = -1
        self._round_trip = 0.0
        self._finished = False
        self._pace = Pace(self._period)
        self._rejections = Rejections()
        self._round_trips: list[float] = []
        self._skipped = 0
        self.watch_parameters()

    @property
    def supervisor(self) -> Supervisor:
        """Life and mode."""
        return self._guard.supervisor

    def report(self) -> Report:
        """Return how the actuator's end has been since the last report."""
        report = Report()
        say_state(report, self.supervisor)
        self._pace.report(report, not self.lockstep)
        percentiles(self._round_trips, report, 'round trip')
        self._round_trips.clear()
        report.put('periods skipped', self._skipped, 'd')
        report.put('command in force', self._guard.output)
        report.put('held back by a limit', self._guard.gate.limited, 'd')
        report.put('commands lost', self._guard.guard.skipped, 'd')
        self._rejections.report(report, {f'command: {reason}': count for reason, count
                                         in self._guard.guard.rejected().items()})
        return report

    def set_up(self) -> None:
        """Offer states, listen to commands."""
        order = self.configuration.plant.order
        self._publish_state = self.offer('state', State.labels(order))
        self._publish_truth = self.offer('truth', Truth.labels())
        self.take('command', Command.labels(),
                  self._on_command_in_lockstep if self.lockstep else self._on_command)
        self.announce('loop', 'plant', seq=self._seq)

    def change_life(self, name: str) -> None:
        """Give the actuator the safe command, whatever the transition."""
        was_active = self.supervisor.life.value == 'active'
        now = self._now()
        self._actuator.command(self._guard.transition(name, now), now)
        self._start_ns = None
        self._answered_seq = -1
        if was_active and not self._finished:
            self.event('stopped', ends=['state'], seq=self._seq)

    def work(self) -> bool:
        """Run to the last sample of the configured duration, or while active.

        Raises:
            LoopError: In lockstep, a command did not come.
        """
        if not self.wait_for_peers(self._no_commander):
            return False
        while not (self._answered() or self.halted):
            self._publish()
            self.spin_until(time.monotonic() + REPEAT, self._answered)
            self.diagnosing.look()
        if self.halted:
            return False
        self.event('started', stamp=self._actuator.t)
        last = self.configuration.loop.samples or float('inf')
        return self._run_lockstep(last) if self.lockstep else self._run_realtime(last)

    def reconfigure(self) -> None:
        """Use other limits, another dead-zone, another plant from now on."""
        self._guard.configure(self.configuration.safety)
        self._actuator.configure(self.configuration)
        self.announce('loop', 'plant', seq=self._seq)

    def stop_now(self, pressed: bool, reason: str) -> None:
        """Hear the e-stop."""
        now = self._now()
        v = self._guard.estop(now, pressed, reason)
        if v is not None:
            self._actuator.command(v, now)

    def partner_ended(self) -> None:
        """Hear that the controller stops in order."""
        now = self._now()
        self._actuator.command(self._guard.end(now), now)

    def reset(self) -> str:
        """Leave a latched mode; return why not."""
        return self._guard.reset(self._now())

    def _now(self) -> float:
        """Return loop time now [s]; it stands still until the clock starts, and in lockstep."""
        if self._start_ns is None:
            return self._actuator.t
        return max(self._actuator.t, (time.monotonic_ns() - self._start_ns) * 1e-9)

    def _run_realtime(self, last: float) -> bool:
        """Measure at absolute deadlines from the first command on."""
        assert self._start_ns is not None
        ticks = Deadlines(self._period, self._start_ns)
        ticks.index = round(self._actuator.t / self._period)
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
            while not (self._answered() or self.halted):
                self.spin_until(time.monotonic() + REPEAT, self._answered)
                if self._answered():
                    break
                if time.monotonic() - asked > GONE:
                    raise LoopError(f'no command for sample {self._seq} within {GONE:g} s: the '
                                    'controller is gone, or waits for a trajectory that is')
                self._publish()
            if self.halted or self._seq >= last:
                break
            message = Clock()
            stamp_ns = round((self._seq + 1) * self._period * 1e9)
            message.clock.sec, message.clock.nanosec = divmod(stamp_ns, 1_000_000_000)
            clock.publish(message)
            self._next((self._seq + 1) * self._period)
            self.diagnosing.look()
        self.destroy_publisher(clock)
        if not (self._seq >= last or self.stopping):
            return False
        self._finish()
        elapsed = time.monotonic() - started
        self.get_logger().info(f'{self._seq + 1} samples in lockstep, {self._seq / elapsed:.0f} '
                               'per second')
        return True

    def _look(self, t: float) -> None:
        """Look at the clock: let the safe command act from when it was due."""
        senders = self.count_publishers('command') if self._guard.guard.rivalry(t) else 1
        found = self._guard.poll(t, senders)
        if found is not None:
            self._actuator.command(*found)

    def _next(self, stamp: float) -> None:
        """Advance the plant to a stamp and publish it."""
        self._publish_truth(self._actuator.advance(stamp, self._seq).numbers())
        self._seq += 1
        self._publish()

    def _finish(self, **details: int) -> None:
        """Publish what is left of the last sample."""
        self._publish_truth(self._actuator.advance(self._actuator.t, self._seq).numbers())
        self._finished = True
        self.event('finished', ends=['state'], seq=self._seq,
                   ignored=self._guard.guard.rejected(), **details)

    def _publish(self) -> None:
        """Measure and publish the state of the present sample."""
        if self._measured_seq != self._seq:
            self._measured = self._actuator.measure()
            self._measured_seq = self._seq
        echo = self._guard.taken or Command(-1, 0.0, 0.0)
        state = State(self._seq, self._actuator.t, self._measured, echo.seq, echo.stamp,
                      self._round_trip)
        self._published_ns = time.monotonic_ns()
        self._publish_state(state.numbers())

    def _on_command(self, numbers: tuple[float, ...]) -> None:
        """Let a command act from now on; the first one starts the clock."""
        now_ns = time.monotonic_ns()
        now, heard = self._now(), self._guard.heard
        if self._start_ns is not None:
            self._look(now)
        v = self._guard.command(numbers, self._seq, now)
        if self._guard.heard is heard:
            return
        assert self._guard.heard is not None
        if self._guard.heard.echo_seq == self._seq:
            self._answered_seq = self._seq
            self._round_trip = (now_ns - self._published_ns) * 1e-9
            self._round_trips.append(self._round_trip)
            if self._start_ns is None:
                self._start_ns = now_ns - round(self._actuator.t * 1e9)
        if v is not None:
            self._actuator.command(v, now)

    def _on_command_in_lockstep(self, numbers: tuple[float, ...]) -> None:
        """Let the command for the present sample act from its stamp on; ignore any other."""
        if numbers[3] != self._seq or self._answered():
            return
        heard = self._guard.heard
        self._guard.command(numbers, self._seq, self._actuator.t)
        if self._guard.heard is not heard:
            self._answered_seq = self._seq
            self._actuator.command(self._guard.output, self._actuator.t)

    def _answered(self) -> bool:
        """Whether the present sample has its command."""
        return self._answered_seq == self._seq

    def _no_commander(self) -> list[str]:
        """Say so if nobody publishes commands."""
        return [] if self.count_publishers('command') else ['a publisher of command']

"""A driver between the loop's topics: what is done at each message, sample and transition.

Publishes `state`, and `truth` where the actuator is simulated; subscribes `command`. When samples
are due: ``clockwork.py``. A command that stays away, is bad, or comes while the e-stop is pressed
does not act (``core/safety/actuator_guard.py``); the safe command then acts from the very instant
at which the hold ended, also if this process slept through it. A driver in trouble is a fault. The
twin without ROS, which holds the driver, is ``drivers/hosted.py``.
"""

from __future__ import annotations

import math
import time
from typing import Any

from dz_ros.core import schema
from dz_ros.core.finding import INFO
from dz_ros.core.latency import Latency
from dz_ros.core.observation import check_observer
from dz_ros.core.records import Command, Reference, State, Truth
from dz_ros.core.safety.actuator_guard import ActuatorGuard
from dz_ros.core.safety.health import Pace, Rejections, Report, say_state
from dz_ros.core.safety.supervisor import Supervisor
from dz_ros.drivers.hosted import HostedDriver
from dz_ros.nodes.guarded import GuardedNode

REMEMBERED = 64
"""So many states are remembered, so that a late answer is measured as what it is."""


class Hosting(GuardedNode):
    """Hosts a driver.

    Args:
        name: Default node name.
        *sections: Sections of the configuration that the node declares as parameters.
    """

    partner = 'command'

    def __init__(self, name: str, *sections: str) -> None:
        super().__init__(name, *sections)
        self._period = self.configuration.loop.period
        self._hosted = HostedDriver(self.configuration)
        self._simulated = self._hosted.driver.lockstep
        self._owns = ['loop', 'plant', *(name for name in ('driver',) if name in sections)]
        self._guard = ActuatorGuard(self.configuration.safety, self._period, not self.lockstep,
                                    self.changed)
        self._start_ns: int | None = None
        self._t = 0.0
        self._published_ns = [0] * REMEMBERED
        self._seq = 0
        self._measured: tuple[float, ...] | None = None
        self._measured_seq = -1
        self._answered_seq = -1
        self._round_trip = 0.0
        self._finished = False
        self._pace = Pace(self._period)
        self._rejections = Rejections()
        self._latency = Latency(self._period)
        self._skipped = 0
        self._check_observer()
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
        self._latency.report(report, 'round trip', not self.lockstep)
        report.put('periods skipped', self._skipped, 'd')
        report.put('command in force', self._guard.output)
        report.put('held back by a limit', self._guard.gate.limited, 'd')
        report.put('commands lost', self._guard.guard.skipped, 'd')
        self._rejections.report(report, {f'command: {reason}': count for reason, count
                                         in self._guard.guard.rejected().items()})
        self._hosted.report(report)
        return report

    def stated(self) -> dict[str, Any]:
        """Return the dotted keys; of a real actuator nobody knows the dead-zone or x(0)."""
        flat = super().stated()
        if self._simulated:
            return flat
        model = {'model', *(item.name for item in schema.fields(
            type(self.configuration.plant.parameters)))}
        return {key: value for key, value in flat.items()
                if not key.startswith('plant.') or key.partition('.')[2] in model}

    def set_up(self) -> None:
        """Offer states, listen to commands."""
        order = self.configuration.plant.order
        self._publish_state = self.offer('state', State.labels(order))
        if self._simulated:
            self._publish_truth = self.offer('truth', Truth.labels())
        self.take('command', Command.labels(),
                  self._on_command_in_lockstep if self.lockstep else self._on_command)
        if self._hosted.observing:
            self.take('reference', Reference.labels(order), self._on_reference)
        self.announce(*self._owns, seq=self._seq)

    def change_life(self, name: str) -> None:
        """Open, enable, disable, close the driver; it has the safe command whenever enabled.

        Raises:
            DriverError: It cannot be opened or refuses to be enabled.
        """
        was_active = self.supervisor.life.value == 'active'
        now = self._now()
        if name == 'configure':
            self._hosted.open(self)
        elif name == 'activate':
            self._hosted.enable()
        v = self._guard.transition(name, now)
        if name == 'activate':
            self._hosted.safe(v, now)
        if name in ('deactivate', 'shutdown'):
            self._complain(self._hosted.disable(v, now))
        if name in ('cleanup', 'shutdown'):
            self._complain(self._hosted.close())
        self._start_ns = None
        self._answered_seq = -1
        if was_active and not self._finished:
            self.event('stopped', ends=['state'], seq=self._seq)

    def reconfigure(self) -> None:
        """Use other limits, another dead-zone, other parameters of the driver from now on."""
        self._guard.configure(self.configuration.safety)
        self._hosted.configure(self.configuration)
        self._check_observer()
        self.announce(*self._owns, seq=self._seq)

    def stop_now(self, pressed: bool, reason: str) -> None:
        """Hear the e-stop."""
        now = self._now()
        v = self._guard.estop(now, pressed, reason)
        if v is not None:
            self._hosted.safe(v, now)

    def close(self) -> None:
        """Stop in order, let go of the device whatever happened, release everything."""
        try:
            super().close()
        finally:
            self._hosted.disable(self.configuration.safety.safe_command, self._now())
            self._hosted.close()

    def partner_ended(self) -> None:
        """Hear that the controller stops in order."""
        now = self._now()
        self._hosted.safe(self._guard.end(now), now)

    def reset(self) -> str:
        """Leave a latched mode, the device its trouble; return why not."""
        now = self._now()
        heard = not self._hosted.trouble()
        if not heard and self.supervisor.life.value == 'inactive' and not self.supervisor.latched:
            return self._hosted.recover()       # the device's own latch, which refuses power
        refused = self._guard.held_by(now, heard)
        if not refused:
            refused = self._hosted.recover() or self._guard.reset(now, heard)
            if not self.supervisor.running:
                self._hosted.safe(self._guard.output, now)      # whatever it did to recover
        return refused

    def _now(self) -> float:
        """Return loop time now [s]; it stands still until the clock starts, and in lockstep."""
        if self._start_ns is None:
            return self._t
        return max(self._t, (time.monotonic_ns() - self._start_ns) * 1e-9)

    def _look(self, t: float) -> None:
        """Look at the clock: let the safe command act from when it was due."""
        senders = self.count_publishers('command') if self._guard.guard.rivalry(t) else 1
        found = self._guard.poll(t, senders)
        if found is not None:
            self._hosted.safe(*found)

    def _ask(self, t: float) -> None:
        """Ask the driver how the device is: its trouble is a fault."""
        trouble = self._hosted.trouble()
        if trouble and not self.supervisor.latched:
            self._hosted.safe(self._guard.fault(trouble, t), t)

    def _next(self, stamp: float) -> None:
        """End the sample at a stamp; publish the next one first, as somebody waits for it."""
        truth = self._end_sample(stamp)
        self._seq += 1
        self._publish()
        self._tell(truth)
        self._ask(stamp)

    def _end_sample(self, stamp: float) -> Truth | None:
        """Advance to a stamp; return what a simulated device knows of the sample it leaves."""
        truth = self._hosted.advance(stamp, self._seq)
        self._t = stamp
        return truth

    def _tell(self, truth: Truth | None) -> None:
        """Publish what a simulated device knows."""
        if truth is not None and self._simulated:
            self._publish_truth(truth.numbers())

    def _publish(self) -> bool:
        """Measure and publish the state of the present sample; return False if there is none.

        A simulated device stands still until it is advanced; any other is measured each time.
        """
        if self._measured_seq != self._seq or not self._simulated:
            self._measured = self._hosted.measure(self._t)
            self._measured_seq = self._seq
        if self._measured is None:
            return False
        echo = self._guard.taken or Command(-1, 0.0, 0.0)
        state = State(self._seq, self._t, self._measured, echo.seq, echo.stamp, self._round_trip)
        self._published_ns[self._seq % REMEMBERED] = time.monotonic_ns()
        self._publish_state(state.numbers())
        return True

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
        answered = self._guard.heard.echo_seq
        if self._seq - REMEMBERED < answered <= self._seq:
            self._round_trip = (now_ns - self._published_ns[answered % REMEMBERED]) * 1e-9
            self._latency.add(self._round_trip)
        if answered == self._seq:
            self._answered_seq = answered
            if self._start_ns is None:
                self._start_ns = now_ns - round(self._t * 1e9)
        if v is not None:
            self._drive(v, now)

    def _on_command_in_lockstep(self, numbers: tuple[float, ...]) -> None:
        """Let the command for the present sample act from its stamp on; ignore any other."""
        if numbers[3] != self._seq or self._answered():
            return
        heard = self._guard.heard
        self._guard.command(numbers, self._seq, self._t)
        if self._guard.heard is not heard:
            self._answered_seq = self._seq
            self._drive(self._guard.output, self._t)

    def _drive(self, v: float, t: float) -> None:
        """Give the device what the guard lets out: the law's command, or the safe one."""
        if self.supervisor.running:
            self._hosted.command(v, t)
        else:
            self._hosted.safe(v, t)

    def _on_reference(self, numbers: tuple[float, ...]) -> None:
        """Hear where the reference goes, for the observer."""
        if all(map(math.isfinite, numbers)):
            self._hosted.reference(Reference.from_numbers(numbers))

    def _check_observer(self) -> None:
        """Log what the design rule says of an observed velocity, where it warns."""
        for finding in check_observer(self.configuration, self._hosted.measured):
            if finding.level != INFO:
                self.get_logger().warning(f'design rule {finding.rule}: {finding.words}; '
                                          f'{finding.change}')

    def _complain(self, trouble: str) -> None:
        """Say what went wrong in letting go of the device."""
        if trouble:
            self.get_logger().error(f'{self._hosted.driver.name}: {trouble}')

    def _answered(self) -> bool:
        """Whether the present sample has its command."""
        return self._answered_seq == self._seq

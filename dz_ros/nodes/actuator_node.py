# SPDX-License-Identifier: Apache-2.0
"""An actuator as a node: a driver between the loop's topics, whatever the driver.

Publishes `state`, and `truth` where the actuator is simulated; subscribes `command`. Sample 0 is
published when all peers are there; for the others, ``parts/loop_clock.py``. A command that stays
away, is bad, or comes while the e-stop is pressed does not act; the safe one then acts from the
instant at which the hold ended (``core/safety/actuator_guard.py``). ``drivers/hosted.py`` holds
the driver. Of the plant's section the node has all where the actuator is simulated, else the model
and its parameters.

Over 300 lines: one node, from its parameters to its end.
"""

from __future__ import annotations

import time
from typing import Any

from dz_ros.core import schema
from dz_ros.core.axes import Rows, rows_maker
from dz_ros.core.axes_keys import parts, section_of
from dz_ros.core.design.finding import INFO
from dz_ros.core.design.observation import check_observer, measured_steps
from dz_ros.core.plants.base import Plant
from dz_ros.core.records import Command, Reference, State, Truth
from dz_ros.core.safety.actuator_guard import ActuatorGuard
from dz_ros.core.safety.health import Rejections, Report, summarize_state
from dz_ros.core.safety.message_guards import ReferenceGuard
from dz_ros.core.safety.supervisor import Supervisor
from dz_ros.drivers.hosted_axes import host
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.nodes.parts.loop_clock import LockstepClock, RealTimeClock, STATE_REPEAT_PERIOD
from dz_ros.nodes.parts.unmeasured import Unmeasured
from dz_ros.nodes.ros.base import PEER_WAIT_LOG_PERIOD
from dz_ros.nodes.ros.graph import publisher_count
from dz_ros.nodes.ros.lifecycle import ManagedNode
from dz_ros.nodes.ros.stop_and_reset import EndSafety


class ActuatorNode(ManagedNode):
    """The actuator's end of the loop.

    Args:
        name: Default node name.
        *sections: Sections of the configuration that the node declares as parameters.

    Attributes:
        clock: The one by which samples are due.
        seq: The present sample.
        t: Its stamp, loop time [s].
        answered_seq: Newest sample whose command has arrived.
        measured: The present measurement, shape (n,), of several axes a row for each; None = there
            is none.
    """

    def __init__(self, name: str = 'actuator_node', *sections: str) -> None:
        sections = sections or ('loop', 'device', 'safety', 'driver')
        super().__init__(name, *sections)
        c = self.configuration
        self.seq, self.t, self.answered_seq = 0, 0.0, -1
        self._hosted = host(c)
        self._simulated = self._hosted.driver.lockstep
        self._owns = ('loop', 'plant', *(item for item in ('driver',) if item in sections))
        self._safety = EndSafety(self, 'command')
        self._guard = ActuatorGuard(self._limits(), c.loop.period, not self.lockstep,
                                    self._safety.changed, c.axis_names, self._plants())
        self._references = ReferenceGuard(c.loop.period, c.axis_names)
        self._reference_of = rows_maker(Reference.from_numbers, len(c.each))
        self._held: Any = (0.0,) * len(c.axes) if self._several else 0.0
        self.clock = (LockstepClock if self.lockstep else RealTimeClock)(self, self._guard)
        self.measured: tuple[Any, ...] | None = None
        self._measured_seq = -1
        self._truth: Any = None
        self._finished = False
        self._rejections = Rejections()
        self._unmeasured = Unmeasured()
        self._check_observer()
        self.watch_parameters()

    @property
    def supervisor(self) -> Supervisor:
        """Lifecycle state and mode."""
        return self._guard.supervisor

    def report(self) -> Report:
        """Return how the actuator's end has been since the last report."""
        report = Report()
        summarize_state(report, self.supervisor)
        self.clock.report(report)
        if self._several:
            for name, v in zip(self.configuration.axis_names, self._guard.output, strict=True):
                report.put(f'{name}: applied command', v)
        else:
            report.put('applied command', self._guard.output)
        report.put('held back by a limit', self._guard.limiter.limited, 'd')
        report.put('commands lost', self._guard.guard.skipped, 'd')
        self._rejections.report(report, self.ignored({
            'command': self._guard.guard.rejected(), 'reference': self._references.rejected(),
            'device': self._hosted.refused()}))
        self._hosted.report(report)
        if self._simulated:
            self.report_schedule(report)
        return report

    def stated(self, *sections: str) -> dict[str, Any]:
        """Return the dotted keys; of a real actuator neither dead-zone nor x(0) is known."""
        flat = super().stated(*sections)
        if self._simulated:
            return flat
        model = {'model', *(item.name for c in self.configuration.each
                            for item in schema.fields(type(c.plant.parameters)))}
        return {key: value for key, value in flat.items()
                if section_of(key) != 'plant' or parts(key)[1].partition('.')[2] in model}

    # Lifecycle.

    def set_up(self) -> None:
        """Publish states, subscribe commands."""
        order = self.configuration.plant.order
        self._publish_state = self.offer('state', State.labels(order))
        if self._simulated:
            self._publish_truth = self.offer('truth', Truth.labels())
        self.subscribe('command', Command.labels(), self.clock.command)
        if self._hosted.observing:
            self.subscribe('reference', Reference.labels(order), self._on_reference)
        if self._simulated:
            self.follow_schedule(self._follow)
        self.announce(*self._owns, seq=self.seq)
        self.clock.set_up()

    def on_transition(self, name: str) -> None:
        """Open, enable, disable, close the driver; it has the safe command whenever enabled.

        Raises:
            DriverError: It cannot be opened or refuses to be enabled.
        """
        was_active = self.supervisor.lifecycle_state.value == 'active'
        now = self.clock.now()
        if name == 'configure':
            self._hosted.open(self)
        elif name == 'activate':
            self._hosted.enable()
        v = self._guard.transition(name, now)
        if name == 'activate':
            self._hosted.safe(v, now)
        if name in ('deactivate', 'shutdown'):
            self._log_fault(self._hosted.disable(v, now))
        if name in ('cleanup', 'shutdown'):
            self._log_fault(self._hosted.close())
        self.clock.stop()
        self.answered_seq = -1
        self._publish_unmeasured()
        if was_active and not self._finished:
            self.event('stopped', ends=['state'], seq=self.seq)

    def reconfigure(self) -> None:
        """Use other limits, another dead-zone, other parameters of the driver from now on."""
        self._guard.configure(self._limits(), self._plants())
        self._hosted.configure(self.configuration)
        self._check_observer()
        self.announce(*self._owns, seq=self.seq)

    def close(self) -> None:
        """Stop in order, release the device whatever happened, and everything else."""
        try:
            super().close()
        finally:
            self._hosted.disable(tuple(item.safe_command for item in self._limits())
                                 if self._several else self.configuration.safety.safe_command,
                                 self.clock.now())
            self._hosted.close()

    # Safety.

    def on_estop(self, pressed: bool, reason: str) -> None:
        """Follow the e-stop."""
        now = self.clock.now()
        v = self._guard.estop(now, pressed, reason)
        if v is not None:
            self._hosted.safe(v, now)

    def on_partner_end(self) -> None:
        """Take the safe command: the controller stops in order."""
        now = self.clock.now()
        self._hosted.safe(self._guard.end(now), now)

    def reset(self) -> str:
        """Leave a latched mode, the device its fault; return why not."""
        now = self.clock.now()
        sound = not self._hosted.fault()
        inactive = self.supervisor.lifecycle_state.value == 'inactive'
        if not sound and inactive and not self.supervisor.latched:
            return str(self._hosted.recover())  # the device's own latch, which refuses power
        refused = self._guard.held_by(now, sound)
        if not refused:
            refused = self._hosted.recover() or self._guard.reset(now, sound)
            if not self.supervisor.running:
                self._hosted.safe(self._guard.output, now)      # whatever it did to recover
        return refused

    def check_deadlines(self, t: float) -> None:
        """Let the safe command act from when it was due, at loop time t [s]."""
        senders = publisher_count(self, 'command') if self._guard.guard.rivalry(t) else 1
        found = self._guard.poll(t, senders)
        if found is not None:
            self._hosted.safe(*found)

    def _check_device(self, t: float) -> None:
        fault = self._hosted.fault()
        if fault and not self.supervisor.latched:
            self._hosted.safe(self._guard.fault(fault, t), t)

    # Samples.

    def work(self) -> bool:
        """Run to the last sample of the configured duration, or while active.

        Raises:
            LoopError: In lockstep, a command did not come.
        """
        if not self.wait_for_peers(self._no_commander):
            return False
        logged = time.monotonic()
        while not (self.answered() or self.halted):
            if self.publish():
                self.clock.show()
                self.spin_until(time.monotonic() + STATE_REPEAT_PERIOD, self.answered)
            else:
                self.spin_until(time.monotonic() + self.configuration.loop.period)
                if time.monotonic() - logged > PEER_WAIT_LOG_PERIOD:
                    self.get_logger().info('waiting for a measurement of the device')
                    logged = time.monotonic()
            self._check_device(self.clock.now())
            self.diagnostics.publish_if_due()
        if self.halted:
            return False
        self.event('started', stamp=self.t)
        return self.clock.run(self.configuration.loop.samples or float('inf'))

    def answered(self) -> bool:
        """Return whether the present sample has its command."""
        return self.answered_seq == self.seq

    def next_sample(self, stamp: float) -> None:
        """End the sample at a stamp; publish the next one, which the controller awaits.

        What a simulated device knows of the sample before is for `publish_truth`.
        """
        self._truth = self._end_sample(stamp)
        self.seq += 1
        if not self.publish():
            self._unmeasured.missed(self.seq, self._hosted.absence())
        elif self._unmeasured.due(self.seq, stamp):
            self._publish_unmeasured()
        self._check_device(stamp)

    def publish_truth(self) -> None:
        """Publish what a simulated device knows of the sample that has ended, once."""
        truth, self._truth = self._truth, None
        if truth is not None and self.offering:
            self._publish_truth(truth.numbers())

    def publish(self) -> bool:
        """Measure and publish the state of the present sample; return False if there is none.

        A simulated device stands still until it is advanced; any other is measured each time.
        """
        if self._measured_seq != self.seq or not self._simulated:
            again = self._measured_seq == self.seq
            self.measured = self._hosted.measure(self.t)
            self._measured_seq = self.seq
            if self.measured is not None and not again:
                self._check_runaway(self.measured)
        if self.measured is None:
            return False
        echo = self._guard.taken or Command(-1, 0.0, 0.0)
        details = echo.seq, echo.stamp, self.clock.round_trip
        state = (Rows(State(self.seq, self.t, x, *details) for x in self.measured)
                 if self._several else State(self.seq, self.t, self.measured, *details))
        self.clock.published(self.seq)
        self._publish_state(state.numbers())
        return True

    def _check_runaway(self, x: tuple[Any, ...]) -> None:
        v = self._guard.measured(x, self._held, self.t)
        if v is not None:
            self._hosted.safe(v, self.t)

    def drive(self, v: Any, t: float) -> None:
        """Give the device what the guard applies: the law's command, or the safe one."""
        if self.supervisor.running:
            self._held = self._hosted.command(v, t)
        else:
            self._hosted.safe(v, t)

    def finish(self, **details: int) -> None:
        """Publish what is left of the last sample."""
        self._truth = self._end_sample(self.t)
        self.publish_truth()
        self._publish_unmeasured()
        self._finished = True
        if not self.lockstep:
            self.event('latency', hop='round trip', **self.clock.latency.summary())
        self.event('finished', ends=['state'], seq=self.seq,
                   ignored=self._guard.guard.rejected(), **details)

    @property
    def _several(self) -> bool:
        """Whether records are rows, of several axes."""
        return len(self.configuration.axes) > 1

    def _limits(self) -> Any:
        """Return the limits, of several axes a row for each."""
        c = self.configuration
        return [item.safety for item in c.each] if self._several else c.safety

    def _plants(self) -> list[Plant]:
        """Return the model of each axis."""
        return [item.plant for item in self.configuration.each]

    def _end_sample(self, stamp: float) -> Any:
        """Advance to a stamp; return what a simulated device knows of the sample it leaves."""
        truth = self._hosted.advance(stamp, self.seq)
        self.t = stamp
        return truth if self._simulated else None

    def _publish_unmeasured(self) -> None:
        if self._unmeasured:
            self.event('unmeasured', **self._unmeasured.details(self.t))

    def _on_reference(self, numbers: tuple[float, ...]) -> None:
        if self._references.takes(numbers, self.clock.now(), self.t,
                                  self.lockstep or not self.supervisor.running):
            self._hosted.reference(self._reference_of(numbers))

    def _follow(self, psi: float) -> None:
        """Let the simulated dead-zone follow a scheduling variable."""
        for _, hosted in self._hosted if self._several else (('', self._hosted),):
            if isinstance(hosted.driver, SimulatedActuator):
                hosted.driver.follow(psi)

    def _check_observer(self) -> None:
        """Log the design rule of an observed velocity, where it warns."""
        hosts = self._hosted if self._several else (('', self._hosted),)
        for (name, hosted), c in zip(hosts, self.configuration.each, strict=True):
            for finding in check_observer(c, hosted.measured,
                                          measured_steps(hosted.driver)):
                if finding.level != INFO:
                    self.get_logger().warning(
                        (f'axis {name}: ' if name else '') + f'design rule {finding.rule}: '
                        f'{finding.words}; {finding.change}')

    def _log_fault(self, fault: str) -> None:
        if fault:
            self.get_logger().error(f'{self._hosted.driver.name}: {fault}')

    def _no_commander(self) -> list[str]:
        return [] if publisher_count(self, 'command') else [
            f'a publisher of {self.resolve_topic_name("command")}']

# SPDX-License-Identifier: Apache-2.0
"""The controller as a node: answers each state at once with a command.

Publishes `command` and `terms`, subscribes `reference` and, once all peers that subscribe its
commands are there, `state`. The ROS-free implementations are ``core/loop/controller.py`` and
``core/safety/controller_guard.py``.
"""

from __future__ import annotations

import time
from typing import Any

from dz_ros.core.axes import joined_numbers, Rows
from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.latency import Latency
from dz_ros.core.records import Command, Reference, State, Terms
from dz_ros.core.safety.controller_guard import Answer, ControllerGuard
from dz_ros.core.safety.health import LawHealth, Pace, Rejections, Report, summarize_state
from dz_ros.core.safety.modes import Mode
from dz_ros.core.safety.supervisor import Supervisor
from dz_ros.errors import LoopError
from dz_ros.nodes.parts.progress_lines import Progress
from dz_ros.nodes.parts.start_checks import DesignLog
from dz_ros.nodes.ros.base import SPIN_LIMIT
from dz_ros.nodes.ros.graph import publisher_count
from dz_ros.nodes.ros.lifecycle import ManagedNode
from dz_ros.nodes.ros.stop_and_reset import EndSafety
from dz_ros.runtime.expected_arrival import ExpectedArrival

REFERENCE_TIMEOUT = 5.0
"""In lockstep, a reference that does not come within this means that its sender is gone [s]."""


class ControllerNode(ManagedNode):
    """Adaptive controller, or any other law."""

    def __init__(self) -> None:
        super().__init__('controller_node', 'loop', 'structure', 'controller', 'safety')
        self._design = DesignLog(self)
        self._design.judge(self.configuration)
        self._safety = EndSafety(self, 'state')
        self._guard = ControllerGuard(self.configuration, self._safety.changed, self._announce)
        self._order = self.configuration.plant.order
        self._pace = Pace(self.configuration.loop.period)
        self._healths = [(name, LawHealth(item)) for name, item in self.configuration.axes or (
            ('', self.configuration),)]
        self._rejections = Rejections()
        self._holds = Latency(self.configuration.loop.period)
        self._waiting: tuple[Any, int] | None = None
        self._announced: tuple[int, tuple[float, ...]] | None = None
        self._expected = (ExpectedArrival(self.configuration.loop.period) if self.polls('both')
                          else None)
        self._arrived = 0.0
        rate = self.given('progress_rate', 0.0, 'lines of progress a second on standard output, '
                          'as JSON, for the program that started this node; 0 = none [Hz]')
        self._progress = Progress(self.configuration, rate, self._pace) if rate > 0.0 else None
        self.watch_parameters()

    @property
    def supervisor(self) -> Supervisor:
        """Lifecycle state and mode."""
        return self._guard.supervisor

    def report(self) -> Report:
        """Return how the controller has been since the last report."""
        report = Report()
        summarize_state(report, self.supervisor)
        self._pace.report(report, not self.lockstep)
        self._holds.report(report, 'state to command', not self.lockstep)
        for name, health in self._healths:
            if len(self._healths) == 1:
                health.report(report)
            else:
                report.add(health.report, name)
        report.put('commands', self._guard.controller.count, 'd')
        report.put('held back by a limit', self._guard.controller.limiter.limited, 'd')
        report.put('states lost', self._guard.state_guard.skipped, 'd')
        self.report_schedule(report)
        self._rejections.report(report, self.ignored({
            'state': self._guard.state_guard.rejected(),
            'reference': self._guard.reference_guard.rejected()}))
        return report

    def set_up(self) -> None:
        """Publish commands, subscribe references; states only when all peers are there."""
        self._publish_command = self.offer('command', Command.labels())
        self._publish_terms = self.offer(
            'terms', Terms.labels(self.configuration.law.signal_names))
        self.subscribe('reference', Reference.labels(self._order), self._on_reference)
        self.follow_schedule(self._guard.controller.follow)
        self._design.log()      # not before: where a topic is claimed, that error is all
        self._subscribed_state = False
        self._announce(self._guard.controller.count, self._guard.controller.memory)

    def on_transition(self, name: str) -> None:
        """Send the safe command several times where commands were sent so far."""
        was_active = self.supervisor.lifecycle_state.value == 'active'
        self._waiting = None
        for answer in self._guard.transition(name):
            self._send(answer)
        if was_active:
            if not self.lockstep:
                self.event('latency', hop='state to command', **self._holds.summary())
            self.event('finished' if name == 'shutdown' else 'stopped', ends=['command'],
                       ignored=self._guard.state_guard.rejected(),
                       ignored_references=self._guard.reference_guard.rejected())

    def work(self) -> bool:
        """Answer states while active.

        Raises:
            LoopError: In lockstep, a reference did not come.
        """
        if not self.wait_for_peers():
            return False
        if not self._subscribed_state:
            self._subscribed_state = True
            self.subscribe('state', State.labels(self._order), self._on_state)
        period, checked = self.configuration.loop.period, 0.0
        while not self.halted:
            watching = self.supervisor.mode in (Mode.RUNNING, Mode.LOST) and not self.lockstep
            if watching and self._expected is not None:
                self._await_state(self._expected, period)
            else:
                self.spin(period if watching else SPIN_LIMIT)
            now = time.monotonic()
            if watching and now - checked >= period:
                checked = now
                self._check_deadlines(now)
            self.diagnostics.publish_if_due()
            if self.lockstep and self._waiting is not None:
                state, taken_ns = self._waiting
                if time.monotonic_ns() - taken_ns > REFERENCE_TIMEOUT * 1e9:
                    raise LoopError(f'no reference for sample {state.seq} within '
                                    f'{REFERENCE_TIMEOUT:g} s: the trajectory is gone')
        return False

    def _await_state(self, expected: ExpectedArrival, limit: float) -> None:
        """Serve a callback; poll for the next state while it is due."""
        arrived = self._arrived
        until = arrived + expected.begin - time.monotonic()
        if until > 0.0:
            self.spin(min(limit, until))
        elif time.monotonic() < arrived + expected.end:
            self.poll_until(arrived + expected.end, lambda: self._arrived != arrived)
        else:
            self.spin(limit)

    def check_configuration(self, configuration: Configuration) -> None:
        """Apply the design rules; those that simulate only while the loop waits to start.

        Raises:
            ConfigurationError: They find an error.
        """
        self._design.judge(configuration, self.supervisor.mode is Mode.WAITING)

    def reconfigure(self) -> None:
        """Use other gains and limits from the next sample on, and announce them."""
        self._design.log()
        self._guard.configure(self.configuration)
        for (_, health), item in zip(self._healths, self.configuration.each, strict=True):
            health.configure(item)
        self._announced = None
        self._announce(self._guard.controller.count, self._guard.controller.memory)

    def on_estop(self, pressed: bool, reason: str) -> None:
        """Follow the e-stop."""
        self._send(self._guard.estop(pressed, reason))

    def on_partner_end(self) -> None:
        """Expect no more states: the plant stops in order."""
        self._guard.end()

    def reset(self) -> str:
        """Leave a latched mode; return why not."""
        return self._guard.reset(time.monotonic())

    def _announce(self, seq: int, memory: Any) -> None:
        """Publish configuration and memory of command `seq`: a run is recomputed from there."""
        memory = joined_numbers(memory)
        if self._announced != (seq, memory):
            self._announced = (seq, memory)
            self.announce('controller', 'safety', seq=seq, memory=memory)

    def _on_reference(self, numbers: tuple[float, ...]) -> None:
        self._guard.reference(numbers, time.monotonic())
        if self._waiting is not None and self._guard.ready(self._waiting[0]):
            state, taken_ns = self._waiting
            self._waiting = None
            self._answer(state, taken_ns)

    def _on_state(self, numbers: tuple[float, ...]) -> None:
        taken_ns = time.monotonic_ns()
        if self._expected is not None:
            now = taken_ns * 1e-9
            self._expected.add(now - self._arrived)
            self._arrived = now
        state = self._guard.take(numbers, taken_ns * 1e-9)
        if state is None:
            return
        if self._guard.ready(state):
            self._answer(state, taken_ns)
        elif self._waiting is None or self._waiting[0].seq != state.seq:
            self._waiting = (state, taken_ns)       # since it came first

    def _answer(self, state: Any, taken_ns: int) -> None:
        answer = self._guard.answer(state, taken_ns * 1e-9)
        self._send_command(answer, taken_ns)
        if answer is None:
            return
        self._take_note(state, answer, taken_ns)
        self._send_terms(answer)

    def _take_note(self, state: Any, answer: Answer, taken_ns: int) -> None:
        """Count a sample for diagnostics and progress."""
        command, terms = answer
        self._pace.sample(taken_ns * 1e-9, state.stamp)
        if len(self._healths) > 1:
            self._note_axes(state, command, terms, taken_ns)
            return
        self._healths[0][1].sample(command.v, terms, self._guard.controller.error)
        if self._progress is not None:
            self._progress.sample(state, terms, self._guard.controller.error, command.v, taken_ns)

    def _note_axes(self, state: Rows, command: Rows, terms: Rows, taken_ns: int) -> None:
        """Take note of a sample of several axes; progress shows the one with the largest error."""
        errors = [item.error for item in self._guard.controller]
        for (_, health), v, row, error in zip(self._healths, command.v, terms, errors,
                                              strict=True):
            health.sample(v, row, error)
        if self._progress is not None:
            worst = max(range(len(errors)), key=lambda place: abs(errors[place]))
            self._progress.sample(state[worst], terms[worst], errors[worst], command.v[worst],
                                  taken_ns, self._healths[worst][0])

    def _check_deadlines(self, now: float) -> None:
        senders = 1
        for topic, guard in (('state', self._guard.state_guard),
                             ('reference', self._guard.reference_guard)):
            if guard.rivalry(now):
                senders = max(senders, publisher_count(self, topic))
        self._send(self._guard.poll(now, senders))

    def _send(self, answer: Answer | None) -> None:
        """Publish a command, which has passed the limiter, and its terms."""
        self._send_command(answer)
        self._send_terms(answer)

    def _send_command(self, answer: Answer | None, taken_ns: int = 0) -> None:
        """Publish a command; its terms are for later: the actuator needs the core."""
        if answer is None or not self.offering:
            return
        command, _ = answer
        hold = 0.0 if self.lockstep or not taken_ns else (
            time.monotonic_ns() - taken_ns) * 1e-9
        if len(self._healths) == 1:
            numbers = [*command.numbers()[:-1], hold]
        else:
            numbers = []
            for row in command:
                numbers += row.numbers()
                numbers[-1] = hold
        self._publish_command(numbers)
        if hold:
            self._holds.add(hold)

    def _send_terms(self, answer: Answer | None) -> None:
        """Publish the terms of a command."""
        if answer is not None and self.offering:
            self._publish_terms(answer[1].numbers())

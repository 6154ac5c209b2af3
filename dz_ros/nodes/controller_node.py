"""The controller as a node: answers each state at once with a command.

Publishes `command` and `terms`, subscribes `reference` and, once everybody who listens to its
commands is there, `state`. The twins without ROS are ``core/controller.py`` and
``core/safety/controller_guard.py``.
"""

from __future__ import annotations

import time

from rcl_interfaces.msg import ParameterDescriptor

from dz_ros.core.configuration import Configuration
from dz_ros.core.latency import Latency
from dz_ros.core.records import Command, Reference, State, Terms
from dz_ros.core.safety.controller_guard import Answer, ControllerGuard
from dz_ros.core.safety.health import LawHealth, Pace, Rejections, Report, say_state
from dz_ros.core.safety.supervisor import Supervisor
from dz_ros.core.safety.table import Mode
from dz_ros.errors import LoopError
from dz_ros.nodes.base import SPIN_LIMIT
from dz_ros.nodes.guarded import GuardedNode
from dz_ros.nodes.progress import Progress
from dz_ros.nodes.start_checks import log, refuse_bad_design

GONE_NS = 5_000_000_000
"""In lockstep, a reference that does not come within this means that its sender is gone [ns]."""


class ControllerNode(GuardedNode):
    """Adaptive controller, or any other law."""

    partner = 'state'

    def __init__(self) -> None:
        super().__init__('controller_node', 'loop', 'structure', 'controller', 'safety')
        self._design = refuse_bad_design(self.configuration)
        self._guard = ControllerGuard(self.configuration, self.changed, self._begins)
        self._order = self.configuration.plant.order
        self._pace = Pace(self.configuration.loop.period)
        self._health = LawHealth(self.configuration)
        self._rejections = Rejections()
        self._holds = Latency(self.configuration.loop.period)
        self._waiting: tuple[State, int] | None = None
        self._announced: tuple[int, tuple[float, ...]] | None = None
        rate = self.declare_parameter('progress_rate', 0.0, ParameterDescriptor(
            read_only=True, description='lines of progress a second on standard output, as '
            'JSON, for the program that started this node; 0 = none [Hz]')).value
        self._progress = Progress(self.configuration, rate) if rate > 0.0 else None
        self.watch_parameters()

    @property
    def supervisor(self) -> Supervisor:
        """Life and mode."""
        return self._guard.supervisor

    def report(self) -> Report:
        """Return how the controller has been since the last report."""
        report = Report()
        say_state(report, self.supervisor)
        self._pace.report(report, not self.lockstep)
        self._holds.report(report, 'state to command', not self.lockstep)
        self._health.report(report)
        report.put('commands', self._guard.controller.count, 'd')
        report.put('held back by a limit', self._guard.controller.gate.limited, 'd')
        report.put('states lost', self._guard.state_guard.skipped, 'd')
        self._rejections.report(report, {
            f'{topic}: {reason}': count for topic, guard in (
                ('state', self._guard.state_guard), ('reference', self._guard.reference_guard))
            for reason, count in guard.rejected().items()})
        return report

    def set_up(self) -> None:
        """Offer commands, listen to references; to states only when everybody is there."""
        self._publish_command = self.offer('command', Command.labels())
        self._publish_terms = self.offer(
            'terms', Terms.labels(self.configuration.law.signal_names))
        self.take('reference', Reference.labels(self._order), self._on_reference)
        log(self, self._design)     # not before: one whose topics are taken says only that
        self._design = []
        self._listening = False
        self._begins(self._guard.controller.count, self._guard.controller.memory)

    def change_life(self, name: str) -> None:
        """Send the safe command several times where commands were sent so far."""
        was_active = self.supervisor.life.value == 'active'
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
        if not self._listening:
            self._listening = True
            self.take('state', State.labels(self._order), self._on_state)
        period, looked = self.configuration.loop.period, 0.0
        while not self.halted:
            watching = self.supervisor.mode in (Mode.RUNNING, Mode.LOST) and not self.lockstep
            self.spin(period if watching else SPIN_LIMIT)
            now = time.monotonic()
            if watching and now - looked >= period:
                looked = now
                self._look(now)
            self.diagnosing.look()
            if self.lockstep and self._waiting is not None:
                state, taken_ns = self._waiting
                if time.monotonic_ns() - taken_ns > GONE_NS:
                    raise LoopError(f'no reference for sample {state.seq} within '
                                    f'{GONE_NS * 1e-9:g} s: the trajectory is gone')
        return False

    def vet(self, configuration: Configuration) -> None:
        """Ask the design rules; those that simulate only while the loop waits to start.

        Raises:
            ConfigurationError: They find an error.
        """
        log(self, refuse_bad_design(configuration, self.supervisor.mode is Mode.WAITING))

    def reconfigure(self) -> None:
        """Use other gains and limits from the next sample on, and say so."""
        self._guard.configure(self.configuration)
        self._health.configure(self.configuration)
        self._announced = None
        self._begins(self._guard.controller.count, self._guard.controller.memory)

    def stop_now(self, pressed: bool, reason: str) -> None:
        """Hear the e-stop."""
        self._send(self._guard.estop(pressed, reason))

    def partner_ended(self) -> None:
        """Hear that the plant stops in order."""
        self._guard.end()

    def reset(self) -> str:
        """Leave a latched mode; return why not."""
        return self._guard.reset(time.monotonic())

    def _begins(self, seq: int, memory: tuple[float, ...]) -> None:
        """Say with which configuration and memory the command `seq` is computed.

        From there on a reader has all it needs to recompute the run.
        """
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
        state = self._guard.take(numbers, taken_ns * 1e-9)
        if state is None:
            return
        if self._guard.ready(state):
            self._answer(state, taken_ns)
        elif self._waiting is None or self._waiting[0].seq != state.seq:
            self._waiting = (state, taken_ns)       # since it came first

    def _answer(self, state: State, taken_ns: int) -> None:
        answer = self._guard.answer(state, taken_ns * 1e-9)
        self._send(answer, taken_ns)
        if answer is None:
            return
        command, terms = answer
        self._pace.sample(taken_ns * 1e-9, state.stamp)
        self._health.sample(command.v, terms, self._guard.controller.error)
        if self._progress is not None:
            self._progress.sample(state, terms, self._guard.controller.error, command.v, taken_ns)

    def _look(self, now: float) -> None:
        """Look at the clock."""
        senders = 1
        for topic, guard in (('state', self._guard.state_guard),
                             ('reference', self._guard.reference_guard)):
            if guard.rivalry(now):
                senders = max(senders, self.count_publishers(topic))
        self._send(self._guard.poll(now, senders))

    def _send(self, answer: Answer | None, taken_ns: int = 0) -> None:
        """Publish a command, which has passed the gate, and its terms."""
        if answer is None or not self._records:
            return
        command, terms = answer
        hold = 0.0 if self.lockstep or not taken_ns else (
            time.monotonic_ns() - taken_ns) * 1e-9
        if hold:
            self._holds.add(hold)
        self._publish_command((*command.numbers()[:-1], hold))
        self._publish_terms(terms.numbers())

"""The controller's end of the loop: which states are answered, by the law or safely (ours).

Every command of a controller comes out of a `ControllerGuard`, and each one has passed the gate.
The twin of what ``nodes/controller_node.py`` does with its topics. Time is a steady clock [s].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dz_ros.core.configuration import Configuration
from dz_ros.core.controller import Controller, ViolationError
from dz_ros.core.records import Command, Reference, State, Terms
from dz_ros.core.safety.actuator_guard import FRESH
from dz_ros.core.safety.guards import FutureGuard, SequenceGuard, Verdict, Watchdog
from dz_ros.core.safety.supervisor import Change, Supervisor
from dz_ros.core.safety.table import Action, Event, Life, Mode

Answer = tuple[Command, Terms]
REPEATS = 5
"""The safe command is sent so often where nothing else follows."""
SNAPSHOT = 1.0
"""Estimates are kept for restoring after each of these [s] of running."""


class ControllerGuard:
    """Guards the law against its inputs, and everybody against its commands.

    Args:
        configuration: Law, plant structure, period, limits.
        changed: Called with each change of mode.
        begins: Called when the law takes over, with the seq of its first command and the memory
            before it.

    Attributes:
        controller: The law's bookkeeping.
        supervisor: Life and mode.
        state_guard, reference_guard: Judges of the messages.
    """

    def __init__(self, configuration: Configuration,
                 changed: Callable[[Change], None] | None = None,
                 begins: Callable[[int, tuple[float, ...]], None] | None = None) -> None:
        self.controller = Controller(configuration)
        self.supervisor = Supervisor(changed)
        self.state_guard = SequenceGuard()
        self.reference_guard = SequenceGuard()
        self._begins = begins
        self._settings = configuration.safety
        self._period = configuration.loop.period
        self._watch = configuration.loop.timing == 'realtime'
        self._watchdog = Watchdog()
        self._future = FutureGuard()
        self._pressed = False
        self._begun = False
        self._first_seq = 0
        self._lost = 0.0
        self._repeats = 0
        self._snapshot_at = 0.0
        self._snapshots = (self.controller.memory, self.controller.memory)
        self._state = State(-1, 0.0, ())

    @property
    def lockstep(self) -> bool:
        """Whether time is not the wall's."""
        return not self._watch

    def configure(self, configuration: Configuration) -> None:
        """Use other gains and limits from the next sample on; the structure is the same."""
        self._settings = configuration.safety
        self.controller.configure(configuration)

    def reference(self, numbers: Sequence[float], now: float) -> bool:
        """Take a reference message; return whether it was."""
        resync = self.lockstep or not self.supervisor.running
        verdict = self.reference_guard.judge(numbers, now, resync)
        if verdict is Verdict.TAKEN:
            self.controller.set_reference(Reference.from_numbers(numbers))
        return verdict is Verdict.TAKEN

    def take(self, numbers: Sequence[float], now: float) -> State | None:
        """Take a state message; return the state to be answered, None = not this one."""
        resync = not self.supervisor.running
        verdict = self.state_guard.judge(numbers, now, resync)
        if verdict not in (Verdict.TAKEN, Verdict.REPEATED):
            return None
        state = State.from_numbers(numbers)
        if verdict is Verdict.TAKEN and self._watch:
            if resync:
                self._future.restart()
            if self._future.ahead(state.stamp, now, self._settings.state_hold * self._period):
                self.state_guard.counts[Verdict.FUTURE] += 1
                return None
        # Before the loop's clock starts, sample 0 comes when it comes.
        if state.seq > 0:
            self._watchdog.feed(now)
        return state

    def ready(self, state: State) -> bool:
        """Whether a state can be answered: in lockstep it waits for its very own reference."""
        if self.lockstep:
            return self.controller.has_reference_for(state)
        return self.controller.has_reference

    def answer(self, state: State, now: float) -> Answer | None:
        """Return the answer to a state that is ready; None where it must not be answered."""
        if self.supervisor.life is not Life.ACTIVE:
            return None
        self._state = state
        trouble = self._trouble(state) if self._watch else ''
        if self.supervisor.running:
            if trouble:
                self._lost = now
                self.supervisor.happen(Event.STALE, trouble)
        elif ((self.supervisor.mode is Mode.WAITING or not trouble)
                and self.supervisor.happen(Event.INPUT) is Action.START):
            self._start(state, now)
        if not self.supervisor.running:
            self._expire(now)
            return self.controller.safe_answer(state)
        try:
            found = self.controller.respond(state)
        except ViolationError as error:
            return self.fault(str(error))
        if now - self._snapshot_at > SNAPSHOT:
            self._snapshot_at = now
            self._snapshots = (self._snapshots[1], self.controller.memory)
        return found

    def poll(self, now: float, senders: int = 1) -> Answer | None:
        """Look at the clock; return a safe command that must be sent now, or None.

        Args:
            now: Steady clock [s].
            senders: How many publishers the graph shows, of states or of references, whichever
                are more.
        """
        if not self._watch or self.supervisor.life is not Life.ACTIVE:
            return None
        hold = self._settings.state_hold * self._period
        if self.supervisor.running and self._watchdog.older(now, hold):
            self._lost, self._repeats = now - hold, 0
            self.supervisor.happen(Event.STALE, 'no state')
        if senders > 1 and (self.state_guard.rivalry(now) or self.reference_guard.rivalry(now)):
            topic = 'states' if self.state_guard.rivalry(now) else 'references'
            self._forget_rivals()
            return self.fault(f'{senders} publishers of {topic}')
        if self.supervisor.mode is not Mode.LOST:
            return None
        self._expire(now)
        silent = self._watchdog.older(now, hold + self._repeats * self._period)
        if silent and self._repeats < REPEATS:
            self._repeats += 1
            return self.controller.safe_answer(self._state)
        return None

    def fault(self, reason: str) -> Answer:
        """Latch a fault; return the safe command."""
        self.supervisor.happen(Event.FAULT, reason)
        return self.controller.safe_answer(self._state)

    def estop(self, pressed: bool = True, reason: str = 'e-stop') -> Answer | None:
        """Hear the e-stop pressed or released; return the safe command to send, if any."""
        self._pressed = pressed
        if not pressed:
            return None
        self.supervisor.happen(Event.ESTOP, reason)
        return self.controller.safe_answer(self._state) if self._state.seq >= 0 else None

    def end(self) -> None:
        """Hear that the plant stops in order."""
        self._watchdog.stop()
        self.supervisor.happen(Event.END)

    def transition(self, name: str) -> list[Answer]:
        """Follow a transition of the life; return the safe commands to send, one by one.

        Raises:
            LookupError: There is none of this name from the present state.
        """
        action = self.supervisor.transition(name)
        self._watchdog.stop()
        if action is not Action.SAFE or self._state.seq < 0:
            return []
        return [self.controller.safe_answer(self._state) for _ in range(REPEATS)]

    def reset(self, now: float) -> str:
        """Leave a latched mode, release a latch of the law's own; return why not, else empty."""
        released = self.controller.law.reset_guard(self.controller.memory)
        if not self.supervisor.latched:
            if released == self.controller.memory:
                return 'nothing is latched'
            self.controller.memory = released
            if self._begins is not None:
                self._begins(self.controller.count, released)
            return ''
        if self._pressed:
            return 'the e-stop is still pressed: publish false on estop first'
        if self.supervisor.life is Life.ACTIVE and self._watch:
            if self._watchdog.older(now, FRESH * self._period):
                return 'no state arrives: start the plant or the driver first'
            if self._overdue(self._state):
                return 'no reference arrives: start the trajectory first'
        self._forget_rivals()
        self.controller.memory = released
        self.supervisor.happen(Event.RESET)
        return ''

    def _start(self, state: State, now: float) -> None:
        """Let the law take over from the present state."""
        memory = self.controller.memory
        if self._begun:
            memory = {'keep': memory, 'reset': self.controller.law.initial_memory(),
                      'restore': self._snapshots[0]}[self._settings.estimates]
        self._begun = True
        self._first_seq = state.seq
        self._snapshot_at = now
        self._snapshots = (memory, memory)
        self.controller.restart(memory)
        if self._begins is not None:
            self._begins(self.controller.count, memory)

    def _trouble(self, state: State) -> str:
        """Return what keeps the law from answering this state, empty if nothing does."""
        if self._overdue(state):
            return 'no reference'
        limit = self._settings.echo_limit
        if (limit and state.seq - self._first_seq > limit and state.echo_seq >= 0
                and self.controller.count - 1 - state.echo_seq > limit):
            return 'the actuator does not take the commands'
        return ''

    def _overdue(self, state: State) -> bool:
        """Whether the newest reference is too old for a state."""
        hold = self._settings.reference_hold * self._period
        return hold > 0.0 and state.stamp - self.controller.newest_reference() > hold + 1e-9

    def _expire(self, now: float) -> None:
        """Latch a fault where the input has been lost for too long."""
        after = self._settings.fault_after * self._period
        if self.supervisor.mode is Mode.LOST and 0.0 < after < now - self._lost:
            self.supervisor.happen(Event.EXPIRED)

    def _forget_rivals(self) -> None:
        self.state_guard.forget_rivals()
        self.reference_guard.forget_rivals()

# SPDX-License-Identifier: Apache-2.0
"""The controller's end of the loop: which states are answered, by the law or safely (ours).

Every command of a controller comes from a `ControllerGuard` and has passed the command limiter.
This is the ROS-free part of ``nodes/controller_node.py``. Time is a steady clock [s].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
from typing import Any

from dz_ros.core.axes import Rows, rows_maker
from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.controller import ViolationError
from dz_ros.core.loop.controllers import controller_of
from dz_ros.core.records import Reference, State
from dz_ros.core.safety.actuator_guard import FRESH
from dz_ros.core.safety.message_guards import (
    FutureGuard,
    ReferenceGuard,
    REPEATED,
    SequenceGuard,
    STATE_ECHO,
    TAKEN,
    Verdict,
)
from dz_ros.core.safety.modes import Action, ACTIVE, Event, LOST, Mode
from dz_ros.core.safety.supervisor import Change, Supervisor
from dz_ros.core.safety.watchdog import Watchdog

Answer = tuple[Any, Any]
"""A `Command` and its `Terms`; of several axes rows of them."""
REPEATS = 5
"""Number of times the safe command is sent where nothing else follows."""
SNAPSHOT = 1.0
"""Interval at which estimates are kept for restoring, while running [s]."""


class ControllerGuard:
    """Guards the law against its inputs, and the actuator against its commands.

    Of several axes, states, references and answers are `dz_ros.core.axes.Rows`; mode, sequence and
    watchdogs are those of the machine.

    Args:
        configuration: Law, plant structure, period, limits.
        changed: Called with each change of mode.
        begins: Called when the law takes over, with the seq of its first command and the memory
            before it.

    Attributes:
        controller: The law's bookkeeping.
        supervisor: Lifecycle state and mode.
        state_guard, reference_guard: Checks of the messages.
    """

    def __init__(self, configuration: Configuration,
                 changed: Callable[[Change], None] | None = None,
                 begins: Callable[[int, Any], None] | None = None) -> None:
        axes = configuration.axis_names
        count = max(1, len(axes))
        self.controller = controller_of(configuration)
        self.supervisor = Supervisor(changed)
        self.state_guard = SequenceGuard(STATE_ECHO, axes)
        self.reference_guard = ReferenceGuard(configuration.loop.period, axes)
        self._state_of = rows_maker(State.from_numbers, count)
        self._reference_of = rows_maker(Reference.from_numbers, count)
        self._begins = begins
        self._period = configuration.loop.period
        self._hold(configuration)
        self._watch = configuration.loop.timing == 'realtime'
        self._watchdog = Watchdog()
        self._future = FutureGuard()
        self._early = -1            # seq of the state refused as from the future, if the last was
        self._pressed = False
        self._begun = False
        self._first_seq = 0
        self._lost = 0.0
        self._repeats = 0
        self._snapshot_at = 0.0
        self._snapshots = (self.controller.memory, self.controller.memory)
        self._state: Any = State(-1, 0.0, ()) if count == 1 else Rows(
            [State(-1, 0.0, ())] * count)
        self._newest = math.inf     # stamp of the newest state taken [s]

    @property
    def lockstep(self) -> bool:
        """Whether time is not the wall clock's."""
        return not self._watch

    def configure(self, configuration: Configuration) -> None:
        """Use other gains and limits from the next sample on; the structure is the same."""
        self._hold(configuration)
        self.controller.configure(configuration)

    def _hold(self, configuration: Configuration) -> None:
        """Take the settings of safety, and what follows of them for every sample."""
        self._settings = settings = configuration.safety
        self._state_hold = settings.state_hold * self._period
        held = settings.reference_hold * self._period
        self._reference_age = held + 1e-9 if held > 0.0 else math.inf   # more is too old [s]

    def reference(self, numbers: Sequence[float], now: float) -> bool:
        """Take a reference message; return whether it was."""
        taken = self.reference_guard.takes(numbers, now, self._newest,
                                           self.lockstep or not self.supervisor.running)
        if taken:
            self.controller.set_reference(self._reference_of(numbers))
        return taken

    def take(self, numbers: Sequence[float], now: float) -> Any:
        """Take a state message; return the state to be answered, None = not this one."""
        resync = not self.supervisor.running
        verdict = self.state_guard.judge(numbers, now, resync)
        if verdict is not TAKEN and verdict is not REPEATED:
            return None
        state = self._state_of(numbers)
        if self._watch:
            if verdict is not TAKEN:
                if self._early == state.seq:
                    return None
            else:
                if resync:
                    self._future.restart()
                if self._future.ahead(state.stamp, now, self._state_hold):
                    self.state_guard.counts[Verdict.FUTURE] += 1
                    self._early = state.seq
                    return None
                self._early = -1
        self._newest = state.stamp
        # Before the loop's clock starts, sample 0 comes when it comes.
        if state.seq > 0:
            self._watchdog.feed(now)
        return state

    def ready(self, state: Any) -> bool:
        """Whether a state can be answered: in lockstep it waits for its very own reference."""
        if self.lockstep:
            return bool(self.controller.has_reference_for(state))
        return self.controller.has_reference and (self._begun or not self.reference_guard.early(
            self.controller.newest_reference(), state.stamp))

    def answer(self, state: Any, now: float) -> Answer | None:
        """Return the answer to a state that is ready; None where it must not be answered."""
        if self.supervisor.lifecycle_state is not ACTIVE:
            return None
        self._state = state
        reason = self._input_fault(state) if self._watch else ''
        if self.supervisor.running:
            if reason:
                self._lost = now
                self.supervisor.happen(Event.STALE, reason)
        elif ((self.supervisor.mode is Mode.WAITING or not reason)
                and self.supervisor.happen(Event.INPUT) is Action.START):
            self._start(state, now)
        if not self.supervisor.running:
            self._expire(now)
            return self._safe_answer(state)
        try:
            found: Answer | None = self.controller.respond(state)
        except ViolationError as error:
            return self.fault(str(error))
        if now - self._snapshot_at > SNAPSHOT:
            self._snapshot_at = now
            self._snapshots = (self._snapshots[1], self.controller.memory)
        return found

    def poll(self, now: float, senders: int = 1) -> Answer | None:
        """Check for timeouts; return a safe command that must be sent now, or None.

        Args:
            now: Steady clock [s].
            senders: Number of publishers in the graph, of states or of references, whichever are
                more.
        """
        if not self._watch or self.supervisor.lifecycle_state is not ACTIVE:
            return None
        hold = self._state_hold
        if self.supervisor.running and self._watchdog.older(now, hold):
            self._lost, self._repeats = now - hold, 0
            self.supervisor.happen(Event.STALE, 'no state')
        if senders > 1 and (self.state_guard.rivalry(now) or self.reference_guard.rivalry(now)):
            topic = 'states' if self.state_guard.rivalry(now) else 'references'
            self._forget_rivals()
            return self.fault(f'{senders} publishers of {topic}')
        if self.supervisor.mode is not LOST:
            return None
        self._expire(now)
        silent = self._watchdog.older(now, hold + self._repeats * self._period)
        if silent and self._repeats < REPEATS:
            self._repeats += 1
            return self._safe_answer(self._state)
        return None

    def fault(self, reason: str) -> Answer:
        """Latch a fault; return the safe command."""
        self.supervisor.happen(Event.FAULT, reason)
        return self._safe_answer(self._state)

    def estop(self, pressed: bool = True, reason: str = 'e-stop') -> Answer | None:
        """Process a press or release of the e-stop; return the safe command to send, if any."""
        self._pressed = pressed
        if not pressed:
            return None
        self.supervisor.happen(Event.ESTOP, reason)
        return self.controller.safe_answer(self._state) if self._state.seq >= 0 else None

    def end(self) -> None:
        """Process the orderly stop of the plant."""
        self._watchdog.stop()
        self.supervisor.happen(Event.END)

    def transition(self, name: str) -> list[Answer]:
        """Follow a lifecycle transition; return the safe commands to send, one by one.

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
            return 'the e-stop is still pressed'
        if self.supervisor.lifecycle_state is ACTIVE and self._watch:
            if self._watchdog.older(now, FRESH * self._period):
                return 'no state arrives: start the plant or the driver first'
            if self._state.stamp - self.controller.newest_reference() > self._reference_age:
                return 'no reference arrives: start the trajectory first'
        self._forget_rivals()
        self.controller.memory = released
        self.supervisor.happen(Event.RESET)
        return ''

    def _start(self, state: Any, now: float) -> None:
        """Let the law take over from the present state."""
        memory = self.controller.memory
        if self._begun:
            memory = {'keep': memory, 'reset': self.controller.law.initial_memory(),
                      'restore': self._snapshots[0]}[self._settings.estimates]
            memory = self.controller.law.take_over(memory)
        self._begun = True
        self._first_seq = state.seq
        self._snapshot_at = now
        self._snapshots = (memory, memory)
        self.controller.restart(memory)
        if self._begins is not None:
            self._begins(self.controller.count, memory)

    def _safe_answer(self, state: Any) -> Answer:
        answer: Answer = self.controller.safe_answer(state)
        return answer

    def _input_fault(self, state: Any) -> str:
        """Return what keeps the law from answering this state, empty if nothing does."""
        if state.stamp - self.controller.newest_reference() > self._reference_age:
            return 'no reference'
        limit = self._settings.echo_limit
        if (limit and state.seq - self._first_seq > limit and state.echo_seq >= 0
                and self.controller.count - 1 - state.echo_seq > limit):
            return 'the actuator does not take the commands'
        return ''

    def _expire(self, now: float) -> None:
        """Latch a fault where the input has been lost for too long."""
        after = self._settings.fault_after * self._period
        if self.supervisor.mode is LOST and 0.0 < after < now - self._lost:
            self.supervisor.happen(Event.EXPIRED)

    def _forget_rivals(self) -> None:
        self.state_guard.forget_rivals()
        self.reference_guard.forget_rivals()

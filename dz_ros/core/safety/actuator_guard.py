# SPDX-License-Identifier: Apache-2.0
"""The actuator's end of the loop: what of the commands that arrive reaches the actuator (ours).

The host of an actuator, simulated or real, passes every command through `command`, calls `poll`
at least once a sample, and applies to the actuator what the two return and nothing else. This is
the ROS-free part of ``nodes/actuator_node.py``. Time is the host's own loop time [s].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from dz_ros.core.axes import rows_maker, spoken
from dz_ros.core.plants.base import Plant
from dz_ros.core.records import Command
from dz_ros.core.safety.command_limiter import limiter_of
from dz_ros.core.safety.message_guards import SequenceGuard, TAKEN, Verdict
from dz_ros.core.safety.modes import Action, Event, LOST, RUNNING
from dz_ros.core.safety.runaway_guard import runaway_text, RunawayGuard
from dz_ros.core.safety.settings import SafetySettings
from dz_ros.core.safety.supervisor import Change, Supervisor
from dz_ros.core.safety.watchdog import Watchdog

FRESH = 20
"""Largest age of the newest command at a reset [samples]."""


class ActuatorGuard:
    """Guards an actuator against its commands.

    Args:
        settings: Limits and holds, of several axes one for each; replace them by `configure`.
        period: T [s].
        watch: False where time is not the wall clock's (lockstep): nothing is then stale or too
            old.
        changed: Called with each change of mode.
        axes: Names of the axes; of several, commands and outputs are rows, shape (n,).
        plants: Model of what each axis drives, for the runaway guard; none = without that guard.

    Attributes:
        supervisor: Lifecycle state and mode.
        guard: Check of the messages.
        newest_command: Newest accepted command, applied or not; None before the first.
        taken: Newest command accepted while running; None before the first.
    """

    def __init__(self, settings: SafetySettings | Sequence[SafetySettings], period: float,
                 watch: bool = True, changed: Callable[[Change], None] | None = None,
                 axes: Sequence[str] = (), plants: Sequence[Plant] = ()) -> None:
        self.supervisor = Supervisor(changed)
        self.guard = SequenceGuard(Command.labels().index('echo_seq'), axes)
        self.newest_command: Command | None = None
        self.taken: Command | None = None
        self.limiter = limiter_of(settings, period)
        self._limiters = getattr(self.limiter, 'each', (self.limiter,))
        self._refused = [0] * len(self._limiters)       # commands, by each of them
        self._runaways = [RunawayGuard(plant, period) for plant in plants]
        self._record = rows_maker(Command.from_numbers, max(1, len(axes)))
        self._axes = axes
        self._period = period
        self._watch = watch
        self._watchdog = Watchdog()
        self._pressed = False

    @property
    def output(self) -> Any:
        """Command to be applied now."""
        return self.limiter.output

    def configure(self, settings: SafetySettings | Sequence[SafetySettings],
                  plants: Sequence[Plant] = ()) -> None:
        """Use other limits, and other models, from now on."""
        self.limiter.configure(settings)
        for guard, plant in zip(self._runaways, plants, strict=False):
            guard.plant = plant

    def measured(self, x: Sequence[Any], held: Any, t: float) -> Any:
        """Judge a measurement; return the safe command where the device runs away, else None.

        Args:
            x: State, shape (n,); of several axes rows of them.
            held: Command that the device was given last [actuator unit]; of several axes a row.
            t: Loop time of the measurement [s].
        """
        if not self.supervisor.running:
            for guard in self._runaways:
                guard.restart()
            return None
        several = len(self._axes) > 1
        for place, guard in enumerate(self._runaways):
            settings = (self.limiter.each[place] if several else self.limiter).settings
            limit = settings.runaway_time
            lasted = (guard.sample(t, held[place], x[place]) if several
                      else guard.sample(t, held, x))
            if 0.0 < limit <= lasted:
                axis = f'axis {self._axes[place]}: ' if several else ''
                return self.fault(axis + runaway_text(lasted, limit), t)
        return None

    def command(self, numbers: Sequence[float], seq: int, t: float) -> Any:
        """Process a command message; return the command to apply, None = no change.

        Args:
            numbers: The message, in the order of `Command.labels`.
            seq: Newest sample that was published.
            t: Time of arrival [s].
        """
        running = self.supervisor.running
        verdict = self.guard.judge(numbers, t, resync=not running)
        if verdict is not TAKEN:
            return None
        command = self._record(numbers)
        limit = self.limiter.settings.echo_limit if self._watch else 0
        if command.echo_seq > seq:
            self.guard.counts[Verdict.FUTURE] += 1
            return None
        if limit and t - command.echo_stamp > limit * self._period:
            self.guard.counts[Verdict.OLD] += 1
            return None
        self._watchdog.feed(t)
        self.newest_command = command
        if not running:
            if self.supervisor.happen(Event.INPUT) is Action.START:
                self.limiter.start(t)
            if not self.supervisor.running:
                return None
        self.taken = command
        v = self.limiter.apply(command.v, t)
        refused = [item.refused for item in self._limiters]
        if refused != self._refused:
            before, self._refused = self._refused, refused
            return self.fault(self._whose(before, refused) + 'command beyond every number', t)
        return v

    def _whose(self, before: Sequence[int], after: Sequence[int]) -> str:
        """Return how a reason begins that is of the axes whose numbers differ."""
        if len(self._axes) < 2:
            return ''
        return spoken([axis for axis, one, other in zip(self._axes, before, after, strict=True)
                       if one != other]) + ': '

    def poll(self, t: float, senders: int = 1) -> tuple[Any, float] | None:
        """Check for timeouts; return the safe command and since when it holds, if it is new.

        Args:
            t: Now [s].
            senders: Number of publishers of commands in the graph.
        """
        if not self._watch:
            return None
        settings, found = self.limiter.settings, None
        hold = settings.command_hold * self._period
        if self.supervisor.mode is RUNNING and self._watchdog.older(t, hold):
            assert self._watchdog.fed is not None
            since = self._watchdog.fed + hold
            self.supervisor.happen(Event.STALE, 'no command')
            found = self.limiter.safe(since), since
        if (self.supervisor.mode is LOST
                and self._watchdog.older(t, settings.fault_after * self._period)):
            self.supervisor.happen(Event.EXPIRED)
        if senders > 1 and self.guard.rivalry(t):
            self.guard.forget_rivals()
            return self.fault(f'{senders} publishers of commands', t), t
        return found

    def fault(self, reason: str, t: float) -> Any:
        """Latch a fault; return the safe command."""
        self.supervisor.happen(Event.FAULT, reason)
        return self.limiter.safe(t)

    def estop(self, t: float, pressed: bool = True, reason: str = 'e-stop') -> Any:
        """Process a press or release of the e-stop; return the safe command on a press."""
        self._pressed = pressed
        if not pressed:
            return None
        self.supervisor.happen(Event.ESTOP, reason)
        return self.limiter.safe(t)

    def end(self, t: float) -> Any:
        """Process the orderly stop of the controller; return the safe command."""
        self._watchdog.stop()
        self.supervisor.happen(Event.END)
        return self.limiter.safe(t)

    def transition(self, name: str, t: float) -> Any:
        """Follow a lifecycle transition; return the safe command, to be applied after each.

        Raises:
            LookupError: There is none of this name from the present state.
        """
        self.supervisor.transition(name)
        self._watchdog.stop()
        self.guard.restart()        # a state that is shown again has the same answer
        return self.limiter.safe(t)

    def held_by(self, t: float, command_required: bool = True) -> str:
        """Return why a latched mode cannot be left now, empty when it can.

        Args:
            t: The time [s].
            command_required: Whether a fresh command is required; False where the device gave
                no states, so that the controller could not answer any.
        """
        if not self.supervisor.latched:
            return 'nothing is latched'
        if self._pressed:
            return 'the e-stop is still pressed'
        active = self.supervisor.lifecycle_state.value == 'active'
        if command_required and active and self._watch and (
                self._watchdog.fed is None or self._watchdog.older(t, FRESH * self._period)):
            return 'no command arrives: start the controller first'
        return ''

    def reset(self, t: float, command_required: bool = True) -> str:
        """Leave a latched mode; return why not, empty when it was left; as `held_by`."""
        refused = self.held_by(t, command_required)
        if not refused:
            self.guard.forget_rivals()
            self.supervisor.happen(Event.RESET)
        return refused

"""The actuator's end of the loop: what of the commands that arrive reaches the actuator (ours).

Whoever hosts an actuator, simulated or real, passes every command through `command`, calls `poll`
at least once a sample, and gives the actuator what the two return and nothing else. The twin of
what ``nodes/hosting.py`` does with its topics. Time is the host's own loop time [s].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dz_ros.core.records import Command
from dz_ros.core.safety.gate import OutputGate
from dz_ros.core.safety.guards import SequenceGuard, Verdict, Watchdog
from dz_ros.core.safety.settings import SafetySettings
from dz_ros.core.safety.supervisor import Change, Supervisor
from dz_ros.core.safety.table import Action, Event, Mode

FRESH = 20
"""A reset asks for a command not older than so many samples."""


class ActuatorGuard:
    """Guards an actuator against its commands.

    Args:
        settings: Limits and holds; replace them by `configure`.
        period: T [s].
        watch: False where time is not the wall's (lockstep): nothing is then stale or too old.
        changed: Called with each change of mode.

    Attributes:
        supervisor: Life and mode.
        guard: Judge of the messages.
        heard: Newest good command, whether it acts or not; None before the first.
        taken: Newest command that acts or acted; None before the first.
    """

    def __init__(self, settings: SafetySettings, period: float, watch: bool = True,
                 changed: Callable[[Change], None] | None = None) -> None:
        self.supervisor = Supervisor(changed)
        self.guard = SequenceGuard()
        self.heard: Command | None = None
        self.taken: Command | None = None
        self.gate = OutputGate(settings, period)
        self._period = period
        self._watch = watch
        self._watchdog = Watchdog()
        self._pressed = False

    @property
    def output(self) -> float:
        """What the actuator is to hold now."""
        return self.gate.output

    def configure(self, settings: SafetySettings) -> None:
        """Use other limits from now on."""
        self.gate.settings = settings

    def command(self, numbers: Sequence[float], seq: int, t: float) -> float | None:
        """Take a command message; return what the actuator is to do, None = what it does now.

        Args:
            numbers: The message, in the order of `Command.labels`.
            seq: Newest sample that was published.
            t: Time of arrival [s].
        """
        running = self.supervisor.running
        verdict = self.guard.judge(numbers, t, resync=not running)
        if verdict is not Verdict.TAKEN:
            return None
        command = Command.from_numbers(numbers)
        limit = self.gate.settings.echo_limit if self._watch else 0
        if command.echo_seq > seq:
            self.guard.counts[Verdict.FUTURE] += 1
            return None
        if limit and t - command.echo_stamp > limit * self._period:
            self.guard.counts[Verdict.OLD] += 1
            return None
        self._watchdog.feed(t)
        self.heard = command
        if not running:
            if self.supervisor.happen(Event.INPUT) is Action.START:
                self.gate.start(t)
            if not self.supervisor.running:
                return None
        self.taken = command
        refused = self.gate.refused
        v = self.gate.let_out(command.v, t)
        if self.gate.refused != refused:
            return self.fault('command beyond every number', t)
        return v

    def poll(self, t: float, senders: int = 1) -> tuple[float, float] | None:
        """Look at the clock; return the safe command and since when it holds, if it is new.

        Args:
            t: Now [s].
            senders: How many publishers of commands the graph shows.
        """
        if not self._watch:
            return None
        settings, found = self.gate.settings, None
        hold = settings.command_hold * self._period
        if self.supervisor.mode is Mode.RUNNING and self._watchdog.older(t, hold):
            assert self._watchdog.fed is not None
            since = self._watchdog.fed + hold
            self.supervisor.happen(Event.STALE, 'no command')
            found = self.gate.safe(since), since
        if (self.supervisor.mode is Mode.LOST
                and self._watchdog.older(t, settings.fault_after * self._period)):
            self.supervisor.happen(Event.EXPIRED)
        if senders > 1 and self.guard.rivalry(t):
            self.guard.forget_rivals()
            return self.fault(f'{senders} publishers of commands', t), t
        return found

    def fault(self, reason: str, t: float) -> float:
        """Latch a fault of the actuator's own; return the safe command."""
        self.supervisor.happen(Event.FAULT, reason)
        return self.gate.safe(t)

    def estop(self, t: float, pressed: bool = True, reason: str = 'e-stop') -> float | None:
        """Hear the e-stop pressed or released; return the safe command when pressed."""
        self._pressed = pressed
        if not pressed:
            return None
        self.supervisor.happen(Event.ESTOP, reason)
        return self.gate.safe(t)

    def end(self, t: float) -> float:
        """Hear that the controller stops in order; return the safe command."""
        self._watchdog.stop()
        self.supervisor.happen(Event.END)
        return self.gate.safe(t)

    def transition(self, name: str, t: float) -> float:
        """Follow a transition of the life; return the safe command, for none leaves it running.

        Raises:
            LookupError: There is none of this name from the present state.
        """
        self.supervisor.transition(name)
        self._watchdog.stop()
        self.guard.restart()        # a state that is shown again has the same answer
        return self.gate.safe(t)

    def held_by(self, t: float, heard: bool = True) -> str:
        """Return why a latched mode cannot be left now, empty when it can.

        Args:
            t: The time [s].
            heard: Whether a fresh command is asked for; not where the device gave no states, for
                then nobody could answer them.
        """
        if not self.supervisor.latched:
            return 'nothing is latched'
        if self._pressed:
            return 'the e-stop is still pressed: publish false on estop first'
        if heard and self.supervisor.life.value == 'active' and self._watch and (
                self._watchdog.fed is None or self._watchdog.older(t, FRESH * self._period)):
            return 'no command arrives: start the controller first'
        return ''

    def reset(self, t: float, heard: bool = True) -> str:
        """Leave a latched mode; return why not, empty when it was left; as `held_by`."""
        refused = self.held_by(t, heard)
        if not refused:
            self.guard.forget_rivals()
            self.supervisor.happen(Event.RESET)
        return refused

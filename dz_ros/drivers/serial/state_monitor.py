# SPDX-License-Identifier: Apache-2.0
"""Monitor of a device's states: is each one new, and does the device do what it was asked (ours).

A state is a measurement only if it advances: its seq and its clock are both newer than those of
the last one taken, modulo 2^32. A frame that a bridge sends twice is therefore taken once, and a
frozen or replayed line measures nothing, however many frames arrive.

Everything else in a state is compared with the commands that were written:

    echo    one of the commands written since the last echo, or the last echo again
    mode    the one that the command of that echo leads to
    trips   rise only where this host was late itself, by `LATE` of the hold of a command

A difference is reported as text. Times are those of a steady clock of the host [s]; the clock of
the device is only ever compared with itself, so that its drift has no effect. No port, no thread.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import math

from dz_ros.core.counted_log import Counted
from dz_ros.drivers.serial.protocol import Mode, newer, Request, State

LATE = 0.5
"""A host that lets more than this share of a hold pass between two commands has itself caused the
trip of the device's watchdog."""
MAX_UNANSWERED = 4096
"""Commands without an answer that are remembered."""
CLOCK_ERROR, CLOCK_SLACK = 0.1, 0.5
"""Over a connection that was lost, a device's clock must have advanced as the host's within this
share and this time [s]; if not, the device has restarted meanwhile."""

LEADS_TO = {
    Request.DISABLE: (Mode.DISABLED,), Request.RUN: (Mode.RUN,), Request.SAFE: (Mode.SAFE,),
    Request.ESTOP: (Mode.ESTOP,), Request.RESET: (Mode.DISABLED, Mode.SAFE, Mode.RUN)}
"""Modes that a request leads to, where the device is in neither FAULT nor ESTOP."""


@dataclass(frozen=True)
class Wish:
    """The newest that the host wants: request, v and safe commands [counts], hold [ms]."""

    request: Request
    v: tuple[int, ...]
    safe: tuple[int, ...]
    hold_ms: int


@dataclass
class Written:
    """A command on its way.

    Attributes:
        seq: Of the command.
        wish: What it asks for.
        began: When its writing began [s].
        ended: When its writing ended [s]; infinite until then.
    """

    seq: int
    wish: Wish
    began: float
    ended: float = math.inf


class StateMonitor:
    """Judges the states of one session after the other.

    Args:
        refused: Counts the states that were not taken, by cause.

    Attributes:
        answered: Wish of the newest command that the device has taken; None where not known.
        slowest: Longest time from the writing of a command to the state that echoes it [s]; the
            reader of it sets it to 0.
        restarted: Whether the device has restarted since `forget`.
    """

    def __init__(self, refused: Counted | None = None) -> None:
        self._refused = refused or Counted()
        self.slowest = 0.0
        self.restarted = False
        self._newest_ever: tuple[State, float] | None = None
        self.begin()

    def forget(self) -> None:
        """Forget the device: the next one may be another."""
        self._newest_ever, self.restarted = None, False
        self.begin()

    def begin(self) -> None:
        """Begin a new session: no command has been answered, nothing is outstanding."""
        self.answered: Wish | None = None
        self._written: deque[Written] = deque(maxlen=MAX_UNANSWERED)
        self._last: State | None = None
        self._since = 0.0
        self._stale = ''
        self._tripped = self._pardoned = False

    def writing(self, seq: int, wish: Wish, now: float) -> Written:
        """Note a command before it is written; set `ended` of the result once it is."""
        self._written.append(Written(seq, wish, now))
        return self._written[-1]

    @property
    def unanswered(self) -> Written | None:
        """The oldest command that a device which sends states has not taken; None = none."""
        if self._last is None:
            return None
        return next((item for item in self._written if self.answered is None
                     or newer(item.seq, self._last.echo)), None)

    def outstanding(self, now: float) -> float:
        """Return the age of the oldest command without an answer [s]; 0 where there is none."""
        item = self.unanswered
        return 0.0 if item is None else max(0.0, now - max(item.ended, self._since))

    def pardon(self) -> None:
        """Take the device's mode as it is, until it answers another command."""
        self._pardoned = True

    @property
    def stale(self) -> str:
        """Why the states that have arrived since the last one taken were not, as text."""
        return self._stale

    def take(self, state: State, now: float) -> tuple[bool, str]:
        """Judge a state of this session.

        Args:
            state: The state.
            now: When it arrived [s].

        Returns:
            Whether it is a measurement, and the difference to what was asked, as text; '' = none.
        """
        last = self._last
        if last is None:
            if self.was_held_back(state):
                return self._reject('older states', 'the device sends older states again')
            self._compare_with_before(state, now)
            self._since = now
        elif state.seq == last.seq:
            return self._reject('repeated states', 'the device repeats its last state')
        elif not newer(state.seq, last.seq):
            return self._reject('older states', 'the device sends older states again')
        elif not newer(state.time_us, last.time_us):
            return self._reject('states without a newer clock',
                                "the device's clock stands still")
        written = self._find(state.echo)
        if last is not None and written is None and state.echo != last.echo:
            self._refused.add('states with a wrong echo')
            return False, f'the device answers command {state.echo}, which was not sent to it'
        difference = '' if last is None else self._judge_trips(state, last, now)
        if written is not None and (last is None or state.echo != last.echo):
            self.slowest = max(self.slowest, now - written.began)
            self._pardoned = False
            self.answered = written.wish
            while self._written[0] is not written:
                self._written.popleft()
        self._last, self._stale = state, ''
        self._newest_ever = state, now
        return True, difference or self._judge_mode(state, now)

    def _reject(self, reason: str, words: str) -> tuple[bool, str]:
        self._refused.add(reason)
        self._stale = self._stale or words
        return False, ''

    def _find(self, seq: int) -> Written | None:
        """Return the command of a seq that was written and not answered by a later one."""
        return next((item for item in self._written if item.seq == seq), None)

    def _judge_trips(self, state: State, last: State, now: float) -> str:
        """Compare the count of trips with how regularly the commands were written."""
        self._tripped &= state.echo == last.echo
        if state.trips == last.trips:
            return ''
        self._tripped = True
        written = list(self._written)
        ends = [*(min(item.ended, now) for item in written[1:]), now]
        if not written or any(end - item.began >= LATE * item.wish.hold_ms * 1e-3
                              for item, end in zip(written, ends, strict=True)):
            return ''       # this host was late: the device has done what was asked
        return ("the device's watchdog has tripped: the commands do not reach it in time")

    def _judge_mode(self, state: State, now: float) -> str:
        """Compare the mode with what the command of the echo leads to."""
        wish, mode = self.answered, state.mode
        if any(state.faults) and mode not in (Mode.FAULT, Mode.ESTOP):
            motor = next(place for place, code in enumerate(state.faults) if code)
            return (f'the device reports fault {state.faults[motor]}'
                    + (f' of motor {motor}' if state.motors > 1 else '')
                    + f' in mode {mode.name.lower()}')
        if (wish is None or self._pardoned or mode in (Mode.FAULT, Mode.ESTOP)
                or mode in LEADS_TO[wish.request]):
            return ''
        if self._tripped and wish.request is Request.RUN and mode is Mode.SAFE:
            if self.outstanding(now) <= wish.hold_ms * 1e-3:
                return ''
            return 'the device does not run again: the commands do not reach it'
        return (f'the device is in mode {mode.name.lower()}, asked for '
                f'{wish.request.name.lower()}')

    def was_held_back(self, state: State) -> bool:
        """Return whether the line held a state back from shortly before the newest one ever."""
        if self._newest_ever is None:
            return False
        before = self._newest_ever[0]
        behind = (before.time_us - state.time_us) % 2 ** 32 * 1e-6
        return not newer(state.seq, before.seq) and behind <= CLOCK_SLACK

    def _compare_with_before(self, state: State, now: float) -> None:
        """Note a restart between the sessions: seq or clock do not continue."""
        if self._newest_ever is None:
            return
        before, then = self._newest_ever
        passed = (state.time_us - before.time_us) % 2 ** 32 * 1e-6
        error = (passed - (now - then) + 2147.483648) % 4294.967296 - 2147.483648
        self.restarted |= (not newer(state.seq, before.seq)
                           or abs(error) > CLOCK_ERROR * (now - then) + CLOCK_SLACK)

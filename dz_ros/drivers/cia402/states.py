# SPDX-License-Identifier: Apache-2.0
"""The state machine of a power drive, CiA 402 / IEC 61800-7-201: what it reports, what moves it.

    not ready ──▶ switch on disabled ◀──────────────┐ disable voltage, from anywhere below
                        │ shutdown                  │
                  ready to switch on                │
                        │ switch on                 │
                  switched on                       │
                        │ enable operation          │
                  operation enabled ──quick stop──▶ quick stop active
    anywhere ──a fault──▶ fault reaction active ──▶ fault ──fault reset──▶ switch on disabled

The drive reports its state in bits 0 to 6 of the statusword (6041h); bits 0 to 3 and 7 of the
controlword (6040h) ask for a transition. Nothing here knows a bus or a clock.
"""

from __future__ import annotations

import enum
import math
from typing import ClassVar


class DriveState(enum.Enum):
    """State of the drive."""

    NOT_READY = 'not ready to switch on'
    DISABLED = 'switch on disabled'
    READY = 'ready to switch on'
    SWITCHED_ON = 'switched on'
    ENABLED = 'operation enabled'
    QUICK_STOP = 'quick stop active'
    REACTING = 'fault reaction active'
    FAULT = 'fault'


class Controlword(enum.IntEnum):
    """Commands of the controlword; the bits they do not name are 0."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    """From operation enabled this is "disable operation"."""
    ENABLE_OPERATION = 0x0F
    FAULT_RESET = 0x80


class Goal(enum.Enum):
    """What the drive is wanted to be."""

    OFF = 'without voltage'
    SAFE = 'stopped'
    ENABLED = 'enabled'


VOLTAGE, REMOTE, FOLLOWS = 1 << 4, 1 << 9, 1 << 12
"""Bits of the statusword: power is on; the controlword is obeyed; the target is followed."""
TARGET_REACHED = 1 << 10
"""Bit of the statusword; while the quick stop is active: the axis stands."""
INTERNAL_LIMIT = 1 << 11
"""Bit of the statusword: the drive clips its target."""

STATUS: tuple[tuple[DriveState, int, int], ...] = (
    (DriveState.NOT_READY, 0x4F, 0x00),
    (DriveState.DISABLED, 0x4F, 0x40),
    (DriveState.READY, 0x6F, 0x21),
    (DriveState.SWITCHED_ON, 0x6F, 0x23),
    (DriveState.ENABLED, 0x6F, 0x27),
    (DriveState.QUICK_STOP, 0x6F, 0x07),
    (DriveState.REACTING, 0x4F, 0x0F),
    (DriveState.FAULT, 0x4F, 0x08),
)
"""(state, bits of the statusword that matter, what they are)."""


def state_of(statusword: int) -> DriveState | None:
    """Return the state in a statusword; None where the profile has no such state."""
    for state, mask, pattern in STATUS:
        if statusword & mask == pattern:
            return state
    return None


_STEPS = {DriveState.DISABLED: Controlword.SHUTDOWN, DriveState.READY: Controlword.SWITCH_ON,
          DriveState.SWITCHED_ON: Controlword.ENABLE_OPERATION,
          DriveState.ENABLED: Controlword.ENABLE_OPERATION,
          DriveState.QUICK_STOP: Controlword.ENABLE_OPERATION}


def step_to(goal: Goal, state: DriveState | None) -> Controlword:
    """Return the controlword that brings a drive in this state one step nearer to the goal.

    A fault is left by `Controlword.FAULT_RESET` alone, which is never a step.
    """
    if goal is Goal.SAFE:
        return Controlword.QUICK_STOP
    if goal is Goal.OFF or state is None:
        return Controlword.DISABLE_VOLTAGE
    return _STEPS.get(state, Controlword.DISABLE_VOLTAGE)


class Promises:
    """Bits of the statusword that a drive keeps set while it is enabled.

    Not every drive has them: only one that was set before and stays away is a contradiction.
    """

    REQUIRED_BITS: ClassVar[dict[int, tuple[int, str]]] = {
        VOLTAGE: (3, 'its power is off (statusword bit 4)'),
        REMOTE: (3, 'it is in local mode (statusword bit 9)'),
        FOLLOWS: (20, 'it does not follow the target (statusword bit 12)')}
    """Bit → number of statuswords without it, what that means."""

    def __init__(self) -> None:
        self._seen = 0
        self._without = dict.fromkeys(self.REQUIRED_BITS, 0)

    def look(self, word: int) -> str:
        """Return what a statusword contradicts of those before it, or ''."""
        if state_of(word) is not DriveState.ENABLED:
            self._without = dict.fromkeys(self.REQUIRED_BITS, 0)
            return ''
        self._seen |= word
        for bit, (most, words) in self.REQUIRED_BITS.items():
            self._without[bit] = 0 if word & bit else self._without[bit] + 1
            if self._seen & bit and self._without[bit] >= most:
                return f'the drive reports operation enabled, but {words}'
        return ''


class Walk:
    """The way to a goal, with the things a clock decides.

    - A statusword right after a change of goal may be the answer to the goal before: operation
      enabled counts as reached once it is reported `settle` after the change.
    - From quick stop back to operation enabled is optional in the profile: a drive that does
      not take that step within `patience` is led through switch on disabled.
    - A drive that leaves operation enabled by itself, or does not reach it within `limit`, is in
      fault. It is not switched on again by itself.
    - A drive that reports `REFUSALS` times that it still has torque does not take the command to
      stop.

    Args:
        limit: Longest way to operation enabled [s].
        settle: How long an answer may be an old one [s].
        patience: How long one step is tried [s].

    Attributes:
        goal: Where it shall go.
        since: From when on [s].
        arrived: Whether operation enabled was reached.
    """

    REFUSALS = 20

    def __init__(self, limit: float, settle: float = 0.1, patience: float = 0.2) -> None:
        self.limit = limit
        self.settle = settle
        self.patience = patience
        self.goal = Goal.OFF
        self.since = 0.0
        self._detour = -math.inf
        self.arrived = False
        self._last_report, self._refusals = 0.0, 0

    def want(self, goal: Goal, now: float) -> None:
        """Set the goal at `now` [s]; the same one again changes nothing."""
        if goal is not self.goal:
            self.goal, self.since, self.arrived = goal, now, False
            self._refusals = 0

    def look(self, state: DriveState | None, reported: float,
             now: float) -> tuple[Controlword, str]:
        """Return what to send, and what is wrong, or ''.

        Args:
            state: State the drive last reported.
            reported: When it did [s].
            now: The time [s].
        """
        word = step_to(self.goal, state)
        if self.goal is not Goal.ENABLED:
            return word, self._refusal(state, reported)
        if state is DriveState.ENABLED:
            self.arrived = (self.arrived
                            or reported - max(self.since, self._detour) > self.settle)
            return word, ''
        if self.arrived:
            return word, f'the drive has left operation enabled by itself: {_name(state)}'
        if now - self.since > self.limit:
            return word, (f'the drive does not reach operation enabled within {self.limit:g} s: '
                          f'{_name(state)}')
        if state is DriveState.QUICK_STOP and now - self.since > self.patience:
            word, self._detour = Controlword.DISABLE_VOLTAGE, now
        return word, ''

    def _refusal(self, state: DriveState | None, reported: float) -> str:
        """Return what is wrong with a drive that shall stop, or ''."""
        if stopped(self.goal, state):
            self._refusals = 0
        elif reported > max(self._last_report, self.since + self.settle):
            self._refusals += 1
        self._last_report = max(self._last_report, reported)
        if self._refusals < self.REFUSALS:
            return ''
        return f'the drive does not take the command to stop: {_name(state)}'


def stopped(goal: Goal, state: DriveState | None) -> bool:
    """Return whether a state has no torque but to brake, or none at all where that is wanted."""
    if goal is Goal.OFF and state is DriveState.QUICK_STOP:
        return False
    return state not in (DriveState.ENABLED, None)


def _name(state: DriveState | None) -> str:
    return 'unknown state' if state is None else state.value

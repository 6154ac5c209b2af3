"""The state machine of a power drive, CiA 402 / IEC 61800-7-201: what it says, what moves it.

    not ready ──▶ switch on disabled ◀──────────────┐ disable voltage, from anywhere below
                        │ shutdown                  │
                  ready to switch on                │
                        │ switch on                 │
                  switched on                       │
                        │ enable operation          │
                  operation enabled ──quick stop──▶ quick stop active
    anywhere ──a fault──▶ fault reaction active ──▶ fault ──fault reset──▶ switch on disabled

The drive tells its state in bits 0 to 6 of the statusword (6041h); bits 0 to 3 and 7 of the
controlword (6040h) ask for a transition. Nothing here knows a bus or a clock.
"""

from __future__ import annotations

import enum


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


TARGET_REACHED = 1 << 10
"""Bit of the statusword; while the quick stop is active it says that the axis stands."""
INTERNAL_LIMIT = 1 << 11
"""Bit of the statusword: the drive clips what it was told."""

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
    """Return the state a statusword tells; None where the profile has no such state."""
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

    A fault is left by nobody but `Controlword.FAULT_RESET`, which is never a step.
    """
    if goal is Goal.SAFE:
        return Controlword.QUICK_STOP
    if goal is Goal.OFF or state is None:
        return Controlword.DISABLE_VOLTAGE
    return _STEPS.get(state, Controlword.DISABLE_VOLTAGE)


class Walk:
    """The way to a goal, with the things a clock decides.

    - What the drive says right after the goal has changed may be its answer to the goal before:
      operation enabled counts as reached once the drive says so `settle` after the change.
    - From quick stop back to operation enabled is optional in the profile: a drive that does
      not take that step within `patience` is led through switch on disabled.
    - A drive that leaves operation enabled by itself, or does not reach it within `limit`, is in
      trouble. It is not switched on again by itself.

    Args:
        limit: Longest way to operation enabled [s].
        settle: How long an answer may be an old one [s].
        patience: How long one step is tried [s].
    """

    def __init__(self, limit: float, settle: float = 0.1, patience: float = 0.2) -> None:
        self.limit = limit
        self.settle = settle
        self.patience = patience
        self.goal = Goal.OFF
        self._since = 0.0
        self._arrived = False

    def want(self, goal: Goal, now: float) -> None:
        """Set the goal at `now` [s]; the same one again changes nothing."""
        if goal is not self.goal:
            self.goal, self._since, self._arrived = goal, now, False

    def look(self, state: DriveState | None, said: float, now: float) -> tuple[Controlword, str]:
        """Return what to send, and what is wrong, or ''.

        Args:
            state: What the drive last said it is in.
            said: When it said so [s].
            now: The time [s].
        """
        word = step_to(self.goal, state)
        if self.goal is not Goal.ENABLED:
            return word, ''
        if state is DriveState.ENABLED:
            self._arrived = self._arrived or said - self._since > self.settle
            return word, ''
        if self._arrived:
            return word, f'the drive has left operation enabled by itself: {_name(state)}'
        if now - self._since > self.limit:
            return word, (f'the drive does not reach operation enabled within {self.limit:g} s: '
                          f'{_name(state)}')
        if state is DriveState.QUICK_STOP and now - self._since > self.patience:
            word = Controlword.DISABLE_VOLTAGE
        return word, ''


def _name(state: DriveState | None) -> str:
    return 'unknown state' if state is None else state.value

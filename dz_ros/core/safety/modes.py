# SPDX-License-Identifier: Apache-2.0
"""States of a node of the loop, what changes them and what is done then (ours).

Two state machines side by side. The *lifecycle state* is that of every managed node of ROS 2; it
decides whether commands are sent or accepted at all. The *mode* decides, at either end of the
loop, between the law's command and the safe one. A latched mode outlives deactivation: only a
reset ends it. docs/safety.md repeats both tables.
"""

from __future__ import annotations

from collections.abc import Mapping
import enum


class LifecycleState(enum.Enum):
    """Primary states of a managed node."""

    UNCONFIGURED = 'unconfigured'
    INACTIVE = 'inactive'
    ACTIVE = 'active'
    FINALIZED = 'finalized'


class Mode(enum.Enum):
    """Which command an end of the loop passes on, and why."""

    WAITING = 'waiting'
    """Safe command; nothing wrong, the input has not begun or has ended in order."""
    RUNNING = 'running'
    """The law's command."""
    LOST = 'lost'
    """Safe command; the input is stale and may come back by itself."""
    FAULT = 'fault'
    """Safe command, latched."""
    ESTOP = 'estop'
    """Safe command, latched by a person."""


RUNNING, LOST = Mode.RUNNING, Mode.LOST
ACTIVE = LifecycleState.ACTIVE
"""What every sample is compared with: before Python 3.12, to ask an enumeration costs a call."""


class Event(enum.Enum):
    """What happens to an end of the loop."""

    INPUT = 'input'
    """A fresh input was accepted."""
    STALE = 'stale'
    """The input is older than its hold."""
    EXPIRED = 'expired'
    """It has been so for safety.fault_after samples."""
    END = 'end'
    """The other end has announced its stop, after going to its safe command."""
    FAULT = 'fault'
    """A guard was violated; the reason comes with it."""
    ESTOP = 'estop'
    """The e-stop, by topic or service."""
    RESET = 'reset'
    """The reset service, granted."""
    STOP = 'stop'
    """This node is deactivated or shut down."""


class Action(enum.Enum):
    """What is done on entering the next mode."""

    NONE = '-'
    START = 'start'
    """The law takes over from the present state: estimates as configured, rate and ramp from
    the safe command."""
    SAFE = 'safe'
    """The safe command is sent at once."""


_M, _E, _A = Mode, Event, Action

MODES: Mapping[tuple[Mode, Event], tuple[Mode, Action]] = {
    (_M.WAITING, _E.INPUT): (_M.RUNNING, _A.START),
    (_M.WAITING, _E.FAULT): (_M.FAULT, _A.SAFE),
    (_M.WAITING, _E.ESTOP): (_M.ESTOP, _A.SAFE),
    (_M.RUNNING, _E.STALE): (_M.LOST, _A.SAFE),
    (_M.RUNNING, _E.END): (_M.WAITING, _A.NONE),
    (_M.RUNNING, _E.FAULT): (_M.FAULT, _A.SAFE),
    (_M.RUNNING, _E.ESTOP): (_M.ESTOP, _A.SAFE),
    (_M.RUNNING, _E.STOP): (_M.WAITING, _A.SAFE),
    (_M.LOST, _E.INPUT): (_M.RUNNING, _A.START),
    (_M.LOST, _E.EXPIRED): (_M.FAULT, _A.SAFE),
    (_M.LOST, _E.END): (_M.WAITING, _A.NONE),
    (_M.LOST, _E.FAULT): (_M.FAULT, _A.SAFE),
    (_M.LOST, _E.ESTOP): (_M.ESTOP, _A.SAFE),
    (_M.LOST, _E.STOP): (_M.WAITING, _A.SAFE),
    (_M.FAULT, _E.ESTOP): (_M.ESTOP, _A.SAFE),
    (_M.FAULT, _E.RESET): (_M.WAITING, _A.NONE),
    (_M.FAULT, _E.STOP): (_M.FAULT, _A.SAFE),
    (_M.ESTOP, _E.RESET): (_M.WAITING, _A.NONE),
    (_M.ESTOP, _E.STOP): (_M.ESTOP, _A.SAFE),
}
"""(mode, event) → (next mode, action); what is not here changes nothing."""

LATCHED = (Mode.FAULT, Mode.ESTOP)
"""Modes that only a reset ends."""

LIFECYCLE: Mapping[tuple[LifecycleState, str], tuple[LifecycleState, Event | None]] = {
    (LifecycleState.UNCONFIGURED, 'configure'): (LifecycleState.INACTIVE, None),
    (LifecycleState.INACTIVE, 'cleanup'): (LifecycleState.UNCONFIGURED, None),
    (LifecycleState.INACTIVE, 'activate'): (LifecycleState.ACTIVE, None),
    (LifecycleState.ACTIVE, 'deactivate'): (LifecycleState.INACTIVE, Event.STOP),
    (LifecycleState.UNCONFIGURED, 'shutdown'): (LifecycleState.FINALIZED, None),
    (LifecycleState.INACTIVE, 'shutdown'): (LifecycleState.FINALIZED, None),
    (LifecycleState.ACTIVE, 'shutdown'): (LifecycleState.FINALIZED, Event.STOP),
}
"""(lifecycle state, transition) → (next lifecycle state, event for the mode)."""

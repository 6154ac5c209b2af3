# SPDX-License-Identifier: Apache-2.0
"""Lifecycle state and mode of one end of the loop, by the tables of `modes`, and the reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dz_ros.core.safety.modes import Action, Event, LATCHED, LIFECYCLE, LifecycleState, Mode, MODES


@dataclass(frozen=True)
class Change:
    """A mode was left for another.

    Attributes:
        mode: The mode now.
        earlier: The mode before.
        event: What happened.
        reason: Why, as text; empty where the event is reason enough.
    """

    mode: Mode
    earlier: Mode
    event: Event
    reason: str


class Supervisor:
    """State of one end of the loop.

    Args:
        changed: Called with each change of mode.

    Attributes:
        lifecycle_state: Primary state of the node.
        mode: Which command is passed on while the node is ACTIVE.
        running: Whether the law's commands may pass: the mode is RUNNING and the node ACTIVE.
        reason: Why the mode is a latched one or LOST; else empty.
        counts: Event → number of changes of mode by it.
    """

    def __init__(self, changed: Callable[[Change], None] | None = None) -> None:
        self.lifecycle_state = LifecycleState.UNCONFIGURED
        self.mode = Mode.WAITING
        self.running = False    # worked out once for each change: it is asked in every sample
        self.reason = ''
        self.counts: dict[Event, int] = {}
        self._changed = changed

    @property
    def latched(self) -> bool:
        """Whether only a reset helps."""
        return self.mode in LATCHED

    def happen(self, event: Event, reason: str = '') -> Action:
        """Change the mode by the table; return the action of the change."""
        found = MODES.get((self.mode, event))
        if found is None:
            return Action.NONE
        earlier = self.mode
        self.mode, action = found
        self._judge()
        if self.mode is not earlier:
            self.counts[event] = self.counts.get(event, 0) + 1
            # A fault that a stale input has become keeps the reason of the input.
            if event is not Event.EXPIRED:
                self.reason = reason if self.latched or self.mode is Mode.LOST else ''
            if self._changed is not None:
                self._changed(Change(self.mode, earlier, event, self.reason))
        return action

    def transition(self, name: str) -> Action:
        """Follow a lifecycle transition.

        Raises:
            LookupError: There is none of this name from the present state.
        """
        if (self.lifecycle_state, name) not in LIFECYCLE:
            raise LookupError(f'{name} is not possible while {self.lifecycle_state.value}')
        state, event = LIFECYCLE[(self.lifecycle_state, name)]
        action = Action.NONE if event is None else self.happen(event)
        self.lifecycle_state = state
        self._judge()
        return action

    def _judge(self) -> None:
        self.running = self.mode is Mode.RUNNING and self.lifecycle_state is LifecycleState.ACTIVE

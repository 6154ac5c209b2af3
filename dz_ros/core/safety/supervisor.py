"""Keeps life and mode of one end of the loop, as the tables say, and remembers why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dz_ros.core.safety.table import Action, Event, LATCHED, LIFE, Life, Mode, MODES


@dataclass(frozen=True)
class Change:
    """A mode was left for another.

    Attributes:
        mode: The mode now.
        earlier: The mode before.
        event: What happened.
        reason: Why, in words; empty where the event says it all.
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
        life: Primary state of the node.
        mode: What is let through while the life is ACTIVE.
        reason: Why the mode is a latched one or LOST; else empty.
        counts: Event → how often it changed something.
    """

    def __init__(self, changed: Callable[[Change], None] | None = None) -> None:
        self.life = Life.UNCONFIGURED
        self.mode = Mode.WAITING
        self.reason = ''
        self.counts: dict[Event, int] = {}
        self._changed = changed

    @property
    def running(self) -> bool:
        """Whether the law's commands may pass."""
        return self.mode is Mode.RUNNING and self.life is Life.ACTIVE

    @property
    def latched(self) -> bool:
        """Whether only a reset helps."""
        return self.mode in LATCHED

    def happen(self, event: Event, reason: str = '') -> Action:
        """Follow the table for an event; return what is to be done."""
        found = MODES.get((self.mode, event))
        if found is None:
            return Action.NONE
        earlier = self.mode
        self.mode, action = found
        if self.mode is not earlier:
            self.counts[event] = self.counts.get(event, 0) + 1
            # A fault that a stale input has become keeps the reason of the input.
            if event is not Event.EXPIRED:
                self.reason = reason if self.latched or self.mode is Mode.LOST else ''
            if self._changed is not None:
                self._changed(Change(self.mode, earlier, event, self.reason))
        return action

    def transition(self, name: str) -> Action:
        """Follow a transition of the life.

        Raises:
            LookupError: There is none of this name from the present state.
        """
        if (self.life, name) not in LIFE:
            raise LookupError(f'{name} is not possible while {self.life.value}')
        life, event = LIFE[(self.life, name)]
        action = Action.NONE if event is None else self.happen(event)
        self.life = life
        return action

"""What a loop runs, put together from what its nodes state of themselves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dz_ros.core.configuration import Configuration, SECTIONS
from dz_ros.core.records import Command, Reference, State, Terms, Truth
from dz_ros.errors import DzRosError


class Stated:
    """Each node's own part of a configuration, as last stated.

    Attributes:
        configuration: What the loop runs; None = not known, or not usable here.
        owners: Section → node whose values are the loop's.
        fresh: Whether what was heard last changed anything of it.
        problem: Why the configuration cannot be used; empty where it can.
    """

    def __init__(self) -> None:
        self.configuration: Configuration | None = None
        self.owners: dict[str, str] = {}
        self.fresh = False
        self.problem = ''
        self._flat: dict[str, Any] = {}

    def begin(self, flat: Mapping[str, Any]) -> None:
        """Begin with a configuration that nobody has stated, as a run's own."""
        self._flat = {key: value for key, value in flat.items()
                      if key.partition('.')[0] in SECTIONS}
        self._build()

    def hear(self, event: Mapping[str, Any]) -> dict[str, Any]:
        """Take over a node's own part of an event `configuration`; return what changed of it."""
        told, node = event.get('configuration'), str(event.get('node', ''))
        listed = event.get('owns')
        if not isinstance(told, dict) or not isinstance(listed, list):
            return {}
        owns = [item for item in listed if isinstance(item, str) and item in SECTIONS]
        before, owners = dict(self._flat), dict(self.owners)
        for key, value in told.items():
            section = key.partition('.')[0]
            if section in owns or section not in self.owners:
                self._flat[key] = value
        self.owners.update(dict.fromkeys(owns, node))
        self.fresh = before != self._flat or owners != self.owners
        if self.fresh:
            self._build()
        return {key: value for key, value in self._flat.items()
                if key.partition('.')[0] in owns and before.get(key, value) != value}

    def _build(self) -> None:
        ours = {key: value for key, value in self._flat.items()
                if key.partition('.')[0] in SECTIONS}
        try:
            self.configuration, self.problem = Configuration.from_flat(ours), ''
        except DzRosError as error:
            self.problem = str(error)


def labels_of(c: Configuration) -> dict[str, tuple[str, ...]]:
    """Return topic → field names of the messages of such a loop."""
    found = {'state': State.labels(c.plant.order), 'command': Command.labels(),
             'reference': Reference.labels(c.plant.order),
             'terms': Terms.labels(c.law.signal_names)}
    if c.driver_settings.name == 'simulated':
        found['truth'] = Truth.labels()
    return found


def brief(event: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a page needs of an event: its short values."""
    return {key: value[:500] if isinstance(value, str) else value for key, value in event.items()
            if isinstance(value, (str, int, float, bool)) or key in ('changed', 'values')}

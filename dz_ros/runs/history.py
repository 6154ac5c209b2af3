# SPDX-License-Identifier: Apache-2.0
"""Configurations of a run: which values held from which sample on, and which node stated them.

A node publishes an event ``configuration`` when it starts and whenever a value changes: all values
it runs with, the sections it *owns*, in which its values are the loop's, and, of a controller, the
seq of the first command they hold for and the law's memory before that command. A simulated run
has no events: what is stored with it holds from the first sample on.

    began    what is stored, each section replaced by what its owner stated first
    latest   what is stored, each key replaced by what the owner of its section stated last
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from dz_ros.core.axes_keys import section_of
from dz_ros.core.configuration import Configuration, SECTIONS
from dz_ros.core.dataset import RunData
from dz_ros.core.events import ConfigurationEvent, of_kind
from dz_ros.errors import DzRosError

MOST_KEYS = 8000
"""Keys of a configuration that nodes may state; a real one has about 100, and 80 for each axis."""


class Statement(NamedTuple):
    """A configuration event and when it was logged [ns since the epoch]."""

    time: int
    event: ConfigurationEvent


def known_keys(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a configuration; recordings may carry others beside them."""
    return {key: value for key, value in flat.items() if section_of(key) in SECTIONS}


def usable(flat: Mapping[str, Any]) -> tuple[Configuration | None, str]:
    """Return the configuration of recorded or received keys; None and why it is of no use here."""
    try:
        return Configuration.from_untrusted(flat), ''
    except DzRosError as error:
        return None, str(error)


class RunHistory:
    """Configurations of a run or of a running loop, in the order in which they were stated.

    Args:
        stored: Dotted key → value that is stored with the run.
        keep: Number of statements kept, the last ones; None = all.

    Attributes:
        stored: The keys of `stored` that are those of a configuration.
        latest: Dotted key → value, as last stated; sections without an owner as any node has them.
        owned: The keys of `latest` that the owners of their sections stated.
        owners: Section → name of the node whose values are the loop's.
        changed: Whether the last statement changed a value or an owner.
    """

    def __init__(self, stored: Mapping[str, Any] | None = None, keep: int | None = None) -> None:
        self.stored = known_keys(stored or {})
        self.latest = dict(self.stored)
        self.owned: dict[str, Any] = {}
        self.owners: dict[str, str] = {}
        self.changed = False
        self._statements: deque[Statement] = deque(maxlen=keep)
        self._configuration: Configuration | None = None
        self._problem = ''
        self._built: dict[str, Any] = {}

    @classmethod
    def of(cls, run: RunData) -> RunHistory:
        """Return the history of a run: what is stored with it and what its events state."""
        history = cls(run.configuration)
        for time, event in of_kind(run.events, ConfigurationEvent):
            history.add(event, time)
        return history

    def add(self, event: ConfigurationEvent, time: int = 0) -> dict[str, Any]:
        """Take in a statement; one that does not name what its node owns changes nothing.

        Args:
            event: The statement.
            time: When it was logged [ns since the epoch].

        Returns:
            The keys known before, of sections that the node owns, whose values changed.
        """
        self._statements.append(Statement(time, event))
        if event.owns is None:
            return {}
        before, owners = dict(self.latest), dict(self.owners)
        for key, value in event.configuration.items():
            section = section_of(key)
            full = len(self.latest) >= MOST_KEYS and key not in self.latest
            if section not in SECTIONS or full:
                continue
            if section in event.owns:
                self.owned[key] = value
            if section in event.owns or section not in self.owners:
                self.latest[key] = value
        self.owners.update((item, event.node) for item in event.owns if item in SECTIONS)
        self.changed = before != self.latest or owners != self.owners
        return {key: value for key, value in self.latest.items()
                if section_of(key) in event.owns and before.get(key, value) != value}

    def statements(self, section: str) -> list[Statement]:
        """Return the statements of the nodes that own a section, in order."""
        return [item for item in self._statements if section in (item.event.owns or ())]

    def held(self, begins: Sequence[int], ends: Sequence[int]
             ) -> list[dict[int, ConfigurationEvent]]:
        """Return what the controller stated: for each of its starts, first seq → statement.

        Args:
            begins: Log time of the first message of each start [ns since the epoch].
            ends: Log time of the last one [ns since the epoch].
        """
        found: list[dict[int, ConfigurationEvent]] = [{} for _ in begins]
        for time, event in sorted(self.statements('controller'), key=lambda item: item.event.seq):
            if event.seq == 0:
                place = min(sum(end < time for end in ends), len(ends) - 1)
            else:
                place = max(sum(begin <= time for begin in begins) - 1, 0)
            if found:
                found[place][event.seq] = event
        return found

    @property
    def began(self) -> dict[str, Any]:
        """Dotted key → value with which the run began.

        What else is not known is taken from nodes of versions that did not name what they own.
        """
        flat = dict(self.stored)
        for section in SECTIONS:
            stated = self.statements(section)[:1]
            flat.update((key, value) for item in stated
                        for key, value in item.event.configuration.items()
                        if section_of(key) == section)
        for item in self._statements:
            if item.event.owns is None:
                flat = {**known_keys(item.event.configuration), **flat}
        return flat

    @property
    def configuration(self) -> Configuration | None:
        """The configuration of `latest`; one that cannot be used here leaves the one before."""
        if self._built != self.latest:
            self._built = dict(self.latest)
            found, self._problem = usable(self.latest)
            self._configuration = found or self._configuration
        return self._configuration

    @property
    def problem(self) -> str:
        """Why `latest` cannot be used here; empty where it can."""
        return self._problem if self.configuration is not None or self.latest else ''

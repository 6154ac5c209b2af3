# SPDX-License-Identifier: Apache-2.0
"""The page's table: one row a sample, the records of all topics beside each other (ours).

A row belongs to a state. Command and terms are those that echo its seq, reference and truth those
with the same seq. What is missing is NaN. After the records' own numbers come those that
`dz_ros.live.derived` works out of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import Command, Reference, State, Terms, Truth
from dz_ros.core.signals import declared, names, Role, Signal
from dz_ros.core.units import Units

_PUBLISHED = Signal('published', 's', 'when the state was published', Role.INDEX)
DERIVED_COLUMNS = (
    Signal('interval', 's', 'from one state to the next, as published', symbol='period'),
    Signal('error', 'x', 'tracking error', symbol='x̃'),
    Signal('omega', 'x', 'bound of the tracking error', symbol='Ω_ε'),
    Signal('s_over_epsilon', '1', 'place in the boundary layer', symbol='s/ε'),
    Signal('band_low', 'v', 'dead-zone that the estimates allow, lower end'),
    Signal('band_high', 'v', 'dead-zone that the estimates allow, upper end'),
    Signal('zone_low', 'v', 'true break point left'),
    Signal('zone_high', 'v', 'true break point right'))
DERIVED = names(DERIVED_COLUMNS)
"""Columns computed from the others."""
MOST_NAMES, LONGEST_NAME = 512, 64
"""Names of one topic's numbers, and characters of each, that become columns; a law has up to
about 400."""


def usable(labels: Sequence[str]) -> str:
    """Return why the names of a topic's numbers cannot be columns; '' where they can."""
    if tuple(labels[:2]) != ('seq', 'stamp'):
        return 'a message without the names of its numbers'
    if len(labels) > MOST_NAMES or any(len(label) > LONGEST_NAME or not label.isprintable()
                                       for label in labels):
        return f'more than {MOST_NAMES} names, or one of more than {LONGEST_NAME} characters'
    return 'a name twice' if len(set(labels)) < len(labels) else ''


@dataclass(frozen=True)
class Part:
    """What a row takes from one topic.

    Attributes:
        start: Place of its first column.
        names: Fields taken, in the order of the columns.
        picks: Place of each in the topic's message.
    """

    start: int
    names: tuple[str, ...]
    picks: tuple[int, ...]


class Layout:
    """Which column is where.

    Args:
        labels: Topic → field names of its messages; topics that are not there have no columns.

    Attributes:
        names: Column names, the derived ones last.
        base: Number of columns before the derived ones.
        order: n.
        signals: The law's own signals that are shown.
        parts: Topic → what a row takes from it.
    """

    def __init__(self, labels: dict[str, tuple[str, ...]]) -> None:
        state = labels.get('state', ())
        self.order = sum(f'x{i}' in state for i in range(len(state)))
        terms = labels.get('terms', ())
        common = names(Terms.fields(()))
        self.signals = tuple(item.name for item in shown(declared(terms))
                             if item.name not in common)
        wanted = {topic: names(shown(fields)) for topic, fields in _records(self.order).items()}
        wanted['terms'] += self.signals
        columns = ['seq', 'stamp', _PUBLISHED.name]
        self.parts: dict[str, Part] = {}
        for topic, fields in wanted.items():
            found = labels.get(topic, ())
            there = tuple(name for name in fields if name in found)
            self.parts[topic] = Part(len(columns), there, tuple(map(found.index, there)))
            columns += there
        self.base = len(columns)
        self.names = (*columns, *DERIVED)
        self.labels = dict(labels)

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.names)

    def place(self, name: str) -> int | None:
        """Return the place of a column, None where there is none."""
        return self.names.index(name) if name in self.names else None

    def describe(self, configuration: Configuration | None) -> list[dict[str, Any]]:
        """Return each column as declared; its unit is '' where there is none or it is unknown."""
        fits = configuration is not None and configuration.plant.order == self.order
        units = Units.of(configuration.plant) if configuration and fits else Units(self.order)
        known = [_PUBLISHED, *chain.from_iterable(_records(self.order).values()),
                 *DERIVED_COLUMNS, *(configuration.law.signals if configuration else ())]
        return [{'name': item.name, 'unit': '' if unit == '1' else unit, 'label': item.label,
                 'role': item.role.value, 'meaning': item.meaning}
                for item in declared(self.names, known)
                for unit in (units.resolve(item.unit),)]


def shown(signals: Iterable[Signal]) -> tuple[Signal, ...]:
    """Return the signals that become columns: no indices, no memory before the step."""
    return tuple(item for item in signals if item.role not in (Role.INDEX, Role.MEMORY))


def _records(order: int) -> dict[str, tuple[Signal, ...]]:
    """Return topic → fields of its messages, a law's own signals left out."""
    return {'state': State.fields(order), 'reference': Reference.fields(order),
            'command': Command.fields(), 'terms': Terms.fields(()), 'truth': Truth.fields()}

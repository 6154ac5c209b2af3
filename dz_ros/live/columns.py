"""The page's table: one row a sample, the records of all topics beside each other (ours).

A row belongs to a state. Command and terms are those that echo its seq, reference and truth those
with the same seq. What is missing is NaN. After the records' own numbers come those that
`dz_ros.live.derived` works out of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import TERM_NAMES

DERIVED = ('interval', 'error', 'omega', 's_over_epsilon', 'band_low', 'band_high', 'zone_low',
           'zone_high')
"""Columns worked out of the others."""
BEFORE = '_before'
"""Ending of the signals that repeat the law's memory, for recomputing a run; not shown."""


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
        known = {'seq', 'stamp', *TERM_NAMES, 'dt', 'status', 'reference_seq', 'echo_seq'}
        self.signals = tuple(name for name in terms
                             if name not in known and not name.endswith(BEFORE))
        wanted = {
            'state': (*(f'x{i}' for i in range(self.order)), 'round_trip'),
            'reference': tuple(f'xd{i}' for i in range(self.order + 1)),
            'command': ('v', 'hold'),
            'terms': (*TERM_NAMES, 'dt', 'status', *self.signals),
            'truth': ('w', 'd', 'disturbance'),
        }
        names = ['seq', 'stamp', 'published']
        self.parts: dict[str, Part] = {}
        for topic, fields in wanted.items():
            found = labels.get(topic, ())
            there = tuple(name for name in fields if name in found)
            self.parts[topic] = Part(len(names), there, tuple(map(found.index, there)))
            names += there
        self.base = len(names)
        self.names = (*names, *DERIVED)
        self.labels = dict(labels)

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.names)

    def place(self, name: str) -> int | None:
        """Return the place of a column, None where there is none."""
        return self.names.index(name) if name in self.names else None

    def describe(self, configuration: Configuration | None) -> list[dict[str, Any]]:
        """Return name and unit of each column, '' where the unit is not known."""
        units = _units(self.names, self.order, configuration)
        return [{'name': name, 'unit': units.get(name, '')} for name in self.names]


def _units(names: Sequence[str], order: int,
           configuration: Configuration | None) -> dict[str, str]:
    """Return column → unit as far as known."""
    found = dict.fromkeys(('stamp', 'published', 'round_trip', 'hold', 'dt', 'interval'), 's')
    if configuration is None or configuration.plant.order != order:
        return found
    states, actuator = configuration.plant.state_units, configuration.plant.actuator_unit
    found.update({f'x{i}': unit for i, unit in enumerate(states)})
    found.update({f'xd{i}': unit for i, unit in enumerate(states)})
    found.update(dict.fromkeys(('s', 's_eps', 'epsilon'), states[-1]))
    found.update(dict.fromkeys(('error', 'omega'), states[0]))
    found.update({name: actuator for name in names if name.startswith('v')})
    found.update(dict.fromkeys(('w', 'd', 'band_low', 'band_high', 'zone_low', 'zone_high'),
                               actuator))
    return {name: '' if unit == '1' else unit for name, unit in found.items()}

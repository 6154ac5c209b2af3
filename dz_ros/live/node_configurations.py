# SPDX-License-Identifier: Apache-2.0
"""Configurations and events in the form in which the page is sent them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.events import Event
from dz_ros.core.records import Command, Reference, State, Terms, Truth
from dz_ros.core.signals import names, Signal
from dz_ros.core.text import printable

MOST_VALUES, SHORT, LONGEST_TEXT = 100, 80, 500
"""Limits on an event for the page: number of values, characters of a name and of a text."""


def fields_of(c: Configuration) -> dict[str, tuple[Signal, ...]]:
    """Return topic → fields of the messages of such a loop."""
    found = {'state': State.fields(c.plant.order), 'command': Command.fields(),
             'reference': Reference.fields(c.plant.order), 'terms': Terms.fields(c.law.signals)}
    if c.driver_settings.name == 'simulated':
        found['truth'] = Truth.fields()
    return found


def labels_of(c: Configuration) -> dict[str, tuple[str, ...]]:
    """Return topic → field names of the messages of such a loop."""
    return {topic: names(fields) for topic, fields in fields_of(c).items()}


def brief(event: Event, changed: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return what a page needs of an event: its short values, printable.

    Args:
        event: The event.
        changed: What a configuration changed.
    """
    found = dict(event.to_dict())
    lists = {name: value for name, value in (('changed', changed), ('values', found.get('values')))
             if isinstance(value, Mapping)}
    kept = {key: value for key, value in found.items()
            if isinstance(value, (str, int, float, bool))}
    return {**{printable(key, SHORT): printable(value, LONGEST_TEXT) if isinstance(value, str)
               else value for key, value in islice(kept.items(), MOST_VALUES)},
            **{name: {printable(key, SHORT): shown(value) for key, value in
                      islice(values.items(), MOST_VALUES)} for name, values in lists.items()},
            'kind': 'event', 'event': printable(event.kind), 'node': printable(event.node)}


def shown(value: Any) -> Any:
    """Return the value of a parameter as a page shows it, its texts and lists not too long."""
    if isinstance(value, str):
        return printable(value, LONGEST_TEXT)
    if isinstance(value, (list, tuple)):
        return [item if isinstance(item, (int, float)) else printable(item, SHORT)
                for item in value[:MOST_VALUES]]
    return value if isinstance(value, (int, float)) else printable(value, SHORT)

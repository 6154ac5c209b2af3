# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers to import, and those of an MCAP or rosbag2 bag; CSV has `import_csv`.

A column has times of its own. In a bag a column is ``/topic/field``
(`dz_ros.recording.message_fields`), its time the message's ``header.stamp`` where it has one, else
when it was recorded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dz_ros.errors import RecordingError
from dz_ros.recording.message_fields import close_names, MessageType

if TYPE_CHECKING:
    from dz_ros.recording.run_source import Source

Array = NDArray[np.float64]

STAMP = 'header.stamp'


@dataclass(frozen=True)
class Column:
    """Numbers over time.

    Attributes:
        values: NaN where the file has no number, shape (N,).
        times: When [s]; None = the file has a column for it, shape (N,).
    """

    values: Array
    times: Array | None = None


@dataclass(frozen=True)
class Columns:
    """What a file holds.

    Attributes:
        names: All of its columns.
        chosen: Those asked for, by name.
    """

    names: tuple[str, ...]
    chosen: dict[str, Column]


def read_bag(source: Source, wanted: Sequence[str]) -> Columns:
    """Return columns of a bag.

    Args:
        source: The bag.
        wanted: ``/topic/field`` each.

    Raises:
        RecordingError: No such topic or field, or messages that cannot be decoded.
    """
    source.outline()
    keys = {topic.name: key for key, topic in source.topics.items()}
    split: dict[str, list[str]] = {}
    for column in wanted:
        topic = max((name for name in keys if column.startswith(f'{name}/')), key=len, default='')
        if not topic:
            raise RecordingError(f'{source.path}: no topic of {column}; there are '
                                 f'{close_names(column, sorted(keys))}')
        split.setdefault(keys[topic], []).append(column)
    types: dict[str, MessageType] = {}
    values: dict[str, list[float]] = {column: [] for column in wanted}
    times: dict[str, list[float]] = {key: [] for key in split}
    fields: dict[str, None] = {}
    for batch in source.batches():
        for message in batch:
            if message.topic not in split:
                continue
            kind = source.topics[message.topic]
            if message.topic not in types:
                types[message.topic] = MessageType(kind.type_name, kind.definition)
            numbers = types[message.topic].decode(message.payload)
            stamp = numbers.get(STAMP, 0.0)
            times[message.topic].append(stamp or message.log_time * 1e-9)
            if not fields or len(times[message.topic]) == 1:
                fields.update(dict.fromkeys(f'{kind.name}/{name}' for name in numbers))
            for column in split[message.topic]:
                values[column].append(numbers.get(column[len(kind.name) + 1:].replace('/', '.'),
                                                  float('nan')))
    chosen = {}
    for key, columns in split.items():
        for column in columns:
            found = np.array(values[column])
            if not np.isfinite(found).any() and column.replace(
                    '/', '.') not in {name.replace('/', '.') for name in fields}:
                raise RecordingError(f'{source.path}: no field {column}; there are '
                                     f'{close_names(column, fields)}')
            chosen[column] = Column(found, np.array(times[key]))
    return Columns(tuple(fields), chosen)

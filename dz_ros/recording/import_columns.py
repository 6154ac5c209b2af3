# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers out of files of other tools: CSV, or topics of an MCAP or rosbag2 bag.

A column has times of its own. Those of a CSV file share its rows; the time is a column of the
file. In a bag a column is ``/topic/field`` (`dz_ros.recording.message_fields`), its time the
message's ``header.stamp`` where it has one, else when it was recorded.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import csv
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dz_ros.errors import RecordingError
from dz_ros.recording.message_fields import close_names, MessageType

if TYPE_CHECKING:
    from dz_ros.recording.run_source import Source

Array = NDArray[np.float64]

DELIMITERS = ',;\t'
LARGEST_FILE = 2**30
"""Bytes of a CSV file at most."""
MOST_ROWS = 2**24
"""Rows of a CSV file at most, a day at 190 Hz."""
LONGEST_LINE = 2**20
"""Characters of a line of a CSV file at most."""
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


def is_table(path: Path) -> bool:
    """Return whether a path is a text file of columns rather than a bag."""
    if not path.is_file():
        return False
    with path.open('rb') as file:
        head = file.read(4096)
    return b'\0' not in head and not head.startswith(b'\x89MCAP')


def table_names(path: Path) -> tuple[str, ...]:
    """Return the names of a CSV file's columns, those of its first line.

    Raises:
        RecordingError: It cannot be read, or has no such line.
    """
    with _opened(path) as lines:
        return _names(lines, path)[0]


def read_table(path: Path, wanted: Sequence[str]) -> Columns:
    """Return columns of a CSV file with a first line of names.

    Cells that are empty, or words such as nan or null, are no numbers.

    Raises:
        RecordingError: A line with a wrong number of cells, or a cell that is text; it is named.
    """
    numbers = array('d')
    with _opened(path) as lines:
        names, delimiter, first = _names(lines, path)
        places = [names.index(name) for name in wanted]
        reader = csv.reader(lines, delimiter=delimiter)
        for cells in reader:
            if not any(cell.strip() for cell in cells) or cells[0].lstrip().startswith('#'):
                continue
            line = first + reader.line_num
            if len(cells) != len(names):
                raise RecordingError(f'{path}: line {line} has {len(cells)} cells, the first line '
                                     f'names {len(names)} columns')
            if len(numbers) >= MOST_ROWS * len(places):
                raise RecordingError(f'{path}: more than {MOST_ROWS} rows')
            numbers.extend(_number(cells[place], path, line, names[place]) for place in places)
    table = np.array(numbers).reshape(-1, len(places))
    return Columns(names, {name: Column(table[:, i]) for i, name in enumerate(wanted)})


@contextmanager
def _opened(path: Path) -> Iterator[Iterator[str]]:
    """Yield the lines of a file, which need not fit into memory.

    Raises:
        RecordingError: It cannot be read, or is no text of lines.
    """
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise RecordingError(f'{path} is larger than {LARGEST_FILE} bytes')
        with path.open(encoding='utf-8-sig') as file:
            yield _lines(file, path)
    except UnicodeDecodeError:
        raise RecordingError(f'{path} is not a text file in UTF-8') from None
    except csv.Error as error:
        raise RecordingError(f'{path}: {error}') from None
    except OSError as error:
        if isinstance(error, RecordingError):
            raise
        raise RecordingError(f'{path} cannot be read: {error.strerror or error}') from None


def _lines(file: TextIO, path: Path) -> Iterator[str]:
    while line := file.readline(LONGEST_LINE + 1):
        if len(line) > LONGEST_LINE:
            raise RecordingError(f'{path}: a line is longer than {LONGEST_LINE} characters')
        yield line


def _names(lines: Iterator[str], path: Path) -> tuple[tuple[str, ...], str, int]:
    """Return the names of the columns, what separates them, and the number of their line."""
    first, head = next(((i, line) for i, line in enumerate(lines, 1) if line.strip()), (0, ''))
    if not head:
        raise RecordingError(f'{path} is empty')
    head = head.strip().lstrip('#').strip()
    delimiter = max(DELIMITERS, key=head.count)
    names = tuple(item.strip() for item in next(csv.reader([head], delimiter=delimiter), ()))
    if all(_is_number(name) for name in names):
        raise RecordingError(f'{path}: the first line must name the columns, it holds numbers')
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise RecordingError(f'{path}: two columns have the name {twice!r}')
    return names, delimiter, first


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _number(cell: str, path: Path, line: int, name: str) -> float:
    text = cell.strip()
    if text.lower() in ('', 'nan', 'null', 'none', 'na', 'n/a', '-'):
        return float('nan')
    try:
        return float(text)
    except ValueError:
        raise RecordingError(f'{path}: line {line}: {name} is {text[:40]!r}, not a number'
                             ) from None


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

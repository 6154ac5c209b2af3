# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers out of a CSV file of another tool.

Its columns share its rows; the time is a column of the file. The first line names them; separated
by comma, semicolon or tab. A second line in which no cell is a number, such as one of units, is
passed over. Where the comma separates no columns it may be that of decimals. Times may be dates in
ISO 8601, UTC where they state no zone.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import csv
from datetime import datetime, timedelta, timezone
from functools import partial
import math
from pathlib import Path
import re
from typing import TextIO

import numpy as np

from dz_ros.errors import RecordingError
from dz_ros.recording.import_columns import Column, Columns

DELIMITERS = ',;\t'
LARGEST_FILE = 2**30
"""Bytes of a CSV file at most."""
MOST_ROWS = 2**24
"""Rows of a CSV file at most, a day at 190 Hz."""
_DATE = re.compile(r'\d{4}-\d\d-\d\d[T ]\d\d:')
_COMMA = re.compile(r'[+-]?\d*,\d+(?:[eE][+-]?\d+)?$')
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
LONGEST_LINE = 2**20
"""Characters of a line of a CSV file at most."""


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
        as_number = partial(_as_number, decimal_comma=delimiter != ',')
        units = False
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
            if not numbers and not units and _is_text([as_number(cell) for cell in cells]):
                units = True
                continue
            for place in places:
                value = as_number(cells[place])
                if value is None:
                    raise RecordingError(f'{path}: line {line}: {names[place]} is '
                                         f'{cells[place].strip()[:40]!r}, not a number')
                numbers.append(value)
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


def _is_text(values: Sequence[float | None]) -> bool:
    """Whether a line has text but no number: of units, some of them empty or -."""
    return None in values and all(item is None or math.isnan(item) for item in values)


def _as_number(cell: str, decimal_comma: bool) -> float | None:
    """Return the number of a cell, NaN for none, None where it is text."""
    text = cell.strip()
    if text.lower() in ('', 'nan', 'null', 'none', 'na', 'n/a', '-'):
        return math.nan
    if decimal_comma and _COMMA.match(text):
        text = text.replace(',', '.')
    try:
        return float(text) if '_' not in text else None
    except ValueError:
        pass
    if not _DATE.match(text):
        return None
    try:
        when = datetime.fromisoformat(text.replace('Z', '+00:00'))
    except ValueError:
        return None
    when = when if when.tzinfo else when.replace(tzinfo=timezone.utc)
    return (when - _EPOCH) / timedelta(seconds=1)

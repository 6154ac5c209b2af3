# SPDX-License-Identifier: Apache-2.0
"""Axes of a loop: their names, and the records of one sample of all of them.

A loop of one axis has none of this: its records and messages are those of `dz_ros.core.records`.
The axes of one loop share sequence, clock, mode and e-stop, so the records of a sample have the
same seq, stamp and echo in every axis.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import math
import re
from typing import Any, TypeVar

from dz_ros.errors import ConfigurationError

MAX_AXES = 32
"""Axes of one loop, at most."""
MAX_NAME = 40
"""Characters of an axis' name, at most."""
SHARED = ('seq', 'stamp', 'echo_seq', 'echo_stamp')
"""Fields that are the machine's, so the same in the rows of all axes."""
_NAME = re.compile(rf'[A-Za-z][A-Za-z0-9_]{{0,{MAX_NAME - 1}}}')

Record = TypeVar('Record')


def is_name(text: str) -> bool:
    """Return whether a text can be the name of an axis, usable in keys and labels."""
    return _NAME.fullmatch(text) is not None


def check_names(axes: Sequence[str], key: str = 'loop.axes') -> tuple[str, ...]:
    """Return the names of the axes of a loop, each different and usable in keys and labels.

    Raises:
        ConfigurationError: A name that is none, one that stands twice, more than `MAX_AXES`.
    """
    found = tuple(axes)
    if len(found) > MAX_AXES:       # first: what comes from elsewhere may be long
        raise ConfigurationError(key, list(found), f'has {len(found)} axes, a loop has at most '
                                 f'{MAX_AXES}')
    for name in found:
        if not is_name(name):
            raise ConfigurationError(key, name, 'must be a name of letters, digits and _ that '
                                     f'begins with a letter, at most {MAX_NAME} characters')
        if found.count(name) > 1:
            raise ConfigurationError(key, list(found), f'names {name} twice; each axis once')
    return found


def spoken(names: Sequence[str]) -> str:
    """Return names of axes as a sentence has them: ``axis yaw``, ``axes surge, sway``."""
    return f'{"axis" if len(names) == 1 else "axes"} {", ".join(names)}'


def gathered(texts: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Return text → names of the axes that have it, of pairs (name, text), in their order."""
    found: dict[str, list[str]] = {}
    for name, text in texts:
        found.setdefault(text, []).append(name)
    return found


class Rows(tuple[Any, ...]):
    """Records of one sample, one for each axis, with the interface of a single one.

    Attributes:
        seq, stamp, echo_seq, echo_stamp: Those of the machine: the first row's.
    """

    __slots__ = ()

    @property
    def seq(self) -> int:
        """Count of samples."""
        return int(self[0].seq)

    @property
    def stamp(self) -> float:
        """Loop time [s]."""
        return float(self[0].stamp)

    @property
    def echo_seq(self) -> int:
        """Seq of the message answered."""
        return int(self[0].echo_seq)

    @property
    def echo_stamp(self) -> float:
        """Stamp of the message answered [s]."""
        return float(self[0].echo_stamp)

    @property
    def v(self) -> tuple[float, ...]:
        """Commands of the axes, shape (n,)."""
        return tuple(record.v for record in self)

    def numbers(self) -> tuple[float, ...]:
        """Return the numbers of all rows, one after the other."""
        found: list[float] = []
        for record in self:
            found += record.numbers()
        return tuple(found)


def all_finite(rows: Sequence[Sequence[float]]) -> bool:
    """Return whether every number of every row is finite."""
    # A sum that is finite has none but finite terms; the reverse need not be so.
    return math.isfinite(sum(map(sum, rows))) or all(
        math.isfinite(number) for row in rows for number in row)


def diagnostic_values(axes: int) -> int:
    """Return how many values of a node's diagnostics are shown: about 12 an axis are reported."""
    return max(200, 24 * axes)


def split(numbers: Sequence[float], count: int) -> list[Sequence[float]]:
    """Return the rows of a message's numbers, `count` of equal length."""
    width = len(numbers) // count
    return [numbers[i:i + width] for i in range(0, count * width, width)]


def rows_maker(make: Callable[[Sequence[float]], Record],
               count: int) -> Callable[[Sequence[float]], Any]:
    """Return the function that makes the records of a message's numbers.

    Args:
        make: Makes one record of its numbers, as `State.from_numbers`.
        count: Number of axes; one has no rows: the record itself is returned.
    """
    if count == 1:
        return make
    return lambda numbers: Rows(map(make, split(numbers, count)))


def uneven(labels: Sequence[str], numbers: Sequence[float], count: int) -> str:
    """Return the field in which rows differ that must be the same in all; '' = none."""
    width = len(labels)
    for name in SHARED:
        if name in labels:
            place = labels.index(name)
            if numbers[place::width].count(numbers[place]) != count:
                return name
    return ''


def joined_numbers(rows: Iterable[Any]) -> tuple[float, ...]:
    """Return numbers of one axis as they are, rows of several one after the other."""
    return tuple(number for row in rows for number in (row if isinstance(row, tuple) else (row,)))

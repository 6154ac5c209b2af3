# SPDX-License-Identifier: Apache-2.0
"""Way-points in CSV files: columns t [s] and x [unit of x], one point a line."""

from __future__ import annotations

import math
from pathlib import Path

from dz_ros.errors import ConfigurationError
from dz_ros.files.yaml12 import MOST_BYTES

KEY = 'trajectory.file'
"""Configuration key that names such a file."""


def read_waypoints(path: Path, key: str = KEY) -> tuple[list[float], list[float]]:
    """Return times [s] and positions [unit of x] of a CSV file with columns t, x.

    A first line of words is a header; empty lines and those that start with # are skipped.

    Args:
        path: The file.
        key: Key that names it, for errors.

    Raises:
        ConfigurationError: Missing or unreadable file, a line that is not two finite numbers,
            times that do not increase; the line is named.
    """
    def fail(problem: str) -> ConfigurationError:
        return ConfigurationError(key, str(path), problem)

    try:
        if path.exists() and not path.is_file():
            raise fail('is not a file')
        if path.stat().st_size > MOST_BYTES:
            raise fail(f'is larger than {MOST_BYTES} bytes')
        text = path.read_text(encoding='utf-8-sig')
    except FileNotFoundError:
        raise fail('no such file') from None
    except UnicodeDecodeError:
        raise fail('is not a text file in UTF-8') from None
    except OSError as error:
        raise fail(f'cannot be read: {error.strerror}') from error
    times: list[float] = []
    positions: list[float] = []
    first = True
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith('#'):
            continue
        values = [_number(cell) for cell in line.split(',')]
        header = first and len(values) == 2 and values == [None, None]
        first = False
        if header:
            continue
        if len(values) != 2 or values[0] is None or values[1] is None or not (
                math.isfinite(values[0]) and math.isfinite(values[1])):
            raise fail(f'line {number}: must be two finite numbers t, x, found '
                       f'{line.strip()[:80]!r}')
        if times and values[0] <= times[-1]:
            raise fail(f'line {number}: times must increase, {values[0]:g} follows {times[-1]:g}')
        times.append(values[0])
        positions.append(values[1])
    if not times:
        raise fail('holds no way-points')
    return times, positions


def _number(text: str) -> float | None:
    """Return the number a cell holds, or None."""
    try:
        return float(text)
    except ValueError:
        return None

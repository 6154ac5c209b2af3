# SPDX-License-Identifier: Apache-2.0
"""The last minutes as one ring of rows, all its memory taken at once, so that it cannot grow."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HEAD = struct.Struct('<IIIId')
"""Head of a frame: kind, generation or request, rows, run, server's time [s since the epoch]."""
LIVE, ANSWER = 1, 2
"""Kinds of frames: rows as they come; rows that were asked for."""
CHUNK = 2000
"""Most rows in a frame."""
MOST_BYTES = 256 << 20
"""Most memory of a table, however many columns and rows are asked for."""
FRAME_BYTES = 8 << 20
"""Most bytes of a frame."""


class History:
    """Rows by their count since the start.

    Args:
        width: Columns.
        capacity: Rows kept, as far as `MOST_BYTES` allow.
        generation: Number of this table; another one means that its columns changed.

    Attributes:
        head: Rows appended so far.
    """

    def __init__(self, width: int, capacity: int, generation: int = 0) -> None:
        largest = max(MOST_BYTES // (8 * max(width, 1)), 1)
        self._rows = np.full((max(min(capacity, largest), 1), width), np.nan)
        self._chunk = max(min(CHUNK, FRAME_BYTES // (8 * max(width, 1))), 1)
        self.generation = generation
        self.head = 0
        self._cached: tuple[int, int, bytes] = (0, 0, b'')

    def __len__(self) -> int:
        """Return the number of rows kept."""
        return min(self.head, len(self._rows))

    @property
    def nbytes(self) -> int:
        """Memory taken [bytes]."""
        return self._rows.nbytes

    def append(self, rows: Array) -> None:
        """Add rows, shape (N, width); the oldest make room."""
        capacity = len(self._rows)
        rows_left = rows[-capacity:]
        self.head += len(rows)
        end = self.head % capacity
        start = end - len(rows_left)
        if start >= 0:
            self._rows[start:end] = rows_left
        else:
            self._rows[start:] = rows_left[:-start]
            self._rows[:end] = rows_left[-start:]

    def begin(self, rows: float) -> int:
        """Return the count of the first of the last `rows` rows."""
        return self.head - int(min(max(rows, 0), len(self)))

    def rows(self, first: int, last: int) -> Array:
        """Return the rows with counts first … last − 1 that are still kept, a copy."""
        capacity = len(self._rows)
        first = max(first, self.head - len(self))
        last = max(min(last, self.head), first)
        return self._rows.take(np.arange(first, last), axis=0, mode='wrap') if (
            last > capacity) else self._rows[first:last].copy()

    def frame(self, cursor: int, now: float) -> tuple[bytes, int]:
        """Return a frame with the rows from a count on, and the count after them.

        Viewers that keep up ask for the same rows, which are then packed once.
        """
        first, last, packed = self._cached
        if packed and (first, last) == (cursor, self.head):
            return packed, last
        last = min(self.head, max(cursor, self.head - len(self)) + self._chunk)
        rows = self.rows(cursor, last)
        packed = pack(LIVE, self.generation, rows, 0, now)
        if last == self.head:
            self._cached = (cursor, last, packed)
        return packed, last


def pack(kind: int, number: int, rows: Array, run: int, now: float) -> bytes:
    """Return a frame.

    Args:
        kind: `LIVE` or `ANSWER`.
        number: Generation, or the number of what was asked.
        rows: Shape (N, width).
        run: Which of several runs.
        now: Server's time [s since the epoch].
    """
    body = np.ascontiguousarray(rows, '<f8').tobytes()
    return HEAD.pack(kind, number, len(rows), run, now) + body

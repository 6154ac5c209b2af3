# SPDX-License-Identifier: Apache-2.0
"""Which sample each row of a log is, by its time alone (ours)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AHEAD = 50
"""Rows behind a late one that show whether it was late or rows are missing before it."""
PULL = 0.1
"""Share of a row's lateness by which the time of the next one is expected later."""
RESTART_AFTER = 10.0
"""Behind a gap of more periods than this the next row is on time, whenever it comes."""
REPEATED_WITHIN = 0.25
"""A row that is not late, this share of a period behind another one, repeats its sample."""


def row_numbers(t: Array, period: float) -> Array:
    """Return the number of the sample that each row is, shape (N,); of rows that repeat one, its.

    A row's number is one more than that of the row before, and more only where it and all behind
    it come later by whole periods: a row that is late alone, or a burst behind a stall, is not
    evidence of rows that are missing. When the next row is expected follows the rows slowly, so
    that a rate known to a per mille does not slip by a sample in a long log.

    Args:
        t: Times [s], each later than the one before, shape (N,).
        period: Of the rows [s].
    """
    times: list[float] = t.tolist()
    count, found, expected = len(times), [0.0], times[0]

    def passed(row: int) -> int:
        """Return the number of periods between the row before and a row."""
        return round((times[row] - expected) / period)

    for row in range(1, count):
        step = passed(row)
        if step > 1:
            step = max(1, min(passed(later) - later + row
                              for later in range(row, min(row + AHEAD, count))))
        elif step < 1:
            near = times[row] - times[row - 1] < REPEATED_WITHIN * period
            if near and row + 1 < count and passed(row + 1) < 2:
                found.append(found[-1])
                continue
            step = 1
        found.append(found[-1] + step)
        expected += step * period
        late = times[row] - expected
        if step > RESTART_AFTER:
            expected = times[row]
        elif abs(late) < 0.5 * period:
            expected += PULL * late
    return np.array(found)

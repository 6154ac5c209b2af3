# SPDX-License-Identifier: Apache-2.0
"""How long things took, as the page draws it: counts in bins, quantiles, how many were late.

A period is *late* more than 1 ms beyond T and *too late* more than T beyond it, a round trip
beyond 1 ms and beyond T, as in the report (`dz_ros.runs.timing`); what is too late is late as
well.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.lateness import LATE
from dz_ros.core.percentiles import percentile

BINS = 48
NAMES = ('interval', 'round_trip')
"""Columns that are counted."""


def counts(values: NDArray[np.float64], name: str, period: float) -> dict[str, Any]:
    """Return what the page draws of some times.

    Args:
        values: Times [s], shape (N,); those that are not > 0 are none.
        name: Column they are of.
        period: T [s].

    Returns:
        Numbers, times in s: count, p50, p99, max, late, too_late, low and high (the middles'
        span), bins (counts, the first and the last with what lies beyond).
    """
    found = np.sort(values[values > 0.0])
    size = len(found)
    if not size:
        return {'count': 0}
    base = period if name == 'interval' else 0.0
    low = max(0.0, base - 2.0 * LATE) if base else 0.0
    high = base + 2.0 * LATE if base else max(1.15 * percentile(found, 0.99), 1e-6)
    bins = np.clip((found - low) / (high - low) * BINS, 0, BINS - 1).astype(int)
    return {'count': size, 'p50': percentile(found, 0.5), 'p99': percentile(found, 0.99),
            'max': float(found[-1]),
            'late': int((found > base + LATE).sum()),
            'too_late': int((found > base + period).sum()), 'low': low, 'high': high,
            'bins': np.bincount(bins, minlength=BINS).tolist()}

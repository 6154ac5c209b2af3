# SPDX-License-Identifier: Apache-2.0
"""The percentile that every table and picture of durations shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from numpy.typing import NDArray

SHARES = {'p50': 0.5, 'p99': 0.99, 'p999': 0.999}
"""Name of a percentile → share of all that it is not below."""


def percentile(ordered: Sequence[float] | NDArray[Any], share: float) -> float:
    """Return the value below which a share of all lies, one of those given.

    Args:
        ordered: Values in ascending order, at least one.
        share: 0 … 1.
    """
    return float(ordered[min(len(ordered) - 1, int(share * len(ordered)))])

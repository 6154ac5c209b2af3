# SPDX-License-Identifier: Apache-2.0
"""The smooth step from 0 to 1 that other trajectories are made of (ours).

    σ(u) = 126 u⁵ − 420 u⁶ + 540 u⁷ − 315 u⁸ + 70 u⁹,   σ'(u) = 630 u⁴ (1 − u)⁴,   0 ≤ u ≤ 1

The polynomial of least degree that leaves 0 and reaches 1 with four derivatives zero: continuous
through the fourth, so a plant of order 4 can follow it.
"""

from __future__ import annotations

CONTINUOUS = 4
"""Highest continuous derivative of the smooth step."""

_COEFFICIENTS = (126.0, -420.0, 540.0, -315.0, 70.0)


def smooth_step(u: float, derivative: int) -> float:
    """Return σ (derivative 0) or its derivative at u; 0 before u = 0, the step after u = 1."""
    if u <= 0.0:
        return 0.0
    if u >= 1.0:
        return 1.0 if derivative == 0 else 0.0
    late = u > 0.5  # σ(u) = 1 − σ(1 − u): near the end, without cancellation
    z = 1.0 - u if late else u
    total = 0.0
    lowest = max(5, derivative)  # products, no powers: the same digits when compiled
    for power in range(9, lowest - 1, -1):
        factor = _COEFFICIENTS[power - 5]
        for j in range(derivative):
            factor *= power - j
        total = total * z + factor
    for _ in range(lowest - derivative):
        total *= z
    if not late or derivative % 2 == 1:
        return total
    return 1.0 - total if derivative == 0 else -total

# SPDX-License-Identifier: Apache-2.0
"""Interpolating spline of degree 2n + 1 that starts and ends at rest.

Of all curves through (t_k, x_k) with x', …, x^(n) zero at both ends, the one with the least
∫ (x^(n+1))² dt; continuous through the derivative 2n.

The unknowns are x', …, x^(n) at the inner points; that the derivatives n + 1 … 2n of neighbouring
pieces agree there is a linear system of n × n blocks, three in a row, solved by elimination.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def spline(times: Sequence[float], positions: Sequence[float], order: int) -> Array:
    """Return the pieces of the smoothest curve, shape (points − 1, 2·order + 2).

    Piece k is Σ_j c_kj u^j with u = (t − t_k)/(t_{k+1} − t_k); times t_k increase, order n ≥ 1.
    """
    n = order
    t, x = np.asarray(times, dtype=float), np.asarray(positions, dtype=float)
    unit = float(t[-1] - t[0]) / (len(t) - 1)  # keeps the powers of the lengths near 1
    powers = (np.diff(t)[:, None] / unit) ** np.arange(2 * n + 1)
    from_ends, at_start, at_end = _piece(n)
    values = np.zeros((len(t), n + 1))
    values[:, 0] = x
    inner = len(t) - 2
    diagonal, right, known = np.zeros((inner, n, n)), np.zeros((inner, n, n)), np.zeros((inner, n))
    for k in range(inner):
        before, after = powers[k], powers[k + 1]
        ending = at_end / before[n + 1:, None]
        starting = at_start / after[n + 1:, None]
        same = (ending[:, n + 1:] * before[:n + 1] - starting[:, :n + 1] * after[:n + 1])
        left = ending[:, :n + 1] * before[:n + 1]
        onward = -starting[:, n + 1:] * after[:n + 1]
        known[k] = -(left[:, 0] * x[k] + same[:, 0] * x[k + 1] + onward[:, 0] * x[k + 2])
        diagonal[k], right[k] = same[:, 1:], onward[:, 1:]
        if k > 0:
            factor = np.linalg.solve(diagonal[k - 1].T, left[:, 1:].T).T
            diagonal[k] -= factor @ right[k - 1]
            known[k] -= factor @ known[k - 1]
    for k in range(inner - 1, -1, -1):
        rest = known[k] - right[k] @ values[k + 2, 1:]
        values[k + 1, 1:] = np.linalg.solve(diagonal[k], rest)
    ends = np.hstack((values[:-1] * powers[:, :n + 1], values[1:] * powers[:, :n + 1]))
    return np.asarray(ends @ from_ends.T)


def _piece(n: int) -> tuple[Array, Array, Array]:
    """Return maps from end values of a piece to coefficients, derivatives n + 1 … 2n at ends."""
    size = 2 * n + 2
    falling = np.array([[float(math.perm(j, m)) for j in range(size)] for m in range(size)])
    at_zero = np.diag(np.diag(falling))
    to_ends = np.vstack((at_zero[:n + 1], falling[:n + 1]))
    from_ends = np.linalg.inv(to_ends)
    high = slice(n + 1, 2 * n + 1)
    return from_ends, at_zero[high] @ from_ends, falling[high] @ from_ends

# SPDX-License-Identifier: Apache-2.0
"""Interpolating spline of degree 2n + 1 that starts and ends at rest.

Of all curves through (t_k, x_k) with x', …, x^(n) zero at both ends, the one with the least
∫ (x^(n+1))² dt; continuous through the derivative 2n.

The unknowns are x', …, x^(n) at the inner points; that the derivatives n + 1 … 2n of neighbouring
pieces agree there is a linear system of n × n blocks, three in a row.
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
    before, after = powers[:-1, None], powers[1:, None]
    ending = at_end / before[..., n + 1:].swapaxes(1, 2)
    starting = at_start / after[..., n + 1:].swapaxes(1, 2)
    left = ending[..., :n + 1] * before[..., :n + 1]
    same = ending[..., n + 1:] * before[..., :n + 1] - starting[..., :n + 1] * after[..., :n + 1]
    right = -starting[..., n + 1:] * after[..., :n + 1]
    known = -(left[..., 0] * x[:-2, None] + same[..., 0] * x[1:-1, None]
              + right[..., 0] * x[2:, None])
    values[1:-1, 1:] = _three_in_a_row(left[..., 1:], same[..., 1:], right[..., 1:],
                                       known[..., None])[..., 0]
    ends = np.hstack((values[:-1] * powers[:, :n + 1], values[1:] * powers[:, :n + 1]))
    return np.asarray(ends @ from_ends.T)


def _three_in_a_row(left: Array, same: Array, right: Array, known: Array) -> Array:
    """Return y with left_k y_{k−1} + same_k y_k + right_k y_{k+1} = known_k, by cyclic reduction.

    Every other unknown is eliminated at once, and of what is left every other one again: some
    steps on whole arrays in place of one for each point.

    Args:
        left: Shape (points, n, n); the first is not used.
        same: Shape (points, n, n).
        right: Shape (points, n, n); the last is not used.
        known: Shape (points, n, 1).
    """
    if len(same) <= 1:
        return np.asarray(np.linalg.solve(same, known))
    odd = slice(1, None, 2)
    solved = np.linalg.solve(same[::2], np.concatenate((left, right, known), axis=2)[::2])
    n = same.shape[1]
    if len(same) % 2 == 0:      # the last one has no neighbour behind it
        solved = np.concatenate((solved, np.zeros((1, n, 2 * n + 1))))
    ahead, behind = left[odd] @ solved[:-1], right[odd] @ solved[1:]
    found = np.zeros(known.shape)
    found[odd] = _three_in_a_row(-ahead[..., :n], same[odd] - ahead[..., n:-1] - behind[..., :n],
                                 -behind[..., n:-1], known[odd] - ahead[..., -1:]
                                 - behind[..., -1:])
    around = np.concatenate((np.zeros((1, n, 1)), found[odd], np.zeros((1, n, 1))))
    solved = solved[:len(found[::2])]
    found[::2] = (solved[..., -1:] - solved[..., :n] @ around[:len(solved)]
                  - solved[..., n:-1] @ around[1:len(solved) + 1])
    return found


def _piece(n: int) -> tuple[Array, Array, Array]:
    """Return maps from end values of a piece to coefficients, derivatives n + 1 … 2n at ends."""
    size = 2 * n + 2
    falling = np.array([[float(math.perm(j, m)) for j in range(size)] for m in range(size)])
    at_zero = np.diag(np.diag(falling))
    to_ends = np.vstack((at_zero[:n + 1], falling[:n + 1]))
    from_ends = np.linalg.inv(to_ends)
    high = slice(n + 1, 2 * n + 1)
    return from_ends, at_zero[high] @ from_ends, falling[high] @ from_ends

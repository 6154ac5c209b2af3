# SPDX-License-Identifier: Apache-2.0
"""Tracking error, filtered error and the boundary layer, (8), (10), (11), (17) of [wang2004].

    x̃ = x − x_d
    s = Λᵀ x̃,      Λ   = [λ^(n−1), (n−1) λ^(n−2), …, 1]      coefficients of (p + λ)^(n−1)
    u_fd = x_d^(n) − Λ_vᵀ x̃,   Λ_v = [0, λ^(n−1), (n−1) λ^(n−2), …, (n−1) λ]
    s_ε = s − ε sat(s/ε)

n: order of the plant, λ [1/s], ε: half-width of the boundary layer, unit of s = unit of x^(n−1).
"""

from __future__ import annotations

from collections.abc import Sequence
import math


def sat(z: float) -> float:
    """Return z limited to [−1, 1], (10)."""
    if z > 1.0:
        return 1.0
    if z < -1.0:
        return -1.0
    return z


def shown_position(x: float, x_d: float, band: float) -> float:
    """Return x less the part of x − x_d within ±band, what a law is shown of it (ours)."""
    error = x - x_d
    if error > band:
        return x - band
    if error < -band:
        return x + band
    return x_d


def error_weights(lambda_: float, order: int) -> tuple[float, ...]:
    """Return Λ, the binomial weights of (8), shape (order,)."""
    return tuple(math.comb(order - 1, i) * lambda_ ** (order - 1 - i) for i in range(order))


def feed_forward_weights(lambda_: float, order: int) -> tuple[float, ...]:
    """Return Λ_v of (17), shape (order,)."""
    return (0.0, *error_weights(lambda_, order)[:-1])


def filtered_error(c: Sequence[float], at: int, x_d: Sequence[float],
                   x: Sequence[float]) -> float:
    """Return s = Λᵀ x̃, (8); Λ is in c from index `at` on."""
    s = 0.0
    for i in range(len(x)):
        s += c[at + i] * (x[i] - x_d[i])
    return s


def feed_forward(c: Sequence[float], at: int, x_d: Sequence[float], x: Sequence[float]) -> float:
    """Return u_fd = x_d^(n) − Λ_vᵀ x̃, (17); Λ_v is in c from index `at` on."""
    u_fd = x_d[len(x)]
    for i in range(len(x)):
        u_fd -= c[at + i] * (x[i] - x_d[i])
    return u_fd


def outside_layer(s: float, epsilon: float) -> float:
    """Return s_ε = s − ε sat(s/ε), (11): the distance of s from the layer, with its sign."""
    return s - epsilon * sat(s / epsilon)


def guaranteed_bounds(lambda_: float, epsilon: float, order: int) -> tuple[float, ...]:
    """Return Ω_ε: |x̃_i| ≤ 2^(i−1) λ^(i−n) ε, i = 1…n, the set x̃ converges to, shape (order,)."""
    return tuple(2.0 ** (i - 1) * lambda_ ** (i - order) * epsilon for i in range(1, order + 1))

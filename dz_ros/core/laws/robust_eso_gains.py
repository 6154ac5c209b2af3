# SPDX-License-Identifier: Apache-2.0
"""Gains of `robust_eso` from rate, delay and bounds of the input gain, by rule (ours).

    β = b_max m_max, b̂ = mean of the bounds of b
    K0 = f μ_d/(β T),  μ_d = 2 sin(π/(2(2d + 1)))      f = 0.375, quiet 0.26
    λ = K0 b̂/6 (quiet K0 b̂/7),  a = λ/5,  ω_o = 0.83 K0 b̂,  k_2 = ⅔ K0,  k_d ≤ K0/6
    Δ = k*/4,  ρ0 = 0.3 k*,  ρ1 = 10 k*
    θ̂ ∈ [0.1, 3] θ_nominal,  φ̂ ∈ [0.3, 2.5] φ_nominal

λ is the same for every order n. k* is not among them: it follows from (18), ρ0 and the stated
disturbance. The quiet set takes about as much effort under measurement noise as `robust`.

Where the velocity is observed from positions with noise σ (one step q of an encoder: q/√12):

    ω = 3 K0 b̂,  λ = K0 b̂/7,  ω_o = 0.6 K0 b̂,  k_2 = 0.66 K0
    K0 the largest with K0 σ √(λ² + G(ω)²) ≤ k*/10, G of the observer `tracking`, and f ≤ 0.3

ω = 2.2 K0 b̂ passes less noise; with a sample of delay it is calm up to b m = 1.2 b̂ only (K 30).
With f = 0.3 and ω = 3 K0 b̂ that is 1.35 b̂. A faster observer has the f = 0.375 of a measured
velocity: with 1.2 times that ω it is calm as far.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

from dz_ros.core.design.boundary_layer import chatter_limit
from dz_ros.core.observers.base import noise_gain
from dz_ros.core.observers.tracking import Tracking

SHARE, QUIET_SHARE = 0.375, 0.26
"""f: share of the chatter limit that K0 uses."""

ENCODER_SHARE, OBSERVER_RATE = 0.3, 3.0
"""f where the velocity is observed, and ω over K0 b̂."""
ALLOWED = 0.1
"""Noise of v from an observed velocity, as a standard deviation over k*."""


def gains_by_rule(period: float, b_bounds: Sequence[float], m_bounds: Sequence[float],
                  k_star: float, k_d: float, theta: Sequence[float], phi: float, delay: int = 1,
                  quiet: bool = False) -> dict[str, Any]:
    """Return the gains of `robust_eso` that the rules give, by key.

    b_bounds, m_bounds: least and largest b [unit of x^(n) per actuator unit] and m [1]; k_d:
        largest
    damping gain wanted; theta, phi: nominal a_i/(b m), shape (r,), and 1/(b m); delay: design
    delay d [samples]; quiet: the set for noisy sensors.
    """
    beta, mean = b_bounds[1] * m_bounds[1], 0.5 * (b_bounds[0] + b_bounds[1])
    gain = (QUIET_SHARE if quiet else SHARE) * chatter_limit(delay) / (beta * period)
    slope = gain * mean / (7.0 if quiet else 6.0)
    # A negative weight turns its bounds around.
    pairs = [sorted((0.1 * item, 3.0 * item)) for item in theta]
    return {'layer_gain': gain, 'design_delay': delay, 'lambda': slope, 'start_rate': 0.2 * slope,
            'observer_rate': 0.83 * gain * mean, 'input_gain': mean, 'k_2': 2.0 * gain / 3.0,
            'k_d': min(k_d, gain / 6.0), 'identifier_band': 0.25 * k_star, 'rho_0': 0.3 * k_star,
            'rho_1': 10.0 * k_star, 'theta_min': [low for low, _ in pairs],
            'theta_max': [high for _, high in pairs], 'phi_min': 0.3 * phi, 'phi_max': 2.5 * phi}


def gains_for_encoder(period: float, sigma: float, beta: float, mean: float, k_star: float,
                      delay: int = 1, faster: float = 1.0) -> dict[str, float]:
    """Return K0, λ, a, ω_o, k_2 of `robust_eso` with an observed velocity, by key.

    Args:
        period: T [s].
        sigma: Standard deviation of the position's noise [unit of x].
        beta: b_max m_max [unit of x^(n) / actuator unit].
        mean: b̂ [unit of x^(n) / actuator unit].
        k_star: k* [actuator unit].
        delay: Design delay d [samples].
        faster: ω over 3 K0 b̂; one above 1 lags less, so that f is that of a measured velocity.
    """
    share = SHARE if faster > 1.0 else ENCODER_SHARE
    most = share * chatter_limit(delay) / (beta * period)

    def noise(gain: float) -> float:
        rate = gain * mean
        passes = noise_gain(Tracking.linear(faster * OBSERVER_RATE * rate, period))
        return gain * sigma * math.hypot(rate / 7.0, passes)

    low, high = 0.05 * ENCODER_SHARE / share * most, most      # the same for all observers
    if noise(high) <= ALLOWED * k_star:
        low = high
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if noise(middle) <= ALLOWED * k_star else (low, middle)
    rate = low * mean
    return {'layer_gain': low, 'lambda': rate / 7.0, 'start_rate': rate / 35.0,
            'observer_rate': 0.6 * rate, 'k_2': 0.66 * low}

"""The boundary layer of a sampled loop: how steep it may be, how thin it may be (ours).

Inside the layer |s| ≤ ε the laws of this family are linear in x^(n−1) with the slope

    K + Λ_v,n φ̂,     K = k_d + k*/ε,     Λ_v,n = (n − 1) λ                 (λ for n = 2)

which the actuator and the plant turn into β = b m times as much of x^(n). Sampled with T and
delayed by d whole samples, s_{k+1} = s_k − g s_{k−d} with g = (K + Λ_v,n φ̂) β T, whose roots leave
the unit circle at

    g = μ_d = 2 sin(π / (2 (2d + 1)))      = 2, 1, 0.618, 0.445 for d = 0, 1, 2, 3

Beyond it the loop chatters: |x̃| hardly changes, the total variation of v rises a hundredfold.
Solved for ε this is ε_crit, the thinnest usable layer; the automatic ε keeps a share f of μ_d. The
rule is exact for d = 0; for d ≥ 1 it leaves out the lower states and is too hopeful by about
(n − 1) d λ T/2 (by 2 % for n = 2, d = 2, λ T = 0.02).

An integral v_I' = r_I s inside the layer takes some of the room for d ≥ 1: then the roots of

    (z − 1)² z^d + T β [K (z − 1) + T r_I]

have to stay inside the unit circle. Laws make r_I = K²/q, so a thinner layer has a faster
integral; `largest_gain` is the K, `critical_epsilon` the ε at which both together leave it.
"""

from __future__ import annotations

import math

import numpy as np

from dz_ros.errors import ConfigurationError


def layer_gain(k_d: float, k_star: float, epsilon: float) -> float:
    """Return K = k_d + k*/ε, the slope of v against s in the layer [actuator unit / unit of s]."""
    return k_d + k_star / epsilon


def chatter_limit(delay: int) -> float:
    """Return μ_d, the largest loop gain a sample [1] for a loop delay of d samples."""
    return 2.0 * math.sin(math.pi / (2.0 * (2 * delay + 1)))


def loop_gain(slope: float, beta: float, period: float) -> float:
    """Return g, what one sample corrects of the error it sees [1].

    Args:
        slope: K + Λ_v,n φ̂ [actuator unit / unit of s].
        beta: b m [unit of x^(n) / actuator unit].
        period: T [s].
    """
    return slope * beta * period


def largest_beta(slope: float, integral_rate: float, period: float, delay: int) -> float:
    """Return the largest β = b m [unit of x^(n) / actuator unit] without chatter; 0 = none.

    Args:
        slope: K + Λ_v,n φ̂ [actuator unit / unit of s].
        integral_rate: r_I [actuator unit / unit of s / s]; 0 = no integral.
        period: T [s].
        delay: Loop delay d [samples].
    """
    limit = chatter_limit(delay) / (slope * period)
    if integral_rate <= 0.0:
        return limit

    low, high = 1e-3 * limit, 2.0 * limit
    if not _calm(low, slope, integral_rate, period, delay):
        return 0.0
    while high - low > 1e-4 * limit:
        middle = 0.5 * (low + high)
        calm = _calm(middle, slope, integral_rate, period, delay)
        low, high = (middle, high) if calm else (low, middle)
    return low


def _calm(beta: float, slope: float, integral_rate: float, period: float, delay: int) -> bool:
    """Return whether the roots with an integral lie inside the unit circle."""
    polynomial = np.zeros(delay + 3)
    polynomial[:3] = 1.0, -2.0, 1.0
    polynomial[-2:] += (period * beta * slope,
                        period * beta * (period * integral_rate - slope))
    return bool(np.abs(np.roots(polynomial)).max() < 1.0)


def largest_gain(lead: float, divisor: float, beta: float, period: float, delay: int) -> float:
    """Return the largest K without chatter [actuator unit / unit of s]; not positive = none.

    Args:
        lead: Λ_v,n φ̂ [actuator unit / unit of s].
        divisor: q of an integral with r_I = K²/q; 0 = no integral.
        beta: b m [unit of x^(n) / actuator unit].
        period: T [s].
        delay: Loop delay d [samples].
    """
    limit = chatter_limit(delay) / (beta * period)
    if divisor <= 0.0:
        return limit - lead
    low, high = 0.0, 2.0 * limit - lead
    while high - low > 1e-5 * limit:
        gain = 0.5 * (low + high)
        calm = _calm(beta, gain + lead, gain * gain / divisor, period, delay)
        low, high = (gain, high) if calm else (low, gain)
    return low


def critical_epsilon(k_star: float, k_d: float, lead: float, beta: float, period: float,
                     delay: int, divisor: float = 0.0) -> float:
    """Return ε_crit, the half-width below which the loop chatters; inf where none is enough.

    Args:
        k_star: k* [actuator unit].
        k_d: Damping gain [actuator unit / unit of s].
        lead: Λ_v,n φ̂ [actuator unit / unit of s].
        beta: b m [unit of x^(n) / actuator unit].
        period: T [s].
        delay: Loop delay d [samples].
        divisor: q of an integral with r_I = K²/q; 0 = no integral.
    """
    room = largest_gain(lead, divisor, beta, period, delay) - k_d
    return k_star / room if room > 0.0 else math.inf


def automatic_epsilon(k_star: float, k_d: float, lead: float, beta: float, period: float,
                      delay: int, margin: float) -> float:
    """Return ε = k* / (f μ_d/(β T) − k_d − Λ_v,n φ̂), the layer for a design delay.

    Args:
        k_star: k* [actuator unit].
        k_d: Damping gain [actuator unit / unit of s].
        lead: Λ_v,n φ̂ [actuator unit / unit of s].
        beta: Largest b m, from the bounds [unit of x^(n) / actuator unit].
        period: T [s].
        delay: Design delay d of the loop [samples], not the one of the moment.
        margin: Share f of μ_d that is used, 0 < f < 1.

    Raises:
        ConfigurationError: No ε is usable at this rate; names the rate or gain that would do.
    """
    allowed = margin * chatter_limit(delay)
    room = allowed / (beta * period) - k_d - lead
    if room <= 0.0:
        rate = (k_d + lead) * beta / allowed
        raise ConfigurationError(
            'controller.automatic_epsilon', True,
            f'no layer is wide enough at {1.0 / period:g} Hz: needs loop.rate above {rate:.4g} '
            f'Hz, or k_d below {allowed / (beta * period) - lead:.4g}')
    return k_star / room

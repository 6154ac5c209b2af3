# SPDX-License-Identifier: Apache-2.0
"""The boundary layer of a sampled loop: how steep it may be, how thin it may be (ours).

Inside |s| ≤ ε the laws of this family have the slope K + Λ_v,n φ̂ against x^(n−1), K = k_d + k*/ε,
Λ_v,n = (n − 1) λ, which the actuator and the plant turn into β = b m times as much of x^(n).
Sampled with T and delayed by d samples, s_{k+1} = s_k − g s_{k−d} with g = (K + Λ_v,n φ̂) β T is
stable for

    g < μ_d = 2 sin(π / (2 (2d + 1)))      = 2, 1, 0.618, 0.445 for d = 0, 1, 2, 3

Beyond it the loop chatters. Exact for d = 0; too hopeful by about (n − 1) d λ T/2 for d ≥ 1: by it
laws choose K, margins come from `dz_ros.core.design.linear_loop` (mathematics.md §5, §12).
"""

from __future__ import annotations

import math

from dz_ros.errors import ConfigurationError


def layer_gain(k_d: float, k_star: float, epsilon: float) -> float:
    """Return K = k_d + k*/ε, the slope of v against s in the layer [actuator unit / unit of s]."""
    return k_d + k_star / epsilon


def chatter_limit(delay: int) -> float:
    """Return μ_d, the largest loop gain a sample [1] for a loop delay of d samples."""
    return 2.0 * math.sin(math.pi / (2.0 * (2 * delay + 1)))


def automatic_epsilon(k_star: float, k_d: float, lead: float, beta: float, period: float,
                      delay: int, margin: float) -> float:
    """Return ε = k* / (f μ_d/(β T) − k_d − Λ_v,n φ̂), the layer for a design delay.

    k_d and lead = Λ_v,n φ̂ are in actuator units per unit of s, beta is the largest b m [unit of
    x^(n) per actuator unit], delay the design delay [samples], margin the share f of μ_d, 0 < f <
    1.

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

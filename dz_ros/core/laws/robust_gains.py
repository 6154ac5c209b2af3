"""Gains of `robust` and the numbers derived from them (ours, but for those of [wang2004])."""

from __future__ import annotations

from dataclasses import dataclass

from dz_ros.core.boundary_layer import chatter_limit
from dz_ros.core.laws.extensions import ProjectionGains
from dz_ros.core.schema import parameter

LEAST_GAIN = 1.5
"""K is never below this many k_d, so that ε = k*/(K − k_d) stays finite."""

OUTER = 1.5
"""ε_a = this many ε."""

GUARD_WINDOW = 0.25
"""Crossings of the layer further apart than this do not count as oscillation [s]."""


@dataclass(frozen=True)
class RobustGains(ProjectionGains):
    """Gains of the recommended law; ε is not among them, it follows from K."""

    lambda_: float = parameter(1.0, '1/s', 'slope λ of the filtered error (8); not in the paper',
                               minimum=0.0, open_minimum=True)
    k_d: float = parameter(10.0, 'actuator unit per unit of s', 'damping gain k_d of (14)',
                           minimum=0.0, open_minimum=True)
    k_star: float = parameter(2.5, 'actuator unit', 'robust gain k* of (14), (18)', minimum=0.0,
                              open_minimum=True)
    gamma: float = parameter(0.5, '1', 'adaptation gain γ of (15)', minimum=0.0)
    eta: float = parameter(0.5, '1', 'adaptation gain η of (16)', minimum=0.0)
    theta_0: tuple[float, ...] = parameter(
        (0.85,), '1', 'initial θ̂, one number for each regressor or one for all')
    phi_0: float = parameter(0.85, '1', 'initial φ̂')
    margin: float = parameter(0.445, '1', 'share f of the chatter limit μ_d that K uses',
                              minimum=0.0, maximum=1.0, open_minimum=True)
    beta: float = parameter(1.25, 'unit of x^(n) per actuator unit', 'b_max m_max, for which the '
                            'full margin is wanted', minimum=0.0, open_minimum=True)
    design_delay: int = parameter(1, 'samples', 'loop delay d for which K is made; 1 for a loop '
                                  'over topics', minimum=0, maximum=100)
    gain_cap: float = parameter(120.0, 'actuator unit per unit of s', 'K_cap, the largest K: '
                                'noise of v is about K times that of x^(n−1)', minimum=0.0,
                                open_minimum=True)
    integral_divisor: float = parameter(2.0, '1', 'q of r_I = K²/q; damping √(q b m)/2, 2.5–3 '
                                        'for more', minimum=0.0, open_minimum=True)
    rho_0: float = parameter(1.47, 'actuator unit', 'authority of a wrong-signed integral outside '
                             'ε_a, at most k* − ρ/m_min', minimum=0.0)
    rho_1: float = parameter(16.0, 'actuator unit', 'authority of the integral: above the largest '
                             'expected residual φ̃u + Yᵀθ̃ + d/m, or v_max', minimum=0.0)
    k_2: float = parameter(20.0, 'actuator unit per unit of s', 'outer gain, 2 k_d; 0 for λ ≥ 8 '
                           'on plants with velocity regressors', minimum=0.0)
    v_floor: float = parameter(0.0, 'actuator unit', 'least effort the outer gain may use, a '
                               'normal actuator level: needed when a run starts on the '
                               'trajectory', minimum=0.0)
    v_max: float = parameter(0.0, 'actuator unit', 'what the actuator can do; 0 = not known',
                             minimum=0.0)
    identifier: bool = parameter(False, '', 'identify θ̂, φ̂ inside the layer; no proof with it')


def nominal_gain(gains: RobustGains, period: float) -> float:
    """Return K0 = f μ_d/(β T) [actuator unit / unit of s]."""
    return gains.margin * chatter_limit(gains.design_delay) / (gains.beta * period)


def layer(gains: RobustGains, period: float, kappa_f: float = 1.0) -> tuple[float, float]:
    """Return K = max(min(κ_f K0, K_cap), 1.5 k_d) and ε = k*/(K − k_d)."""
    gain = max(min(kappa_f * nominal_gain(gains, period), gains.gain_cap), LEAST_GAIN * gains.k_d)
    return gain, gains.k_star / (gain - gains.k_d)

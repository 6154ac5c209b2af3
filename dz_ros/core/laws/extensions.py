"""What may be added to the paper's law, one small function a piece, shared by the laws (ours).

    projection            θ̂_i, φ̂ clipped to prior bounds that contain a_i/(bm), 1/(bm)
    late gradient         θ̂_k = θ̂_{k−1} − T γ Y_{k−1} s_k / N,  φ̂_k likewise with η u_{k−1},
                          N = 1 + T (γ|Y_{k−1}|² + η u_{k−1}²)/k_d
    anti-windup           nothing that integrates moves while |v| > v_max and v s < 0
    in-layer integral     v_I' = r_I s only while |s| ≤ ε, |v_I| ≤ ρ_I
    dead-zone feed-forward  v += b̂_r χ_r + b̂_l χ_l,  χ_r = 1/(1 + e^(−2v/e0)),  χ_l = 1 − χ_r

Projection onto a convex set that contains the true parameters, and the normalised gradient, keep
the Lyapunov argument [ioannou_sun1996]. An integral of bounded authority acts as more d/m: the
theorem stays if k* ≥ ρ/m_min + ρ_I. The feed-forward is the smooth dead-zone inverse with fixed
break points [tao_kokotovic1994]; its error acts as d/m too.

Scalar functions without side effect but the buffer they fill; `at` is where, in a longer sequence,
their numbers begin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from dz_ros.core.laws.base import per_regressor
from dz_ros.core.schema import parameter
from dz_ros.errors import ConfigurationError


@dataclass(frozen=True)
class ProjectionGains:
    """Prior bounds of the estimates; the values are ours for the example of [wang2004]."""

    theta_min: tuple[float, ...] = parameter(
        (0.1,), '1', 'lowest θ̂ after projection, one number for each regressor or one for all; '
        'must lie below every a_i/(b m) that can occur')
    theta_max: tuple[float, ...] = parameter(
        (3.0,), '1', 'highest θ̂ after projection; must lie above every a_i/(b m)')
    phi_min: float = parameter(0.3, '1', 'lowest φ̂ after projection; must lie below 1/(b m)')
    phi_max: float = parameter(2.5, '1', 'highest φ̂ after projection; must lie above 1/(b m)')


def projection_box(gains: ProjectionGains, count: int) -> tuple[float, ...]:
    """Return θ̂ minima, θ̂ maxima, φ̂ minimum, φ̂ maximum for `project`, shape (2 count + 2,).

    Raises:
        ConfigurationError: Wrong lengths, or a lower bound above the upper one.
    """
    low = per_regressor(gains.theta_min, count, 'theta_min')
    high = per_regressor(gains.theta_max, count, 'theta_max')
    for minimum, maximum in zip(low, high, strict=True):
        if minimum > maximum:
            raise ConfigurationError('controller.theta_min', list(gains.theta_min),
                                     f'must not exceed theta_max = {list(gains.theta_max)}')
    if gains.phi_min > gains.phi_max:
        raise ConfigurationError('controller.phi_min', gains.phi_min,
                                 f'must not exceed phi_max = {gains.phi_max:g}')
    return (*low, *high, gains.phi_min, gains.phi_max)


def check_start(box: Sequence[float], theta_0: Sequence[float], phi_0: float) -> None:
    """Check that θ̂(0), φ̂(0) lie in the box.

    Raises:
        ConfigurationError: They do not.
    """
    r = len(theta_0)
    for i, value in enumerate(theta_0):
        if not box[i] <= value <= box[r + i]:
            raise ConfigurationError('controller.theta_0', list(theta_0),
                                     f'θ̂_{i + 1}(0) must lie in its projection bounds '
                                     f'[{box[i]:g}, {box[r + i]:g}]')
    if not box[2 * r] <= phi_0 <= box[2 * r + 1]:
        raise ConfigurationError('controller.phi_0', phi_0, 'must lie in its projection bounds '
                                 f'[{box[2 * r]:g}, {box[2 * r + 1]:g}]')


def clip(value: float, low: float, high: float) -> float:
    """Return the value limited to [low, high]."""
    if value < low:
        return low
    if value > high:
        return high
    return value


def project(box: Sequence[float], at: int, count: int, estimates: Any) -> None:
    """Clip θ̂, φ̂ (the first count + 1 estimates) in place to the box that starts at `at`."""
    for i in range(count):
        estimates[i] = clip(estimates[i], box[at + i], box[at + count + i])
    estimates[count] = clip(estimates[count], box[at + 2 * count], box[at + 2 * count + 1])


def late_gradient(gamma: float, eta: float, k_d: float, dt: float, s_a: float,
                  before: Sequence[float], at: int, count: int, u_before: float,
                  estimates: Any) -> None:
    """Move θ̂, φ̂ in place by the gradient of the sample before and the error it led to.

    Args:
        gamma: γ.
        eta: η.
        k_d: Damping gain, the scale of N.
        dt: Interval between the two samples [s].
        s_a: Distance of s from the layer now.
        before: Holds Y of the sample before from index `at` on.
        at: Index of Y_1.
        count: Number r of regressors.
        u_before: u_fd of the sample before.
        estimates: θ̂_1 … θ̂_r, φ̂ (and what follows).
    """
    power = 0.0
    for i in range(count):
        power += before[at + i] * before[at + i]
    step = dt * s_a / (1.0 + dt * (gamma * power + eta * u_before * u_before) / k_d)
    for i in range(count):
        estimates[i] -= step * gamma * before[at + i]
    estimates[count] -= step * eta * u_before


def exceeds(v: float, v_max: float) -> bool:
    """Return whether a command exceeds the known limit; 0 = no limit is known."""
    return v_max > 0.0 and (v > v_max or v < -v_max)


def winds_up(v: float, v_max: float, s: float) -> bool:
    """Return whether the command exceeds the known limit and pushes against s."""
    return exceeds(v, v_max) and ((v > 0.0 and s < 0.0) or (v < 0.0 and s > 0.0))


def right_share(v: float, e0: float) -> float:
    """Return χ_r = 1/(1 + e^(−2v/e0)), how far v is on the right; χ_l = 1 − χ_r."""
    return 0.5 * (1.0 + math.tanh(v / e0))


def break_point(v: float, b_r: float, b_l: float, e0: float) -> float:
    """Return b_r χ_r + b_l χ_l, what to add to v to leave the dead-zone on its side."""
    right = right_share(v, e0)
    return b_r * right + b_l * (1.0 - right)


def largest_rest(guess: Sequence[float], b_r_bounds: Sequence[float],
                 b_l_bounds: Sequence[float]) -> float:
    """Return the largest |d̂ − d|/m that the feed-forward leaves to k* [actuator unit] (ours).

    With δ = b̂_r χ_r + b̂_l χ_l the actuator gets v = v_d + δ; of m v_d it misses m (δ − b_r) where
    v ≥ b_r, m (δ − b_l) where v ≤ b_l and m v_d between. Each is monotonic in b_r and b_l, so the
    corners of their bounds are the worst; v_d is looked at on a grid.

    Args:
        guess: b̂_r, b̂_l, e0.
        b_r_bounds: Known bounds of b_r (A4).
        b_l_bounds: Known bounds of b_l (A4).
    """
    b_r, b_l, e0 = guess
    far = 20.0 * e0 + max(b_r, -b_l, b_r_bounds[1], -b_l_bounds[0])
    v_d = np.concatenate([np.linspace(-far, far, 8001), np.linspace(-20.0, 20.0, 4001) * e0])
    right = 0.5 * (1.0 + np.tanh(v_d / e0))
    delta = b_r * right + b_l * (1.0 - right)
    v = v_d + delta
    largest = 0.0
    for true_r in b_r_bounds:
        for true_l in b_l_bounds:
            rest = np.where(v >= true_r, delta - true_r,
                            np.where(v <= true_l, delta - true_l, v_d))
            largest = max(largest, float(np.abs(rest).max()))
    return largest

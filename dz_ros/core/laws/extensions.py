# SPDX-License-Identifier: Apache-2.0
"""What may be added to the paper's law, one small function a piece, shared by the laws (ours).

Projection, late gradient, anti-windup, integral in the layer, identifier, feed-forward of the
dead-zone: equations and what is proven in mathematics.md §6, §10. Projection onto a convex set
that contains the true parameters, and the normalised gradient, keep the Lyapunov argument
[ioannou_sun1996]; the feed-forward is the smooth dead-zone inverse with fixed break points
[tao_kokotovic1994].

Scalar functions without side effect but the buffer they fill; `at` is where, in a longer sequence,
their numbers begin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np

from dz_ros.core.laws.base import Design, per_regressor
from dz_ros.core.laws.wang2004 import Wang2004
from dz_ros.core.schema import parameter
from dz_ros.core.signals import Signal
from dz_ros.errors import ConfigurationError

INTEGRAL = Signal('v_integral', 'v', 'integral inside the layer', symbol='v_I')
LAST = (Signal('u_last', 'x^(n)', 'u_fd of the sample before'),
        Signal('v_last', 'v', 'v of the sample before'))
STARTED = Signal('started', '1', 'whether a sample came before')


def last_regressors(count: int) -> tuple[Signal, ...]:
    """Return the signals of Y of the sample before."""
    return tuple(Signal(f'y{i}_last', f'Y{i}', f'Y_{i} of the sample before')
                 for i in range(1, count + 1))


@dataclass(frozen=True)
class ProjectionGains:
    """Prior bounds of the estimates; the values are ours for the example of [wang2004]."""

    theta_min: tuple[float, ...] = parameter(
        (0.1,), 'actuator unit per unit of Y_i', 'lowest θ̂ after projection, one number for each '
        'regressor or one for all; must lie below every a_i/(b m) that can occur')
    theta_max: tuple[float, ...] = parameter(
        (3.0,), 'actuator unit per unit of Y_i', 'highest θ̂ after projection; must lie above '
        'every a_i/(b m)')
    phi_min: float = parameter(0.3, 'actuator unit per unit of x^(n)', 'lowest φ̂ after '
                               'projection; must lie below 1/(b m)')
    phi_max: float = parameter(2.5, 'actuator unit per unit of x^(n)', 'highest φ̂ after '
                               'projection; must lie above 1/(b m)')


class ProjectedLaw(Wang2004):
    """Base of the laws whose θ̂, φ̂ may be clipped to a box.

    Raises:
        ConfigurationError: Bounds of the wrong length or order, or a start outside of them.
    """

    def __init__(self, gains: Any = None, order: int = 2, regressor_count: int = 2,
                 period: float = 0.005) -> None:
        super().__init__(gains, order, regressor_count, period)
        g = self.gains
        low = per_regressor(g.theta_min, regressor_count, 'theta_min')
        high = per_regressor(g.theta_max, regressor_count, 'theta_max')
        if any(minimum > maximum for minimum, maximum in zip(low, high, strict=True)):
            raise ConfigurationError('controller.theta_min', list(g.theta_min),
                                     f'must not exceed theta_max = {list(g.theta_max)}')
        if g.phi_min > g.phi_max:
            raise ConfigurationError('controller.phi_min', g.phi_min,
                                     f'must not exceed phi_max = {g.phi_max:g}')
        self._box = (*low, *high, g.phi_min, g.phi_max)
        if not self._projects:
            return
        for i, (value, minimum, maximum) in enumerate(zip(self._theta_0, low, high, strict=True),
                                                      1):
            if not minimum <= value <= maximum:
                raise ConfigurationError('controller.theta_0', list(self._theta_0),
                                         f'θ̂_{i}(0) must lie in its projection bounds '
                                         f'[{minimum:g}, {maximum:g}]')
        if not g.phi_min <= g.phi_0 <= g.phi_max:
            raise ConfigurationError('controller.phi_0', g.phi_0, 'must lie in its projection '
                                     f'bounds [{g.phi_min:g}, {g.phi_max:g}]')

    @property
    def _projects(self) -> bool:
        return True

    def projected(self, design: Design) -> Design:
        """Return a design with the bounds of the estimates."""
        r = self.regressor_count
        return replace(design, theta=tuple(zip(self._box[:r], self._box[r:2 * r], strict=True)),
                       phi=self._box[2 * r:])


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

        θ̂ −= T γ Y⁻ s_a/N,   φ̂ −= T η u⁻ s_a/N,   N = 1 + T (γ|Y⁻|² + η u⁻²)/k_d

    Y⁻ is in `before` from index `at` on, count numbers; u⁻ is u_before, T is dt [s].
    """
    power = 0.0
    for i in range(count):
        power += before[at + i] * before[at + i]
    step = dt * s_a / (1.0 + dt * (gamma * power + eta * u_before * u_before) / k_d)
    for i in range(count):
        estimates[i] -= step * gamma * before[at + i]
    estimates[count] -= step * eta * u_before


def correct_estimates(amount: float, u_before: float, before: Sequence[float], at: int,
                      box: Sequence[float], box_at: int, count: int, estimates: Any) -> float:
    """Move θ̂, φ̂ in place against Y⁻, u⁻, clipped to the box; return Y⁻ᵀΔθ̂ + u⁻Δφ̂.

    `amount` is T times what is to be moved [actuator unit · s]; the box of `project` is in
    `box` from index `box_at` on; the rest as of `late_gradient`.
    """
    power = 1.0 + u_before * u_before
    for i in range(count):
        power += before[at + i] * before[at + i]
    step = amount / power
    moved = 0.0
    for i in range(count):
        old = estimates[i]
        estimates[i] = clip(old - step * before[at + i], box[box_at + i], box[box_at + count + i])
        moved += before[at + i] * (estimates[i] - old)
    old = estimates[count]
    estimates[count] = clip(old - step * u_before, box[box_at + 2 * count],
                            box[box_at + 2 * count + 1])
    moved += u_before * (estimates[count] - old)
    return float(moved)


def opposed(a: float, b: float) -> bool:
    """Return whether two numbers have opposite signs, neither being 0."""
    return (a > 0.0 and b < 0.0) or (a < 0.0 and b > 0.0)


def exceeds(v: float, v_max: float) -> bool:
    """Return whether a command exceeds the known limit; 0 = no limit is known."""
    return v_max > 0.0 and (v > v_max or v < -v_max)


def winds_up(v: float, v_max: float, s: float) -> bool:
    """Return whether the command exceeds the known limit and pushes against s."""
    return exceeds(v, v_max) and opposed(v, s)


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
    corners of their bounds (A4) are the worst; v_d is searched on a grid. guess: b̂_r, b̂_l, e0.
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

# SPDX-License-Identifier: Apache-2.0
"""Whether measurement noise makes the guard of a law step, and what the guard cannot see (ours).

    σ_s = √(Σ_i (Λ_i σ_i)²)       noise in s of measured states, σ_i with q_i/√12 of their steps
    σ_s = (Λ_n−1 + G(ω)) σ        of an observed velocity, as in `observation`
    ε ≥ 4 σ_s                     else the guard takes noise for changes of side
    ε ≥ 3 σ_s of the closed loop  likewise: near its limit of b m the loop amplifies the noise

By simulation of 4 seeds over 60 s each no step at ε = 3.5 σ_s, steps in most at 3 σ_s. Of the
closed loop σ_s is that of the linear loop inside the layer, the larger one of the two bounds of
b m, with the delay configured; docs/robustness.md has the share of loops that step by that ratio.
The guard counts visits of |s| ≥ ε: oscillation inside the layer it does not see; that shows in the
total variation of v only (`dz_ros.core.safety.health`, report).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import math

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import Finding, INFO, WARNING
from dz_ros.core.design.linear_loop import noise_of_surface
from dz_ros.core.design.observation import (
    linear_observer,
    observer_of,
    sensor_noise,
    state_noise,
)
from dz_ros.core.observers.base import noise_gain
from dz_ros.core.tracking import error_weights
from dz_ros.core.units import Units

LEAST = 4.0
"""Least ε over σ_s."""
LEAST_IN_LOOP = 3.0
"""Least ε over σ_s of the closed loop."""


def noise_in_s(c: Configuration, measured: int, steps: Sequence[float]) -> float | None:
    """Return σ_s [unit of x^(n−1)]; None = the observer is not linear.

    Args:
        c: Plant, noise, law and observer.
        measured: Number of measured states.
        steps: One step of each state as it is measured [state units]; those missing are 0.
    """
    design, n = c.law.design, c.plant.order
    if design is None:
        return None
    weights = error_weights(design.lambda_, n)
    if measured >= n:
        noise = state_noise(c, steps)
        return math.sqrt(sum((weight * sigma) ** 2
                             for weight, sigma in zip(weights, noise, strict=True)))
    observer = observer_of(c)
    linear = type(observer).linear(observer.omega, c.loop.period)
    if linear is None:
        return None
    return (weights[-2] + noise_gain(linear)) * sensor_noise(c, steps)


def loop_noise_in_s(c: Configuration, measured: int, steps: Sequence[float]
                    ) -> tuple[tuple[float, float], ...]:
    """Return b m and σ_s of the closed loop at either bound of b m; the arguments of `noise_in_s`.

    Empty where the law is not linear in its layer or the observer is not linear; σ_s is inf where
    the loop is not calm, of which the rule of chatter warns.
    """
    model, design = c.law.layer_model(), c.law.design
    observer = linear_observer(c, measured)
    if model is None or design is None or (measured < c.plant.order and observer is None):
        return ()
    noise, known = state_noise(c, steps), c.controller_settings
    betas = (b * m for b, m in zip(known.b_bounds, known.m_bounds, strict=True))
    return tuple((beta, noise_of_surface(model, design.lambda_, c.loop.period, beta, c.loop.delay,
                                         noise, observer)) for beta in betas)


def check_guard(c: Configuration, measured: int, steps: Sequence[float]) -> Iterator[Finding]:
    """Check ε against the noise in s for a law with a guard; the arguments of `noise_in_s`."""
    design = c.law.design
    if design is None or design.epsilon <= 0.0 or 'kappa_f' not in c.law.signal_names:
        return
    words = ('the guard sees oscillation that reaches |s| = ε; chatter inside the layer it does '
             'not see, the variation of v in diagnostics and report shows it')
    sigma = noise_in_s(c, measured, steps)
    if not sigma:
        yield Finding(INFO, 'guard', words, {'epsilon': design.epsilon})
        return
    ratio = design.epsilon / sigma
    numbers = {'epsilon': design.epsilon, 'noise': sigma, 'ratio': ratio}
    unit = Units.of(c.plant).behind('x^(n-1)')
    words += (f'; ε = {design.epsilon:.3g}{unit} is {ratio:.2g} times the noise of s, '
              f'σ_s = {sigma:.3g}{unit}')
    below = [] if ratio >= LEAST else [f'{LEAST:g}']
    in_loop = loop_noise_in_s(c, measured, steps)
    amplified, beta = max(((noise, beta) for beta, noise in in_loop if noise < math.inf),
                          default=(0.0, 0.0))
    if amplified > 0.0:
        share = design.epsilon / amplified
        numbers |= {'loop_noise': amplified, 'loop_ratio': share, 'beta': beta}
        words += (f', and {share:.2g} times that of the closed loop, {amplified:.3g}{unit} at '
                  f'b m = {beta:.3g}')
        if share < LEAST_IN_LOOP:
            below.append(f'{LEAST_IN_LOOP:g} in the closed loop')
    words += ''.join(f'; the closed loop is not calm at b m = {beta:.3g}, where noise has no bound'
                     for beta, noise in in_loop if noise == math.inf)
    if not below:
        yield Finding(INFO, 'guard', words, numbers)
        return
    yield Finding(WARNING, 'guard', f'{words}: below {" and ".join(below)} it takes noise for '
                  'oscillation and lowers K', numbers, 'measure better, ' + (
                      f'or widen ε to {LEAST * sigma:.3g} or more by a smaller layer gain'
                      if ratio < LEAST else 'use a smaller layer gain, or narrow the bounds of '
                      'b m'))

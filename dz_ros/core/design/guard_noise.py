# SPDX-License-Identifier: Apache-2.0
"""Whether measurement noise makes the guard of a law step, and what the guard cannot see (ours).

    σ_s = √(Σ_i (Λ_i σ_i)²)       noise in s of measured states, σ_i with q_i/√12 of their steps
    σ_s = (Λ_n−1 + G(ω)) σ        of an observed velocity, as in `observation`
    ε ≥ 4 σ_s                     else the guard takes noise for changes of side

By simulation of 4 seeds over 60 s each no step at ε = 3.5 σ_s, steps in most at 3 σ_s. The guard
counts visits of |s| ≥ ε: oscillation inside the layer it does not see; that shows in the total
variation of v only (`dz_ros.core.safety.health`, report).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import math

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import Finding, INFO, WARNING
from dz_ros.core.design.observation import observer_of, sensor_noise, state_noise
from dz_ros.core.observers.base import noise_gain
from dz_ros.core.tracking import error_weights

LEAST = 4.0
"""Least ε over σ_s."""


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
    return (weights[-2] + noise_gain(linear)) * sensor_noise(c, steps[0])


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
    words += f'; ε = {design.epsilon:.3g} is {ratio:.2g} times the noise of s, σ_s = {sigma:.3g}'
    if ratio >= LEAST:
        yield Finding(INFO, 'guard', words, numbers)
    else:
        yield Finding(WARNING, 'guard', f'{words}: below {LEAST:g} it takes noise for oscillation '
                      'and lowers K', numbers,
                      f'measure better, or widen ε to {LEAST * sigma:.3g} by a smaller layer gain')

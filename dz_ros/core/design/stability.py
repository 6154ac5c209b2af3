# SPDX-License-Identifier: Apache-2.0
"""Stability limit on the slope λ of the surface s = 0 in a sampled loop (ours).

The theorem of [wang2004] is global in continuous time; sampled, the loop is not. v(0) grows with λ
times the initial error, which throws θ̂ and φ̂ within a few samples. There is no formula for the
largest λ; it is found by simulation from the initial state, without the configured pulse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import rho
from dz_ros.core.design.along_reference import disturbance_along_reference
from dz_ros.core.design.robust_gain import least_robust_gain
from dz_ros.core.loop.compiled import simulate_quick
from dz_ros.core.loop.offline import Run, simulate
from dz_ros.core.tracking import guaranteed_bounds
from dz_ros.errors import ConfigurationError

LONG_ENOUGH = 10.0
"""A loop that is lost from its initial state shows it within this [s]."""


def is_lost(configuration: Configuration,
            simulated: Callable[[Configuration], Run] = simulate) -> bool:
    """Return whether a simulated loop fails to follow its reference.

    It overflows, or in the last tenth of the run the error of some state is larger than its
    initial error, than the reference's own excursion, and than what Ω_ε and an uncompensated
    dead-zone leave together.

    Args:
        configuration: The loop.
        simulated: What simulates it.
    """
    try:
        run = simulated(configuration)
    except (ArithmeticError, ValueError):   # math.sin(inf) and the like
        return True
    return run_is_lost(run)


def run_is_lost(run: Run) -> bool:
    """Return whether a run fails to follow its reference, as in `is_lost`."""
    desired = np.ascontiguousarray(run.x_d[:, :-1].T)   # states in one piece each: quicker
    error = np.abs(run.x.T - desired)
    if not np.isfinite(error).all():
        return True
    tail = error[:, -max(1, error.shape[1] // 10):].max(axis=1)
    large = tail > np.maximum(error[:, 0], np.abs(desired).max(axis=1))
    return bool(large.any()) and bool((tail > _remaining(run.configuration))[large].any())


def _remaining(c: Configuration) -> NDArray[np.float64]:
    """Return the |x̃_i| that a loop in good order may keep, shape (n,)."""
    design, known = c.law.design, c.controller_settings
    if design is None or design.k_d <= 0.0:
        return np.zeros(c.plant.order)
    uncovered = least_robust_gain(
        rho(known.b_r_bounds[1], known.b_l_bounds[0], known.m_bounds[1]), known.m_bounds[0],
        known.b_bounds[0], disturbance_along_reference(c))
    return np.asarray(guaranteed_bounds(design.lambda_, design.target + uncovered / design.k_d,
                                        c.plant.order))


def has_slope(configuration: Configuration) -> bool:
    """Return whether the law is one with a λ, so that the rule applies."""
    return (configuration.law.design is not None
            and hasattr(configuration.law.gains, 'lambda_'))


def lost_from_start(configuration: Configuration) -> bool | None:
    """Return whether the loop is lost with its own λ from its x(0); None = a law without λ."""
    if not has_slope(configuration):
        return None
    return is_lost(_trial(configuration, LONG_ENOUGH))


def _trial(c: Configuration, duration: float) -> Configuration:
    """Return the configuration as it is tried: that long [s], and without disturbance pulse."""
    return replace(c, loop=replace(c.loop, duration=duration),
                   plant_settings=replace(c.plant_settings, disturbance_pulse=(0.0, 0.0, 0.0)))


def lambda_limit(configuration: Configuration, highest: float = 64.0, resolution: float = 0.05,
                 duration: float = LONG_ENOUGH) -> float:
    """Return the largest λ below which the loop is not lost [1/s]; inf = none up to `highest`.

    λ is raised by a quarter at a time until the loop is lost, then the interval is halved; it is
    lowered first where the loop is lost with its own λ. A λ that the law refuses counts as lost.

    Args:
        configuration: Loop, plant, gains and initial state; its λ is where the search starts.
        highest: Largest λ tried [1/s].
        resolution: Width of the interval the limit is found to [1/s].
        duration: Length of each simulated run [s].

    Returns:
        The lower end of the interval; 0 where the loop is lost down to 0.001 of its own λ.
    """
    base = _trial(configuration, duration)

    def lost(lambda_: float) -> bool:
        try:
            tried = base.replace(**{'controller.lambda': lambda_})
        except ConfigurationError:
            return True
        return is_lost(tried, simulate_quick)

    low = float(configuration.law.gains.lambda_)
    smallest = 0.001 * low
    high = low
    while lost(low):
        high, low = low, 0.8 * low
        if low < smallest:
            return 0.0
    while high <= low:
        step = min(1.25 * low, highest)
        if lost(step):
            high = step
        elif step >= highest:
            return math.inf
        else:
            low = high = step
    while high - low > resolution:
        middle = 0.5 * (low + high)
        if lost(middle):
            high = middle
        else:
            low = middle
    return low

"""How steep the surface s = 0 may be: the stability limit on λ of a sampled loop (ours).

The theorem of [wang2004] is global in continuous time; sampled, the loop is not. v(0) grows with λ
times the initial error, θ̂ and φ̂ are thrown by it within a few samples, and beyond some λ the loop
never recovers. There is no formula for that λ; it is found by simulation, from the initial state
of the configuration.
"""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop import Run, simulate


def is_lost(configuration: Configuration) -> bool:
    """Return whether a simulated loop ends up not following its reference at all.

    That is: it overflows, or in the last tenth of the run the error of some state is larger than
    both its initial error and the reference's own excursion.
    """
    try:
        run = simulate(configuration)
    except (OverflowError, ValueError):   # math.sin(inf) and the like
        return True
    return run_is_lost(run)


def run_is_lost(run: Run) -> bool:
    """Return whether a run ends up not following its reference at all, as `is_lost` says."""
    desired = run.x_d[:, :-1]
    error = np.abs(run.x - desired)
    if not np.isfinite(error).all():
        return True
    tail = error[-max(1, len(error) // 10):].max(axis=0)
    return bool((tail > np.maximum(error[0], np.abs(desired).max(axis=0))).any())


def lambda_limit(configuration: Configuration, highest: float = 64.0, resolution: float = 0.05,
                 duration: float = 10.0) -> float:
    """Return the largest λ below which the loop is not lost [1/s]; inf = none up to `highest`.

    λ is raised by a quarter at a time until the loop is lost, then the step is halved. Raised from
    the configuration's own λ; lowered first where the loop is lost with that.

    Args:
        configuration: Loop, plant, gains and initial state; its λ is where the search starts.
        highest: Largest λ tried [1/s].
        resolution: Width of the interval the limit is found to [1/s].
        duration: Length of each simulated run [s].

    Returns:
        The lower end of the interval; 0 where the loop is lost down to 0.001 of its own λ.
    """
    base = replace(configuration, loop=replace(configuration.loop, duration=duration))

    def lost(lambda_: float) -> bool:
        return is_lost(base.replace(**{'controller.lambda': lambda_}))

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

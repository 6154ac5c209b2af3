# SPDX-License-Identifier: Apache-2.0
"""A closed loop offline whose numbers are all finite, or an error with the time (ours)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dz_ros.core.axes import spoken
from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.offline import Run, simulate
from dz_ros.errors import ConfigurationError, DivergedError

TOO_LARGE = ('math ', 'cannot convert float', 'expected a ')
"""How Python's own errors begin for numbers that are too large, infinite or none."""


def simulate_finite(configuration: Configuration, memory: Sequence[float] | None = None,
                    simulate_one: Callable[..., Run] = simulate) -> Run:
    """Return the closed loop of a configuration, as `simulate_one` does it.

    Args:
        configuration: What to run.
        memory: The law's memory before the first sample; None = its initial one.
        simulate_one: `simulate`, or what gives the same numbers faster.

    Raises:
        ConfigurationError: As of `simulate`.
        DivergedError: The loop diverged; with the time.
        OverflowError, ValueError: Not even the first sample can be computed, or a class raised
            it for another reason: that is no divergence.
    """
    try:
        run = simulate_one(configuration, memory=memory)
    except (OverflowError, ValueError) as error:
        if isinstance(error, ConfigurationError) or not (
                isinstance(error, OverflowError) or str(error).startswith(TOO_LARGE)):
            raise
        sample = _first_failing(configuration, memory)
        if sample == 0:
            raise
        raise DivergedError(sample * configuration.loop.period) from error
    require_finite({'': run})
    return run


def require_finite(runs: Mapping[str, Run]) -> None:
    """Refuse loops with numbers that are not finite.

    Args:
        runs: Axis → its loop; one axis is called ''.

    Raises:
        DivergedError: There are some; with the first one's time and axis.
    """
    found = []
    for place, (name, run) in enumerate(runs.items()):
        for array in (run.x, run.v[:, np.newaxis], run.terms):
            bad = ~np.isfinite(array).all(axis=1)
            if bad.any():
                found.append((float(run.t[int(bad.argmax())]), place, name))
    if found:
        t, _, name = min(found)
        raise DivergedError(t, spoken([name]) if name else '')


def _first_failing(configuration: Configuration, memory: Sequence[float] | None) -> int:
    """Return the first sample that cannot be computed, by bisection on shorter runs; 0 = none can.

    Plain Python, which is where a compiled loop goes on with infinities and NaN.
    """
    def fails(samples: int) -> bool:
        loop = replace(configuration.loop, duration=samples * configuration.loop.period)
        try:
            simulate(replace(configuration, loop=loop), memory=memory)
        except (OverflowError, ValueError):
            return True
        return False

    good, bad = 0, configuration.loop.samples
    while bad - good > 1:
        middle = (good + bad) // 2
        if fails(middle):
            bad = middle
        else:
            good = middle
    return 0 if bad == 1 and fails(0) else bad

"""The loop off line, for a person: a loop that diverges is one line that says when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop import Run, simulate
from dz_ros.errors import ConfigurationError, LoopError

ADVICE = ('try a smaller controller.lambda, a larger controller.epsilon, a higher loop.rate or '
          'less loop.delay')


def simulate_offline(configuration: Configuration,
                     memory: Sequence[float] | None = None) -> Run:
    """Return the closed loop of a configuration from t = 0 to its duration, all numbers finite.

    Args:
        configuration: What to run.
        memory: The law's memory before the first sample; None = its initial one.

    Raises:
        ConfigurationError: The configuration has no end.
        LoopError: The loop diverged; says at what time.
    """
    if configuration.loop.samples == 0:
        raise ConfigurationError('loop.duration', configuration.loop.duration,
                                 'a loop off line needs an end: at least one sample interval, '
                                 f'{configuration.loop.period:g} s')
    try:
        run = simulate(configuration, memory=memory)
    except MemoryError:
        raise ConfigurationError('loop.duration', configuration.loop.duration, 'this machine has '
                                 f'no room for {configuration.loop.samples} samples: must be '
                                 'shorter') from None
    except (OverflowError, ValueError) as error:
        if isinstance(error, ConfigurationError):
            raise
        sample = _first_failing(configuration, memory)
        raise _diverged(sample * configuration.loop.period) from error
    for array in (run.x, run.v[:, np.newaxis], run.terms):
        bad = ~np.isfinite(array).all(axis=1)
        if bad.any():
            raise _diverged(float(run.t[int(bad.argmax())]))
    return run


def _diverged(t: float) -> LoopError:
    return LoopError(f'the loop diverged, its numbers are no longer finite at t = {t:g} s: '
                     f'{ADVICE}')


def _first_failing(configuration: Configuration, memory: Sequence[float] | None) -> int:
    """Return the first sample that cannot be computed, by bisection on shorter runs."""
    period = configuration.loop.period
    good, bad = 0, configuration.loop.samples
    while bad - good > 1:
        middle = (good + bad) // 2
        try:
            loop = replace(configuration.loop, duration=middle * period)
            simulate(replace(configuration, loop=loop), memory=memory)
        except (OverflowError, ValueError):
            bad = middle
        else:
            good = middle
    return bad

# SPDX-License-Identifier: Apache-2.0
"""The offline loop for a person: one that diverges is one line with the time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dz_ros.cli.progress import stage
from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.coupled import is_coupled, simulate_together
from dz_ros.core.loop.offline import Run, simulate
from dz_ros.errors import ConfigurationError, LoopError

ADVICE = ('try a smaller controller.lambda, a larger controller.epsilon, a higher loop.rate or '
          'less loop.delay')


def simulate_machine(configuration: Configuration,
                     memories: Sequence[Sequence[float] | None] = ()) -> dict[str, Run]:
    """Return axis → its closed loop, as `simulate_offline`; one axis is called ''.

    Args:
        configuration: What to run.
        memories: Those of the axes, as of `simulate_offline`; none at all = their initial ones.

    Raises:
        ConfigurationError: The configuration has no end.
        LoopError: An axis diverged; with its name and the time.
    """
    if not is_coupled(configuration):
        found = {}
        each = configuration.axes or (('', configuration),)
        for (name, item), memory in zip(each, memories or (None,) * len(each), strict=True):
            try:
                found[name] = simulate_offline(item, memory)
            except LoopError as error:
                raise LoopError(f'axis {name}: {error}' if name else str(error)) from error
        return found
    _require_end(configuration)
    try:
        with stage(_simulating(configuration)):
            runs = simulate_together(configuration, memories)
    except (OverflowError, ValueError) as error:
        if isinstance(error, ConfigurationError):
            raise
        raise LoopError('the loop diverged, its numbers are no longer finite: '
                        f'{ADVICE}') from error
    for name, run in runs.items():
        _require_finite(run, f'axis {name}: ')
    return runs


def simulate_offline(configuration: Configuration,
                     memory: Sequence[float] | None = None) -> Run:
    """Return the closed loop of a configuration from t = 0 to its duration, all numbers finite.

    Args:
        configuration: What to run.
        memory: The law's memory before the first sample; None = its initial one.

    Raises:
        ConfigurationError: The configuration has no end.
        LoopError: The loop diverged; with the time.
    """
    _require_end(configuration)
    try:
        with stage(_simulating(configuration)):
            run = simulate(configuration, memory=memory)
    except MemoryError:
        raise ConfigurationError('loop.duration', configuration.loop.duration, 'this machine has '
                                 f'no room for {configuration.loop.samples} samples: must be '
                                 'shorter') from None
    except (OverflowError, ValueError) as error:
        if isinstance(error, ConfigurationError):
            raise
        with stage('searching the sample from which on the loop diverges'):
            sample = _first_failing(configuration, memory)
        raise _diverged(sample * configuration.loop.period) from error
    _require_finite(run)
    return run


def _simulating(configuration: Configuration) -> str:
    return f'simulating {configuration.loop.duration:g} s, {configuration.loop.samples} samples'


def _require_end(configuration: Configuration) -> None:
    if configuration.loop.samples == 0:
        raise ConfigurationError('loop.duration', configuration.loop.duration,
                                 'an offline loop needs an end: at least one sample interval, '
                                 f'{configuration.loop.period:g} s')


def _require_finite(run: Run, where: str = '') -> None:
    for array in (run.x, run.v[:, np.newaxis], run.terms):
        bad = ~np.isfinite(array).all(axis=1)
        if bad.any():
            raise _diverged(float(run.t[int(bad.argmax())]), where)


def _diverged(t: float, where: str = '') -> LoopError:
    return LoopError(f'{where}the loop diverged, its numbers are no longer finite at t = {t:g} s: '
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

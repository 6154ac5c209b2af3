# SPDX-License-Identifier: Apache-2.0
"""The offline loop for a person: one that diverges is one line with the time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from dz_ros.cli.progress import stage
from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.coupled import simulate_axes, simulate_together
from dz_ros.core.loop.finite import require_finite, simulate_finite
from dz_ros.core.loop.offline import Run
from dz_ros.errors import ConfigurationError, DivergedError, LoopError

ADVICE = ('try a smaller controller.lambda, a larger controller.epsilon, a higher loop.rate or '
          'less loop.delay')


def simulate_machine(configuration: Configuration,
                     memories: Sequence[Sequence[float] | None] = ()) -> dict[str, Run]:
    """Return axis → its closed loop, as `simulate_offline`; one axis is called ''.

    Args:
        configuration: What to run.
        memories: Those of the axes, as of `simulate_offline`; none at all = their initial ones.

    Raises:
        ConfigurationError: The configuration has no end, or more samples than there is room for.
        LoopError: An axis diverged; with its name, or the names of axes that are moved together,
            and the time.
    """
    return simulate_axes(configuration, simulate_offline, memories, _coupled_offline)


def _coupled_offline(configuration: Configuration,
                     memories: Sequence[Sequence[float] | None]) -> dict[str, Run]:
    """Return what `simulate_machine` does, of axes that plant or law couple."""
    try:
        with _simulating(configuration):
            runs = simulate_together(configuration, memories)
        require_finite(runs)
    except DivergedError as error:
        raise _advised(error) from error
    return runs


def simulate_offline(configuration: Configuration,
                     memory: Sequence[float] | None = None) -> Run:
    """Return the closed loop of a configuration from t = 0 to its duration, all numbers finite.

    Args:
        configuration: What to run.
        memory: The law's memory before the first sample; None = its initial one.

    Raises:
        ConfigurationError: The configuration has no end, or more samples than there is room for.
        LoopError: The loop diverged; with the time.
    """
    try:
        with _simulating(configuration):
            return simulate_finite(configuration, memory)
    except DivergedError as error:
        raise _advised(error) from error
    except (OverflowError, ValueError) as error:
        if isinstance(error, ConfigurationError):
            raise
        raise LoopError(f'the loop cannot be computed: {error}') from error


@contextmanager
def _simulating(configuration: Configuration) -> Iterator[None]:
    """Show that a loop is simulated.

    Raises:
        ConfigurationError: It has no end, or more samples than there is room for.
    """
    loop = configuration.loop
    if loop.samples == 0:
        raise ConfigurationError('loop.duration', loop.duration, 'an offline loop needs an end: '
                                 f'at least one sample interval, {loop.period:g} s')
    try:
        with stage(f'simulating {loop.duration:g} s, {loop.samples} samples'):
            yield
    except MemoryError:
        raise ConfigurationError('loop.duration', loop.duration, 'this machine has no room for '
                                 f'{loop.samples} samples: must be shorter') from None


def _advised(error: DivergedError) -> LoopError:
    return LoopError(f'{error}: {ADVICE}')

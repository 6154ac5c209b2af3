"""A driver and an experiment brought together, sample by sample; the safe command at every end.

The loop is the host's: a sample is measured at t_k = k T, the command goes out at once and is held
until t_{k+1}. Who calls decides what time is: `wait` returns when sample k is due and says which
sample it is (a device's clock skips those it missed), or does nothing for drivers without a clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.safety.gate import OutputGate
from dz_ros.drivers.hosted import HostedDriver
from dz_ros.errors import DriverError
from dz_ros.identification.experiment import Experiment

Array = NDArray[np.float64]

LAST = 5
"""At the end the safe command is given so often, each for a sample."""


class StoppedError(DriverError):
    """Somebody stopped the experiment; the safe command has gone out."""


@dataclass(frozen=True)
class Samples:
    """What was measured, one row a sample; rows without measurement are NaN.

    Attributes:
        seq: Number of the sample, ascending; a gap is a sample that was missed, shape (K,).
        x: x, x', …, as measured (and observed), shape (K, n).
        v: Command the device was given and holds from the sample on, shape (K,).
        repeat: Repeat it belongs to, −1 = none, shape (K,).
        kinds: What went on.
        measured: How many of x, x', … the device measures.
        period: T [s].
    """

    seq: NDArray[np.int64]
    x: Array
    v: Array
    repeat: NDArray[np.int64]
    kinds: tuple[str, ...]
    measured: int
    period: float

    @property
    def t(self) -> Array:
        """Loop time [s]."""
        return np.asarray(self.seq * self.period, dtype=float)


def run_session(configuration: Configuration, experiment: Experiment,
                wait: Callable[[int], int], stopped: Callable[[], str],
                hosted: HostedDriver | None = None) -> Samples:
    """Run an experiment through the configured driver.

    Args:
        configuration: Driver, rate, limits.
        experiment: What to do.
        wait: Waits for the sample; returns its number, which may be a later one.
        stopped: Why to stop, asked in each sample; '' = go on.
        hosted: The driver; None = the configured one.

    Raises:
        DriverError: The device fails, takes less than the experiment's effort, or does not do
            what it would have to.
        StoppedError: `stopped` said so.
    """
    settings = configuration.safety
    limit = min(item for item in (settings.command_limit, experiment.limits.effort) if item > 0.0)
    gate = OutputGate(replace(settings, command_limit=limit, ramp=0.0), configuration.loop.period)
    driver = HostedDriver(configuration) if hosted is None else hosted
    rows: list[tuple[int, tuple[float, ...], float, int, str]] = []
    driver.open()
    try:
        if experiment.limits.effort > driver.limit:     # a device may tell its own once it is open
            raise DriverError(f'{driver.driver.name} takes |v| up to {driver.limit:g}, effort = '
                              f'{experiment.limits.effort:g} is more')
        driver.enable()
        try:
            _loop(configuration, experiment, driver, gate, wait, stopped, rows)
        finally:
            last = rows[-1][0] if rows else 0
            driver.disable(gate.safe(last * configuration.loop.period),
                           last * configuration.loop.period)
    finally:
        driver.close()
    return Samples(np.array([item[0] for item in rows], dtype=np.int64),
                   np.array([item[1] for item in rows], dtype=float),
                   np.array([item[2] for item in rows], dtype=float),
                   np.array([item[3] for item in rows], dtype=np.int64),
                   tuple(item[4] for item in rows), driver.measured,
                   configuration.loop.period)


def _loop(c: Configuration, experiment: Experiment, driver: HostedDriver, gate: OutputGate,
          wait: Callable[[int], int], stopped: Callable[[], str],
          rows: list[tuple[int, tuple[float, ...], float, int, str]]) -> None:
    """Run it; whatever ends it, the last thing the driver is given is the safe command."""
    nothing = (math.nan,) * c.plant.order
    seq, over = 0, 0
    try:
        while over < LAST:
            seq = wait(seq)
            t = seq * c.loop.period
            driver.advance(t, seq)
            reason = stopped()
            if reason:
                raise StoppedError(reason)
            x = driver.measure(t)
            trouble = driver.trouble()
            if trouble:
                raise DriverError(trouble)
            v: float | None = gate.output       # without a measurement, as before
            if over:
                v = None
            elif x is not None:
                v = experiment.command(x)
            over += v is None
            given = gate.safe(t) if v is None else gate.let_out(v, t)
            given = driver.command(given, t)
            rows.append((seq, nothing if x is None else x, given, experiment.repeat,
                         experiment.kind))
            seq += 1
    finally:
        driver.safe(gate.safe(seq * c.loop.period), seq * c.loop.period)

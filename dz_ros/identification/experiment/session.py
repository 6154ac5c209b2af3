# SPDX-License-Identifier: Apache-2.0
"""The loop that runs an experiment through a driver; the safe command at every end.

A sample is measured at t_k = k T, the command is sent at once and held until t_{k+1}. The caller
owns the clock: `wait` returns when sample k is due, with its number (a later one where samples
were missed), or at once for drivers without a clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.safety.command_limiter import CommandLimiter
from dz_ros.drivers.beside import Beside
from dz_ros.drivers.hosted import add_not_let_go, HostedDriver, NOT_LET_GO
from dz_ros.errors import DriverError, DzRosError
from dz_ros.identification.experiment.moves import Experiment, STALL
from dz_ros.identification.samples import Samples

LAST = 5
"""Number of samples at the end in which the safe command is given."""
AFTER = 1.0
"""A fault within this after a stall of the machine is left without an operator, but for a trip or
an e-stop of the device and a fault of another axis, and the move made again [s]."""


FIRST = 10.0
"""A device has sent its first measurement by then [s]."""


class StoppedError(DriverError):
    """The experiment was stopped.

    Attributes:
        reason: Why.
        failed: What then went wrong; '' = the device has had its safe command and is disabled.
    """

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason, self.failed = reason, ''


class NotLetGoError(DriverError):
    """The moves are complete, the device could not be disabled or closed after them.

    Attributes:
        samples: What was measured; None before `run_session` has added it.
    """

    samples: Samples | None = None


def run_session(configuration: Configuration, experiment: Experiment,
                wait: Callable[[int], int], stopped: Callable[[], str],
                hosted: HostedDriver | Beside | None = None,
                kept: Callable[[Samples], None] | None = None) -> Samples:
    """Run an experiment through the configured driver.

    Args:
        configuration: Driver, rate, limits.
        experiment: What to do.
        wait: Waits for the sample; returns its number, which may be a later one.
        stopped: Why to stop, asked in each sample; '' = go on.
        hosted: The driver, alone or beside those of other axes; None = the configured one, alone.
        kept: Called with what was measured where the experiment does not come to its end.

    Raises:
        DriverError: The device fails, takes less than the experiment's effort, or does not do
            what it would have to.
        NotLetGoError: It cannot be disabled or closed after the moves.
        StoppedError: `stopped` gave a reason.
    """
    settings = configuration.safety
    limit = min(item for item in (settings.command_limit, experiment.limits.effort) if item > 0.0)
    limiter = CommandLimiter(replace(settings, command_limit=limit, ramp=0.0),
                             configuration.loop.period)
    driver = HostedDriver(configuration) if hosted is None else hosted
    rows: Rows = []
    try:
        _driven(configuration, experiment, driver, limiter, wait, stopped, rows)
    except DriverError as error:
        if kept is not None and rows:
            kept(_samples(rows, driver, configuration))
        if isinstance(error, NotLetGoError):
            error.samples = _samples(rows, driver, configuration)
        raise
    return _samples(rows, driver, configuration)


Rows = list[tuple[int, tuple[float, ...], float, int, str]]
"""seq, x, v, repeat and kind of each sample."""


def _samples(rows: Rows, driver: HostedDriver | Beside, c: Configuration) -> Samples:
    """Return the samples from the first measurement on; before it a device is being found."""
    first = next((place for place, item in enumerate(rows) if math.isfinite(item[1][0])), 0)
    rows = rows[first:]
    return Samples(np.array([item[0] for item in rows], dtype=np.int64),
                   np.array([item[1] for item in rows], dtype=float),
                   np.array([item[2] for item in rows], dtype=float),
                   np.array([item[3] for item in rows], dtype=np.int64),
                   tuple(item[4] for item in rows), driver.measured, c.loop.period,
                   resolution=driver.driver.resolution)


def _driven(configuration: Configuration, experiment: Experiment, driver: HostedDriver | Beside,
            limiter: CommandLimiter, wait: Callable[[int], int], stopped: Callable[[], str],
            rows: Rows) -> None:
    """Open the driver, run the experiment, close the driver whatever happens."""
    def let_go() -> str:
        t = (rows[-1][0] if rows else 0) * configuration.loop.period
        return driver.let_go(limiter.safe(t), t)

    failed = ''
    try:
        driver.open()
        try:
            if experiment.limits.effort > driver.limit:     # known once it is open
                raise DriverError(f'{driver.driver.name} takes |v| up to {driver.limit:g}, '
                                  f'effort = {experiment.limits.effort:g} is more')
            driver.enable()
            _loop(configuration, experiment, driver, limiter, wait, stopped, rows)
        finally:
            failed = let_go()
    except (DzRosError, KeyboardInterrupt) as error:
        add_not_let_go(error, failed)
        if isinstance(error, StoppedError):
            error.failed = failed
        raise
    finally:
        let_go()        # what an interrupt has left, which came before the first one
    if failed:
        raise NotLetGoError(f'{NOT_LET_GO}: {failed}')


def _loop(c: Configuration, experiment: Experiment, driver: HostedDriver | Beside,
          limiter: CommandLimiter, wait: Callable[[int], int], stopped: Callable[[], str],
          rows: Rows) -> None:
    """Run it; whatever ends it, the caller then lets the device go, by the safe command first."""
    nothing = (math.nan,) * c.plant.order
    seq, over, stall = 0, 0, -math.inf
    x: tuple[float, ...] | None = None
    measured = resumed = False
    try:
        while over < LAST:
            x, due, seq = None, seq, wait(seq)
            t = seq * c.loop.period
            late = (seq - due) * c.loop.period
            experiment.stalled(late)
            if late >= STALL and not resumed:
                stall = t
            resumed = False
            driver.advance(t, seq)
            x = driver.measure(t)
            reason = stopped()
            if reason:
                raise StoppedError(reason)
            fault = driver.fault()
            if fault and t - stall <= AFTER:    # once for each stall
                stall, x, fault = -math.inf, None, driver.resume()
                resumed = True      # the time that took is no stall
                experiment.stalled(STALL)
                limiter.safe(t)
            measured = measured or x is not None
            if not (fault or measured) and t > FIRST:
                why = driver.absence()
                fault = f'no measurement within {FIRST:g} s' + (f': {why}' if why else '')
            if fault:
                raise DriverError(fault)
            v: float | None = limiter.output    # without a measurement, as before
            if over:
                v = None
            elif x is not None:
                v = experiment.command(x)
            over += v is None
            given = limiter.safe(t) if v is None else limiter.apply(v, t)
            given = driver.command(given, t)
            rows.append((seq, nothing if x is None else x, given, experiment.repeat,
                         experiment.kind))
            seq += 1
    finally:
        if over < LAST and (rows or x is not None):     # the sample in which it was stopped
            rows.append((seq, nothing if x is None else x, limiter.safe(seq * c.loop.period), -1,
                         'rest'))

# SPDX-License-Identifier: Apache-2.0
"""Moving a device from the command line: asked first, paced, stopped by signals and the e-stop."""

from __future__ import annotations

from collections.abc import Callable
import signal
import sys
import time

from dz_ros.cli.driver.stop_requests import stop_on_estop
from dz_ros.cli.progress import Progress
from dz_ros.core.configuration import Configuration
from dz_ros.drivers.beside import Beside
from dz_ros.drivers.hosted import NOT_LET_GO
from dz_ros.errors import ConfigurationError, DriverError
from dz_ros.identification.experiment.moves import Experiment
from dz_ros.identification.experiment.plan import Limits, Plan
from dz_ros.identification.experiment.session import run_session, StoppedError
from dz_ros.identification.samples import Samples
from dz_ros.runtime.deadlines import Deadlines
from dz_ros.runtime.os_signals import stop_on_signals, Stopping

SLICE = 0.05
"""A signal is noticed within this, or a sample [s]."""
CLEAR = 'Is everybody away from it, and the e-stop at hand?'
NOTHING_MOVED = 'nothing has moved'
STOPPED_SAFELY = 'the device has had its safe command and is disabled'


def ask(c: Configuration, limits: Limits, plan: Plan, duration: float, yes: bool,
        hosted: Beside | None = None) -> None:
    """Print what is going to move, and ask whether it may.

    Args:
        c: Names the driver.
        limits: How far, fast and hard at most.
        plan: The moves.
        duration: Of all of it, at most [s].
        yes: Whether it may without asking.
        hosted: What holds the driver beside those of other axes; None = it is alone.

    Raises:
        ConfigurationError: There is no terminal to ask at.
        DriverError: The answer is not yes.
    """
    print(motion_text(c, limits, f'{plan.repeats} times ramps and steps both ways', duration))
    if hosted is not None:
        print(hosted.note)
    if not yes:
        ask_at_terminal()


def motion_text(c: Configuration, limits: Limits, what: str, duration: float) -> str:
    """Return how a device is going to move.

    Args:
        c: Names the driver.
        limits: How far, fast and hard at most.
        what: The moves, as text.
        duration: Of all of it, at most [s].
    """
    driver = c.make_driver()
    x, unit = driver.state_units[0], driver.command_unit
    speed = ''
    if c.plant.order > 1:
        speed = f', no faster than {limits.speed:g} {driver.state_units[1]}'
    return (f'{driver.name} is going to move: {what}, '
            f'within {limits.travel:g} {x} of where it stands{speed}, |v| up to '
            f'{limits.effort:g} {unit}, at most about {duration:.0f} s'
            + (' of loop time' if driver.lockstep else ''))


def ask_at_terminal() -> None:
    """Ask whether a device may move.

    Raises:
        ConfigurationError: There is no terminal to ask at.
        DriverError: The answer is not yes.
    """
    if not sys.stdin.isatty():
        raise ConfigurationError('--yes', False, 'there is no terminal to ask whether it may '
                                 'move; check that the area is clear, then give --yes')
    if input(f'{CLEAR} Type yes to start: ') != 'yes':
        raise DriverError(NOTHING_MOVED)


def move(c: Configuration, experiment: Experiment, namespace: str,
         kept: Callable[[Samples], None] | None = None,
         watch: Callable[[Experiment], str] = lambda _: '',
         hosted: Beside | None = None) -> Samples:
    """Run an experiment through the configured driver.

    Args:
        c: The configuration.
        experiment: What to do.
        namespace: Where the e-stop is.
        kept: Called with what was measured where it does not come to its end.
        watch: Called in each sample; returns why to stop, '' = go on.
        hosted: What holds the driver beside those of other axes; None = it is alone.

    Raises:
        DriverError: The device fails, or it was stopped; what then went wrong is named.
        KeyboardInterrupt: It was stopped by Ctrl-C, in the same way.
    """
    lockstep = c.driver_class.lockstep
    progress = Progress(experiment.plan.repeats, 'repeats', 'moving')
    with stop_on_signals() as stopping, stop_on_estop(stopping, lockstep, namespace):
        wait = (lambda seq: seq) if lockstep else _pacer(c.loop.period, stopping)

        shown = 0

        def stopped() -> str:
            nonlocal shown
            if experiment.repeat > shown:
                shown = experiment.repeat
                progress(shown, experiment.plan.repeats)
            return stopping.reason or watch(experiment)

        try:
            samples = run_session(c, experiment, wait, stopped, hosted, kept)
        except StoppedError as stop:
            if stop.reason == signal.SIGINT.name:
                raise KeyboardInterrupt(f'{NOT_LET_GO}: {stop.failed}' if stop.failed else
                                        STOPPED_SAFELY) from stop
            raise
        progress(experiment.plan.repeats, experiment.plan.repeats)
        return samples


def _pacer(period: float, stopping: Stopping) -> Callable[[int], int]:
    """Return what waits for a sample on absolute deadlines of the steady clock."""
    deadlines: list[Deadlines] = []

    def wait(_seq: int) -> int:
        if not deadlines:
            deadlines.append(Deadlines(period, time.monotonic_ns()))
            return 0
        while (left := deadlines[0].remaining()) > 0.0 and not stopping.reason:
            time.sleep(min(left, SLICE))
        return deadlines[0].begin()

    return wait

"""Moving a device from the command line: asked first, paced, stopped by signals and the e-stop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
import json
import sys
import threading
import time

from dz_ros.cli.operator import operator
from dz_ros.cli.progress import Progress
from dz_ros.core.configuration import Configuration
from dz_ros.errors import ConfigurationError, DriverError
from dz_ros.identification.experiment import Experiment
from dz_ros.identification.plan import Limits, Plan
from dz_ros.identification.session import run_session, Samples
from dz_ros.runtime.deadlines import Deadlines
from dz_ros.runtime.stopping import stop_on_signals, Stopping

SLICE = 0.05
"""A signal is heard within this, or a sample [s]."""
HEARD = 20.0
"""The listener for the e-stop must be there within this [s]."""


def ask(c: Configuration, limits: Limits, plan: Plan, duration: float, yes: bool) -> None:
    """Say what is going to move, and ask whether it may.

    Raises:
        ConfigurationError: Nobody can be asked.
        DriverError: No.
    """
    driver = c.make_driver()
    x, unit = driver.state_units[0], driver.command_unit
    speed = ''
    if c.plant.order > 1:
        speed = f', no faster than {limits.speed:g} {driver.state_units[1]}'
    print(f'{driver.name} is going to move: {plan.repeats} times ramps and steps both ways, '
          f'within {limits.travel:g} {x} of where it stands{speed}, |v| up to {limits.effort:g} '
          f'{unit}, at most about {duration:.0f} s' + (' of loop time' if driver.lockstep else ''))
    if yes:
        return
    if not sys.stdin.isatty():
        raise ConfigurationError('--yes', False, 'there is no terminal to ask whether it may '
                                 'move; look that nobody is near, then give --yes')
    if input('Is everybody away from it, and the e-stop at hand? Type yes to start: ') != 'yes':
        raise DriverError('nothing has moved')


def move(c: Configuration, experiment: Experiment, namespace: str) -> Samples:
    """Run an experiment through the configured driver.

    Raises:
        DriverError: The device fails, or somebody stopped it: the safe command has gone out.
    """
    lockstep = c.driver_class.lockstep
    progress = Progress(experiment.plan.repeats, what='repeats')
    with stop_on_signals() as stopping, listening(stopping, lockstep, namespace):
        wait = (lambda seq: seq) if lockstep else _pacer(c.loop.period, stopping)

        shown = 0

        def stopped() -> str:
            nonlocal shown
            if experiment.repeat > shown:
                shown = experiment.repeat
                progress(shown, experiment.plan.repeats)
            return stopping.reason

        samples = run_session(c, experiment, wait, stopped)
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


@contextmanager
def listening(stopping: Stopping, lockstep: bool, namespace: str) -> Iterator[None]:
    """Stop when the e-stop is pressed on its topic, where ROS is installed and a device moves.

    Raises:
        DriverError: The listener does not come up.
    """
    if lockstep or find_spec('rclpy') is None:
        yield
        return
    ready = threading.Event()
    with operator('listen', namespace) as process:
        def read() -> None:
            assert process.stdout is not None
            for line in process.stdout:
                heard = json.loads(line)
                if heard.get('pressed'):
                    stopping.stop('e-stop pressed')
                elif heard.get('listening'):
                    ready.set()
            stopping.stop('the listener for the e-stop has gone')

        threading.Thread(target=read, name='e-stop', daemon=True).start()
        if not ready.wait(HEARD):
            raise DriverError(f'the listener for the e-stop was not there within {HEARD:g} s')
        yield

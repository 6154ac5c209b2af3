"""The conformance kit's first half: a driver class held to its contract, in this process (ours).

`check_contract` opens the driver, runs it at the loop's rate with commands of at most `amplitude`,
and looks at each sentence of ``core/driver.py``: what it declares, that it opens, measures,
answers at once, takes the safe command, keeps within its limit, restarts, comes back after a stop
and after it was closed in the middle of its work. What reached the device is known only where
`in_force` tells; what cannot be seen is said to be unseen, never passed. The second half, through
topics, is ``nodes/check_node.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
import math
import time

from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.drivers.hosted import HostedDriver
from dz_ros.drivers.telling import checked, told
from dz_ros.errors import DriverError, DzRosError

SPAN = 1.0
"""Each part of the check that runs in the loop takes so long [s]."""
FIRST = 5.0
"""A first measurement must come within this [s]."""
WITH_MEASUREMENT, SLOW_CALLS = 0.95, 0.05
"""Least share of samples with a measurement; largest share of samples with a slow call."""


@dataclass(frozen=True)
class Result:
    """What one check found.

    Attributes:
        name: The check.
        passed: None where it could not be seen or was not asked for.
        figure: What was found, in words with unit.
        limit: What it had to be.
        words: Why it failed, or could not be seen; '' where it passed.
    """

    name: str
    passed: bool | None
    figure: str
    limit: str
    words: str = ''


def wave(phase: float) -> float:
    """Return both signs in turn, 0.5 … 1 in size, of period 1: never 0, which the safe command is.

    A driver that holds its last command is thereby told from one that took the safe one.
    """
    sine = math.sin(2.0 * math.pi * phase)
    return math.copysign(0.5 + 0.5 * abs(sine), sine)


class _Subject:
    """The driver under test, and the loop's time."""

    def __init__(self, configuration: Configuration) -> None:
        self.hosted = HostedDriver(configuration)
        self.driver = self.hosted.driver
        self.period = configuration.loop.period
        self.t = 0.0
        self.seq = 0
        self.safe_command = configuration.safety.safe_command

    def start(self) -> None:
        """Open and enable it, and wait for its first measurement.

        Raises:
            DzRosError: It cannot be opened, refuses, or measures nothing.
        """
        self.hosted.open()
        self.hosted.enable()
        self.hosted.safe(self.safe_command, self.t)
        give_up = time.monotonic() + FIRST
        while self.hosted.measure(self.t) is None:
            if self.hosted.trouble():
                raise DriverError(self.hosted.trouble())
            if time.monotonic() > give_up:
                raise DriverError(f'no measurement within {FIRST:g} s')
            time.sleep(self.period)

    def stop(self) -> str:
        """Disable and close it; return what went wrong."""
        return self.hosted.disable(self.safe_command, self.t) or self.hosted.close()

    def samples(self, count: int) -> Iterator[int]:
        """Yield at the loop's rate, at absolute deadlines; the driver hears of each sample."""
        start = time.monotonic() - self.t
        for k in range(count):
            yield k
            self.t += self.period
            time.sleep(max(0.0, start + self.t - time.monotonic()))
            self.hosted.advance(self.t, self.seq)
            self.seq += 1

    def give(self, v: float, safe: bool = False) -> None:
        """Give a command for some samples."""
        for _ in self.samples(20):
            (self.hosted.safe if safe else self.hosted.command)(v, self.t)
            self.hosted.measure(self.t)

    def settle(self, v: float, safe: bool = False) -> float | None:
        """Give a command for some samples; return what the device then holds.

        Raises:
            DriverError: It cannot tell, whatever its code raised.
        """
        self.give(v, safe)
        held = checked('in_force', self.driver.in_force)
        if held is not None and not (isinstance(held, (int, float)) and math.isfinite(held)):
            raise DriverError(f'in_force: {held!r} is neither a finite number nor None')
        return held


Check = Callable[[_Subject], Result]


def check_contract(configuration: Configuration, amplitude: float,
                   saturate: bool) -> Iterator[Result]:
    """Yield the result of each check, in order; the device is let go at the end.

    Args:
        configuration: Names the driver.
        amplitude: Largest command but for `saturate` [command unit].
        saturate: Whether a command beyond the limit may be sent, so that the limit acts.

    Raises:
        ConfigurationError: The driver cannot be made of this configuration.
    """
    subject = _Subject(configuration)
    yield _guarded('declaration', 'complete', lambda: _declaration(subject, configuration))
    try:
        yield _guarded('opens', 'a measurement', lambda: _opens(subject))
        if not subject.hosted.enabled:
            return
        try:
            yield from _runs(subject, amplitude)
        except Exception as error:  # noqa: BLE001  somebody else's code
            yield Result('no trouble', False, 'lost', 'none', _words(error))
        yield _guarded('safe command', 'held at once', lambda: _safe(subject, amplitude))
        yield _guarded('limit', 'kept', lambda: _limit(subject, saturate))
        yield _guarded('stop and reset', 'acts again', lambda: _reset(subject, amplitude))
        yield _guarded('restart', 'measures again', lambda: _restart(subject))
        yield _guarded('reconnect', 'measures again', lambda: _reconnect(subject))
    finally:
        subject.stop()


def _guarded(name: str, limit: str, check: Callable[[], Result]) -> Result:
    """Return what a check finds; what goes wrong on the way is a failure."""
    try:
        return check()
    except Exception as error:  # noqa: BLE001  somebody else's code
        return Result(name, False, 'failed', limit, _words(error))


def _words(error: Exception) -> str:
    """Return in words what a check met."""
    return str(error) if isinstance(error, DzRosError) else told('the driver', error)


def _declaration(subject: _Subject, c: Configuration) -> Result:
    driver, order, faults = subject.driver, c.plant.order, []
    if driver.order not in (0, order):
        faults.append(f'order {driver.order}, the plant has {order}')
    units = driver.state_units
    if len(units) != order or not all(isinstance(item, str) and item for item in units):
        faults.append(f'state_units {units!r} must be {order} texts')
    if not (isinstance(driver.command_unit, str) and driver.command_unit):
        faults.append('command_unit must be a text')
    limit = driver.limit
    if not limit > 0.0:
        faults.append(f'limit {limit} must be > 0')
    if not driver.summary.strip():
        faults.append('summary is empty')
    for item in schema.fields(driver.Parameters):
        if not item.spec.description:
            faults.append(f'parameter {item.name} has no description')
    figure = (f'order {driver.order or "any"}, measures {driver.measured} of {order} in '
              f'{", ".join(units)}; command in {driver.command_unit}'
              + (f' up to {limit:g}' if math.isfinite(limit) else ''))
    return Result('declaration', not faults, figure, 'complete', '; '.join(faults))


def _opens(subject: _Subject) -> Result:
    started = time.monotonic()
    subject.start()
    return Result('opens', True, f'first measurement after {time.monotonic() - started:.3f} s',
                  f'<= {FIRST:g} s')


def _runs(subject: _Subject, amplitude: float) -> Iterator[Result]:
    """Run at the rate with a slow wave of commands: measurements, time of calls, trouble."""
    count = max(round(SPAN / subject.period), 50)
    hosted, missed = subject.hosted, subject.hosted.missed
    slowest, trouble = [], ''
    for k in subject.samples(count):
        started = time.perf_counter()
        hosted.command(subject.safe_command + amplitude * wave(k / count), subject.t)
        hosted.measure(subject.t)
        trouble = trouble or hosted.trouble()
        slowest.append(time.perf_counter() - started)
    missed = hosted.missed - missed
    least = math.ceil(WITH_MEASUREMENT * count)
    yield Result('measurement', count - missed >= least, f'{count - missed} of {count} samples',
                 f'>= {least}', '' if count - missed >= least else
                 f'{missed} samples without a measurement of {subject.hosted.measured} finite '
                 'numbers')
    slow = sum(item > 0.5 * subject.period for item in slowest)
    allowed = max(3, round(SLOW_CALLS * count))
    yield Result('answers at once', slow <= allowed,
                 f'longest {max(slowest) * 1e3:.3f} ms, {slow} samples beyond half a period',
                 f'<= {allowed}', '' if slow <= allowed else
                 'a slow device is fed from a thread (drivers/feeding.py)')
    yield Result('no trouble', not trouble, 'trouble' if trouble else 'none', 'none', trouble)
    hosted.recover()


def _safe(subject: _Subject, amplitude: float) -> Result:
    acting = subject.settle(subject.safe_command + amplitude)
    held = subject.settle(subject.safe_command, safe=True)
    trouble = subject.hosted.trouble()
    if trouble:
        return Result('safe command', False, 'trouble', 'held at once', trouble)
    if held is None or acting is None:
        return Result('safe command', None, 'sent', 'held at once', 'the driver does not tell '
                      'what the device holds (in_force)')
    if math.isclose(subject.safe_command + amplitude, subject.safe_command, abs_tol=1e-6):
        return Result('safe command', None, f'holds {held:g}', f'{subject.safe_command:g}',
                      'the commands before were as small: nothing tells them from the safe one')
    kept = math.isclose(held, subject.safe_command, rel_tol=1e-3, abs_tol=1e-6)
    return Result('safe command', kept, f'holds {held:g}', f'{subject.safe_command:g}',
                  '' if kept else 'the device still holds another command')


def _limit(subject: _Subject, saturate: bool) -> Result:
    limit = subject.hosted.limit
    if not math.isfinite(limit):
        return Result('limit', None, 'no limit declared', 'kept', 'nothing is clipped')
    if not saturate:
        return Result('limit', None, 'not tried', 'kept', 'it would move the device with all it '
                      'has: --saturate tries')
    before = subject.hosted.saturated
    held = subject.settle(2.0 * limit)
    subject.give(subject.safe_command, safe=True)
    reported = subject.hosted.saturated - before
    if held is None:
        return Result('limit', None, f'{reported} commands clipped', f'|v| <= {limit:g}',
                      'the driver does not tell what the device holds (in_force)')
    kept = math.isclose(held, limit, rel_tol=1e-3) and reported > 0
    return Result('limit', kept, f'holds {held:g} for {2.0 * limit:g}, {reported} clipped',
                  f'{limit:g}', '' if kept else 'the device holds another command')


def _reset(subject: _Subject, amplitude: float) -> Result:
    """The e-stop as the host does it, then the reset, then a command."""
    subject.give(subject.safe_command, safe=True)
    lasting = subject.hosted.recover()
    if lasting:
        return Result('stop and reset', False, 'trouble lasts', 'acts again', lasting)
    wanted = min(subject.safe_command + amplitude, subject.hosted.limit)
    held = subject.settle(wanted)
    trouble = subject.hosted.trouble()
    subject.give(subject.safe_command, safe=True)
    if trouble or held is None:
        return Result('stop and reset', False if trouble else None, 'commands again',
                      'acts again', trouble or 'the driver does not tell what the device holds '
                      '(in_force)')
    acts = math.isclose(held, wanted, rel_tol=1e-3, abs_tol=1e-6)
    return Result('stop and reset', acts, f'holds {held:g}', f'{wanted:g}',
                  '' if acts else 'no command acts after the reset')


def _restart(subject: _Subject) -> Result:
    started = time.monotonic()
    said = subject.stop()
    if said:
        return Result('restart', False, 'cannot be closed', 'measures again', said)
    subject.start()
    return Result('restart', True, f'{time.monotonic() - started:.3f} s', f'<= {FIRST:g} s')


def _reconnect(subject: _Subject) -> Result:
    """Closed in the middle of the work, as after an error; opened anew."""
    subject.give(subject.safe_command)
    started = time.monotonic()
    said = subject.hosted.close()
    if said:
        return Result('reconnect', False, 'cannot be closed', 'measures again', said)
    subject.start()
    return Result('reconnect', True, f'{time.monotonic() - started:.3f} s', f'<= {FIRST:g} s')

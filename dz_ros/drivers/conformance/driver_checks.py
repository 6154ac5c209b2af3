# SPDX-License-Identifier: Apache-2.0
"""The conformance kit's first half: a driver class against its contract, in this process (ours).

`check_contract` opens the driver, runs it at the loop's rate with commands of at most `amplitude`,
and checks each sentence of ``drivers/contract.py``. What reached the device is known by
`applied_command` alone; what cannot be seen is reported as unseen, never passed. Of a slow call
only the time in which the machine let it run counts (``machine.py``). The second half,
through topics, is ``nodes/check_node.py``.

Over 300 lines: one function for each sentence of the contract.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import math
import time
from typing import Any

from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.drivers.beside import Beside
from dz_ros.drivers.conformance.machine import lateness, MachineWatch, overlap, RunQueue
from dz_ros.drivers.conformance.result import Result
from dz_ros.drivers.hosted import add_not_let_go, checked, error_text, HostedDriver
from dz_ros.drivers.hosted_axes import HostedDrivers
from dz_ros.errors import DriverError, DzRosError

RUN_DURATION = 1.0
"""Duration of the check that runs in the loop [s]."""
FIRST_MEASUREMENT = 5.0
"""A first measurement must come within this [s]."""
LEAST_MEASURED_SHARE, MOST_SLOW_SHARE = 0.95, 0.05
"""Least share of samples with a measurement; largest share of samples with a slow call."""
SETTLING_SAMPLES = 20
"""A command is given for this number of samples before its effect is read back."""
NOT_KNOWN = 'the driver does not read back what the device holds (applied_command)'


def wave(phase: float) -> float:
    """Return both signs in turn, 0.5 … 1 in size, of period 1: never 0, the usual safe command."""
    sine = math.sin(2.0 * math.pi * phase)
    return math.copysign(0.5 + 0.5 * abs(sine), sine)


class _Subject:
    """The driver under test, and the loop's time."""

    def __init__(self, configuration: Configuration, stopped: Callable[[], str],
                 hosted: Any) -> None:
        self.stopped = stopped
        self.hosted = hosted
        self.driver = self.hosted.driver
        self.period = configuration.loop.period
        self.t = 0.0
        self.seq = 0
        safe = tuple(item.safety.safe_command for item in configuration.each)
        each = getattr(hosted, 'each', (hosted,))
        self.measured = ' and '.join(str(item.measured) for item in each)
        self.safe_command: Any = safe if configuration.axes else safe[0]

    def start(self) -> None:
        """Open and enable it, and wait for its first measurement."""
        self.hosted.open()
        self.hosted.enable()
        self.hosted.safe(self.safe_command, self.t)
        give_up = time.monotonic() + FIRST_MEASUREMENT
        while self.hosted.measure(self.t) is None:
            self.check_stop()
            if self.hosted.fault():
                raise DriverError(self.hosted.fault())
            if time.monotonic() > give_up:
                raise DriverError(f'no measurement within {FIRST_MEASUREMENT:g} s')
            time.sleep(self.period)

    def stop(self) -> str:
        """Disable and close it; return what went wrong."""
        return str(self.hosted.let_go(self.safe_command, self.t))

    def samples(self, count: int) -> Iterator[int]:
        """Yield at the loop's rate, at absolute deadlines; each sample is ended."""
        start = time.monotonic() - self.t
        for k in range(count):
            self.check_stop()
            yield k
            self.t += self.period
            time.sleep(max(0.0, start + self.t - time.monotonic()))
            self.hosted.advance(self.t, self.seq)
            self.seq += 1

    def check_stop(self) -> None:
        """Raise DriverError where the check is to stop."""
        if reason := self.stopped():
            raise DriverError(reason)

    def from_safe(self, amplitude: Any, share: float) -> Any:
        """Return the safe command with a share of an amplitude added, of each axis."""
        if isinstance(self.safe_command, tuple):
            return tuple(own + more * share for own, more in
                         zip(self.safe_command, amplitude, strict=True))
        return self.safe_command + amplitude * share

    def give(self, v: float, safe: bool = False) -> None:
        """Give a command for some samples."""
        for _ in self.samples(SETTLING_SAMPLES):
            (self.hosted.safe if safe else self.hosted.command)(v, self.t)
            self.hosted.measure(self.t)

    def settle(self, v: float, safe: bool = False) -> float | None:
        """Give a command for some samples; return what the device then holds."""
        self.give(v, safe)
        held = checked('applied_command', self.driver.applied_command)
        if held is not None and not (isinstance(held, (int, float)) and math.isfinite(held)):
            raise DriverError(f'applied_command: {held!r} is neither a finite number nor None')
        return held


def check_contract(configuration: Configuration, amplitude: float, saturate: bool,
                   stopped: Callable[[], str] = str,
                   hosted: Beside | None = None) -> Iterator[Result]:
    """Yield the result of each check, in order; the device is let go at the end.

    Args:
        configuration: Names the driver.
        amplitude: Largest command but for `saturate` [command unit].
        saturate: Whether a command beyond the limit may be sent, so that the limit acts.
        stopped: Returns why to stop, '' = go on; asked in every sample.
        hosted: What holds the driver beside those of other axes; None = it is alone.

    Raises:
        ConfigurationError: The driver cannot be made of this configuration.
        DriverError: `stopped` gave a reason; the safe command has gone out.
    """
    subject = _Subject(configuration, stopped,
                       HostedDriver(configuration) if hosted is None else hosted)
    yield _guarded(subject, 'declaration', 'complete',
                   lambda: _declaration(subject, configuration))
    yield from _then_let_go(subject, _each_check(subject, amplitude, saturate))


def _each_check(subject: _Subject, amplitude: float, saturate: bool) -> Iterator[Result]:
    """Yield the results of an axis from its opening on."""
    yield _guarded(subject, 'opens', 'a measurement', lambda: _opens(subject))
    if not subject.hosted.enabled:
        return
    yield from _lasting_runs(subject, amplitude)
    yield _guarded(subject, 'safe command', 'held at once', lambda: _safe(subject, amplitude))
    yield _guarded(subject, 'limit', 'kept', lambda: _limit(subject, saturate))
    yield _guarded(subject, 'stop and reset', 'acts again', lambda: _reset(subject, amplitude))
    yield _guarded(subject, 'restart', 'measures again', lambda: _restart(subject))
    yield _guarded(subject, 'reconnect', 'measures again', lambda: _reconnect(subject))


def check_together(machine: Configuration, amplitudes: Sequence[float],
                   stopped: Callable[[], str] = str) -> Iterator[Result]:
    """Yield what the drivers of all axes do as their host holds them: opened, moved, let go.

    Args:
        machine: Names the drivers.
        amplitudes: Largest command of each axis [command unit].
        stopped: As of `check_contract`.

    Raises:
        ConfigurationError: As of `check_contract`.
        DriverError: As of `check_contract`.
    """
    subject = _Subject(machine, stopped, HostedDrivers(machine))
    yield from _then_let_go(subject, _checks_together(subject, amplitudes))


def _checks_together(subject: _Subject, amplitudes: Sequence[float]) -> Iterator[Result]:
    """Yield the results of all axes at once."""
    opened = _guarded(subject, 'opens', 'a measurement', lambda: _opens(subject))
    yield opened
    if opened.passed:
        yield from _lasting_runs(subject, amplitudes)
        yield _guarded(subject, 'restart', 'measures again', lambda: _restart(subject))


def _then_let_go(subject: _Subject, results: Iterator[Result]) -> Iterator[Result]:
    """Yield results, then disable and close; what goes wrong with that is another one.

    Raises:
        DriverError: As of the results; what then went wrong is named.
    """
    failed = ''
    try:
        try:
            yield from results
        finally:
            failed = subject.stop()
    except (DzRosError, KeyboardInterrupt) as error:
        add_not_let_go(error, failed)
        raise
    finally:
        subject.stop()      # what an interrupt has left, which came before the first one
    if failed:
        yield Result('let go', False, 'failed', 'disabled and closed', failed)


def _lasting_runs(subject: _Subject, amplitude: Any) -> Iterator[Result]:
    """Yield the results of `_runs`, and what ends it."""
    try:
        with MachineWatch() as watch:
            yield from _runs(subject, amplitude, watch)
    except Exception as error:  # noqa: BLE001  a driver's code may raise anything
        subject.check_stop()
        yield Result('no fault', False, 'lost', 'none', _words(error))


def _guarded(subject: _Subject, name: str, limit: str, check: Callable[[], Result]) -> Result:
    """Return what a check finds; an exception on the way is a failure, a stop goes on."""
    try:
        return check()
    except Exception as error:  # noqa: BLE001  a driver's code may raise anything
        subject.check_stop()
        return Result(name, False, 'failed', limit, _words(error))


def _words(error: Exception) -> str:
    return str(error) if isinstance(error, DzRosError) else error_text('the driver', error)


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
    return Result('opens', True, f'first measurement after {_started(subject):.3f} s',
                  f'<= {FIRST_MEASUREMENT:g} s')


def _started(subject: _Subject) -> float:
    """Start the driver; return how long that took [s]."""
    began = time.monotonic()
    subject.start()
    return time.monotonic() - began


def _runs(subject: _Subject, amplitude: Any, watch: MachineWatch) -> Iterator[Result]:
    """Run at the rate with a slow wave of commands: measurements, time of calls, fault."""
    count = max(round(RUN_DURATION / subject.period), 50)
    hosted, missed = subject.hosted, 0
    calls, fault = [], ''
    watch.stalls()
    with RunQueue() as queue:
        for k in subject.samples(count):
            waited, started = queue.waited(), time.monotonic()
            hosted.command(subject.from_safe(amplitude, wave(k / count)), subject.t)
            missed += hosted.measure(subject.t) is None
            fault = fault or hosted.fault()
            calls.append((started, time.monotonic(), queue.waited() - waited))
    stalls = watch.stalls()
    least = math.ceil(LEAST_MEASURED_SHARE * count)
    yield Result('measurement', count - missed >= least, f'{count - missed} of {count} samples',
                 f'>= {least}', '' if count - missed >= least else
                 '; '.join(filter(None, (
                     f'{missed} samples without a measurement of {subject.measured} finite '
                     'numbers', lateness(stalls)))))
    half = 0.5 * subject.period
    slow = [call for call in calls if call[1] - call[0] > half]
    own = sum(end - begin - max(waited, overlap(stalls, begin, end)) > half
              for begin, end, waited in slow)
    more = f' and {len(slow) - own} while the machine was late' if len(slow) > own else ''
    longest = max(end - begin for begin, end, _ in calls)
    allowed = max(3, round(MOST_SLOW_SHARE * count))
    yield Result('answers at once', own <= allowed,
                 f'longest {longest * 1e3:.3f} ms, {own} samples beyond half a period{more}',
                 f'<= {allowed}', '' if own <= allowed else
                 'a slow device is fed from a thread (drivers/feeder.py)')
    yield Result('no fault', not fault, 'fault' if fault else 'none', 'none', fault)
    hosted.recover()


def _safe(subject: _Subject, amplitude: float) -> Result:
    acting = subject.settle(subject.safe_command + amplitude)
    held = subject.settle(subject.safe_command, safe=True)
    fault = subject.hosted.fault()
    if fault:
        return Result('safe command', False, 'fault', 'held at once', fault)
    if held is None or acting is None:
        return Result('safe command', None, 'sent', 'held at once', NOT_KNOWN)
    if math.isclose(subject.safe_command + amplitude, subject.safe_command, abs_tol=1e-6):
        return Result('safe command', None, f'holds {held:g}', f'{subject.safe_command:g}',
                      'the commands before were as small as the safe one')
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
                      NOT_KNOWN)
    kept = math.isclose(held, limit, rel_tol=1e-3) and reported > 0
    return Result('limit', kept, f'holds {held:g} for {2.0 * limit:g}, {reported} clipped',
                  f'{limit:g}', '' if kept else 'the device holds another command')


def _reset(subject: _Subject, amplitude: float) -> Result:
    """The e-stop as the host does it, then the reset, then a command."""
    subject.give(subject.safe_command, safe=True)
    lasting = subject.hosted.recover()
    if lasting:
        return Result('stop and reset', False, 'fault lasts', 'acts again', lasting)
    wanted = min(subject.safe_command + amplitude, subject.hosted.limit)
    held = subject.settle(wanted)
    fault = subject.hosted.fault()
    subject.give(subject.safe_command, safe=True)
    if fault or held is None:
        return Result('stop and reset', False if fault else None, 'commands again',
                      'acts again', fault or NOT_KNOWN)
    acts = math.isclose(held, wanted, rel_tol=1e-3, abs_tol=1e-6)
    return Result('stop and reset', acts, f'holds {held:g}', f'{wanted:g}',
                  '' if acts else 'no command acts after the reset')


def _restart(subject: _Subject) -> Result:
    """Disabled and closed, then opened and enabled again."""
    return _again('restart', subject, subject.stop())


def _reconnect(subject: _Subject) -> Result:
    """Closed in the middle of its work, as after an error; opened again."""
    subject.give(subject.safe_command)
    return _again('reconnect', subject, subject.hosted.close())


def _again(name: str, subject: _Subject, failure: str) -> Result:
    if failure:
        return Result(name, False, 'cannot be closed', 'measures again', failure)
    return Result(name, True, f'{_started(subject):.3f} s', f'<= {FIRST_MEASUREMENT:g} s')

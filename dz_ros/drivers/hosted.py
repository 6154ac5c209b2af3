# SPDX-License-Identifier: Apache-2.0
"""A driver as an actuator's node and the conformance kit hold it (ours).

Calls come in order, and nothing the driver raises ends the loop. What this adds to a driver:

- commands clipped to its `limit`, and their number;
- a measurement that is absent, of another length or not finite is none; after
  `safety.state_hold` such samples in a row, once there has been one, the driver has a fault;
- the velocity of one that measures positions only (``core/observers``);
- whatever its code raises while the loop runs is a fault, as text, and ends no process;
- `close` for each `open`, `disable` for each `enable`, also after a failure or an interrupt;
- the duration of its calls: a driver must not wait for its device.

Over 300 lines: everything a driver is spared.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import math
from pathlib import Path
import sys
import time
from typing import Any, Protocol, TypeVar

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.observation import observer_of
from dz_ros.core.records import Reference, Truth
from dz_ros.core.safety.health import Level, Report, SATURATED_SHARE
from dz_ros.core.text import printable
from dz_ros.drivers.contract import Driver
from dz_ros.errors import ConfigurationError, DriverError, DzRosError, LoopError
from dz_ros.runtime.os_signals import held_ends

SLOW_CALL_SHARE = 0.5
"""A call that takes more than this share of a period is counted as slow."""
LONGEST_FAULT = 600
"""Characters of a fault that are passed on: its words may be the device's."""
_AT_ONCE = ('command', 'safe', 'advance', 'measure', 'fault')

NOT_LET_GO = 'letting the device go failed'
KEPT_REFERENCES = 256
"""References kept: in lockstep they are sent that far ahead at most."""
SAME_INSTANT = 1e-9
"""Instants closer than this are one [s]."""

Result = TypeVar('Result')


def error_text(name: str, error: Exception) -> str:
    """Return an exception of a driver's code in one line, with the place where it was raised."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    place = '' if trace is None else (f' ({Path(trace.tb_frame.f_code.co_filename).name}, '
                                      f'line {trace.tb_lineno})')
    return f'{name}: {type(error).__name__}: {" ".join(str(error).split())}{place}'


def checked(name: str, call: Callable[[], Result]) -> Result:
    """Return what a call of a driver's code returns.

    Raises:
        DriverError: It raised something else than our errors.
    """
    try:
        return call()
    except DzRosError:
        raise
    except Exception as error:
        raise DriverError(error_text(name, error)) from error


class Host(Protocol):
    """What is let go: the driver of an axis, or those of several."""

    def disable(self, v: Any, t: float) -> str:
        """Send the safe command v at loop time t [s] and disable; return what went wrong."""

    def close(self) -> str:
        """Close what was opened; return what went wrong."""


def let_go(host: Host, v: Any, t: float) -> str:
    """Send the safe command, disable and close, whatever happens; return what went wrong.

    Signals that ask the program to end are held back meanwhile; where it is ending, for good.

    Args:
        host: The driver, or those of several axes.
        v: Safe command, of each axis [command unit].
        t: Loop time [s].
    """
    with held_ends(deliver=sys.exc_info()[1] is None):
        try:
            try:
                disabled = host.disable(v, t)
            except KeyboardInterrupt:   # it came just before, or is of the driver's own
                host.disable(v, t)
                raise
        finally:
            closed = host.close()
    return _texts(disabled, closed)


def add_not_let_go(error: BaseException, failed: str) -> None:
    """Add to an error that letting the device go went wrong after it; '' = it did not."""
    if failed:
        error.args = (_texts(str(error), f'{NOT_LET_GO}: {failed}'),)


def _texts(*each: str) -> str:
    return '; '.join(filter(None, each))


class HostedDriver:
    """Holds the driver that a configuration names.

    Args:
        configuration: What it is for.
        driver: The driver, where it was made together with those of other axes.

    Attributes:
        driver: The driver itself.
        enabled: Whether it takes commands.
        measured: Number of the states x, x', … that it measures.
        observing: Whether its velocity is observed.
        commands: Commands given since the start.
        saturated: Those beyond its limit.
        missed: Samples without a measurement.
        bad: Those of them whose measurement was not finite or of another length.
        slow: Calls that took more than `SLOW_CALL_SHARE` of a period.
        slowest: The longest call since the last report [s].

    Raises:
        ConfigurationError: It measures too little for the plant's order, or its number is unknown.
    """

    def __init__(self, configuration: Configuration, driver: Driver | None = None) -> None:
        self.driver: Driver = configuration.make_driver() if driver is None else driver
        self.commands = self.saturated = self.missed = self.bad = self.slow = 0
        self.slowest = 0.0
        order = configuration.plant.order
        try:
            measured = checked('measured', lambda: int(self.driver.measured))
        except DriverError as error:
            raise ConfigurationError('driver.name', self.driver.name, str(error)) from error
        if not max(1, order - 1) <= measured <= order:
            raise ConfigurationError('driver.name', self.driver.name, f'measures {measured} of '
                                     f"x, x', …; a plant of order {order} needs {order}, or "
                                     f'{order - 1} and the observer')
        self.measured, self.observing = measured, measured < order
        self._observer = observer_of(configuration)
        self._configuration = configuration
        self._slow = SLOW_CALL_SHARE * configuration.loop.period
        self._references: deque[Reference] = deque(maxlen=KEPT_REFERENCES)
        self._followed = False
        self._measured_at: float | None = None
        self._missing = 0
        self._failure = ''
        self._opened = self.enabled = False
        self._window = (0, 0)

    @property
    def safe_command(self) -> float:
        """Command where the law must not act [command unit]."""
        return self._configuration.safety.safe_command

    def open(self, node: Any = None) -> None:
        """Attach it to a node, if there is one, and open it.

        Raises:
            DriverError: It cannot be opened, whatever its code raised.
            DzRosError: As raised by it.
        """
        self._opened = True
        try:
            if node is not None:
                checked('attach', lambda: self.driver.attach(node))
            checked('open', self.driver.open)
        except BaseException:       # also Ctrl-C
            with held_ends():
                self.close()
            raise

    def enable(self) -> None:
        """Enable it, with nothing counted against it.

        Raises:
            DriverError: It refuses, whatever its code raised.
        """
        self._missing, self._failure, self._measured_at = 0, '', None
        self._observer.restart()
        self.enabled = True
        try:
            checked('enable', self.driver.enable)
        except BaseException as error:      # also Ctrl-C
            with held_ends():
                self._attempt('disable', self.driver.disable)
                self.enabled = False
            add_not_let_go(error, self._failure)
            raise

    def disable(self, v: float, t: float) -> str:
        """Send the safe command and disable it; return what went wrong.

        Where that is interrupted, it is still enabled: to be disabled again.
        """
        if not self.enabled:
            return ''
        self._failure = ''
        try:
            self.safe(v, t)
        finally:
            self._attempt('disable', self.driver.disable)
            self.enabled = False
        return self._failure

    def close(self) -> str:
        """Close it if it was opened; return what went wrong."""
        if not self._opened:
            return ''
        self._opened = False
        self._failure = ''
        self._attempt('close', self.driver.close)
        return self._failure

    def configure(self, configuration: Configuration) -> None:
        """Use other limits and parameters from now on."""
        self._configuration = configuration
        self._observer.omega = observer_of(configuration).omega
        self._attempt('configure', lambda: self.driver.configure(configuration))

    def reference(self, reference: Reference) -> None:
        """Keep the reference for the observer."""
        self._references.append(reference)

    @property
    def limit(self) -> float:
        """Largest |v| it takes [command unit].

        Raises:
            DriverError: It is not known, whatever its code raised.
        """
        limit = checked('limit', lambda: float(self.driver.limit))
        if not limit >= 0.0:
            raise DriverError(f'limit {limit:g} must be >= 0')
        return limit

    def command(self, v: float, t: float) -> float:
        """Give it a command, no larger than its limit; return what it was given.

        One whose limit is not known has a fault and is given the safe command.
        """
        self.commands += 1
        limit = self._known_limit()
        if limit is None:
            self.safe(self._configuration.safety.safe_command, t)
            return self._configuration.safety.safe_command
        clipped = min(max(v, -limit), limit)
        self.saturated += clipped != v
        self._attempt('command', lambda: self.driver.command(clipped, t))
        return clipped

    def safe(self, v: float, t: float) -> None:
        """Have it go to its safe state, also where its limit is not known, if it is enabled."""
        if not self.enabled:
            return
        limit = self._known_limit()
        given = v if limit is None else min(max(v, -limit), limit)
        self._attempt('safe', lambda: self.driver.safe(given, t))

    def advance(self, t: float, seq: int) -> Truth | None:
        """Let it know that the sample `seq` ends at loop time t [s].

        Raises:
            LoopError: A simulated device has diverged.
        """
        return self._attempt('advance', lambda: self.driver.advance(t, seq))

    def measure(self, t: float) -> tuple[float, ...] | None:
        """Return x, x', …, shape (n,), measured at loop time t [s]; None = no measurement."""
        found = self._attempt('measure', self.driver.measure)
        if found is not None:
            try:
                found = tuple(map(float, found))
            except (TypeError, ValueError):
                found = ()
            if len(found) != self.measured or not all(map(math.isfinite, found)):
                self.bad += 1
                found = None
        if found is not None and self.observing:
            found = self._observed(found, t)
        if found is None:
            self.missed += 1
            self._missing += self._measured_at is not None
            return None
        self._missing = 0
        self._measured_at = t
        return found

    def _observed(self, found: tuple[float, ...], t: float) -> tuple[float, ...] | None:
        """Return a measurement with the velocity observed; None where that is not finite.

        An observer that a reference without sense has led there begins again.
        """
        interval = 0.0 if self._measured_at is None else t - self._measured_at
        try:
            velocity = self._observer.step(found[-1], self._followed_at(t), interval)
        except ArithmeticError:
            velocity = math.nan
        if math.isfinite(velocity):
            return (*found, velocity)
        self.bad += 1
        self._observer.restart()
        return None

    def fault(self) -> str:
        """Return what is wrong with it, as text; '' = nothing."""
        found = self._attempt('fault', self.driver.fault)
        hold = self._configuration.safety.state_hold
        if self._failure or found:
            return printable(self._failure or str(found), LONGEST_FAULT)
        if 0 < hold <= self._missing:
            why = self.absence()
            return f'no measurement for {self._missing} samples' + (f': {why}' if why else '')
        return ''

    def absence(self) -> str:
        """Return why there is no measurement, in the driver's words; '' = not known."""
        return printable(str(self._attempt('absence', self.driver.absence) or ''), LONGEST_FAULT)

    def refused(self) -> dict[str, int]:
        """Return how many of the device's messages were not taken, by cause."""
        found = self._attempt('refused', lambda: dict(self.driver.refused))
        return found or {}

    def recover(self) -> str:
        """Have it try to leave its fault; return why it lasts."""
        self._failure = ''
        self._attempt('recover', self.driver.recover)
        self._missing = 0
        return self.fault()

    def resume(self) -> str:
        """Have it go on after a stall of this machine, with no operator; return why it cannot."""
        self._failure = ''
        self._attempt('resume', self.driver.resume)
        self._missing = 0
        return self.fault()

    def let_go(self, v: float, t: float) -> str:
        """Disable and close it, as `let_go`; return what went wrong."""
        return let_go(self, v, t)

    def report(self, report: Report) -> None:
        """Add what is known of it to the diagnostics, and begin a new window."""
        report.put('driver', self.driver.name)
        for label, count in (('saturated by the device [commands]', self.saturated),
                             ('samples without measurement', self.missed),
                             ('bad measurements', self.bad), ('slow driver calls', self.slow)):
            report.put(label, count, 'd')
        report.put('driver call max [ms]', self.slowest * 1e3, '.3f')
        commands, saturated = (self.commands - self._window[0], self.saturated - self._window[1])
        if commands and saturated > SATURATED_SHARE * commands:
            report.summarize(Level.WARN, f'{saturated} of {commands} commands beyond the limit '
                             f'{self._known_limit() or 0.0:g} of the device')
        self._window = (self.commands, self.saturated)
        self.slowest = 0.0
        self._attempt('report', lambda: self.driver.report(report))

    def _known_limit(self) -> float | None:
        """Return its limit; None where it is not known, which is a fault."""
        try:
            return self.limit
        except DzRosError as error:
            self._failure = self._failure or str(error)
            return None

    def _followed_at(self, t: float) -> tuple[float, float, float]:
        """Return x_d^(n−2), x_d^(n−1), x_d^(n) at loop time t [s]; 0 where none is fresh."""
        c = self._configuration
        hold = c.safety.reference_hold * c.loop.period
        newest = None
        for item in reversed(self._references):
            newest = item
            if item.stamp <= t + SAME_INSTANT:
                break
        fresh = newest is not None and not (hold and abs(t - newest.stamp) > hold)
        if fresh != self._followed:     # the error it observed was another one
            self._followed = fresh
            self._observer.restart()
        if newest is None or not fresh:
            return (0.0, 0.0, 0.0)
        x, v, a = (newest if abs(t - newest.stamp) <= SAME_INSTANT else newest.at(t)).x_d[-3:]
        return (x, v, a)

    def _attempt(self, name: str, call: Callable[[], Result]) -> Result | None:
        """Return what a call returns; keep what it raises as a fault, the loop's end aside."""
        started = time.perf_counter()
        try:
            return call()
        except DriverError as error:
            self._failure = self._failure or str(error)
        except LoopError:
            raise
        except Exception as error:  # noqa: BLE001  a driver's code may raise anything
            self._failure = self._failure or error_text(name, error)
        finally:
            took = time.perf_counter() - started
            self.slowest = max(self.slowest, took)
            if took > self._slow and name in _AT_ONCE:
                self.slow += 1
        return None

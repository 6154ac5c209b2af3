"""A driver as its host holds it: calls in order, and nothing it raises ends the loop (ours).

The twin without ROS of what ``nodes/hosting.py`` does with its topics; the conformance kit holds
drivers the same way. What this adds to a driver:

- commands clipped to its `limit`, and how many were;
- a measurement that is absent, of another length or not finite is none; after
  `safety.state_hold` such samples in a row, once there has been one, the driver is in trouble;
- the velocity of one that measures positions only (``core/observer.py``);
- whatever its code raises while the loop runs is trouble, in words, and ends no process;
- `close` for each `open`, `disable` for each `enable`, also after a failure;
- how long its calls took: a driver must not wait for its device.
"""

from __future__ import annotations

from collections.abc import Callable
import math
import time
from typing import Any, TypeVar

from dz_ros.core.configuration import Configuration
from dz_ros.core.driver import Driver
from dz_ros.core.observer import VelocityObserver
from dz_ros.core.records import Reference, Truth
from dz_ros.core.safety.health import Level, Report, SATURATED_SHARE
from dz_ros.drivers.telling import checked, told
from dz_ros.errors import ConfigurationError, DriverError, DzRosError, LoopError

SLOW = 0.5
"""A call that takes more than this share of a period is counted as slow."""

Result = TypeVar('Result')


class HostedDriver:
    """Holds a driver.

    Args:
        configuration: Says which, and what of.

    Attributes:
        driver: The driver itself.
        enabled: Whether it takes commands.
        measured: How many of x, x', … it measures.
        observing: Whether its velocity is observed.
        commands: Commands given since the start.
        saturated: Those beyond its limit.
        missed: Samples without a measurement.
        bad: Those of them whose measurement was not finite or of another length.
        slow: Calls that took more than `SLOW` of a period.
        slowest: The longest call since the last report [s].

    Raises:
        ConfigurationError: It measures too little for the plant's order, or cannot tell.
    """

    def __init__(self, configuration: Configuration) -> None:
        self.driver: Driver = configuration.make_driver()
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
        self._observer = VelocityObserver(configuration.driver_settings.observer)
        self._configuration = configuration
        self._slow = SLOW * configuration.loop.period
        self._reference: Reference | None = None
        self._measured_at: float | None = None
        self._missing = 0
        self._failure = ''
        self._opened = self.enabled = False
        self._window = (0, 0)

    # Its life.

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
        except DzRosError:
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
        except DzRosError:
            self._attempt('disable', self.driver.disable)
            self.enabled = False
            raise

    def disable(self, v: float, t: float) -> str:
        """Send the safe command and disable it; return what went wrong."""
        if not self.enabled:
            return ''
        self._failure = ''
        self.safe(v, t)
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
        self._observer.omega = configuration.driver_settings.observer
        self._attempt('configure', lambda: self.driver.configure(configuration))

    # Each sample.

    def reference(self, reference: Reference) -> None:
        """Hear the reference whose x_d^(n) the observer takes for the acceleration."""
        self._reference = reference

    @property
    def limit(self) -> float:
        """Largest |v| it takes [command unit].

        Raises:
            DriverError: It cannot tell, whatever its code raised.
        """
        try:
            limit = float(self.driver.limit)
        except DzRosError:
            raise
        except Exception as error:
            raise DriverError(told('limit', error)) from error
        if not limit >= 0.0:
            raise DriverError(f'limit {limit:g} must be >= 0')
        return limit

    def command(self, v: float, t: float) -> float:
        """Give it a command, no larger than its limit; return what it was given.

        One that cannot tell its limit is in trouble and is given the safe command.
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
        """Have it go to its safe state; nothing where it is not enabled.

        The safe command goes out also where the limit cannot be told.
        """
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
        if found is None:
            self.missed += 1
            self._missing += self._measured_at is not None
            return None
        self._missing = 0
        if self.observing:
            interval = 0.0 if self._measured_at is None else t - self._measured_at
            found = (*found, self._observer.step(found[-1], self._acceleration(t), interval))
        self._measured_at = t
        return found

    def trouble(self) -> str:
        """Return what is wrong with it, in words; '' = nothing."""
        said = self._attempt('trouble', self.driver.trouble)
        hold = self._configuration.safety.state_hold
        if self._failure or said:
            return self._failure or str(said)
        if 0 < hold <= self._missing:
            return f'no measurement for {self._missing} samples'
        return ''

    def recover(self) -> str:
        """Have it try to leave its trouble; return why it lasts."""
        self._failure = ''
        self._attempt('recover', self.driver.recover)
        self._missing = 0
        return self.trouble()

    def report(self, report: Report) -> None:
        """Add what is known of it to the diagnostics, and begin a new window."""
        report.put('driver', self.driver.name)
        report.put('saturated by the device [commands]', self.saturated, 'd')
        report.put('samples without measurement', self.missed, 'd')
        report.put('bad measurements', self.bad, 'd')
        report.put('driver call max [ms]', self.slowest * 1e3, '.3f')
        report.put('slow driver calls', self.slow, 'd')
        commands, saturated = (self.commands - self._window[0], self.saturated - self._window[1])
        if commands and saturated > SATURATED_SHARE * commands:
            report.say(Level.WARN, f'{saturated} of {commands} commands beyond the limit '
                       f'{self._known_limit() or 0.0:g} of the device')
        self._window = (self.commands, self.saturated)
        self.slowest = 0.0
        self._attempt('report', lambda: self.driver.report(report))

    def _known_limit(self) -> float | None:
        """Return its limit; None where it cannot tell, which is trouble."""
        try:
            return self.limit
        except DzRosError as error:
            self._failure = self._failure or str(error)
            return None

    def _acceleration(self, t: float) -> float:
        """Return x_d^(n) of the reference; 0 where there is none that is fresh."""
        if self._reference is None:
            return 0.0
        c = self._configuration
        hold = c.safety.reference_hold * c.loop.period
        if hold and abs(t - self._reference.stamp) > hold:
            return 0.0
        return self._reference.x_d[-1]

    def _attempt(self, name: str, call: Callable[[], Result]) -> Result | None:
        """Return what a call of the driver's returns; keep what it raises as trouble.

        Raises:
            LoopError: It is the loop's end, not the device's trouble (a simulated plant diverged).
        """
        started = time.perf_counter()
        try:
            return call()
        except DriverError as error:
            self._failure = self._failure or str(error)
        except LoopError:
            raise
        except Exception as error:  # noqa: BLE001  somebody else's code
            self._failure = self._failure or told(name, error)
        finally:
            took = time.perf_counter() - started
            if took > self.slowest:
                self.slowest = took
            if took > self._slow and name in _AT_ONCE:
                self.slow += 1
        return None


_AT_ONCE = ('command', 'safe', 'advance', 'measure', 'trouble')

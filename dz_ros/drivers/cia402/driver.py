"""`cia402`: servo drives on CANopen, cyclic synchronous torque or velocity.

Sources: CiA 301 (CANopen), CiA 402 / IEC 61800-7-201 (drives). What each part does:

    states.py    the drive's state machine          objects.py   its objects and PDOs
    scaling.py   its numbers ↔ units of the plant   setup.py     what it is told before it is used
    bus.py       the bus and what the drive says    cycle.py     the thread that talks to it

The safe state is the drive's own quick stop. Whatever the drive complains of (EMCY, fault, a
heartbeat that stays away, a boot-up message, a bus that is gone) is a trouble that lasts until
`recover`; meanwhile the drive is asked for its quick stop, as far as it hears. The drive in turn
stops by itself when commands or our heartbeat stay away.
"""

from __future__ import annotations

import math
import time
from typing import Any, TYPE_CHECKING

from dz_ros.core.driver import Driver
from dz_ros.core.safety.health import Level, percentiles
from dz_ros.drivers.cia402.bus import DriveBus, Measurement, PRE_OPERATIONAL
from dz_ros.drivers.cia402.cycle import Cycle
from dz_ros.drivers.cia402.objects import ERROR_CODE, TORQUE_DEMAND, VELOCITY_DEMAND
from dz_ros.drivers.cia402.scaling import Scaling
from dz_ros.drivers.cia402.settings import Cia402Parameters
from dz_ros.drivers.cia402.states import DriveState, Goal, INTERNAL_LIMIT, TARGET_REACHED
from dz_ros.errors import ConfigurationError, DriverError

if TYPE_CHECKING:
    from dz_ros.core.configuration import Configuration
    from dz_ros.core.records import Truth
    from dz_ros.core.safety.health import Report

STALE = 3.0
"""A measurement older than so many periods is none."""
STANDSTILL = 1.0
"""Longest wait for the axis to stand before the voltage is taken away [s]."""


class Cia402(Driver):
    """A CiA 402 servo drive with one axis."""

    name = 'cia402'
    summary = 'servo drive on CANopen (CiA 402), torque or velocity'
    order = 0
    requires = ('can', 'canopen')
    Parameters = Cia402Parameters

    def __init__(self, parameters: Any, configuration: Configuration) -> None:
        super().__init__(parameters, configuration)
        order = configuration.plant.order
        if order > 2:
            raise ConfigurationError('driver.name', 'cia402', 'measures position and velocity, '
                                     f'plant.model has order {order}')
        self._period = configuration.loop.period
        self._scaling = Scaling.of(parameters)
        self._bus: DriveBus | None = None
        self._cycle: Cycle | None = None
        self._enabled = False
        self._samples = self._late = 0
        self._sample_at = -math.inf

    @property
    def measured(self) -> int:
        """Return 1 for x alone, 2 for x and x'."""
        return min(self.configuration.plant.order, 2 if self.parameters.velocity_measured else 1)

    @property
    def limit(self) -> float:
        """Largest |v| that the target object, or the largest torque or speed, can hold."""
        return self._scaling.limit

    # Its life.

    def open(self) -> None:
        """Connect to the bus, configure the drive, begin to measure.

        Raises:
            MissingDependencyError: canopen or python-can is not installed.
            DriverError: No bus, no drive, or another one.
        """
        self._bus = DriveBus(self.parameters, self._period)
        self._bus.open()
        self._bus.configure()
        self._cycle = Cycle(self._bus, self._period)
        self._cycle.start()

    def enable(self) -> None:
        """Bring the drive to operation enabled, its target 0; a fault from before is reset.

        Raises:
            DriverError: It does not get there.
        """
        bus, cycle = self._open()
        if not bus.wait_for_status(lambda: bus.statusword >= 0, self.parameters.transition_limit):
            raise DriverError(f'{bus.place}: answers SDOs but sends no PDOs')
        cycle.want(Goal.SAFE)       # what the loop wanted before is forgotten
        bus.forget_trouble()
        self._leave_fault()
        cycle.want(Goal.ENABLED)
        bus.wait_for_status(lambda: bus.state is DriveState.ENABLED or bool(bus.trouble),
                            self.parameters.transition_limit)
        if bus.state is not DriveState.ENABLED or bus.trouble:
            reason = bus.trouble or f'remains {_name(bus.state)}'
            bus.complain(reason)
            cycle.want(Goal.OFF)
            raise DriverError(f'{bus.place}: {reason}{self._error_code()}')
        self._enabled = True

    def disable(self) -> None:
        """Take the voltage away, once the axis stands if a quick stop is under way."""
        self._enabled = False
        if self._bus is None or self._cycle is None:
            return
        bus = self._bus
        if not bus.broken and not bus.trouble:
            bus.wait_for_status(lambda: bus.state is not DriveState.QUICK_STOP
                                or bool(bus.statusword & TARGET_REACHED), STANDSTILL)
        self._cycle.want(Goal.OFF)
        if not bus.broken:
            bus.wait_for_status(lambda: bus.state in (DriveState.DISABLED, DriveState.FAULT),
                                10.0 * self._period)

    def close(self) -> None:
        """Stop the drive's communication and leave the bus."""
        if self._cycle is not None:
            self._cycle.stop()
            self._cycle = None
        if self._bus is not None:
            if not self._bus.broken:
                self._bus.nmt(PRE_OPERATIONAL)
            self._bus.close()
            self._bus = None

    # Each sample.

    def command(self, v: float, t: float) -> None:  # noqa: ARG002
        """Have the thread send v; what is not finite is the safe state."""
        if self._cycle is not None:
            if math.isfinite(v):
                self._cycle.want(Goal.ENABLED, self._scaling.target(v))
            else:
                self._cycle.want(Goal.SAFE)

    def safe(self, v: float, t: float) -> None:  # noqa: ARG002
        """Have the thread ask for a quick stop; v is not used."""
        if self._cycle is not None:
            self._cycle.want(Goal.SAFE)

    def advance(self, t: float, seq: int) -> Truth | None:  # noqa: ARG002
        """Learn when samples end, so that SYNC goes out before."""
        if self._cycle is not None:
            self._sample_at = self._cycle.hear(t)
            self._samples += 1
            oldest = min(self.parameters.sync_lead, self._period) + 0.5 * self._period
            self._late += self._newest(oldest) is None
        return None

    def measure(self) -> tuple[float, ...] | None:
        """Return x, or x and x', as the drive last said; None where that is too long ago.

        The drive says what was at the SYNC; x is brought from there to the sample by x'.
        """
        found = self._newest(STALE * self._period)
        if found is None:
            return None
        x, now = found.x, time.monotonic()
        if self.parameters.extrapolate and math.isfinite(found.speed):
            # No loop, or one that waits: there is no sample but now.
            sample = self._sample_at if abs(now - self._sample_at) < self._period else now
            x += found.speed * min(max(sample - found.synced_at, 0.0), STALE * self._period)
        return (x, found.speed)[:self.measured]

    def trouble(self) -> str:
        """Return the first thing that went wrong since the last reset."""
        bus = self._bus
        if bus is None:
            return 'not connected'
        if not bus.trouble and bus.state in (DriveState.FAULT, DriveState.REACTING):
            bus.complain('the drive is in fault')
        return bus.trouble

    def recover(self) -> None:
        """Reach the drive again, configure it, reset its fault, enable it if it was.

        Raises:
            DriverError: The bus or the drive is not there, the fault lasts, or the position is
                lost.
        """
        bus, cycle = self._open()
        cycle.want(Goal.SAFE)
        if bus.broken:
            bus = self._reconnect()
        bus.look_for_restart()
        if bus.restarted and not self.parameters.absolute_encoder:
            raise DriverError(f'{bus.place}: has restarted and has lost its position '
                              '(driver.absolute_encoder = false): home it, then start the loop '
                              'anew')
        bus.configure()
        if self._enabled:
            self.enable()
        else:
            bus.forget_trouble()
            self._leave_fault()

    def in_force(self) -> float | None:
        """Ask the drive for its demand value; waits for the answer."""
        bus, _ = self._open()
        found = bus.sdo.read_optional(TORQUE_DEMAND if self.parameters.mode == 'torque'
                                      else VELOCITY_DEMAND)
        return None if found is None else self._scaling.v(found)

    def report(self, report: Report) -> None:
        """Add state, round trips on the bus, samples whose measurement was an old one."""
        if self._bus is None or self._cycle is None:
            return
        report.put('drive', _name(self._bus.state))
        taken, self._cycle.round_trips = self._cycle.round_trips, []
        percentiles(taken, report, 'bus round trip')
        report.put('samples without a fresh answer', self._late, 'd')
        report.put('samples', self._samples, 'd')
        report.put('loop silent', self._cycle.silences, 'd')
        found = self._bus.measurement
        if found is not None and math.isfinite(found.torque):
            report.put('torque over the rated', found.torque)
        if self._bus.lacks:
            report.put('objects the drive lacks', self._bus.lacks)
        if self._bus.statusword >= 0 and self._bus.statusword & INTERNAL_LIMIT:
            report.say(Level.WARN, 'the drive is at its limit')

    # Parts.

    def _open(self) -> tuple[DriveBus, Cycle]:
        if self._bus is None or self._cycle is None:
            raise DriverError('driver cia402 is not open')
        return self._bus, self._cycle

    def _newest(self, age: float) -> Measurement | None:
        """Return the newest measurement unless it is older than this [s]."""
        found = self._bus.measurement if self._bus is not None else None
        return None if found is None or time.monotonic() - found.at > age else found

    def _reconnect(self) -> DriveBus:
        """Leave the bus that is gone and connect anew."""
        bus, cycle = self._open()
        trouble = bus.trouble
        cycle.stop()
        bus.close()
        fresh = DriveBus(self.parameters, self._period)
        fresh.follow(bus)
        self._bus = fresh
        self._cycle = Cycle(fresh, self._period)
        try:
            fresh.open()
        except DriverError:
            fresh.complain(trouble)
            raise
        finally:
            self._cycle.start()
        return fresh

    def _leave_fault(self) -> None:
        """Reset the drive's fault.

        Raises:
            DriverError: It lasts.
        """
        bus, cycle = self._open()
        limit = self.parameters.transition_limit
        bus.wait_for_status(lambda: bus.state not in (None, DriveState.REACTING), limit)
        if bus.state is not DriveState.FAULT:
            return
        cycle.reset_fault(True)
        try:
            left = bus.wait_for_status(lambda: bus.state is not DriveState.FAULT, limit)
        finally:
            cycle.reset_fault(False)
        if not left:
            bus.complain('the drive remains in fault')
            raise DriverError(f'{bus.place}: remains in fault{self._error_code()}')

    def _error_code(self) -> str:
        """Return what the drive says its error is, for a message."""
        bus, _ = self._open()
        try:
            code = bus.sdo.read_optional(ERROR_CODE)
        except DriverError:
            return ''
        return f'; error code (603Fh) {code:04X}h' if code else ''


def _name(state: DriveState | None) -> str:
    return 'unknown' if state is None else state.value

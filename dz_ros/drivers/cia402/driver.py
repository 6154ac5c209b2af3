# SPDX-License-Identifier: Apache-2.0
"""`cia402`: servo drives on CANopen, cyclic synchronous torque or velocity.

Sources: CiA 301 (CANopen), CiA 402 / IEC 61800-7-201 (drives). What each part does:

    states.py    the drive's state machine          objects.py      its objects and PDOs
    scaling.py   its numbers ↔ units of the plant   measurement.py  what is true of its answers
    setup.py     its settings before it is used     bus.py          the drive on its bus
    cycle.py     the thread that talks to it        sdo_watch.py    the thread that waits for it
    shared_bus.py    the connection, of one drive or of those of several axes

The safe state is the drive's own quick stop. Whatever the drive complains of (EMCY, fault, a
heartbeat that stays away, a boot-up message, any NMT state but operational, another mode of
operation, answers that contradict each other, a bus that is gone) is a fault that lasts until
`recover`, or `resume` where it has but missed our messages; meanwhile the drive is asked for its
quick stop, by SDO where it takes no PDOs. Where it receives nothing, that is reported instead of a
safe command. The drive in turn stops by itself when commands or our heartbeat stay away.

Over 300 lines: the whole contract of a driver, and what of it waits for the drive.
"""

from __future__ import annotations

import math
import time
from typing import Any, TYPE_CHECKING

from dz_ros.core.safety.health import Level, percentiles
from dz_ros.drivers.cia402.bus import DriveBus
from dz_ros.drivers.cia402.cycle import DriveCycle
from dz_ros.drivers.cia402.measurement import Measurement
from dz_ros.drivers.cia402.objects import ERROR_CODE, MODES, TORQUE_DEMAND, VELOCITY_DEMAND
from dz_ros.drivers.cia402.scaling import Scaling
from dz_ros.drivers.cia402.sdo_watch import SdoWatch
from dz_ros.drivers.cia402.settings import check_buses, Cia402Parameters
from dz_ros.drivers.cia402.shared_bus import SharedBus
from dz_ros.drivers.cia402.states import (
    DriveState,
    Goal,
    INTERNAL_LIMIT,
    REMOTE,
    stopped,
    TARGET_REACHED,
)
from dz_ros.drivers.contract import Driver
from dz_ros.drivers.freshness import Freshness
from dz_ros.drivers.phase import nearest
from dz_ros.errors import ConfigurationError, DriverError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from dz_ros.core.configuration import Configuration
    from dz_ros.core.records import Truth
    from dz_ros.core.safety.health import Report

STALE = 3.0
"""A measurement older than this is none [samples]."""
STANDSTILL = 1.0
"""Longest wait for the axis to stand before the voltage is taken away [s]."""


class Cia402(Driver):
    """A CiA 402 servo drive with one axis.

    Args:
        parameters: Its own.
        configuration: The whole configuration.
        shared: Its bus, where that is shared with other axes.

    Attributes:
        scaling: Its numbers.
        shared: Its bus.
        bus: The drive on the bus and what it sends, while open.
        cycle: What is sent to it in each cycle, while open.
        sdo_watch: The thread that waits for it, while open.
        sample_at: When the newest sample ended [s].
    """

    name = 'cia402'
    summary = 'servo drive on CANopen (CiA 402), torque or velocity'
    order = 0
    requires = ('can', 'canopen')
    Parameters = Cia402Parameters

    def __init__(self, parameters: Any, configuration: Configuration,
                 shared: SharedBus | None = None) -> None:
        super().__init__(parameters, configuration)
        order = configuration.plant.order
        if order > 2:
            raise ConfigurationError('driver.name', 'cia402', 'measures position and velocity, '
                                     f'plant.model has order {order}')
        self._period = configuration.loop.period
        self._freshness = Freshness.of(STALE, configuration)
        self.scaling = Scaling.of(parameters)
        self.shared = shared or SharedBus(parameters, self._period)
        self.bus: DriveBus | None = None
        self.cycle: DriveCycle | None = None
        self.sdo_watch: SdoWatch | None = None
        self._enabled = False
        self._samples = self._late = 0
        self.sample_at = -math.inf

    @classmethod
    def check_axes(cls, axes: Mapping[str, Configuration]) -> None:
        """Check that drives on one bus can be.

        Raises:
            ConfigurationError: Two with one node id, or what concerns the bus differs.
        """
        check_buses({name: item.driver_parameters for name, item in axes.items()})

    @classmethod
    def for_axes(cls, each: Sequence[Configuration]) -> Sequence[Cia402]:
        """Return the drivers of all axes; those of one interface and channel share the bus."""
        buses: dict[tuple[str, str], SharedBus] = {}
        made = []
        for item in each:
            p = item.driver_parameters
            shared = buses.setdefault(p.bus, SharedBus(p, item.loop.period))
            made.append(cls(p, item, shared))
        return made

    @property
    def measured(self) -> int:
        """Return 1 for x alone, 2 for x and x'."""
        return min(self.configuration.plant.order, 2 if self.parameters.velocity_measured else 1)

    @property
    def resolution(self) -> float:
        """One count of its encoder [unit of x]."""
        return super().resolution or abs(self.scaling.position)

    @property
    def derivative_resolution(self) -> tuple[float, ...]:
        """One number of its velocity [unit of x'], where that is taken."""
        known = super().derivative_resolution
        return known or ((abs(self.scaling.velocity),) if self.measured > 1 else ())

    @property
    def command_resolution(self) -> float:
        """One number of the target object: a per mille of the rated torque, or a speed count."""
        return super().command_resolution or 1.0 / abs(self.scaling.command)

    @property
    def limit(self) -> float:
        """Largest |v| that the target object, or the largest torque or speed, can hold."""
        return self.scaling.limit

    # Lifecycle.

    def open(self) -> None:
        """Connect to the bus, configure the drive, begin to measure.

        Raises:
            MissingDependencyError: canopen or python-can is not installed.
            DriverError: No bus, no drive, or another one.
        """
        self.bus = DriveBus(self.parameters, self._period, self.shared)
        self.bus.open()
        self.bus.configure()
        self._begin(self.bus)

    def enable(self) -> None:
        """Bring the drive to operation enabled, its target 0; a fault from before is reset.

        Beside other drives of its bus, which are enabled before or after it, it is then stopped
        until the loop commands it.

        Raises:
            DriverError: It does not get there.
        """
        bus, cycle = self._open()
        if not bus.wait_for_status(lambda: bus.statusword >= 0, self.parameters.transition_limit):
            raise DriverError(f'{bus.place}: answers SDOs but sends no PDOs')
        cycle.want(Goal.SAFE)       # what the loop wanted before is forgotten
        bus.forget_fault()
        wanted = MODES[self.parameters.mode]
        if bus.mode != wanted:
            raise DriverError(f'{bus.place}: is not in mode {wanted} (6061h = {bus.mode}): it is '
                              'not enabled')
        self._leave_fault()
        cycle.want(Goal.ENABLED)
        bus.wait_for_status(lambda: bus.state is DriveState.ENABLED or bool(bus.fault),
                            self.parameters.transition_limit)
        if bus.state is not DriveState.ENABLED or bus.fault:
            reason = bus.fault or f'remains {_name(bus.state)}'
            if bus.statusword >= 0 and not bus.statusword & REMOTE:
                reason += ', in local mode (statusword bit 9 is 0)'
            bus.complain(reason)
            cycle.want(Goal.OFF)
            raise DriverError(f'{bus.place}: {reason}{self._error_code()}')
        self._enabled = True
        if self.shared.served > 1:
            cycle.want(Goal.SAFE)

    def disable(self) -> None:
        """Take the voltage away, once the axis stands if a quick stop is under way.

        Raises:
            DriverError: It is not known to be without torque: the command was not taken.
        """
        self._enabled = False
        if self.bus is None or self.cycle is None:
            return
        bus, cycle = self.bus, self.cycle
        if not bus.broken and not bus.fault:
            bus.wait_for_status(lambda: bus.state is not DriveState.QUICK_STOP
                                or bool(bus.statusword & TARGET_REACHED), STANDSTILL)
        cycle.want(Goal.OFF)
        asked = time.monotonic()
        if not bus.broken:
            bus.wait_for_status(lambda: bus.received_at > asked and stopped(Goal.OFF, bus.state),
                                self.parameters.transition_limit)
        refused = self._not_taken()
        if refused:
            raise DriverError(f'{bus.place}: the safe command is not taken: {refused}')

    def close(self) -> None:
        """Stop the drive's communication, unless it still has torque, and leave the bus."""
        self._end()
        if self.bus is not None:
            if not self.bus.broken:
                self.bus.leave()
            self.bus.close()
            self.bus = None

    # Each sample.

    def command(self, v: float, t: float) -> None:  # noqa: ARG002
        """Have the thread send v; what is not finite is the safe state."""
        if self.cycle is not None:
            if math.isfinite(v):
                self.cycle.want(Goal.ENABLED, self.scaling.target(v))
            else:
                self.cycle.want(Goal.SAFE)

    def safe(self, v: float, t: float) -> None:  # noqa: ARG002
        """Have the thread ask for a quick stop; v is not used."""
        if self.cycle is not None:
            self.cycle.want(Goal.SAFE)

    def advance(self, t: float, seq: int) -> Truth | None:  # noqa: ARG002
        """Learn when samples end, so that SYNC goes out before."""
        if self.cycle is not None:
            self.sample_at = self.cycle.sample_ended(t)
            self._samples += 1
            oldest = min(self.parameters.sync_lead, self._period) + 0.5 * self._period
            self._late += self._newest(Freshness(oldest)) is None
        return None

    def measure(self) -> tuple[float, ...] | None:
        """Return x, or x and x', as the drive last sent it; None where that is too long ago.

        The drive samples at the SYNC; x is brought from there to the sample by x'.
        """
        found = self._newest(self._freshness)
        if found is None:
            return None
        x, now = found.x, time.monotonic()
        if self.parameters.extrapolate:
            sample = nearest(self.sample_at, now, self._period)
            x = self._freshness.advanced(x, found.speed, sample - found.synced_at)
        return (x, found.speed)[:self.measured]

    def fault(self) -> str:
        """Return the first thing that went wrong since the last reset."""
        bus = self.bus
        if bus is None:
            return 'not connected'
        if not bus.fault and bus.state in (DriveState.FAULT, DriveState.REACTING):
            bus.complain('the drive is in fault', False)
        return bus.fault

    def recover(self) -> None:
        """Reach the drive again, configure it, reset its fault, enable it if it was.

        Raises:
            DriverError: The bus or the drive is not there, the fault lasts, or the position is
                lost.
        """
        self._recover(self._open()[0], lambda: None)

    def resume(self) -> None:
        """Go on where the drive has missed our messages and reports nothing else.

        Raises:
            DriverError: As `recover`, or another fault: a trip of the drive, a restart, a bus that
                is gone, what another master or a hand at the drive has done.
        """
        bus, _ = self._open()

        def check() -> None:
            if not bus.lost_us():
                why = bus.fault or ('has restarted' if bus.restarted else 'is in fault')
                raise DriverError(f'{bus.place}: {why}')

        if bus.broken:
            check()
        self._recover(bus, check)

    def applied_command(self) -> float | None:
        """Ask the drive for its demand value; waits for the answer."""
        bus, _ = self._open()
        found = bus.sdo.read_optional(TORQUE_DEMAND if self.parameters.mode == 'torque'
                                      else VELOCITY_DEMAND)
        return None if found is None else self.scaling.v(found)

    def report(self, report: Report) -> None:
        """Add state, round trips on the bus, samples whose measurement was an old one."""
        if self.bus is None or self.cycle is None:
            return
        report.put('drive', _name(self.bus.state))
        refused = self._not_taken()
        if refused:
            report.summarize(Level.ERROR, f'the safe command is not taken: {refused}')
        for remark in self.bus.remarks:
            report.summarize(Level.WARN, f'the drive: {remark}')
        taken, self.cycle.round_trips = self.cycle.round_trips, []
        percentiles(taken, report, 'bus round trip')
        report.put('samples without a fresh answer', self._late, 'd')
        report.put('samples', self._samples, 'd')
        report.put('loop silent', self.cycle.silences, 'd')
        found = self.bus.measurement
        if found is not None and math.isfinite(found.torque):
            report.put('torque over the rated', found.torque)
        if self.bus.lacks:
            report.put('objects the drive lacks', self.bus.lacks)
        if self.bus.statusword >= 0 and self.bus.statusword & INTERNAL_LIMIT:
            report.summarize(Level.WARN, 'the drive is at its limit')

    # Parts.

    def _open(self) -> tuple[DriveBus, DriveCycle]:
        if self.bus is None or self.cycle is None:
            raise DriverError('driver cia402 is not open')
        return self.bus, self.cycle

    def _newest(self, freshness: Freshness) -> Measurement | None:
        """Return the newest measurement if it is fresh since its SYNC."""
        found = self.bus.measurement if self.bus is not None else None
        return found if found is not None and freshness.holds(found.synced_at) else None

    def _begin(self, bus: DriveBus) -> None:
        """Start the threads."""
        self.cycle = cycle = self.shared.serve(bus)
        self.sdo_watch = SdoWatch(bus, lambda: cycle.goal)
        self.sdo_watch.start()

    def _end(self) -> None:
        """End the threads."""
        if self.sdo_watch is not None:
            self.sdo_watch.stop()
        if self.cycle is not None:
            self.cycle.stop()
        self.cycle = self.sdo_watch = None

    def _not_taken(self) -> str:
        """Return why the drive is not known to have taken the safe command, or ''."""
        bus, cycle = self._open()
        if cycle.goal is Goal.ENABLED or (bus.received_at > cycle.since
                                          and stopped(cycle.goal, bus.state)):
            return ''
        return bus.deaf or f'the drive remains {_name(bus.state)}'

    def _recover(self, bus: DriveBus, check: Callable[[], None]) -> None:
        """Recover as far as a check, which raises, allows."""
        self._open()[1].want(Goal.SAFE)
        if bus.broken:
            self._reconnect(bus)
        bus.look_for_restart()
        check()
        absolute, position = self.parameters.absolute_encoder, bus.position
        if (bus.restarted or position.lost) and (position.narrow or not absolute):
            what = 'has restarted and has lost' if bus.restarted else 'has lost'
            why = (f'its counter has {position.modulus} values' if position.narrow
                   else 'driver.absolute_encoder = false')
            raise DriverError(f'{bus.place}: {what} its position ({why}): home it, then start the '
                              'loop again')
        bus.configure()
        check()
        if self._enabled:
            self.enable()
        else:
            bus.forget_fault()
            self._leave_fault()

    def _reconnect(self, bus: DriveBus) -> None:
        """Leave the bus that is gone and connect again, with all its drives."""
        self._end()
        try:
            self.shared.reconnect()
        finally:
            self._begin(bus)

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
        bus, _ = self._open()
        try:
            code = bus.sdo.read_optional(ERROR_CODE)
        except DriverError:
            return ''
        return f'; error code (603Fh) {code:04X}h' if code else ''


def _name(state: DriveState | None) -> str:
    return 'unknown' if state is None else state.value

# SPDX-License-Identifier: Apache-2.0
"""A microcontroller on a serial line, by the protocol of `protocol` (ours).

    v [actuator unit] = command_scale · counts        x^(i) = state_scales[i] · counts

The device sends its state at a rate of its own, faster than the loop; each sample takes the
newest. Each command carries how long it is valid, by default as long as the host itself holds one
(`safety.command_hold`), so that the device goes to the safe command on its own where this process,
the line or the machine has died.

The axes at one port are the motors of one device and share its `board`: what is measured of a
sample is of one state, a fault of one motor stops all and is reported by its own axis.

A device that falls silent, repeats itself, restarts, is unplugged or does something else than
it was asked (`state_monitor`) is a fault until the operator resets, also if it is back within a
sample: it must not be given power again by a reconnection.

Over 300 lines: the whole contract of a driver, of which the board has what all motors share.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math
import time
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import Truth
from dz_ros.core.safety.health import Level, Report
from dz_ros.drivers.contract import Driver
from dz_ros.drivers.freshness import Freshness
from dz_ros.drivers.phase import Phase
from dz_ros.drivers.serial.board import Board, RefusedError
from dz_ros.drivers.serial.link import Link
from dz_ros.drivers.serial.protocol import (
    COUNT_LIMIT,
    MAX_HOLD_MS,
    Mode,
    MotorInfo,
    Request,
)
from dz_ros.drivers.serial.settings import check_device, measured_of, SerialParameters
from dz_ros.errors import DriverError


class Serial(Driver):
    """A motor of a microcontroller on a serial line.

    Args:
        board: The device, where axes share it; None = it is this axis' own.
        motor: Which of its motors.

    Attributes:
        motor: Which motor of the device.
        hold_ms: How long the device holds a command [ms].
    """

    name = 'serial'
    summary = 'a microcontroller on a serial line (extra serial); docs/serial.md has the protocol'
    order = 0
    requires = ('serial',)
    Parameters = SerialParameters

    def __init__(self, parameters: Any, configuration: Configuration,
                 board: Board | None = None, motor: int = 0) -> None:
        super().__init__(parameters, configuration)
        if board is None:
            check_device({'': configuration})
        self.motor = motor
        self._board = Board([configuration]) if board is None else board
        self._board.axes[motor] = self
        self._phase = Phase(configuration.loop.period)
        self._scales: tuple[float, ...] = ()
        self.configure(configuration)

    @classmethod
    def check_axes(cls, axes: Mapping[str, Configuration]) -> None:
        """Check that axes at one port can be the motors of one device.

        Raises:
            ConfigurationError: They cannot.
        """
        names = tuple(axes)
        for places in _ports(tuple(axes.values())).values():
            check_device({names[place]: axes[names[place]] for place in places})

    @classmethod
    def for_axes(cls, each: Sequence[Configuration]) -> Sequence[Serial]:
        """Return the drivers of axes; those with the same port share a device."""
        made: dict[int, Serial] = {}
        for places in _ports(each).values():
            board = Board([each[place] for place in places])
            for place, motor in zip(places, board.motors, strict=True):
                made[place] = cls(each[place].driver_parameters, each[place], board, motor)
        return [made[place] for place in range(len(each))]

    @property
    def link(self) -> Link:
        """The line."""
        return self._board.link

    @property
    def _info(self) -> MotorInfo | None:
        """What the device states of the motor; None before it did."""
        info = self.link.info
        return None if info is None else info.each[self.motor]

    @property
    def _command_scale(self) -> float:
        """Actuator unit of a count of v."""
        return self.parameters.command_scale or (
            1.0 if self._info is None else self._info.command_scale)

    @property
    def device(self) -> Board | None:
        """The board, where it has motors of other axes."""
        return self._board if len(self._board.motors) > 1 else None

    @property
    def measured(self) -> int:
        """How many of x, x', … are taken from the device."""
        return measured_of(self.configuration)

    @property
    def resolution(self) -> float:
        """One count of x [unit of x]; 0 = what the device states, once open."""
        return super().resolution or next(iter(self._scales or self.parameters.state_scales), 0.0)

    @property
    def derivative_resolution(self) -> tuple[float, ...]:
        """One count of x', x'', … [state units]; empty = what the device states, once open."""
        known = (self._scales or self.parameters.state_scales)[:self.measured]
        return super().derivative_resolution or known[1:]

    @property
    def command_resolution(self) -> float:
        """One count of the command [actuator unit]; 0 = what the device states, once open."""
        known = self.parameters.command_scale if self._info is None else self._command_scale
        return super().command_resolution or known

    @property
    def limit(self) -> float:
        """Largest |v| of the device and of `driver.limit` [command unit]."""
        own = self.parameters.limit or math.inf
        return own if self._info is None else min(own, self._info.limit * self._command_scale)

    def configure(self, configuration: Configuration) -> None:
        """Use another safe command, limit and watchdog from now on."""
        super().configure(configuration)
        self.parameters = configuration.driver_parameters
        hold = self.parameters.watchdog or (configuration.safety.command_hold
                                            * configuration.loop.period)
        # Where the host holds a command for ever the device does for as long as it can.
        self.hold_ms = max(math.ceil(min((hold or math.inf) * 1e3, MAX_HOLD_MS) - 1e-6), 1)
        self._freshness = Freshness.of(self.parameters.fresh, configuration)

    # Lifecycle.

    def open(self) -> None:
        """Find the device, greet it, take its limits and units.

        Raises:
            DriverError: It is not there, or has too few values or motors.
            MissingDependencyError: pyserial is not installed.
        """
        p, count = self.parameters, len(self._board.motors)
        if p.motor >= count:
            raise DriverError(f'driver.motor = {p.motor}: must be below {count}, the number of '
                              f'axes at driver.port = {p.port!r} and of its motors')
        info = self._board.open(self.motor)
        if info.values < self.measured:
            raise DriverError(f'{p.port}: {info.name!r} measures {info.values} of the '
                              f'{self.measured} values wanted: set driver.measured to '
                              f'{info.values}')
        self._scales = (p.state_scales or info.each[self.motor].state_scales)[:self.measured]

    def enable(self) -> None:
        """Have power on, at the safe command; a fault from before that has gone is reset.

        Raises:
            DriverError: The device refuses, has a fault, its fault lasts, or its e-stop is
                pressed: that one only `recover` lifts.
        """
        self._ask(self._board.enable)

    def disable(self) -> None:
        """Take power away; a device that does not receive it holds the safe command by itself."""
        self._ask(self._board.disable)

    def close(self) -> None:
        """Let go of the port."""
        self._board.close(self.motor)

    # Each sample.

    def command(self, v: float, t: float) -> None:  # noqa: ARG002
        """Have the newest command sent; only a device without a fault gets the request to run."""
        if self._board.powered:
            running = Request.SAFE if self.fault() else Request.RUN
            self._board.command(self.motor, running, self._counts(v), self.safe_count())

    def safe(self, v: float, t: float) -> None:  # noqa: ARG002
        """Have the device hold the safe command v."""
        if self._board.powered:
            self._board.command(self.motor, Request.SAFE, self._counts(v), self._counts(v))

    def safe_count(self) -> int:
        """Return the safe command [counts]."""
        return self._counts(self.configuration.safety.safe_command)

    def advance(self, t: float, seq: int) -> Truth | None:  # noqa: ARG002
        """Learn when samples end: what is measured is brought there."""
        self._phase.sample_ended(time.monotonic(), t)
        return None

    def measure(self) -> tuple[float, ...] | None:
        """Return the newest measurement, shape (measured,); None where none is fresh.

        x is brought from the instant of the state to that of the sample.
        """
        found = self._board.once(self.motor, self._board.measure)
        if found is None:
            return None
        state, arrived, measured, now = found
        if not self._freshness.holds(arrived, now):
            return None
        counts = state.values[self.motor]
        if len(counts) < len(self._scales):
            return None
        x, *others = (scale * count for scale, count in zip(self._scales, counts, strict=False))
        if self.parameters.extrapolate:
            speed = others[0] if others else self._scales[0] * self.link.speed(self.motor)
            x = self._freshness.advanced(x, speed, self._phase.near(now) - measured)
        return (x, *others)

    def fault(self) -> str:
        """Return what is wrong with line, device or motor; a fault of another one is not."""
        if self.link.fault:
            return self.link.fault
        found, stale = self.link.newest(), self.link.monitor.stale
        if found is not None and stale and self._freshness.lost(found[1]):
            return stale
        if found is not None and found[0].mode is Mode.FAULT:
            return self._board.trip(self.motor, found[0].faults)
        if found is not None and found[0].mode is Mode.ESTOP:
            return 'the e-stop of the device is latched: release it, then reset'
        return ''

    def recover(self) -> None:
        """Take the device as it is now, clear its fault or e-stop, give it power if it had it.

        Raises:
            DriverError: It is not there, its fault lasts, or its position is lost.
        """
        self._ask(self._board.recover)

    def resume(self) -> None:
        """Take the device as it is now, give it power if it had it; trip and e-stop last.

        Raises:
            DriverError: It is not there, takes no power, or its position is lost.
        """
        self._ask(self._board.resume)

    def applied_command(self) -> float | None:
        """Return what the device holds, by its mode and the newest command it has taken."""
        found, wish = self.link.newest(), self.link.taken()
        if found is None:
            return None
        if found[0].mode not in (Mode.RUN, Mode.SAFE):
            return 0.0      # no power
        if wish is None:
            return None
        return self._command_scale * (wish.v if found[0].mode is Mode.RUN
                                      else wish.safe)[self.motor]

    @property
    def refused(self) -> Mapping[str, int]:
        """Damaged frames, frames and states not taken, by cause; motor 0 has those of all."""
        return self.link.refused.counts if self.motor == 0 else {}

    def report(self, report: Report) -> None:
        """Add the fault of the motor, and once for all motors what is known of device and line."""
        found = self.link.newest()
        if self.motor == 0:
            report.put('device', None if self.link.info is None else self.link.info.name)
            if found is not None:
                report.put('device mode', found[0].mode.name.lower())
        if found is not None:
            report.put('device fault', found[0].faults[self.motor], 'd')
        if self.motor == 0:
            if found is not None:
                report.put('trips of its watchdog', found[0].trips, 'd')
                report.put('age of the state [ms]', (time.monotonic() - found[1]) * 1e3, '.3f')
            monitor = self.link.monitor
            report.put('command to answer max [ms]', monitor.slowest * 1e3, '.3f')
            monitor.slowest = 0.0
            for what, count in self.link.counts.items():
                report.put(f'line: {what}', count, 'd')
        if self.fault():
            report.summarize(Level.ERROR, self.fault())

    def _counts(self, v: float) -> int:
        """Return a command in counts, within what the motor takes."""
        limit = COUNT_LIMIT if self._info is None else self._info.limit
        return round(min(max(v / self._command_scale, -limit), limit))

    def _ask(self, work: Callable[[], None]) -> None:
        """Have something done for all axes of the device, once.

        Raises:
            DriverError: It is not done, and not because of another axis' motor.
        """
        try:
            self._board.once(self.motor, work)
        except RefusedError as error:
            why = self.fault()
            if why or not self._board.fault():
                raise DriverError(f'{self.link.port}: {error.what}{why or "no answer"}') from None


def _ports(each: Sequence[Configuration]) -> dict[str, list[int]]:
    """Return port → places of the axes there."""
    found: dict[str, list[int]] = {}
    for place, item in enumerate(each):
        found.setdefault(item.driver_parameters.port, []).append(place)
    return found

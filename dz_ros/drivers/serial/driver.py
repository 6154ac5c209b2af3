# SPDX-License-Identifier: Apache-2.0
"""A microcontroller on a serial line, by the protocol of `protocol` (ours).

    v [actuator unit] = command_scale · counts        x^(i) = state_scales[i] · counts

The device sends its state at a rate of its own, faster than the loop; each sample takes the
newest. Each command carries how long it is valid, by default as long as the host
itself holds one (`safety.command_hold`), so that the device goes to the safe command on its own
where this process, the line or the machine has died.

A device that falls silent, repeats itself, restarts, is unplugged or does something else than
it was asked (`state_monitor`) is a fault until the operator resets, also if it is back within a
sample: it must not be given power again by a reconnection.

Over 300 lines: the whole contract of a driver.
"""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
import math
import time
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.safety.health import Level, Report
from dz_ros.drivers.contract import Driver
from dz_ros.drivers.freshness import Freshness
from dz_ros.drivers.serial.framing import CRC_SIZE
from dz_ros.drivers.serial.link import Link
from dz_ros.drivers.serial.protocol import (
    COUNT_LIMIT,
    Info,
    MAX_HOLD_MS,
    MAX_VALUES,
    Mode,
    Request,
    State,
)
from dz_ros.drivers.serial.settings import SerialParameters
from dz_ros.drivers.serial.state_monitor import Wish
from dz_ros.errors import ConfigurationError, DriverError

ANSWER = 0.5
"""A device that is there does what it is asked within this [s]."""
BITS = 10
"""Bits on the line for a byte: start, eight, stop."""


class Serial(Driver):
    """A microcontroller on a serial line.

    Attributes:
        link: The line.
        hold_ms: How long the device holds a command [ms].
    """

    name = 'serial'
    summary = 'a microcontroller on a serial line (extra serial); docs/serial.md has the protocol'
    order = 0
    requires = ('serial',)
    Parameters = SerialParameters

    def __init__(self, parameters: Any, configuration: Configuration) -> None:
        super().__init__(parameters, configuration)
        p, order = parameters, configuration.plant.order
        if self.measured > order or order > MAX_VALUES:
            raise ConfigurationError('driver.measured', p.measured, f'must be at most {order}, '
                                     f'and a plant of order {MAX_VALUES} at most')
        if p.state_scales and len(p.state_scales) != self.measured:
            raise ConfigurationError('driver.state_scales', list(p.state_scales), 'must have '
                                     f'{self.measured} numbers, one for each value measured')
        if p.device_rate < configuration.loop.rate:
            raise ConfigurationError('driver.device_rate', p.device_rate, 'must be at least '
                                     f'loop.rate = {configuration.loop.rate:g} Hz')
        share = p.device_rate * BITS * _on_the_line(self.measured) / p.baudrate
        if share > 0.9:
            raise ConfigurationError('driver.device_rate', p.device_rate, 'needs '
                                     f'{share:.0%} of a line of driver.baudrate = {p.baudrate}; '
                                     'it must be at most 90 %')
        self.link = Link(p.port, p.baudrate, round(1e6 / p.device_rate), p.silence)
        self._info: Info | None = None
        self._command_scale = 1.0
        self._scales: tuple[float, ...] = ()
        self._powered = False
        self.configure(configuration)

    @property
    def measured(self) -> int:
        """How many of x, x', … are taken from the device."""
        return self.parameters.measured or self.configuration.plant.order

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
        known = self.parameters.command_scale
        if self._info is not None:
            known = self._command_scale
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
            DriverError: It is not there, or measures less than is needed.
            MissingDependencyError: pyserial is not installed.
        """
        p = self.parameters
        info = self.link.open(p.patience)
        if info.values < self.measured:
            raise DriverError(f'{p.port}: {info.name!r} measures {info.values} of the '
                              f'{self.measured} values wanted: set driver.measured to '
                              f'{info.values}')
        self._command_scale = p.command_scale or info.command_scale
        self._scales = (p.state_scales or info.state_scales)[:self.measured]
        self._info = info

    def enable(self) -> None:
        """Have power on, at the safe command; a fault from before that has gone is reset.

        Raises:
            DriverError: The device refuses, has a fault, its fault lasts, or its e-stop is
                pressed: that one only `recover` lifts.
        """
        self._accept()
        if self._mode() is Mode.FAULT:
            self._ask(Request.RESET, (Mode.DISABLED, Mode.SAFE), 'leave its fault')
        if self.fault():
            raise DriverError(f'{self.parameters.port}: {self.fault()}')
        self._give_power()
        self._powered = True

    def disable(self) -> None:
        """Take power away; a device that does not receive it holds the safe command by itself."""
        self._powered = False
        with contextlib.suppress(DriverError):  # it is not there, and its watchdog has acted
            self._ask(Request.DISABLE, (Mode.DISABLED, Mode.FAULT, Mode.ESTOP), 'give power off')

    def close(self) -> None:
        """Let go of the port."""
        self.link.close()

    # Each sample.

    def command(self, v: float, t: float) -> None:  # noqa: ARG002
        """Have the newest command sent; only a device without a fault gets the request to run."""
        if self._powered:
            running = Request.SAFE if self.fault() else Request.RUN
            self.link.send(self._wish(running, v, self.configuration.safety.safe_command))

    def safe(self, v: float, t: float) -> None:  # noqa: ARG002
        """Have the device hold the safe command v."""
        if self._powered:
            self.link.send(self._wish(Request.SAFE, v, v))

    def measure(self) -> tuple[float, ...] | None:
        """Return the newest measurement, shape (measured,); None where none is fresh."""
        found = self.link.newest()
        if found is None or not self._freshness.holds(found[1]):
            return None
        if len(found[0].values) < len(self._scales):
            return None
        return tuple(scale * counts for scale, counts in zip(self._scales, found[0].values,
                                                             strict=False))

    def fault(self) -> str:
        """Return what is wrong with line or device."""
        if self.link.fault:
            return self.link.fault
        found, stale = self.link.newest(), self.link.monitor.stale
        if found is not None and stale and self._freshness.lost(found[1]):
            return stale
        if found is not None and found[0].mode is Mode.FAULT:
            return f'the device reports fault {found[0].fault}'
        if found is not None and found[0].mode is Mode.ESTOP:
            return 'the e-stop of the device is latched: release it, then reset'
        return ''

    def recover(self) -> None:
        """Take the device as it is now, clear its fault or e-stop, give it power if it had it.

        Raises:
            DriverError: It is not there, its fault lasts, or its position is lost.
        """
        self._accept()
        if self._mode() in (Mode.FAULT, Mode.ESTOP):
            self._ask(Request.RESET, (Mode.DISABLED, Mode.SAFE), 'leave its fault')
        if self._powered:
            self._give_power()

    def applied_command(self) -> float | None:
        """Return what the device holds, by its mode and the newest command it has taken."""
        found, wish = self.link.newest(), self.link.taken()
        if found is None:
            return None
        if found[0].mode not in (Mode.RUN, Mode.SAFE):
            return 0.0      # no power
        if wish is None:
            return None
        return self._command_scale * (wish.v if found[0].mode is Mode.RUN else wish.safe)

    @property
    def refused(self) -> Mapping[str, int]:
        """Damaged frames, frames and states that were not taken, by cause."""
        return self.link.refused.counts

    def report(self, report: Report) -> None:
        """Add device, rate, damage on the line and trips of the watchdog."""
        report.put('device', None if self._info is None else self._info.name)
        found = self.link.newest()
        if found is not None:
            report.put('device mode', found[0].mode.name.lower())
            report.put('device fault', found[0].fault, 'd')
            report.put('trips of its watchdog', found[0].trips, 'd')
            report.put('age of the state [ms]', (time.monotonic() - found[1]) * 1e3, '.3f')
        monitor = self.link.monitor
        report.put('command to answer max [ms]', monitor.slowest * 1e3, '.3f')
        monitor.slowest = 0.0
        for what, count in self.link.counts.items():
            report.put(f'line: {what}', count, 'd')
        if self.fault():
            report.summarize(Level.ERROR, self.fault())

    # Requests to the device.

    def _mode(self) -> Mode | None:
        """Return the device's newest mode; None where nothing is known."""
        found = self.link.newest()
        return None if found is None else found[0].mode

    def _accept(self) -> None:
        """Take the device that is there for the one to work with.

        Raises:
            DriverError: There is none, or it has lost its position.
        """
        self.link.mend()
        if self.link.monitor.restarted and not self.parameters.absolute_encoder:
            raise DriverError(f'{self.parameters.port}: the device has restarted and its position '
                              'is lost (driver.absolute_encoder = false): home it, then start '
                              'the loop again')

    def _give_power(self) -> None:
        """Have power on, at the safe command, in this session of the line.

        Raises:
            DriverError: The device refuses.
        """
        self.link.grant()
        self._ask(Request.SAFE, (Mode.SAFE,), 'take power')

    def _wish(self, request: Request, v: float, safe: float) -> Wish:
        return Wish(request, self._counts(v), self._counts(safe), self.hold_ms)

    def _counts(self, v: float) -> int:
        """Return a command in counts, within what the device takes."""
        limit = COUNT_LIMIT if self._info is None else self._info.limit
        return round(min(max(v / self._command_scale, -limit), limit))

    def _ask(self, request: Request, wanted: tuple[Mode, ...], what: str) -> None:
        """Ask until the device has taken the request and is in one of the modes.

        Raises:
            DriverError: It is not, in time.
        """
        give_up = time.monotonic() + ANSWER
        safe = self.configuration.safety.safe_command

        asked = time.monotonic()

        def done() -> bool:
            found, taken = self.link.newest(), self.link.taken()
            return (found is not None and found[1] > asked and found[0].mode in wanted
                    and taken is not None and taken.request is request)

        while time.monotonic() < give_up:
            self.link.send(self._wish(request, safe, safe))
            if self.link.wait(done, 0.05):
                return
        raise DriverError(f'{self.parameters.port}: the device does not {what}: '
                          f'{self.fault() or "no answer"}')


def _on_the_line(values: int) -> int:
    """Return the bytes of a state on the line: body, CRC, overhead of COBS, end."""
    return State.LAYOUT.size + 4 * values + CRC_SIZE + 2

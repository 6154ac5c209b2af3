"""A microcontroller on a serial line, by the protocol of `protocol` (ours).

    v [actuator unit] = command_scale · counts        x^(i) = state_scales[i] · counts

The device sends its state at a rate of its own, faster than the loop; each sample takes the
newest. Each command tells the device for how long it is good, by default as long as the host
itself holds one (`safety.command_hold`), so that the device goes to the safe command on its own
where this process, the line or the machine has died.

A device that falls silent, starts anew or is unplugged is trouble until the operator resets, also
if it is back within a sample: it must not be given power again by a reconnection.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
import math
import time
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.driver import Driver
from dz_ros.core.safety.health import Level, Report
from dz_ros.core.schema import parameter
from dz_ros.drivers.serial.framing import CRC_SIZE
from dz_ros.drivers.serial.link import Link, Wish
from dz_ros.drivers.serial.protocol import (
    COUNT_LIMIT,
    Info,
    MAX_HOLD_MS,
    MAX_VALUES,
    Mode,
    Request,
    State,
)
from dz_ros.errors import ConfigurationError, DriverError

ANSWER = 0.5
"""A device that is there does what it is asked within this [s]."""
BITS = 10
"""Bits on the line for a byte: start, eight, stop."""


@dataclass(frozen=True)
class SerialParameters:
    """The line, the device's units, its watchdog."""

    port: str = parameter('/dev/ttyACM0', '', 'device file, or a URL that pyserial knows',
                          structural=True)
    baudrate: int = parameter(921600, 'bit/s', 'speed of the line; of no effect where a device is '
                              'on USB itself', minimum=1200, maximum=12_000_000, structural=True)
    device_rate: float = parameter(1000.0, 'Hz', 'states per second; the newest is used',
                                   minimum=1.0, maximum=5000.0, structural=True)
    measured: int = parameter(0, '1', "how many of x, x', … are taken from the device; 0 = all; a "
                              'velocity that is not is observed', minimum=0, maximum=MAX_VALUES,
                              structural=True)
    command_scale: float = parameter(0.0, 'actuator unit', 'of a count of v; 0 = what the device '
                                     'says', minimum=0.0, structural=True)
    state_scales: tuple[float, ...] = parameter((), 'state units', "of a count of x, x', …; empty "
                                                '= what the device says', minimum=0.0,
                                                open_minimum=True, structural=True)
    limit: float = parameter(0.0, 'actuator unit', "largest |v|, on top of the device's own; 0 = "
                             'no other', minimum=0.0)
    watchdog: float = parameter(0.0, 's', 'the device holds a command so long; 0 = '
                                'safety.command_hold', minimum=0.0, maximum=MAX_HOLD_MS * 1e-3)
    fresh: float = parameter(2.0, 'samples', 'an older state is none', minimum=0.1)
    silence: float = parameter(0.1, 's', 'a device that says nothing for so long has gone',
                               minimum=0.01, structural=True)
    patience: float = parameter(5.0, 's', 'longest wait for the first answer; boards that start '
                                'anew when a port is opened take seconds', minimum=0.1,
                                structural=True)


class Serial(Driver):
    """A microcontroller on a serial line."""

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
        self._link = Link(p.port, p.baudrate, round(1e6 / p.device_rate), p.silence)
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
        self._hold_ms = min(max(math.ceil(hold * 1e3 - 1e-6), 1), MAX_HOLD_MS)

    # Its life.

    def open(self) -> None:
        """Find the device, greet it, take its limits and units.

        Raises:
            DriverError: It is not there, or measures less than is needed.
            MissingDependencyError: pyserial is not installed.
        """
        p = self.parameters
        info = self._link.open(p.patience)
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
            DriverError: The device refuses, is in trouble, its fault lasts, or its e-stop is
                pressed: that one only `recover` lifts.
        """
        self._link.mend()
        if self._mode() is Mode.FAULT:
            self._ask(Request.RESET, (Mode.DISABLED, Mode.SAFE), 'leave its fault')
        if self.trouble():
            raise DriverError(f'{self.parameters.port}: {self.trouble()}')
        self._ask(Request.SAFE, (Mode.SAFE, Mode.RUN), 'take power')
        self._powered = True

    def disable(self) -> None:
        """Have power off; a device that does not hear it holds the safe command by itself."""
        self._powered = False
        with contextlib.suppress(DriverError):  # it is not there, and its watchdog has acted
            self._ask(Request.DISABLE, (Mode.DISABLED, Mode.FAULT, Mode.ESTOP), 'give power off')

    def close(self) -> None:
        """Let go of the port."""
        self._link.close()

    # Each sample.

    def command(self, v: float, t: float) -> None:  # noqa: ARG002
        """Have the newest command sent; only a device that is not in trouble is told to run."""
        if self._powered:
            running = Request.SAFE if self.trouble() else Request.RUN
            self._link.send(self._wish(running, v, self.configuration.safety.safe_command))

    def safe(self, v: float, t: float) -> None:  # noqa: ARG002
        """Have the device hold the safe command v."""
        if self._powered:
            self._link.send(self._wish(Request.SAFE, v, v))

    def measure(self) -> tuple[float, ...] | None:
        """Return the newest measurement, shape (measured,); None where none is fresh."""
        found = self._link.newest()
        limit = self.parameters.fresh * self.configuration.loop.period
        if found is None or time.monotonic() - found[1] > limit:
            return None
        if len(found[0].values) < len(self._scales):
            return None
        return tuple(scale * counts for scale, counts in zip(self._scales, found[0].values,
                                                             strict=False))

    def trouble(self) -> str:
        """Return what is wrong with line or device."""
        if self._link.trouble:
            return self._link.trouble
        found = self._link.newest()
        if found is not None and found[0].mode is Mode.FAULT:
            return f'the device reports fault {found[0].fault}'
        if found is not None and found[0].mode is Mode.ESTOP:
            return 'the e-stop of the device is latched: release it, then reset'
        return ''

    def recover(self) -> None:
        """Take the device as it is now, clear its fault or e-stop, give it power if it had it.

        Raises:
            DriverError: It is not there, or its fault lasts.
        """
        self._link.mend()
        if self._mode() in (Mode.FAULT, Mode.ESTOP):
            self._ask(Request.RESET, (Mode.DISABLED, Mode.SAFE), 'leave its fault')
        if not self._powered:
            return
        self._ask(Request.SAFE, (Mode.SAFE, Mode.RUN), 'take power')

    def in_force(self) -> float | None:
        """Return what the device holds, by its mode and the newest command it has taken."""
        found, wish = self._link.newest(), self._link.taken()
        if found is None:
            return None
        if found[0].mode not in (Mode.RUN, Mode.SAFE):
            return 0.0      # no power
        if wish is None:
            return None
        return self._command_scale * (wish.v if found[0].mode is Mode.RUN else wish.safe)

    def report(self, report: Report) -> None:
        """Add device, rate, damage on the line and trips of the watchdog."""
        report.put('device', None if self._info is None else self._info.name)
        found = self._link.newest()
        if found is not None:
            report.put('device mode', found[0].mode.name.lower())
            report.put('device fault', found[0].fault, 'd')
            report.put('trips of its watchdog', found[0].trips, 'd')
            report.put('age of the state [ms]', (time.monotonic() - found[1]) * 1e3, '.3f')
        for what, count in {**self._link.counts, **self._link.rejected()}.items():
            report.put(f'line: {what}', count, 'd')
        if self.trouble():
            report.say(Level.ERROR, self.trouble())

    # What it says to the device, and hears of it.

    def _mode(self) -> Mode | None:
        """Return the device's newest mode; None where nothing is known."""
        found = self._link.newest()
        return None if found is None else found[0].mode

    def _wish(self, request: Request, v: float, safe: float) -> Wish:
        return Wish(request, self._counts(v), self._counts(safe), self._hold_ms)

    def _counts(self, v: float) -> int:
        """Return a command in counts, within what the device takes."""
        limit = COUNT_LIMIT if self._info is None else self._info.limit
        return round(min(max(v / self._command_scale, -limit), limit))

    def _ask(self, request: Request, wanted: tuple[Mode, ...], what: str) -> None:
        """Ask until the device is in one of the modes.

        Raises:
            DriverError: It is not, in time.
        """
        give_up = time.monotonic() + ANSWER
        safe = self.configuration.safety.safe_command

        asked = time.monotonic()

        def done() -> bool:
            found = self._link.newest()
            return found is not None and found[1] > asked and found[0].mode in wanted

        while time.monotonic() < give_up:
            self._link.send(self._wish(request, safe, safe))
            if self._link.wait(done, 0.05):
                return
        raise DriverError(f'{self.parameters.port}: the device does not {what}: '
                          f'{self.trouble() or "no answer"}')


def _on_the_line(values: int) -> int:
    """Return the bytes of a state on the line: body, CRC, overhead of COBS, end."""
    return State.LAYOUT.size + 4 * values + CRC_SIZE + 2

# SPDX-License-Identifier: Apache-2.0
"""A microcontroller on a pseudo-terminal, to try the driver and the loop without hardware (ours).

    plant ── device (or a program) ── cable ── port ◀── driver

The device speaks the whole protocol, with its own watchdog, and has the configured plant behind
the configured dead-zone, of several axes a motor for each. Faults happen to the cable (bytes
wrong, lost, added; unplugged, cut), to the device (silent, deaf, frozen, restarted, in fault) or
to its states (`tampering`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
import select
import time
from typing import Any, ClassVar

from dz_ros.core.configuration import Configuration
from dz_ros.core.plants.coupled import CoupledPlant
from dz_ros.core.schema import parameter
from dz_ros.drivers.emulators import Emulator, Fault
from dz_ros.drivers.serial import tampering
from dz_ros.drivers.serial.cable import Cable
from dz_ros.drivers.serial.emulated_devices import EmulatedDevice, EmulationTarget, Program
from dz_ros.drivers.serial.framing import Receiver
from dz_ros.drivers.serial.protocol import (
    Command,
    decode,
    FrameError,
    MAX_MOTORS,
    MAX_VALUES,
    Mode,
    Request,
)
from dz_ros.drivers.serial.settings import motors_of, SerialParameters
from dz_ros.errors import ConfigurationError

SHARE = 0.01
"""Share of bytes that a fault hits unless it gives another one."""
CONTACT, OPEN = 0.02, 0.5
"""An intermittent contact decides after each of these [s]; share in which it is open."""


@dataclass(frozen=True)
class SerialEmulatorParameters:
    """The port and the device."""

    link: str = parameter('', '', 'symbolic link to the port, so that its name stays the same')
    program: str = parameter('', '', 'program to be the device: its standard input and output '
                             'are the line')
    values: int = parameter(0, '1', "how many of x, x', … it measures; 0 = all", minimum=0,
                            maximum=MAX_VALUES)
    command_scale: float = parameter(1e-3, 'actuator unit', 'of a count of v', minimum=0.0,
                                     open_minimum=True)
    state_scale: float = parameter(1e-6, 'state units', "of a count of x, x', …", minimum=0.0,
                                   open_minimum=True)
    limit: int = parameter(30000, 'counts', 'largest |v|', minimum=1, maximum=2 ** 31 - 1)
    motors: int = parameter(0, '1', 'how many motors it has; 0 = one for each axis of the '
                            'configuration. Where those are fewer they come again', minimum=0,
                            maximum=MAX_MOTORS)


class SerialEmulator(Emulator):
    """A device of the serial protocol on a pseudo-terminal."""

    name = 'serial'
    summary = 'a microcontroller on a pseudo-terminal, for the driver serial'
    faults: ClassVar[Mapping[str, str]] = {
        'unplug': 'the port is gone for S s',
        'mute': 'nothing comes from the device for S s',
        'deaf': 'nothing reaches the device for S s',
        'intermittent': 'for S s nothing passes in a share VALUE (0.5) of intervals of 20 ms',
        'corrupt': 'for S s a share VALUE of the bytes has a wrong bit (0.01)',
        'lose': 'for S s a share VALUE of the bytes is lost (0.01)',
        'garbage': 'VALUE bytes of noise both ways at once (1000)',
        'freeze': 'the device does nothing for S s; the actuator keeps what it has',
        'restart': 'the device restarts',
        'trip': 'its amplifier reports fault VALUE for S s (7); DEVICE is a motor or its axis',
        **tampering.FAULTS,
    }
    Parameters = SerialEmulatorParameters

    def __init__(self, parameters: Any, configuration: Configuration,
                 faults: Sequence[Fault] = ()) -> None:
        super().__init__(parameters, configuration, faults)
        order = configuration.plant.order
        if (parameters.values or order) > min(order, MAX_VALUES):
            raise ConfigurationError('values', parameters.values, f'must be at most '
                                     f'{min(order, MAX_VALUES)}')
        for fault in faults:
            if fault.name == 'mode' and fault.value not in tuple(Mode) \
                    and not math.isnan(fault.value):
                raise ConfigurationError('--fault', f'mode@{fault.start:g}={fault.value:g}',
                                         f'must have a VALUE of 0 to {max(Mode)}')
        self._names, self._each = zip(*self._axes(), strict=True)
        for fault in faults:
            if fault.device and fault.name != 'trip':
                raise ConfigurationError('--fault', f'{fault.device}:{fault.name}', 'is a fault '
                                         'of the device; trip alone is one of a motor')
            self._motor(fault)
        self._cable = Cable(parameters.link, configuration.loop.seed)
        self._device: EmulationTarget | None = None
        self._receiver = Receiver()
        self._moving: int | None = None
        self._happening: set[Fault] = set()
        self._past: set[Fault] = set()
        self._tampering: tampering.Tampering | None = None

    def open(self) -> str:
        """Make the port appear.

        Raises:
            DriverError: The link or the program cannot be used.
        """
        p = self.parameters
        values = p.values or self.configuration.plant.order
        self._device = Program(p.program) if p.program else EmulatedDevice(
            self._each, (p.command_scale, *[p.state_scale] * values), p.limit)
        self._cable.plug()
        return f'serial device on {self._cable.port}'

    def run(self, stopping: Callable[[], bool], log: Callable[[str], None]) -> None:
        """Be the device until `stopping` returns True.

        Raises:
            DriverError: The program has ended.
        """
        device = self._device
        assert device is not None
        now = time.monotonic_ns() // 1000
        if self.script:
            self._tampering = tampering.Tampering(lambda mode: log(f'mode {mode.name.lower()}'))
        while not stopping():
            ends = [end for end in (self._cable.fileno(), device.fileno()) if end >= 0]
            select.select(ends, [], [], max(device.due(now) - now, 0) * 1e-6)
            now = time.monotonic_ns() // 1000
            self._follow_script(device, now, log)
            received = self._disturb('deaf', self._cable.read(), log, now)
            sent = device.step(received, now)
            if self._tampering is not None:
                sent = self._tampering.pass_on(sent, {fault.name: fault.value
                                                      for fault in self._happening})
            self._cable.write(self._disturb('mute', sent, log, now))

    def close(self) -> None:
        """Make the port vanish."""
        self._cable.unplug()
        if self._device is not None:
            self._device.close()

    @classmethod
    def of_axes(cls, parameters: Any, machine: Configuration, nodes: int,
                faults: Sequence[Fault]) -> SerialEmulator:
        """Return the device with a motor for each axis.

        Raises:
            ConfigurationError: They do not make one.
        """
        if nodes:
            raise ConfigurationError('--nodes', nodes, f'{cls.name} emulates one device; the '
                                     'number of its motors is --option motors')
        return cls(parameters, machine, faults)

    def _axes(self) -> list[tuple[str, Configuration]]:
        """Return the axis behind each motor; of axes at several ports those at that of `link`.

        Raises:
            ConfigurationError: They do not make one device, or a plant couples another number.
        """
        machine = self.configuration.axes or (('', self.configuration),)
        at = {name: item.driver_parameters.port for name, item in machine
              if isinstance(item.driver_parameters, SerialParameters)}
        ports, link = sorted(set(at.values())), self.parameters.link
        if len(ports) > 1 and link not in ports:
            raise ConfigurationError('--option link', link, 'must be a driver.port of the axes: '
                                     f'one of {", ".join(ports)}')
        axes = [axis for axis in machine if len(ports) < 2 or at.get(axis[0]) == link]
        if ports:
            motors = motors_of([item for _, item in axes])
            axes = [axes[motors.index(motor)] for motor in range(len(axes))]
        count = self.parameters.motors or len(axes)
        if count > MAX_MOTORS:
            raise ConfigurationError('loop.axes', [name for name, _ in axes], 'are more than the '
                                     f'{MAX_MOTORS} motors of a device: set --option motors')
        if isinstance(axes[0][1].plant, CoupledPlant) and (
                len(axes), count) != (len(machine), len(machine)):
            raise ConfigurationError('--option motors', count, f'must be {len(machine)}: the '
                                     'plant couples as many')
        return [axes[place % len(axes)] for place in range(count)]

    def _motor(self, fault: Fault) -> int | None:
        """Return the motor that a fault is of; None = each.

        Raises:
            ConfigurationError: There is none of that name or number.
        """
        known = [*self._names, *map(str, range(len(self._names)))]
        if not fault.device:
            return None
        if fault.device not in known:
            raise ConfigurationError('--fault', f'{fault.device}:{fault.name}', 'DEVICE must be '
                                     f'one of {", ".join(filter(None, known))}')
        return known.index(fault.device) % len(self._names)

    def _disturb(self, lost_by: str, data: bytes, log: Callable[[str], None], now: int) -> bytes:
        """Return what of the bytes gets through; note the first command that moves the device."""
        if lost_by == 'deaf' and self._moving is None and data:
            for body in self._receiver.feed(data):
                try:
                    frame = decode(body)
                except FrameError:
                    continue
                if isinstance(frame, Command) and frame.request is Request.RUN:
                    self._moving = now
                    log('running: the script begins')
        for fault in self._happening:
            share = SHARE if math.isnan(fault.value) else fault.value
            if fault.name == lost_by:
                return b''
            if fault.name == 'intermittent' and self._cable.open_contact(
                    int(now * 1e-6 / CONTACT), OPEN if math.isnan(fault.value) else fault.value):
                return b''
            if fault.name == 'corrupt' and data:
                data = self._cable.corrupt(data, share)
            elif fault.name == 'lose' and data:
                data = self._cable.lose(data, share)
            elif fault.name == 'garbage':
                data = self._cable.noise(1000 if math.isnan(fault.value) else int(fault.value))
        return data

    def _follow_script(self, device: EmulationTarget, now: int,
                       log: Callable[[str], None]) -> None:
        """Let begin and end what is due."""
        if self._moving is None or not self.script:
            return
        t = (now - self._moving) * 1e-6
        for fault in self._happening - {item for item in self.script if item.active(t)}:
            self._happening.discard(fault)
            self._past.add(fault)
            self._end(device, fault)
            log(f'{fault.name} ends')
        for fault in self.script:
            if t >= fault.start and fault not in self._happening | self._past:
                self._happening.add(fault)
                log(f'{fault.name} begins at {t:.3f} s')
                self._begin(device, fault)

    def _begin(self, device: EmulationTarget, fault: Fault) -> None:
        if fault.name == 'unplug':
            self._cable.unplug()
        elif fault.name in ('restart', 'swap'):
            device.restart()
        elif fault.name == 'freeze':
            device.freeze(True)
        elif fault.name == 'trip':
            device.trip(7 if math.isnan(fault.value) else int(fault.value), self._motor(fault))

    def _end(self, device: EmulationTarget, fault: Fault) -> None:
        if fault.name == 'unplug':
            self._cable.plug()
        elif fault.name == 'swap':
            device.restart()
        elif fault.name == 'freeze':
            device.freeze(False)
        elif fault.name == 'trip':
            device.trip(0, self._motor(fault))

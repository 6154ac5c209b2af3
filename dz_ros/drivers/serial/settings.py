# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver serial: the line, the device's units, its watchdog (ours)."""

from __future__ import annotations

from dataclasses import dataclass

from dz_ros.core.schema import parameter
from dz_ros.drivers.freshness import fresh_parameter
from dz_ros.drivers.serial.protocol import MAX_HOLD_MS, MAX_MOTORS, MAX_VALUES


@dataclass(frozen=True)
class SerialParameters:
    """The line, the device's units, its watchdog."""

    port: str = parameter('/dev/ttyACM0', '', 'device file, or a URL that pyserial knows',
                          structural=True)
    baudrate: int = parameter(921600, 'bit/s', 'speed of the line; of no effect where a device is '
                              'on USB itself', minimum=1200, maximum=12_000_000, structural=True)
    motor: int = parameter(-1, '1', 'which motor of the device it is, from 0; -1 = by the place '
                           'of the axis among those at driver.port', minimum=-1,
                           maximum=MAX_MOTORS - 1, structural=True)
    device_rate: float = parameter(1000.0, 'Hz', 'states per second; the newest is used',
                                   minimum=1.0, maximum=5000.0, structural=True)
    measured: int = parameter(0, '1', "how many of x, x', … are taken from the device; 0 = all; a "
                              'velocity that is not is observed', minimum=0, maximum=MAX_VALUES,
                              structural=True)
    command_scale: float = parameter(0.0, 'actuator unit', 'of a count of v; 0 = what the device '
                                     'reports', minimum=0.0, structural=True)
    state_scales: tuple[float, ...] = parameter((), 'state units', "of a count of x, x', …; empty "
                                                '= what the device reports', minimum=0.0,
                                                open_minimum=True, structural=True)
    limit: float = parameter(0.0, 'actuator unit', "largest |v|, on top of the device's own; 0 = "
                             'no other', minimum=0.0)
    watchdog: float = parameter(0.0, 's', 'the device holds a command that long; 0 = '
                                'safety.command_hold', minimum=0.0, maximum=MAX_HOLD_MS * 1e-3)
    fresh: float = fresh_parameter('state')
    silence: float = parameter(0.1, 's', 'a device that sends nothing new, or takes no command, '
                               'for that long has gone', minimum=0.01, structural=True)
    patience: float = parameter(5.0, 's', 'longest wait for the first answer; boards that start '
                                'again when a port is opened take seconds', minimum=0.1,
                                structural=True)
    absolute_encoder: bool = parameter(True, '', 'the position survives a restart of the device; '
                                       'if false, a reset after one is refused', structural=True)

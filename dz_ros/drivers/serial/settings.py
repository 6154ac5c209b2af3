# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver serial: the line, the device's units, its watchdog (ours).

And what those of the axes at one port must be together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from dz_ros.core.axes_keys import axis_key
from dz_ros.core.schema import parameter
from dz_ros.drivers.freshness import fresh_parameter
from dz_ros.drivers.serial.framing import CRC_SIZE
from dz_ros.drivers.serial.protocol import MAX_HOLD_MS, MAX_MOTORS, MAX_VALUES, State
from dz_ros.errors import ConfigurationError

if TYPE_CHECKING:
    from dz_ros.core.configuration import Configuration

BITS = 10
"""Bits on the line for a byte: start, eight, stop."""
SHARED = ('baudrate', 'device_rate', 'silence', 'patience')
"""Parameters that are the port's, so the same for all axes there."""


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
    extrapolate: bool = parameter(True, '', 'bring x from the instant of the state to the sample '
                                  "by the device's velocity; by what x has changed, where none is "
                                  'taken', structural=True)
    silence: float = parameter(0.1, 's', 'a device that sends nothing new, or takes no command, '
                               'for that long has gone', minimum=0.01, structural=True)
    patience: float = parameter(5.0, 's', 'longest wait for the first answer; boards that start '
                                'again when a port is opened take seconds', minimum=0.1,
                                structural=True)
    absolute_encoder: bool = parameter(True, '', 'the position survives a restart of the device; '
                                       'if false, a reset after one is refused', structural=True)


def check_device(axes: Mapping[str, Configuration]) -> None:
    """Check that axes at one port can be the motors of one device, and what each has of it.

    Args:
        axes: Name → configuration; the only one may have no name.

    Raises:
        ConfigurationError: An axis cannot be measured so, what is the port's differs, there is no
            motor of that number or two axes have it, the line is too slow.
    """
    first, *_ = axes
    shared: SerialParameters = axes[first].driver_parameters
    owners: dict[int, str] = {}
    for (name, item), motor in zip(axes.items(), motors_of(tuple(axes.values())), strict=True):
        p: SerialParameters = item.driver_parameters
        at_port = f'driver.port = {p.port!r}'
        own = partial(axis_key, name) if name else str
        if len(owners) == MAX_MOTORS:
            raise ConfigurationError(own('driver.port'), p.port, f'is that of {len(axes)} axes; a '
                                     f'device has at most {MAX_MOTORS} motors')
        order, measured = item.plant.order, measured_of(item)
        if measured > order or order > MAX_VALUES:
            raise ConfigurationError(own('driver.measured'), p.measured, f'must be at most {order}'
                                     f', and a plant of order {MAX_VALUES} at most')
        if p.state_scales and len(p.state_scales) != measured:
            raise ConfigurationError(own('driver.state_scales'), list(p.state_scales), 'must have '
                                     f'{measured} numbers, one for each value measured')
        for key in SHARED:
            if getattr(p, key) != getattr(shared, key):
                raise ConfigurationError(own(f'driver.{key}'), getattr(p, key), 'must be '
                                         f'{getattr(shared, key)}, as of axis {first} at the '
                                         f'same {at_port}')
        if name and motor >= len(axes):     # one made alone is asked, `open` refuses it
            raise ConfigurationError(own('driver.motor'), motor, f'must be below {len(axes)}, the '
                                     f'number of axes at {at_port} and of its motors')
        if motor in owners:
            raise ConfigurationError(own('driver.motor'), motor, 'is the motor of axis '
                                     f'{owners[motor]} as well; each has its own (-1: by its '
                                     f'place at {at_port})')
        owners[motor] = name
    rate = axes[first].loop.rate
    if shared.device_rate < rate:
        raise ConfigurationError('driver.device_rate', shared.device_rate, 'must be at least '
                                 f'loop.rate = {rate:g} Hz')
    values = max(map(measured_of, axes.values()))
    size = State.size(len(axes), values) + CRC_SIZE + 2       # overhead of COBS, end
    share = shared.device_rate * BITS * size / shared.baudrate
    if share > 0.9:
        raise ConfigurationError('driver.device_rate', shared.device_rate, 'needs '
                                 f'{share:.0%} of a line of driver.baudrate = '
                                 f'{shared.baudrate}; it must be at most 90 %')


def motors_of(each: Sequence[Configuration]) -> tuple[int, ...]:
    """Return the motor of each axis at a port."""
    return tuple(place if item.driver_parameters.motor < 0 else item.driver_parameters.motor
                 for place, item in enumerate(each))


def measured_of(configuration: Configuration) -> int:
    """Return how many of x, x', … are taken of the motor of an axis."""
    return int(configuration.driver_parameters.measured) or configuration.plant.order

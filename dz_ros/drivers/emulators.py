# SPDX-License-Identifier: Apache-2.0
"""Emulators of devices: processes of their own that answer a driver as a real device would.

An emulator has the configured plant behind its dead-zone, and faults on a script, so that a
driver and the loop behind it can be tried without hardware. ``dz driver emulate KIND`` starts
one; a package of yours adds its own by an entry point in the group ``dz_ros.emulators``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
import re
from typing import Any, ClassVar

from dz_ros.core.configuration import Configuration
from dz_ros.core.registry import Registry
from dz_ros.errors import ConfigurationError

_NUMBER = r'\d+(?:\.\d+)?'
_FAULT = re.compile(rf'(?:(?P<device>\w+):)?(?P<name>[a-z-]+)@(?P<start>{_NUMBER})'
                    rf'(?:\+(?P<duration>{_NUMBER}))?(?:=(?P<value>{_NUMBER}))?', re.ASCII)


@dataclass(frozen=True)
class Fault:
    """A scripted fault.

    Attributes:
        name: One of the emulator's `faults`.
        start: From the first command that moves the device on [s].
        duration: [s].
        value: What the fault needs besides, e.g. a probability or a code; NaN = not given.
        device: Of several emulated devices the one it is of; '' = each of them.
    """

    name: str
    start: float
    duration: float = 0.0
    value: float = math.nan
    device: str = ''

    @classmethod
    def parse(cls, text: str, known: Mapping[str, str]) -> Fault:
        """Return the fault written as [DEVICE:]NAME@START[+DURATION][=VALUE].

        Raises:
            ConfigurationError: It is not written so, or of no kind that is known.
        """
        found = _FAULT.fullmatch(text)
        if found is None:
            raise ConfigurationError('--fault', text, 'must be NAME@START[+DURATION][=VALUE], '
                                     'times in s, e.g. ' + f'{next(iter(known))}@2+0.5')
        if found['name'] not in known:
            raise ConfigurationError('--fault', text, 'is none of ' + ', '.join(known))
        return cls(found['name'], device=found['device'] or '', **{
            key: float(value) for key, value in found.groupdict().items()
            if key not in ('device', 'name') and value is not None})

    def active(self, t: float) -> bool:
        """Return whether it is there at time t [s]."""
        return self.start <= t < self.start + self.duration


class Emulator(ABC):
    """An emulated device.

    Args:
        parameters: The emulator's own, checked.
        configuration: The plant behind it, and the rest.
        faults: The script.

    Attributes:
        name: Name, that of the driver it is for.
        summary: One line for lists.
        faults: Name of each fault it knows → what happens.
        Parameters: Frozen dataclass of `dz_ros.core.schema.parameter` fields.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    faults: ClassVar[Mapping[str, str]]
    Parameters: ClassVar[type]

    def __init__(self, parameters: Any, configuration: Configuration,
                 faults: Sequence[Fault] = ()) -> None:
        self.parameters = parameters
        self.configuration = configuration
        self.script = tuple(faults)

    @classmethod
    def of_axes(cls, parameters: Any, machine: Configuration, nodes: int,  # noqa: ARG003
                faults: Sequence[Fault]) -> Emulator:  # noqa: ARG003
        """Return the emulated devices of a machine in one process, where the class has several.

        Args:
            parameters: The emulator's own, checked, the same for each device.
            machine: The plants behind them, of one axis or several.
            nodes: Number of devices that is asked for; 0 = one for each axis.
            faults: The script.

        Raises:
            ConfigurationError: The class is one device, or the number is not that of the axes.
        """
        if machine.axes:
            raise ConfigurationError('loop.axes', list(machine.axis_names), f'{cls.name} emulates '
                                     'a device of one axis; choose it with --axis')
        raise ConfigurationError('--nodes', nodes, f'{cls.name} emulates one device')

    @abstractmethod
    def open(self) -> str:
        """Begin to answer; return as text how a driver finds it.

        Raises:
            DriverError: It cannot.
        """

    @abstractmethod
    def run(self, stopping: Callable[[], bool], log: Callable[[str], None]) -> None:
        """Emulate the device until `stopping` returns True; log what happens to it."""

    @abstractmethod
    def close(self) -> None:
        """Answer no more."""


EMULATORS = Registry('emulator', 'KIND', 'dz_ros.emulators', Emulator, {
    'serial': 'dz_ros.drivers.serial.emulator:SerialEmulator',
    'cia402': 'dz_ros.drivers.cia402.emulator:Cia402Emulator',
})

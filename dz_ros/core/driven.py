# SPDX-License-Identifier: Apache-2.0
"""What a configuration knows of the driver it names; the contract is ``drivers/contract.py``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from dz_ros.core.registry import Registry
from dz_ros.core.schema import parameter
from dz_ros.plugins import DRIVERS as OWN_DRIVERS


@dataclass(frozen=True)
class DriverSettings:
    """What every driver has besides its own parameters."""

    name: str = parameter('simulated', '', 'name of the driver, or package.module:Class',
                          structural=True)
    observer: float = parameter(0.0, 'rad/s', 'rate ω of the observer of a velocity that the '
                                'device does not measure; 0 = by rule, 3 K b_hat', minimum=0.0)
    observer_kind: str = parameter('tracking', '', 'how that velocity is observed',
                                   choices=('tracking', 'luenberger', 'levant', 'difference'),
                                   structural=True)
    resolution: float = parameter(0.0, 'unit of x', 'one step of the position sensor, for the '
                                  'design rules; 0 = what the driver knows of it', minimum=0.0)
    derivative_resolution: tuple[float, ...] = parameter(
        (), 'state units', "one step of x', x'', … as they are measured, for the design rules; "
        'empty = what the driver knows of them', minimum=0.0)
    command_resolution: float = parameter(0.0, 'actuator unit', 'one step of the command, for the '
                                          'design rules; 0 = what the driver knows of it',
                                          minimum=0.0)


class DriverClass(Protocol):
    """What the class must define for a configuration to name it.

    Attributes:
        name: Name in configurations.
        summary: One line for lists.
        order: Order n of the loop it can close; 0 = any.
        lockstep: Whether it is simulated, so that it can run without a wall clock.
        requires: Modules of optional packages that it imports on opening.
        measured: Number of the states x, x', … that it measures, 1 … n.
        resolution: One step of its position sensor [unit of x]; 0 = not known, or none.
        derivative_resolution: The same of x', x'', …, as many as are known.
        Parameters: Frozen dataclass of `dz_ros.core.schema.parameter` fields.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    order: ClassVar[int]
    lockstep: ClassVar[bool]
    requires: ClassVar[tuple[str, ...]]
    measured: Any
    resolution: Any
    derivative_resolution: Any
    Parameters: ClassVar[type]

    def __init__(self, parameters: Any, configuration: Any) -> None:
        """Take the checked parameters and the whole configuration; open nothing."""


@dataclass(frozen=True)
class NoParameters:
    """Parameters of a driver that has none."""


class Undriven:
    """The driver of a configuration that drives nothing, as that of a controller or a recording.

    The driver's class need not be installed: its name stays, its parameters are set aside.
    """

    name: ClassVar[str] = 'undriven'
    summary: ClassVar[str] = 'no driver'
    order: ClassVar[int] = 0
    lockstep: ClassVar[bool] = True
    requires: ClassVar[tuple[str, ...]] = ()
    Parameters: ClassVar[type] = NoParameters

    def __init__(self, parameters: Any, configuration: Any) -> None:  # noqa: ARG002
        self.measured: Any = configuration.plant.order
        self.resolution: Any = configuration.driver_settings.resolution
        self.derivative_resolution: Any = configuration.driver_settings.derivative_resolution
        self.command_resolution: Any = configuration.driver_settings.command_resolution


DRIVERS = Registry('driver', 'driver.name', 'dz_ros.drivers', DriverClass, OWN_DRIVERS)

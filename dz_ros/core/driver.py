"""What a driver is: the one thing to write to have dz_ros drive an actuator of yours (ours).

A driver moves numbers between the loop and a device, and nothing else. Its host
(``nodes/actuator_node.py``) keeps the 200 Hz, the watchdogs, the limits, the e-stop, the life
cycle and the recording, so that every driver has them. The host calls, in this order:

    driver = Class(parameters, configuration)      nothing is opened, everything is checked
    attach(node)                                   only drivers that speak ROS need it
    open()                                         may take seconds; raises DriverError
    enable()                                       power on; raises DriverError
    each sample    advance(t, seq), trouble(), measure()          at once
    each command   command(v, t), or safe(v, t) where the loop must not act      at once
    recover()                                      when the operator resets a fault
    safe(v, t), disable(), close()                 whatever happened before

"At once" means: without waiting for the device. A device that answers slowly is served by a
thread of the driver's that sends the newest command and keeps the newest state. Libraries a
driver needs are imported in `open`, so that listing drivers needs none of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
import math
from typing import Any, ClassVar, TYPE_CHECKING

from dz_ros.core.records import Truth
from dz_ros.core.registry import Registry
from dz_ros.core.schema import parameter
from dz_ros.errors import DriverError

if TYPE_CHECKING:
    from dz_ros.core.configuration import Configuration
    from dz_ros.core.safety.health import Report


@dataclass(frozen=True)
class DriverSettings:
    """What every driver has besides its own parameters."""

    name: str = parameter('simulated', '', 'name of the driver, or package.module:Class',
                          structural=True)
    observer: float = parameter(50.0, 'rad/s', 'double pole of the observer of a velocity that '
                                'the device does not measure', minimum=0.0, open_minimum=True)


class Driver(ABC):
    """A device that takes commands and is measured; subclass it to add your own.

    Args:
        parameters: The driver's own, checked.
        configuration: The whole configuration: loop, plant, safety.

    Attributes:
        name: Name in configurations.
        summary: One line for lists.
        order: Order n of the loop it can close; 0 = any.
        lockstep: Whether it is simulated, so that it can run without a wall clock.
        requires: Modules of optional packages that `open` imports.
        Parameters: Frozen dataclass of `dz_ros.core.schema.parameter` fields.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    order: ClassVar[int]
    lockstep: ClassVar[bool] = False
    requires: ClassVar[tuple[str, ...]] = ()
    Parameters: ClassVar[type]

    def __init__(self, parameters: Any, configuration: Configuration) -> None:
        self.parameters = parameters
        self.configuration = configuration

    # What it is.

    @property
    def measured(self) -> int:
        """How many of x, x', … it measures, 1 … n; the host observes a velocity not measured."""
        return self.configuration.plant.order

    @property
    def state_units(self) -> tuple[str, ...]:
        """Units of x, x', …, shape (n,); those of the plant unless overridden."""
        return self.configuration.plant.state_units

    @property
    def command_unit(self) -> str:
        """Unit of v; that of the plant unless overridden."""
        return self.configuration.plant.actuator_unit

    @property
    def limit(self) -> float:
        """Largest |v| the device takes [command unit]; the host clips to it and says so."""
        return math.inf

    # Its life.

    def attach(self, node: Any) -> None:
        """Hear of the node that hosts the driver, for publishers, subscriptions and parameters."""

    def open(self) -> None:
        """Find the device and talk to it.

        Raises:
            DriverError: It is not there, or is another one.
            MissingDependencyError: A library is not installed.
        """

    def enable(self) -> None:
        """Let the device take commands.

        Raises:
            DriverError: It refuses.
        """

    def disable(self) -> None:
        """Let the device take no more commands; the host has sent the safe one."""

    def close(self) -> None:
        """Let go of the device; called once for each `open`, also after a failure."""

    def configure(self, configuration: Configuration) -> None:
        """Use other limits and parameters from now on; structural ones are the same."""
        self.configuration = configuration
        self.parameters = configuration.driver_parameters

    # Each sample.

    @abstractmethod
    def command(self, v: float, t: float) -> None:
        """Give the device a command [command unit] at loop time t [s]; return at once."""

    def safe(self, v: float, t: float) -> None:
        """Go to the safe state, the command v if the device has none of its own (quick stop).

        A later `command` acts again, unless `trouble` then says that an operator must reset.
        """
        self.command(v, t)

    @abstractmethod
    def measure(self) -> tuple[float, ...] | None:
        """Return the newest measurement, shape (measured,), at once; None = none that is fresh.

        A sample without one has no state; too many in a row (`safety.state_hold`) are a fault.
        """

    def advance(self, t: float, seq: int) -> Truth | None:  # noqa: ARG002
        """Hear that sample `seq` ends at loop time t [s]; a simulated device says what is true."""
        return None

    def trouble(self) -> str:
        """Return what is wrong with the device, in words; the host latches it as a fault."""
        return ''

    def recover(self) -> None:
        """Try to leave the trouble, when an operator resets; may take a second.

        Raises:
            DriverError: It lasts.
        """

    def in_force(self) -> float | None:
        """Return the command the device holds now [command unit], None where it does not tell.

        Asked by the conformance kit alone, which cannot see otherwise what reached the device.
        """
        return None

    def report(self, report: Report) -> None:
        """Add what the driver knows to the diagnostics, once a second."""


@dataclass(frozen=True)
class NoParameters:
    """Of a driver that is not asked for any."""


class Undriven(Driver):
    """Stands for the driver of a configuration with which nothing is driven here.

    A controller, or whoever looks at a recording, needs no driver's class; it may not even be
    installed. Its name stays in the configuration, its parameters are set aside.
    """

    name = 'undriven'
    summary = 'no driver'
    order = 0
    lockstep = True
    Parameters = NoParameters

    def command(self, v: float, t: float) -> None:  # noqa: ARG002
        """Drive nothing.

        Raises:
            DriverError: Always.
        """
        raise DriverError('this configuration was read without its driver')

    def measure(self) -> tuple[float, ...] | None:
        """Measure nothing."""
        return None


DRIVERS = Registry('driver', 'driver.name', 'dz_ros.drivers', Driver, {
    'simulated': 'dz_ros.drivers.simulated:SimulatedActuator',
    'mock': 'dz_ros.drivers.mock:Mock',
    'cia402': 'dz_ros.drivers.cia402.driver:Cia402',
    'serial': 'dz_ros.drivers.serial.driver:Serial',
    'joint': 'dz_ros.nodes.joint_driver:Joint',
})

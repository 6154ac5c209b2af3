# SPDX-License-Identifier: Apache-2.0
"""The contract of a driver: the class to write to have dz_ros drive an actuator of yours (ours).

A driver moves numbers between the loop and a device, and nothing else. Its host
(``nodes/actuator_node.py``) keeps the 200 Hz, the watchdogs, the limits, the e-stop, the lifecycle
and the recording, so that every driver has them. The host calls, in this order:

    driver = Class(parameters, configuration)      nothing is opened, everything is checked
    attach(node)                                   only drivers that use ROS need it
    open()                                         may take seconds; raises DriverError
    enable()                                       power on; raises DriverError
    each sample    advance(t, seq), fault(), measure()          at once
    each command   command(v, t), or safe(v, t) where the loop must not act      at once
    recover()                                      when the operator resets a fault
    resume()                                       in `dz driver identify`, after a stall
    safe(v, t), disable(), close()                 whatever happened before

"At once" means: without waiting for the device. A device that answers slowly is served by a
thread of the driver's that sends the newest command and keeps the newest state (``feeder.py``).
Libraries a driver needs are imported in `open`, so that listing drivers needs none of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
import math
from typing import Any, ClassVar

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import Truth
from dz_ros.core.safety.health import Report


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

    @classmethod
    def check_axes(cls, axes: Mapping[str, Configuration]) -> None:
        """Check that the axes of a machine that name this class can have it together.

        Called when a configuration is made, by every verb; anything goes unless overridden.

        Args:
            axes: Name → configuration, each as of a loop of this axis alone.

        Raises:
            ConfigurationError: They cannot: two of them name one device.
        """

    @classmethod
    def for_axes(cls, each: Sequence[Configuration]) -> Sequence[Driver]:
        """Return the drivers of all axes of a machine that name this class, in their order.

        One driver for each axis, unless overridden: where several axes are devices of one bus, the
        drivers share its connection. The host calls each of them as if it were alone, axis by axis
        in this order, and takes a sample or a fault of one for all.

        Args:
            each: Configurations of the axes, each as of a loop of this axis alone.
        """
        return [cls(item.driver_parameters, item) for item in each]

    @property
    def measured(self) -> int:
        """Number of the states x, x', … that it measures; the host observes a missing velocity."""
        return self.configuration.plant.order

    @property
    def device(self) -> object:
        """What it shares with the drivers of other axes, a board or a controller; None = nothing.

        Drivers that return the same object are opened, enabled and commanded together or not at
        all: where one of these axes is commanded alone, `beside.py` holds the others at their
        safe command.
        """
        return None

    @property
    def resolution(self) -> float:
        """One step of the position sensor [unit of x]; 0 = not known, or none."""
        return self.configuration.driver_settings.resolution

    @property
    def derivative_resolution(self) -> tuple[float, ...]:
        """One step of x', x'', … as they are measured [state units]; 0, or fewer = not known."""
        return self.configuration.driver_settings.derivative_resolution

    @property
    def command_resolution(self) -> float:
        """One step of the command that the device takes [command unit]; 0 = not known, or none."""
        return self.configuration.driver_settings.command_resolution

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
        """Largest |v| the device takes [command unit]; the host clips to it and reports it."""
        return math.inf

    def attach(self, node: Any) -> None:
        """Take the node that hosts the driver, for publishers, subscriptions and parameters."""

    def open(self) -> None:
        """Find the device and connect to it.

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
        """Release the device; called once for each `open`, also after a failure."""

    def configure(self, configuration: Configuration) -> None:
        """Use other limits and parameters from now on; structural ones are the same."""
        self.configuration = configuration
        self.parameters = configuration.driver_parameters

    @abstractmethod
    def command(self, v: float, t: float) -> None:
        """Give the device a command [command unit] at loop time t [s]; return at once."""

    def safe(self, v: float, t: float) -> None:
        """Go to the safe state, the command v if the device has none of its own (quick stop).

        A later `command` acts again, unless `fault` then asks an operator to reset.
        """
        self.command(v, t)

    @abstractmethod
    def measure(self) -> tuple[float, ...] | None:
        """Return the newest measurement, shape (measured,), at once; None = none that is fresh.

        A sample without one has no state; too many in a row (`safety.state_hold`) are a fault.
        """

    def advance(self, t: float, seq: int) -> Truth | None:  # noqa: ARG002
        """End sample `seq` at loop time t [s]; a simulated device returns what is true."""
        return None

    def fault(self) -> str:
        """Return what is wrong with the device, as text, '' = nothing; the host latches it."""
        return ''

    def absence(self) -> str:
        """Return why `measure` has nothing, as text; '' = not known."""
        return ''

    def recover(self) -> None:
        """Try to leave the fault, when an operator resets; may take a second.

        Raises:
            DriverError: It lasts.
        """

    def resume(self) -> None:
        """Leave a fault that a stall of this machine has caused; no operator has looked at it.

        As `recover` unless overridden; a trip or an e-stop of the device must last.

        Raises:
            DriverError: It lasts.
        """
        self.recover()

    def applied_command(self) -> float | None:
        """Return the command the device holds now [command unit], None = not known.

        Asked by the conformance kit alone, which cannot see otherwise what reached the device.
        """
        return None

    @property
    def refused(self) -> Mapping[str, int]:
        """Cause → number of the device's messages that were not taken; the host logs them."""
        return {}

    def report(self, report: Report) -> None:
        """Add what the driver knows to the diagnostics, once a second."""

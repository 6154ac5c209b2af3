# SPDX-License-Identifier: Apache-2.0
"""One axis of several, checked or identified, the drivers of the others open beside it (ours).

Axes may be motors of one board or joints of one controller, which is there for all of them or for
none: these are opened, enabled and stopped together, and while one is commanded the others get
their safe command. Axes of other devices are left aside, but by the kit that checks all in turn.
"""

from __future__ import annotations

from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.hosted_axes import HostedDrivers


class Beside:
    """Holds one axis with the interface of `HostedDriver`, and the others as far as they must be.

    Args:
        hosts: The drivers of all axes that are opened.
        place: Which one is commanded.
        all_faults: Whether a fault of any axis is one of this axis, as in a loop; the conformance
            kit wants its own alone.

    Attributes:
        own: What holds the driver of this axis.
        driver: The driver itself.
        others: Names of the other ones of these axes.
        measured: Number of the states x, x', … that it measures.
    """

    def __init__(self, hosts: HostedDrivers, place: int, all_faults: bool = False) -> None:
        self._hosts = hosts
        self._place = place
        self._all_faults = all_faults
        self.others = tuple(name for name in hosts.names if name != hosts.names[place])
        self.own = hosts.each[place]
        self.driver = self.own.driver
        self.measured = self.own.measured

    def open(self) -> None:
        """Open all.

        Raises:
            DriverError: One cannot be opened; the axis is named.
        """
        self._hosts.open()

    def enable(self) -> None:
        """Enable all; after a failure none is enabled.

        Raises:
            DriverError: One refuses; the axis is named.
        """
        self._hosts.enable()

    @property
    def enabled(self) -> bool:
        """Whether it takes commands."""
        return self.own.enabled

    @property
    def limit(self) -> float:
        """Largest |v| it takes [command unit].

        Raises:
            DriverError: It is not known.
        """
        return self.own.limit

    @property
    def saturated(self) -> int:
        """Commands beyond its limit."""
        return self.own.saturated

    def command(self, v: float, t: float) -> float:
        """Give it a command, the others the safe one; return what it was given."""
        return self._hosts.command(self._row(v), t)[self._place]

    def safe(self, v: float, t: float) -> None:
        """Have all go to their safe states."""
        self._hosts.safe(self._row(v), t)

    def advance(self, t: float, seq: int) -> None:
        """Let all know that a sample ends."""
        self._hosts.advance(t, seq)

    def measure(self, t: float) -> tuple[float, ...] | None:
        """Return its measurement."""
        found = [item.measure(t) for item in self._hosts.each]
        return found[self._place]

    def absence(self) -> str:
        """Return why it has no measurement; '' = not known."""
        return self.own.absence()

    def fault(self) -> str:
        """Return what is wrong with it, or with any axis; '' = nothing."""
        return self._hosts.fault() if self._all_faults else self.own.fault()

    def recover(self) -> str:
        """Have all try to leave their faults; return why its own lasts, or that of any axis."""
        if self._all_faults:
            return self._hosts.recover()
        return [item.recover() for item in self._hosts.each][self._place]

    def resume(self) -> str:
        """Have all go on after a stall of this machine, if the fault is this axis' and no other's.

        Returns:
            Why not: what is wrong with any axis, where another one has a fault of its own.
        """
        own = self.own.fault()
        if {item.fault() for item in self._hosts.each} - {'', own}:
            return self._hosts.fault()
        return self._hosts.resume()

    def disable(self, v: float, t: float) -> str:
        """Disable all; return what went wrong."""
        return self._hosts.disable(self._row(v), t)

    def close(self) -> str:
        """Close all; return what went wrong."""
        return self._hosts.close()

    def let_go(self, v: float, t: float) -> str:
        """Disable and close all, as `hosted.let_go`; return what went wrong."""
        return self._hosts.let_go(self._row(v), t)

    @property
    def note(self) -> str:
        """Which other axes get power, as a line to print before that; '' = none."""
        return (f'its device is that of {", ".join(self.others)} too: enabled with it, at the '
                'safe command') if self.others else ''

    def _row(self, v: float) -> tuple[float, ...]:
        rows: list[Any] = [item.safe_command for item in self._hosts.each]
        rows[self._place] = v
        return tuple(rows)


def beside_others(machine: Configuration, axis: str | None,
                  all_faults: bool = False) -> Beside | None:
    """Return what holds the driver of an axis whose device is that of other axes too.

    Args:
        machine: Of all axes.
        axis: Name of the axis.
        all_faults: As of `Beside`.

    Returns:
        None where its driver can be opened alone. Axes of other devices are left aside.

    Raises:
        ConfigurationError: A driver does not go with the loop.
    """
    if axis is None or len(machine.axes) < 2:
        return None
    every = HostedDrivers(machine)
    devices = {name: item.driver.device for name, item in every}
    if devices[axis] is None:
        return None
    names = [name for name in every.names if devices[name] is devices[axis]]
    return Beside(every.part(names), names.index(axis), all_faults)

# SPDX-License-Identifier: Apache-2.0
"""The drivers of all axes of a machine, held together, with the interface of one (ours).

Each axis is held by a `HostedDriver` of its own. What is measured or true of a sample is so of all
axes or of none, and one axis' fault is the machine's, with the axis named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from functools import partial
from typing import Any, TypeVar

from dz_ros.core.axes import gathered, Rows, spoken
from dz_ros.core.configuration import Configuration
from dz_ros.core.safety.health import Report
from dz_ros.drivers.hosted import add_not_let_go, HostedDriver, let_go
from dz_ros.errors import ConfigurationError, DriverError, DzRosError
from dz_ros.runtime.os_signals import held_ends

Result = TypeVar('Result')


class HostedDrivers:
    """Holds the drivers that a configuration of several axes names.

    Args:
        configuration: Of the machine.

    Attributes:
        names: The axes.
        each: What holds the driver of each.

    Raises:
        ConfigurationError: One of them does not go with the loop.
    """

    def __init__(self, configuration: Configuration) -> None:
        self.names = configuration.axis_names
        self.each = []
        for name, item, driver in zip(self.names, configuration.each,
                                      configuration.make_drivers(), strict=True):
            try:
                self.each.append(HostedDriver(item, driver))
            except ConfigurationError as error:
                error.args = (f'axis {name}: {error}',)
                raise
        self.observing = any(item.observing for item in self.each)

    def __iter__(self) -> Iterator[tuple[str, HostedDriver]]:
        return iter(zip(self.names, self.each, strict=True))

    @property
    def driver(self) -> Any:
        """The driver of the first axis; all are simulated or none."""
        return self.each[0].driver

    def open(self, node: Any = None) -> None:
        """Attach all to a node, if there is one, and open them; after a failure none is open.

        Raises:
            DzRosError: One cannot be opened; the axis is named.
        """
        self._all_or_none('open', node)

    def enable(self) -> None:
        """Enable all; after a failure none is enabled.

        Raises:
            DriverError: One refuses; the axis is named.
        """
        self._all_or_none('enable')

    def _all_or_none(self, step: str, *arguments: Any) -> None:
        name, place = '', 0
        try:
            for place, (name, item) in enumerate(self):  # noqa: B007
                getattr(item, step)(*arguments)
        except BaseException as error:      # also Ctrl-C
            done = self.part(self.names[:place + 1])    # the interrupted one may be done too
            with held_ends():
                failed = (done.close() if step == 'open' else
                          done.disable([item.safe_command for item in done.each], 0.0))
            if isinstance(error, DzRosError):
                named = DriverError(f'axis {name}: {error}')
                add_not_let_go(named, failed)
                raise named from error
            add_not_let_go(error, failed)
            raise

    def disable(self, v: Sequence[float], t: float) -> str:
        """Send the safe commands, to all before one is waited for, and disable all.

        Returns:
            What went wrong.
        """
        try:
            self.safe(v, t)
        finally:
            found = _all_of([partial(item.disable, own, t)
                             for item, own in zip(self.each, v, strict=True)])
        return self._joined(found)

    def close(self) -> str:
        """Close those that were opened; return what went wrong."""
        return self._joined(_all_of([item.close for item in self.each]))

    def let_go(self, v: Sequence[float], t: float) -> str:
        """Disable and close all, as `let_go`; return what went wrong."""
        return let_go(self, v, t)

    def part(self, names: Sequence[str]) -> HostedDrivers:
        """Return what holds some of these drivers."""
        found = copy(self)
        found.names = tuple(names)
        found.each = [item for name, item in self if name in names]
        found.observing = any(item.observing for item in found.each)
        return found

    def configure(self, configuration: Configuration) -> None:
        """Use other limits and parameters from now on."""
        for item, own in zip(self.each, configuration.each, strict=True):
            item.configure(own)

    def reference(self, reference: Rows) -> None:
        """Keep the references for the observers."""
        for item, row in zip(self.each, reference, strict=True):
            item.reference(row)

    def command(self, v: Sequence[float], t: float) -> tuple[float, ...]:
        """Give each its command, no larger than its limit; return what they were given."""
        return tuple(item.command(own, t) for item, own in zip(self.each, v, strict=True))

    def safe(self, v: Sequence[float], t: float) -> None:
        """Have all go to their safe states."""
        _all_of([partial(item.safe, own, t) for item, own in zip(self.each, v, strict=True)])

    def advance(self, t: float, seq: int) -> Rows | None:
        """Let all know that a sample ends at loop time t [s]; return what is true, if known."""
        found = [item.advance(t, seq) for item in self.each]
        return None if None in found else Rows(found)

    def measure(self, t: float) -> tuple[tuple[float, ...], ...] | None:
        """Return x, x', … of each axis; None = one of them has no measurement."""
        found = [item.measure(t) for item in self.each]
        return None if None in found else tuple(found)  # type: ignore[arg-type]

    def fault(self) -> str:
        """Return what is wrong, with the axis; '' = nothing."""
        return self._joined(item.fault() for item in self.each)

    def absence(self) -> str:
        """Return why there is no measurement, with the axis; '' = not known."""
        return self._joined(item.absence() for item in self.each)

    def refused(self) -> dict[str, int]:
        """Return cause → number of what was refused of the devices, with the axis."""
        return {f'{name}: {cause}': count for name, item in self
                for cause, count in item.refused().items()}

    def recover(self) -> str:
        """Have all try to leave their faults; return why one lasts."""
        return self._joined([item.recover() for item in self.each])

    def resume(self) -> str:
        """Have all go on after a stall of this machine; return why one cannot."""
        return self._joined([item.resume() for item in self.each])

    def report(self, report: Report) -> None:
        """Add what is known of each to the diagnostics, and begin a new window."""
        for name, item in self:
            report.add(item.report, name)

    def _joined(self, faults: Any) -> str:
        """Return faults of the axes as one text; what is the same of several, once."""
        found = gathered((name, fault) for name, fault in zip(self.names, faults, strict=True)
                         if fault)
        return '; '.join(f'{spoken(names)}: {fault}' for fault, names in found.items())


def _all_of(calls: Sequence[Callable[[], Result]]) -> list[Result]:
    """Return what each call returns; all are made, whatever one of them raises."""
    found: list[Result] = []
    for place, call in enumerate(calls):
        try:
            found.append(call())
        except BaseException:       # also Ctrl-C
            _all_of(calls[place + 1:])
            raise
    return found


def host(configuration: Configuration) -> Any:
    """Return what holds the driver of a loop, of several axes the drivers."""
    return (HostedDrivers if len(configuration.axes) > 1 else HostedDriver)(configuration)

# SPDX-License-Identifier: Apache-2.0
"""The bus of one drive or several: one connection, one SYNC, one thread (ours).

Whatever is connected first opens it, the last that leaves closes it. What befalls the bus befalls
each of its drives; connected again, each of them is reached again by its own `recover`.
"""

from __future__ import annotations

from collections.abc import Iterable
import time
from typing import Any

from dz_ros.drivers.cia402.bus import DriveBus, SYNC
from dz_ros.drivers.cia402.connection import bus_errors, connect, share, unshare, Watcher
from dz_ros.drivers.cia402.cycle import DriveCycle, SharedCycle
from dz_ros.drivers.cia402.settings import Cia402Parameters

BUS_OFF = 0x40
"""Bit of the identifier of an error frame, as Linux numbers them."""


class SharedBus:
    """A CAN bus and the drives on it that are open.

    Args:
        parameters: Of one of the drives; what concerns the bus is the same in all of them.
        period: Loop period [s].

    Attributes:
        lost: Whether it has gone.
        drives: Those that are connected.
    """

    def __init__(self, parameters: Cia402Parameters, period: float) -> None:
        self.parameters = parameters
        self.lost = False
        self.drives: tuple[DriveBus, ...] = ()
        self._period = period
        self._network: Any = None
        self._cycle: SharedCycle | None = None
        self._errors: tuple[type[Exception], ...] = (OSError,)

    def join(self, drive: DriveBus) -> None:
        """Connect a drive.

        Raises:
            MissingDependencyError: canopen or python-can is not installed.
            DriverError: There is no such bus.
        """
        if self._network is None:
            self._connect()
        self.drives = (*self.drives, drive)
        drive.attach(share(self._network))

    def leave(self, drive: DriveBus) -> str:
        """Disconnect a drive; return why the bus could not be closed, '' = it was, or is used."""
        self.drives = tuple(item for item in self.drives if item is not drive)
        self._detach(drive)
        return '' if self.drives else self._disconnect()

    def reconnect(self) -> None:
        """Connect again to a bus that has gone; what was known of its drives is forgotten.

        Raises:
            DriverError: It is not there.
        """
        for drive in self.drives:
            self._detach(drive)
        self._disconnect()
        for drive in self.drives:
            drive.forget()
        self._connect()
        for drive in self.drives:
            drive.attach(share(self._network))

    def serve(self, drive: DriveBus) -> DriveCycle:
        """Send to a drive from now on, in each cycle."""
        if self._cycle is None or self._cycle.ended:
            self._cycle = SharedCycle(self, self._period)
        return self._cycle.serve(drive)

    @property
    def served(self) -> int:
        """Number of the drives that are sent to in each cycle."""
        return 0 if self._cycle is None else len(self._cycle.members)

    def send(self, identifier: int, data: bytes) -> None:
        """Send one frame; where the bus is gone that is a fault of its drives, not an error."""
        network = self._network
        if network is None:
            return
        try:
            network.send_message(identifier, data)
        except self._errors as error:
            self._fail(network.bus, error)

    def sync(self, drives: Iterable[DriveBus]) -> None:
        """Send a SYNC that these drives are to answer."""
        at = time.monotonic()
        for drive in drives:
            drive.synced(at)
        self.send(SYNC, b'')

    def error_frame(self, identifier: int) -> None:
        """Take an error frame of the adapter."""
        if identifier & BUS_OFF:
            self.lost = True
            self._complain('bus off: too many errors on the CAN bus')

    def _connect(self) -> None:
        """Connect to the bus.

        Raises:
            MissingDependencyError: canopen or python-can is not installed.
            DriverError: There is no such bus.
        """
        found: list[Any] = []       # what fails may be a connection that was given up
        network = connect(self.parameters, Watcher(
            self.error_frame, lambda error: self._fail(found and found[0], error)))
        found.append(network.bus)
        self._errors = bus_errors()
        self._network = network
        self.lost = False

    def _disconnect(self) -> str:
        """Close the connection, if there is one; return why it could not be."""
        network, self._network = self._network, None
        if network is not None:
            try:
                network.disconnect()
            except self._errors as error:
                return f'the bus could not be closed: {error}'
        return ''

    @staticmethod
    def _detach(drive: DriveBus) -> None:
        network, drive.network = drive.network, None
        if network is not None:
            unshare(network)

    def _fail(self, bus: Any, error: BaseException) -> None:
        if self._network is not None and bus is self._network.bus:
            self.lost = True
            self._complain(f'the bus has gone: {" ".join(str(error).split())}')

    def _complain(self, text: str) -> None:
        for drive in self.drives:
            drive.complain(text)

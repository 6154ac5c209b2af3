# SPDX-License-Identifier: Apache-2.0
"""The thread that waits for the drive, so that neither the loop nor the cycle does (ours).

- A drive that has left NMT state operational takes no PDO: it is asked by SDO to stop, in
  pre-operational, which NMT state stopped is left for first (there it takes no SDO either).
- A mode of operation that is in no PDO is read.
"""

from __future__ import annotations

from collections.abc import Callable
import threading

from dz_ros.drivers.cia402 import objects
from dz_ros.drivers.cia402.bus import DriveBus, PRE_OPERATIONAL, STOPPED
from dz_ros.drivers.cia402.states import Controlword, Goal, stopped
from dz_ros.errors import DriverError


class SdoWatch:
    """Looks after a drive by SDO, once in a heartbeat.

    Args:
        bus: The drive.
        goal: Returns the wanted state of the drive.
    """

    def __init__(self, bus: DriveBus, goal: Callable[[], Goal]) -> None:
        self._bus = bus
        self._goal = goal
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name='cia402 SDO', daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End, and wait until it has."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        period = self._bus.parameters.heartbeat
        while not self._stop.wait(period / 5.0 if self._bus.outside else period):
            if self._bus.broken:
                continue
            try:
                self._look()
            except DriverError:
                continue        # silent: its heartbeat is watched elsewhere

    def _look(self) -> None:
        bus = self._bus
        if bus.outside:
            if bus.nmt_state == STOPPED:
                bus.nmt(PRE_OPERATIONAL)
            goal = Goal.OFF if self._goal() is Goal.OFF else Goal.SAFE
            if bus.received_at < bus.left_at or not stopped(goal, bus.state):
                bus.take_status(bus.sdo.read(objects.STATUSWORD))
            if not stopped(goal, bus.state):
                bus.sdo.write(objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE
                              if goal is Goal.OFF else Controlword.QUICK_STOP)
                bus.take_status(bus.sdo.read(objects.STATUSWORD))
        elif bus.polls_mode:
            bus.take_mode(bus.sdo.read(objects.MODE_DISPLAY))

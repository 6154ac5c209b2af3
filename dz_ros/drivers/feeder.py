# SPDX-License-Identifier: Apache-2.0
"""A thread for a device that answers slowly: newest command out, newest measurement in (ours).

The loop must never wait for a device. A driver whose device takes its time (a serial line, a bus
without its own thread, a library that blocks) writes one blocking function, and the loop's side
only puts down the newest order and picks up the newest measurement:

    def exchange(order):            # in the thread; may block, may raise
        if order is not None:
            port.write(...)
        return parse(port.read(...))

    self._feeder = Feeder(exchange, period)
    open     self._feeder.start()
    command  self._feeder.put(v, t)         safe  self._feeder.put(v, t, safe=True)
    measure  return self._feeder.newest()   fault  return self._feeder.fault()
    recover  self._feeder.forgive()         close  self._feeder.stop()

Orders that the device was too slow for are replaced by newer ones and counted, never queued: a
command that waited is worth nothing. A safe order is never replaced by a command that came before
it, and `stop` sends the last order first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import threading
import time

from dz_ros.drivers.freshness import Freshness, SAMPLES
from dz_ros.errors import DriverError


@dataclass(frozen=True)
class Order:
    """A command v [command unit], given at loop time t [s]; whether it is the safe one."""

    v: float
    t: float
    safe: bool = False


Exchange = Callable[[Order | None], Sequence[float] | None]
"""Sends an order, None = nothing new, and returns a measurement, None = none; may block."""


class Feeder:
    """Runs a device's exchanges in a thread of its own.

    Args:
        exchange: One exchange with the device; what it raises becomes `fault`, and it is called
            again, to reconnect if it can.
        period: Longest time between two exchanges, orders or not [s].
        fresh: A measurement older than this is none [s]; 0 = `freshness.SAMPLES` periods.

    Attributes:
        replaced: Orders that a newer one has overtaken.
        exchanges: Exchanges so far.
        slowest: Longest exchange since it was last read by `take_slowest` [s].
    """

    def __init__(self, exchange: Exchange, period: float, fresh: float = 0.0) -> None:
        self.replaced = 0
        self.exchanges = 0
        self.slowest = 0.0
        self._exchange = exchange
        self._period = period
        self._freshness = Freshness(fresh or SAMPLES * period)
        self._changed = threading.Condition()
        self._order: Order | None = None
        self._measured: tuple[float, ...] | None = None
        self._measured_at = 0.0
        self._fault = ''
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread afresh; call it once the device answers."""
        with self._changed:
            self._order, self._measured, self._fault = None, None, ''
            self._stopping = threading.Event()      # of this thread alone
            self._thread = threading.Thread(target=self._run, args=(self._stopping,),
                                            name='device', daemon=True)
        self._thread.start()

    def stop(self, timeout: float = 2.0) -> None:
        """Send the last order, then end the thread, within a time [s]; may be called twice.

        Raises:
            DriverError: The device holds the thread; it ends when the device lets go, also if
                another one has been started by then.
        """
        thread, self._thread = self._thread, None
        if thread is None:
            return
        with self._changed:
            self._stopping.set()
            self._changed.notify_all()
        thread.join(timeout)
        if thread.is_alive():
            raise DriverError(f'the device has not answered for {timeout:g} s, its thread is '
                              'left behind')

    def put(self, v: float, t: float, safe: bool = False) -> None:
        """Give the newest order; return at once."""
        with self._changed:
            self.replaced += self._order is not None
            self._order = Order(v, t, safe)
            self._changed.notify_all()

    def newest(self) -> tuple[float, ...] | None:
        """Return the newest measurement, None where none is fresh; at once."""
        with self._changed:
            if self._measured is None or not self._freshness.holds(self._measured_at):
                return None
            return self._measured

    def fault(self) -> str:
        """Return the error of the last exchange, '' where it succeeded."""
        with self._changed:
            return self._fault

    def forgive(self) -> None:
        """Forget the fault; the next exchange shows whether it lasts."""
        with self._changed:
            self._fault = ''

    def take_slowest(self) -> float:
        """Return the longest exchange since the last call [s], and begin again."""
        with self._changed:
            slowest, self.slowest = self.slowest, 0.0
            return slowest

    def _run(self, stopping: threading.Event) -> None:
        while True:
            with self._changed:
                if stopping is not self._stopping:
                    return      # left behind, and another thread has begun
                if self._order is None and not stopping.is_set():
                    self._changed.wait(self._period)
                    if stopping is not self._stopping:
                        return
                order, self._order = self._order, None
                if stopping.is_set() and order is None:
                    return
            started = time.monotonic()
            try:
                found = self._exchange(order)
                fault = ''
            except Exception as error:  # noqa: BLE001  whatever the device's library raises
                found, fault = None, ' '.join(str(error).split()) or type(error).__name__
            ended = time.monotonic()
            with self._changed:
                if stopping is not self._stopping:
                    return
                self.exchanges += 1
                self.slowest = max(self.slowest, ended - started)
                self._fault = fault
                if found is not None:
                    self._measured, self._measured_at = tuple(found), ended
                if fault and not stopping.is_set():
                    # A device that fails at once must not be asked as fast as the machine goes.
                    self._changed.wait(max(0.0, self._period - (ended - started)))

# SPDX-License-Identifier: Apache-2.0
"""A simulated servo drive on a CAN bus in the loop, and what goes wrong with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import signal
import subprocess
import sys
import threading
import time
from typing import TYPE_CHECKING

from dz_ros.drivers.cia402.emulator import FAULTS

if TYPE_CHECKING:
    from fault_kit.loop import Loop

GROUP, PORT = '239.74.163.2', 43779
DRIVE_SETTINGS = [
    'loop.duration=0', 'trajectory.kind=sinusoid', 'trajectory.amplitude=1.0',
    'trajectory.frequency=2.0', f'driver.bus_options=[port={PORT}, hop_limit=0]',
    'safety.state_hold=40', 'safety.command_hold=20', 'driver.heartbeat_hold=0.5',
    'driver.command_hold=0.5', 'driver.answer_limit=1.0']
"""Holds that outlast the stalls of a busy machine, as in benchmarks/cia402.py."""


class Drive:
    """The drive's process, and the states it says it goes through.

    Attributes:
        states: (time of the line [s], state of the drive), in order.
    """

    def __init__(self) -> None:
        import can

        self.states: list[tuple[float, str]] = []
        words = [word for text in DRIVE_SETTINGS for word in ('--set', text)]
        self._process = subprocess.Popen(
            [sys.executable, '-u', '-m', 'dz_ros', 'driver', 'emulate', 'cia402', 'cia402',
             *words], text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True)
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        if not self._ready.wait(30.0):
            self.close()
            raise AssertionError('the simulated drive does not start')
        self._bus = can.Bus(interface='udp_multicast', channel=GROUP, port=PORT, hop_limit=0)

    def close(self) -> None:
        """End it."""
        if hasattr(self, '_bus'):
            self._bus.shutdown()
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._thread.join()

    def stopped_after(self, began: float) -> float | None:
        """Return how long after `began` it was no more enabled [s]; None = it never left."""
        before = [state for when, state in self.states if when <= began]
        after = [when for when, state in self.states
                 if when > began and state != 'operation enabled']
        if not before or before[-1] != 'operation enabled':
            return 0.0
        return after[0] - began if after else None

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame, as another master."""
        import can

        self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def ask(self, fault: str, value: int = 0, duration: float = 0.0) -> None:
        """Have a fault of the emulator's begin."""
        for index, number, size in ((0x2001, value, 2), (0x2002, round(duration * 1000.0), 2),
                                    (0x2000, list(FAULTS).index(fault) + 1, 1)):
            head = bytes((0x23 | (4 - size) << 2,)) + index.to_bytes(2, 'little') + b'\0'
            self.send(0x601, head + number.to_bytes(4, 'little'))

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._ready.set()
            if line.startswith('state: '):
                self.states.append((time.monotonic(), line.removeprefix('state: ').strip()))


@contextmanager
def drive_for(wanted: bool) -> Iterator[Drive | None]:
    """Have a drive, where one is wanted."""
    drive = Drive() if wanted else None
    try:
        yield drive
    finally:
        if drive is not None:
            drive.close()


def at_speed(loop: Loop) -> None:
    """Wait until the axis moves fast."""
    loop.until(lambda: abs(loop.heard['state'][-1][1][3]) > 1.5, 10.0)


def nmt(command: int) -> Callable[[Loop], None]:
    """Have another master send an NMT command."""
    def inject(loop: Loop) -> None:
        at_speed(loop)
        loop.began = time.monotonic()
        loop.drive.send(0, bytes((command, 1)))
        time.sleep(1.0)
    return inject


def fault(name: str, value: int = 0, duration: float = 0.0) -> Callable[[Loop], None]:
    """Have a fault of the emulator's, at speed."""
    def inject(loop: Loop) -> None:
        at_speed(loop)
        loop.began = time.monotonic()
        loop.drive.ask(name, value, duration)
        time.sleep(1.0 + duration)
    return inject


def kill_host(loop: Loop) -> None:
    """Kill the actuator's host at speed, and start it again."""
    at_speed(loop)
    loop.began = time.monotonic()
    loop.processes[loop.actuator].kill()
    loop.processes[loop.actuator].wait()
    time.sleep(1.5)
    seen = len(loop.heard['state'])
    loop.start(loop.actuator)
    loop.until(lambda: len(loop.heard['state']) > seen + 5)
    time.sleep(4.0)

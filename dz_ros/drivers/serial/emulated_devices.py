# SPDX-License-Identifier: Apache-2.0
"""The device at the end of an emulated line: in Python, or a program of its own.

Both take bytes and give bytes, can be restarted, frozen and made to report a fault.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
import contextlib
from dataclasses import replace
import os
from pathlib import Path
import signal
import subprocess

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.serial.device import Device
from dz_ros.drivers.serial.protocol import COUNT_LIMIT, Info, MotorInfo
from dz_ros.drivers.simulated import SimulatedActuator, SimulatedParameters
from dz_ros.errors import DriverError

TICK_US = 1000
"""A device looks at its line and its clock at least once in this time [µs]."""


class EmulationTarget(ABC):
    """What answers at the device's end."""

    def fileno(self) -> int:
        """Return the descriptor that is readable when it sends; -1 if it has none."""
        return -1

    def due(self, now: int) -> int:
        """Return when it has to be stepped again, if nothing arrives before [µs]."""
        return now + TICK_US

    @abstractmethod
    def step(self, received: bytes, now: int) -> bytes:
        """Give it bytes at a time [µs]; return what it sends."""

    @abstractmethod
    def restart(self) -> None:
        """Restart it, as a press on its reset button."""

    @abstractmethod
    def trip(self, code: int, motor: int | None) -> None:
        """Make the amplifier of a motor, None = of each, report a fault; 0 takes it back."""

    @abstractmethod
    def freeze(self, frozen: bool) -> None:
        """Let it do nothing at all, or go on."""

    @abstractmethod
    def close(self) -> None:
        """End it."""


class EmulatedDevice(EmulationTarget):
    """The device of `device` with the configured plant behind each motor, in real time.

    The plants stand still until the first command moves one of them.

    Args:
        each: Plant, dead-zone, initial state, noise behind each motor.
        scales: Unit of a count: of the command, then of x, x', …
        limit: Largest |v| [counts].
    """

    def __init__(self, each: Sequence[Configuration], scales: tuple[float, ...],
                 limit: int) -> None:
        each = [replace(item, driver_parameters=SimulatedParameters()) for item in each]
        self._plants = (SimulatedActuator.for_axes(each) if len(each) > 1
                        else [SimulatedActuator(each[0].driver_parameters, each[0])])
        self._command_scale, *self._scales = scales
        motor = MotorInfo(limit, self._command_scale, tuple(self._scales))
        self._info = Info(0, (motor,) * len(each), 'emulated device')
        self._start: int | None = None
        self._now = 0
        self._codes = [0] * len(each)
        self._frozen = False
        self.restart()

    def step(self, received: bytes, now: int) -> bytes:
        """Move the plants to now and let the device look."""
        self._now = now
        self._move()
        return b'' if self._frozen else self._device.step(received, now)

    def due(self, now: int) -> int:
        """Return when the next state is due, or the tick before [µs]."""
        return min(self._device.due, now + TICK_US)

    def restart(self) -> None:
        """Begin without a session and without power; the plants go on."""
        self._device = Device(self._info, self.measure, self.actuate)

    def trip(self, code: int, motor: int | None) -> None:
        """Report a fault of a motor or of each from now on; 0 = none."""
        self._codes = [code if motor in (None, place) else before
                       for place, before in enumerate(self._codes)]

    def freeze(self, frozen: bool) -> None:
        """Hold what the actuator has, and be silent."""
        self._frozen = frozen

    def close(self) -> None:
        """Do nothing: it is part of this process."""

    def _time(self) -> float:
        return 0.0 if self._start is None else (self._now - self._start) * 1e-6

    def _move(self) -> None:
        if self._start is not None:
            for plant in self._plants:
                plant.advance(self._time(), 0)

    def measure(self) -> tuple[list[list[int]], list[int]]:
        """Return the values of each motor now [counts] and their fault codes."""
        rows = [[min(max(round(value / scale), -COUNT_LIMIT), COUNT_LIMIT) for value, scale
                 in zip(plant.measure(), self._scales, strict=False)] for plant in self._plants]
        return rows, self._codes

    def actuate(self, counts: tuple[int, ...] | None) -> None:
        """Give the plants their commands [counts]; None = no power."""
        counts = counts or (0,) * len(self._plants)
        if self._start is None:
            if not any(counts):
                return
            self._start = self._now
        self._move()
        for plant, count in zip(self._plants, counts, strict=True):
            plant.command(self._command_scale * count, self._time())


class Program(EmulationTarget):
    """A program whose standard input and output are the line, e.g. firmware built for a PC.

    Args:
        command: The program.

    Raises:
        DriverError: It cannot be started.
    """

    def __init__(self, command: str) -> None:
        self._command = str(Path(command).expanduser().absolute())
        self._code = 0
        self._start()

    def _start(self) -> None:
        try:
            self._process = subprocess.Popen([self._command], stdin=subprocess.PIPE,
                                             stdout=subprocess.PIPE, bufsize=0,
                                             start_new_session=True)
        except OSError as error:
            raise DriverError(f'{self._command}: cannot be started: {error.strerror}') from None
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            os.set_blocking(stream.fileno(), False)

    def fileno(self) -> int:
        """Return the descriptor of its standard output."""
        assert self._process.stdout is not None
        return self._process.stdout.fileno()

    def step(self, received: bytes, now: int) -> bytes:  # noqa: ARG002
        """Pass bytes on, both ways.

        Raises:
            DriverError: It has ended.
        """
        assert self._process.stdin is not None
        with contextlib.suppress(BlockingIOError, BrokenPipeError):
            if received:
                os.write(self._process.stdin.fileno(), received)
        try:
            sent = os.read(self.fileno(), 65536)
        except BlockingIOError:
            return b''
        if not sent:
            raise DriverError(f'{self._command}: has ended (exit code {self._process.wait()})')
        return sent

    def restart(self) -> None:
        """Kill it and start it again."""
        self.close()
        self._start()

    def trip(self, code: int, motor: int | None) -> None:
        """Send it SIGUSR1, for one motor SIGRTMIN plus its number, SIGUSR2 to take it back."""
        if bool(code) != bool(self._code):
            self._process.send_signal(signal.SIGUSR2 if not code else signal.SIGUSR1
                                      if motor is None else signal.SIGRTMIN + motor)
        self._code = code

    def freeze(self, frozen: bool) -> None:
        """Stop the process, or let it go on."""
        self._process.send_signal(signal.SIGSTOP if frozen else signal.SIGCONT)

    def close(self) -> None:
        """Kill it."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            stream.close()

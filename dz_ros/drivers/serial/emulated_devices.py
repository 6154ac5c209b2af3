# SPDX-License-Identifier: Apache-2.0
"""The device at the end of an emulated line: in Python, or a program of its own.

Both take bytes and give bytes, can be restarted, frozen and made to report a fault.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
import contextlib
import os
from pathlib import Path
import signal
import subprocess

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.serial.device import Device
from dz_ros.drivers.serial.protocol import COUNT_LIMIT, Info
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
    def trip(self, code: int) -> None:
        """Make its amplifier report a fault; 0 takes it back."""

    @abstractmethod
    def freeze(self, frozen: bool) -> None:
        """Let it do nothing at all, or go on."""

    @abstractmethod
    def close(self) -> None:
        """End it."""


class EmulatedDevice(EmulationTarget):
    """The device of `device` with the configured plant behind it, in real time.

    The plant stands still until the first command moves it.

    Args:
        configuration: Plant, dead-zone, initial state, noise.
        scales: Unit of a count: of the command, then of x, x', …
        limit: Largest |v| [counts].
    """

    def __init__(self, configuration: Configuration, scales: tuple[float, ...],
                 limit: int) -> None:
        self._plant = SimulatedActuator(SimulatedParameters(), configuration)
        self._command_scale, *self._scales = scales
        self._info = Info(0, len(self._scales), limit, self._command_scale, tuple(self._scales),
                          'emulated device')
        self._start: int | None = None
        self._now = 0
        self._code = 0
        self._frozen = False
        self.restart()

    def step(self, received: bytes, now: int) -> bytes:
        """Move the plant to now and let the device look."""
        self._now = now
        self._move()
        return b'' if self._frozen else self._device.step(received, now)

    def due(self, now: int) -> int:
        """Return when the next state is due, or the tick before [µs]."""
        return min(self._device.due, now + TICK_US)

    def restart(self) -> None:
        """Begin without a session and without power; the plant goes on."""
        self._device = Device(self._info, self.measure, self.actuate)

    def trip(self, code: int) -> None:
        """Report a fault from now on; 0 = none."""
        self._code = code

    def freeze(self, frozen: bool) -> None:
        """Hold what the actuator has, and be silent."""
        self._frozen = frozen

    def close(self) -> None:
        """Do nothing: it is part of this process."""

    def _time(self) -> float:
        return 0.0 if self._start is None else (self._now - self._start) * 1e-6

    def _move(self) -> None:
        if self._start is not None:
            self._plant.advance(self._time(), 0)

    def measure(self) -> tuple[list[int], int]:
        """Return the values now [counts] and the fault code."""
        return [min(max(round(value / scale), -COUNT_LIMIT), COUNT_LIMIT) for value, scale
                in zip(self._plant.measure(), self._scales, strict=False)], self._code

    def actuate(self, counts: int | None) -> None:
        """Give the plant a command [counts]; None = no power."""
        if counts is None and self._start is None:
            return
        if self._start is None:
            if counts == 0:
                return
            self._start = self._now
        self._move()
        self._plant.command(self._command_scale * (counts or 0), self._time())


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

    def trip(self, code: int) -> None:
        """Send it SIGUSR1, SIGUSR2 to take it back."""
        if bool(code) != bool(self._code):
            self._process.send_signal(signal.SIGUSR1 if code else signal.SIGUSR2)
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

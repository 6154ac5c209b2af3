# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of drivers: a serial driver, a port, waiting while driving, the kit."""

import contextlib
from dataclasses import replace
import os
from pathlib import Path
import pty
import sys
import threading
import time
import tty
from types import SimpleNamespace

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.conformance import driver_checks
from dz_ros.drivers.serial.device import Device
from dz_ros.drivers.serial.framing import pack, Receiver
from dz_ros.drivers.serial.protocol import Command, decode, Info, MotorInfo, State
from dz_ros.files.configurations import load_configuration

TIME_OUT = 60.0
SERVO = Path(__file__).parents[2] / 'config' / 'servo.yaml'


class Fake:
    """A pseudo-terminal at whose other end the test answers."""

    def __init__(self, answer=None):
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self.received = []
        self._receiver = Receiver()
        self._answer = answer
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        if answer is not None:
            self._thread.start()

    def _serve(self):
        os.set_blocking(self._master, False)
        while not self._stop.wait(0.002):
            try:
                data = os.read(self._master, 4096)
            except BlockingIOError:
                data = b''
            for body in self._receiver.feed(data):
                self.received.append(decode(body))
                for reply in self._answer(self.received[-1]):
                    os.write(self._master, reply)

    def stop(self):
        """Read and answer nothing any more."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def close(self):
        self.stop()
        os.close(self._master)
        os.close(self._slave)


@pytest.fixture
def fake():
    made = []

    def give(answer=None):
        made.append(Fake(answer))
        return made[-1]

    yield give
    for item in made:
        item.close()


class Liar:
    """The device of the package on a pseudo-terminal; the test changes what passes each way.

    Attributes:
        change: State that the device sends → the states that are sent instead.
        receives: Command of the host → whether it reaches the device.
        name: What it reports it is.
        shift: Added to its clock [µs].
        measured: Motor → its values [counts].
        faults: Fault code of each motor.
        given: What its motors were given, in order; None = no power.
    """

    def __init__(self, motors=1):
        self.motors, self.faults = motors, [0] * motors
        self.measured = lambda motor: (100 + motor, 0)
        self.change = lambda state: [state]
        self.receives = lambda command: True
        self.drift, self.shift, self.name = 1.0, 0, 'bench'
        self.info = True
        self.given = []
        self.commands = []
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._in, self._out = Receiver(), Receiver()
        self._start = time.monotonic()
        self._stop = threading.Event()
        self.restart()
        self.device.seq = 10 ** 6      # it has been on for a while
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def restart(self):
        """Start again, as after a loss of power."""
        self.device = Device(
            Info(0, (MotorInfo(30000, 1e-3, (1e-3, 1e-3)),) * self.motors, ''),
            lambda: ([self.measured(motor) for motor in range(self.motors)], self.faults),
            self.given.append)

    @property
    def actuated(self):
        """What the first motor was given, in order; None = no power."""
        return [None if v is None else v[0] for v in self.given]

    def _serve(self):
        while not self._stop.wait(0.001):
            try:
                data = os.read(self._master, 4096)
            except BlockingIOError:
                data = b''
            received = b''
            for body in self._in.feed(data):
                frame = decode(body)
                if isinstance(frame, Command):
                    self.commands.append(frame)
                if self.receives(frame):
                    received += pack(body)
            now = round(self.drift * 1e6 * (time.monotonic() - self._start)) + self.shift
            for body in self._out.feed(self.device.step(received, now)):
                frame = decode(body)
                if isinstance(frame, State):
                    frames = self.change(frame)
                else:
                    frames = [replace(frame, name=self.name)] * self.info
                with contextlib.suppress(BlockingIOError):      # the host stands still
                    os.write(self._master, b''.join(pack(item.body()) for item in frames))

    def close(self):
        self._stop.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)


@pytest.fixture
def liars():
    """Return the function that makes a device of the package that lies, of some motors."""
    made = []

    def give(motors=1):
        made.append(Liar(motors))
        return made[-1]

    yield give
    for item in made:
        item.close()


@pytest.fixture
def liar(liars):
    """A device of one motor that lies."""
    return liars()


@pytest.fixture
def make():
    """Return the function that makes a serial driver for a port, not open."""
    def give(port, **driver):
        overrides = [f'driver.{key}={value}' for key, value in
                     {'name': 'serial', 'port': port, **driver}.items()]
        return load_configuration(SERVO, overrides).make_driver()

    return give


@pytest.fixture
def until():
    """Return the function that commands a driver at about 200 Hz until a condition holds."""
    def wait(condition, driver=None, v=0.0):
        deadline = time.monotonic() + TIME_OUT
        while not condition():
            assert time.monotonic() < deadline, driver and (
                driver.fault(), driver.link.counts, driver.link.newest())
            if driver is not None:
                driver.command(v, 0.0)
            time.sleep(0.004)

    return wait


@pytest.fixture
def check(monkeypatch):
    """Return the function that checks a class of a test, or a name: check → result.

    A part of the kit takes no longer than it must.
    """
    monkeypatch.setattr(driver_checks, 'FIRST_MEASUREMENT', 0.3)
    monkeypatch.setattr(driver_checks, 'RUN_DURATION', 0.3)

    def found(driver, amplitude=0.1, saturate=True, **overrides):
        if not isinstance(driver, str):
            monkeypatch.setitem(sys.modules, 'broken_driver', SimpleNamespace(Here=driver))
            driver = 'broken_driver:Here'
        flat = {'driver.name': driver,
                **{key.replace('__', '.'): value for key, value in overrides.items()}}
        return {item.name: item for item in driver_checks.check_contract(
            Configuration.from_flat(flat), amplitude, saturate)}
    return found

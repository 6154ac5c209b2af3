# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of drivers: a serial driver, a port, waiting while driving, the kit."""

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
from dz_ros.drivers.serial.framing import Receiver
from dz_ros.drivers.serial.protocol import decode
from dz_ros.files.configurations import load_configuration

TIME_OUT = 60.0
SERVO = Path(__file__).parents[2] / 'config' / 'servo.yaml'


class Fake:
    """A pseudo-terminal at whose other end the test answers."""

    def __init__(self, answer=None):
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self.heard = []
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
                self.heard.append(decode(body))
                for reply in self._answer(self.heard[-1]):
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

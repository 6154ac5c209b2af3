# SPDX-License-Identifier: Apache-2.0
"""A simulated drive in this process, on python-can's virtual bus; no network."""

from __future__ import annotations

import itertools
import threading
import time

import pytest

from dz_ros.core import schema
from dz_ros.drivers.cia402.emulator import Cia402Emulator, EmulatedParameters, FAULTS
from dz_ros.files.configurations import load_configuration

TIME_OUT = 60.0
_channels = itertools.count()


def until(condition, what='the condition'):
    """Wait until a condition holds; fail after a generous time."""
    deadline = time.monotonic() + TIME_OUT
    while not condition():
        assert time.monotonic() < deadline, f'{what} did not come'
        time.sleep(0.001)


class Drive:
    """A simulated drive that runs, and drivers for it."""

    def __init__(self, **overrides):
        for package in ('can', 'canopen'):
            pytest.importorskip(package, reason=f'{package} is not installed')
        emulated = {key.removeprefix('emulated__'): value for key, value in overrides.items()
                    if key.startswith('emulated__')}
        self.configuration = load_configuration('cia402').replace(**{
            'driver.interface': 'virtual', 'driver.channel': f'test-{next(_channels)}',
            'driver.bus_options': [], 'driver.answer_limit': 2.0, 'driver.heartbeat_hold': 1.0,
            'driver.command_hold': 1.0,
            **{key.replace('__', '.'): value for key, value in overrides.items()
               if not key.startswith('emulated__')}})
        self.emulator = Cia402Emulator(schema.build(EmulatedParameters, emulated),
                                       self.configuration)
        self.reported = []
        self._end = threading.Event()
        self._drivers = []
        self.place = self.emulator.open()
        self.node = self.emulator.node
        self._thread = threading.Thread(target=self.emulator.run,
                                        args=(self._end.is_set, self.reported.append))
        self._thread.start()

    def driver(self, **overrides):
        """Return a driver for it, not opened."""
        driver = self.configuration.replace(**{
            key.replace('__', '.'): value for key, value in overrides.items()}).make_driver()
        self._drivers.append(driver)
        return driver

    def enabled(self, **overrides):
        """Return a driver for it, enabled."""
        driver = self.driver(**overrides)
        driver.open()
        driver.enable()
        return driver

    def fault(self, name, value=0, duration=1.0):
        """Have something go wrong, as a master that writes 2000h does."""
        self.emulator.ask(list(FAULTS).index(name) + 1, value, duration)

    def close(self):
        for driver in self._drivers:
            driver.close()
        self._end.set()
        self._thread.join(TIME_OUT)
        self.emulator.close()


@pytest.fixture
def drive():
    """Yield a function that starts a simulated drive; all of them end with the test."""
    started = []

    def start(**overrides):
        started.append(Drive(**overrides))
        return started[-1]

    yield start
    for item in started:
        item.close()


@pytest.fixture(name='until')
def until_fixture():
    """Return `until`."""
    return until

"""Fixtures of the tests of drivers: a serial driver, waiting while it is driven, the kit."""

from pathlib import Path
import sys
import time
from types import SimpleNamespace

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.drivers import conformance
from dz_ros.files import load_configuration

TIME_OUT = 60.0
SERVO = Path(__file__).parents[2] / 'config' / 'servo.yaml'


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
                driver.trouble(), driver._link.counts, driver._link.newest())
            if driver is not None:
                driver.command(v, 0.0)
            time.sleep(0.004)

    return wait


@pytest.fixture
def check(monkeypatch):
    """Return the function that checks a class of a test, or a name: check → result.

    A part of the kit takes no longer than it must.
    """
    monkeypatch.setattr(conformance, 'FIRST', 0.3)
    monkeypatch.setattr(conformance, 'SPAN', 0.3)

    def found(driver, amplitude=0.1, saturate=True, **overrides):
        if not isinstance(driver, str):
            monkeypatch.setitem(sys.modules, 'broken_driver', SimpleNamespace(Here=driver))
            driver = 'broken_driver:Here'
        flat = {'driver.name': driver,
                **{key.replace('__', '.'): value for key, value in overrides.items()}}
        return {item.name: item for item in conformance.check_contract(
            Configuration.from_flat(flat), amplitude, saturate)}
    return found

"""Fixtures of the tests of drivers: a serial driver of the servo, waiting while it is driven."""

from pathlib import Path
import time

import pytest

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

# SPDX-License-Identifier: Apache-2.0
"""The mock's script: what it refuses, and that each fault is what it reports, when it reports."""

import math
import time

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.hosted import HostedDriver
from dz_ros.drivers.mock import Fault, read_script
from dz_ros.errors import ConfigurationError, DriverError

T = 0.005


def mock(*script, **more):
    return Configuration.from_flat({'driver.name': 'mock', 'driver.script': list(script),
                                    **{f'driver.{key}': value for key, value in more.items()}})


def measurements(driver, count):
    """Return what it measures in samples 0 … count − 1, under a command of 1."""
    found = []
    driver.command(1.0, 0.0)
    for k in range(count):
        found.append(driver.measure())
        driver.advance((k + 1) * T, k)
    return found


@pytest.mark.parametrize(('line', 'fault'), [
    ('7 none', Fault('none', 7, 7, '')), ('7-9 nan', Fault('nan', 7, 9, '')),
    (' 7-   frozen ', Fault('frozen', 7, math.inf, '')),
    ('7 fault it is hot', Fault('fault', 7, 7, 'it is hot')),
    ('3 slow 2e-3', Fault('slow', 3, 3, '2e-3')), ('open no such bus', Fault('open', 0, 0,
                                                                             'no such bus'))])
def test_a_line_is_read_as_it_is_meant(line, fault):
    assert read_script([line]) == (fault,)


@pytest.mark.parametrize('line', [
    '', 'none', '7', '7 gone', '9-7 none', '-7 none', 'x none', '7 none now', '7 fault', 'open',
    '7 open x', '7 slow', '7 slow soon', 'fault hot', '7-8-9 none', '7 slow -1', '7 NONE'])
def test_a_line_that_is_none_is_refused_by_name(line):
    with pytest.raises(ConfigurationError, match=r'driver\.script') as caught:
        mock(line)
    assert caught.value.value == line


def test_without_a_script_it_is_the_simulated_one_bit_for_bit():
    simulated = Configuration.from_flat({}).make_driver()
    assert measurements(mock().make_driver(), 50) == measurements(simulated, 50)


def test_each_fault_of_a_measurement_comes_in_its_samples_only():
    plain = measurements(mock().make_driver(), 30)
    found = measurements(mock('3 none', '5-6 nan', '8 short', '10-12 frozen').make_driver(), 30)
    assert [k for k in range(30) if found[k] != plain[k]] == [3, 5, 6, 8, 10, 11, 12]
    assert found[3] is None
    assert math.isnan(found[5][-1])
    assert len(found[8]) == 1
    assert found[10] == found[11] == found[12] == plain[9]


def test_it_measures_as_many_as_it_is_faults():
    driver = mock(measures=1).make_driver()
    assert driver.measured == 1
    assert driver.measure() == (-2.5,)
    assert mock(measures=9).make_driver().measured == 2


def test_commands_are_lost_while_it_is_deaf():
    driver = mock('0-4 deaf').make_driver()
    driver.command(1.0, 0.0)
    assert driver.applied_command() == 0.0
    for k in range(5):
        driver.advance((k + 1) * T, k)
    driver.safe(0.5, 5 * T)
    assert driver.applied_command() == 0.5
    assert driver.given == [(1.0, 0.0, False), (0.5, 5 * T, True)]


def test_a_fault_lasts_until_it_is_reset():
    driver = mock('2 fault hot').make_driver()
    faults = []
    for k in range(6):
        faults.append(driver.fault())
        driver.advance((k + 1) * T, k)
    assert faults == ['', '', 'hot', 'hot', 'hot', 'hot']
    driver.recover()
    assert driver.fault() == ''


def test_within_its_samples_a_fault_comes_back():
    driver = mock('0- fault hot').make_driver()
    assert driver.fault() == 'hot'
    driver.recover()
    assert driver.fault() == 'hot'


@pytest.mark.parametrize('name', ['open', 'enable', 'recover'])
def test_what_is_refused_is_refused_in_its_words(name):
    driver = mock(f'{name} the door is open').make_driver()
    with pytest.raises(DriverError, match='the door is open'):
        getattr(driver, name)()
    assert driver.calls == [name]


def test_code_that_raises_and_code_that_is_slow():
    hosted = HostedDriver(mock('1 raise broken wire', '2 slow 0.02'))
    hosted.open()
    hosted.enable()
    started = time.perf_counter()
    for k in range(3):
        hosted.measure(k * T)
        hosted.advance((k + 1) * T, k)
    assert 'RuntimeError: broken wire' in hosted.fault()
    assert time.perf_counter() - started >= 0.02
    assert hosted.slow >= 1
    assert hosted.slowest >= 0.02


def test_another_script_while_it_runs():
    driver = mock().make_driver()
    driver.configure(mock('0 none'))
    assert driver.measure() is None

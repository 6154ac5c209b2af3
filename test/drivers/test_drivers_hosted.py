# SPDX-License-Identifier: Apache-2.0
"""The host's side of a driver: order of calls, limits, bad measurements, code that raises.

Over 300 lines: all of it uses one driver that writes down every call.
"""

from __future__ import annotations

import math
import sys
from types import SimpleNamespace
from typing import ClassVar

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.driven import NoParameters
from dz_ros.core.records import Reference
from dz_ros.core.safety.health import Level, Report
from dz_ros.drivers.contract import Driver
from dz_ros.drivers.hosted import HostedDriver
from dz_ros.errors import ConfigurationError, DriverError, LoopError

LIMIT = 5.0


def noted(name, with_values=False):
    """Return the method of a driver that writes down that it was called."""
    return lambda self, *values: self._call(name, *(values if with_values else ()))


class Noting(Driver):
    """Writes down every call; does what the test reports."""

    name = 'noting'
    summary = 'of this test'
    order = 2
    Parameters = NoParameters
    limit = LIMIT

    def __init__(self, parameters, configuration):
        super().__init__(parameters, configuration)
        self.calls = []
        self.answers = {}

    def _call(self, name, *values):
        self.calls.append((name, *values))
        answer = self.answers.get(name)
        if isinstance(answer, Exception):
            raise answer
        return answer

    attach, open, enable, disable, close, measure, recover, report = map(noted, (
        'attach', 'open', 'enable', 'disable', 'close', 'measure', 'recover', 'report'))
    command, safe = noted('command', True), noted('safe', True)

    def fault(self):
        return self._call('fault') or ''


class Positions(Noting):
    """Measures the position only."""

    measured = 1


class Nothing(Noting):
    """Measures nothing."""

    measured = 0


@pytest.fixture
def make(monkeypatch):
    """Return the function that hosts a class of this test."""
    def hosted(driver=Noting, **overrides):
        monkeypatch.setitem(sys.modules, 'noting_driver', SimpleNamespace(Here=driver))
        return HostedDriver(Configuration.from_flat(
            {'driver.name': 'noting_driver:Here',
             **{key.replace('__', '.'): value for key, value in overrides.items()}}))
    return hosted


def names(hosted):
    return [call[0] for call in hosted.driver.calls]


def running(hosted):
    hosted.open()
    hosted.enable()
    hosted.driver.calls.clear()
    return hosted


def test_the_lifecycle_is_called_in_order_and_each_end_once(make):
    hosted = make()
    hosted.open(object())
    hosted.enable()
    assert [hosted.disable(0.5, 1.0) for _ in range(2)] == ['', '']
    assert [hosted.close() for _ in range(2)] == ['', '']
    assert hosted.driver.calls == [('attach',), ('open',), ('enable',), ('safe', 0.5, 1.0),
                                   ('disable',), ('close',)]


@pytest.mark.parametrize('error', [DriverError('not there'), OSError('not there')])
def test_a_device_that_does_not_open_is_closed_and_reported(make, error):
    hosted = make()
    hosted.driver.answers['open'] = error
    with pytest.raises(DriverError, match='not there'):
        hosted.open()
    assert names(hosted) == ['open', 'close']


def test_a_device_that_refuses_is_disabled_again(make):
    hosted = make()
    hosted.open()
    hosted.driver.answers['enable'] = ValueError('no power')
    with pytest.raises(DriverError, match=r'enable: ValueError: no power \(test_drivers_hosted'):
        hosted.enable()
    assert names(hosted) == ['open', 'enable', 'disable']
    hosted.safe(0.0, 0.0)
    assert names(hosted) == ['open', 'enable', 'disable']    # nothing is sent to it then
    assert hosted.close() == ''


def test_letting_go_goes_on_after_a_failure_and_reports_it(make):
    hosted = running(make())
    hosted.driver.answers['safe'] = OSError('bus off')
    hosted.driver.answers['close'] = DriverError('still busy')
    assert 'bus off' in hosted.disable(0.0, 0.0)
    assert names(hosted) == ['safe', 'disable']
    assert hosted.close() == 'still busy'


def test_commands_and_safe_commands_are_clipped_to_the_limit_and_counted(make):
    hosted = running(make())
    for v in (4.0, 6.0, -math.inf, -5.0):
        hosted.command(v, 0.1)
    hosted.safe(9.0, 0.2)
    assert [call[1] for call in hosted.driver.calls] == [4.0, 5.0, -5.0, -5.0, 5.0]
    assert (hosted.commands, hosted.saturated) == (4, 2)
    report = Report()
    hosted.report(report)
    assert report.values['saturated by the device [commands]'] == '2'
    assert report.level is Level.WARN
    assert '2 of 4 commands beyond the limit 5' in report.message
    report = Report()
    hosted.report(report)       # a new window
    assert report.level is Level.OK


@pytest.mark.parametrize('bad', [(math.nan, 0.0), (0.0,), (0.0, 0.0, 0.0), (0.0, math.inf),
                                 ('x', 'y'), 7.0, (None, None)])
def test_a_bad_measurement_is_none_and_three_of_them_are_a_fault(make, bad):
    hosted = running(make())
    hosted.driver.answers['measure'] = (1.0, 2.0)
    assert hosted.measure(0.0) == (1.0, 2.0)
    hosted.driver.answers['measure'] = bad
    for k in range(1, 4):
        assert hosted.fault() == ''
        assert hosted.measure(0.005 * k) is None
    assert hosted.fault() == 'no measurement for 3 samples'
    assert (hosted.missed, hosted.bad) == (3, 3)
    hosted.driver.answers['measure'] = (1.0, 2.0)
    assert hosted.recover() == ''
    assert hosted.measure(0.1) == (1.0, 2.0)


def test_before_the_first_measurement_none_is_no_fault(make):
    hosted = running(make())
    for k in range(10):
        assert hosted.measure(0.005 * k) is None
    assert hosted.fault() == ''
    assert (hosted.missed, hosted.bad) == (10, 0)


def test_state_hold_of_zero_waits_for_ever(make):
    hosted = running(make(safety__state_hold=0))
    hosted.driver.answers['measure'] = (1.0, 2.0)
    hosted.measure(0.0)
    hosted.driver.answers['measure'] = None
    for k in range(50):
        hosted.measure(0.005 * k)
    assert hosted.fault() == ''


@pytest.mark.parametrize('name', ['command', 'safe', 'measure', 'fault', 'recover', 'report'])
def test_code_that_raises_is_a_fault_with_its_place_until_it_recovers(make, name):
    hosted = running(make())
    hosted.driver.answers['measure'] = (1.0, 2.0)
    hosted.driver.answers[name] = ZeroDivisionError('by zero')
    {'command': lambda: hosted.command(1.0, 0.0), 'safe': lambda: hosted.safe(1.0, 0.0),
     'measure': lambda: hosted.measure(0.0), 'fault': hosted.fault,
     'recover': hosted.recover, 'report': lambda: hosted.report(Report())}[name]()
    assert f'{name}: ZeroDivisionError: by zero (test_drivers_hosted.py, line ' in hosted.fault()
    if name in ('recover', 'fault'):
        assert 'ZeroDivisionError' in hosted.recover()
    del hosted.driver.answers[name]
    assert hosted.recover() == ''


class Forgetful(Noting):
    """Reports its limit, and what it measures, as the test reports."""

    limits: ClassVar = {'limit': LIMIT, 'measured': 2}

    def _report(self, name):
        found = self.limits[name]
        if isinstance(found, Exception):
            raise found
        return found

    @property
    def limit(self):
        return self._report('limit')

    @property
    def measured(self):
        return self._report('measured')


@pytest.mark.parametrize(('limit', 'words'), [
    (OSError('gone'), 'limit: OSError: gone (test_drivers_hosted.py, line '),
    (DriverError('gone'), 'gone'), (math.nan, 'limit nan must be >= 0'), (-1.0, 'limit -1'),
    (None, 'limit: TypeError')])
def test_a_limit_that_cannot_be_reported_is_a_fault_and_only_safe_commands_go_out(
        make, monkeypatch, limit, words):
    hosted = running(make(Forgetful))
    assert hosted.command(7.0, 0.1) == LIMIT
    monkeypatch.setitem(Forgetful.limits, 'limit', limit)
    assert hosted.command(3.0, 0.2) == 0.0
    assert words in hosted.fault()
    hosted.safe(0.5, 0.3)
    hosted.report(Report())
    assert [call for call in hosted.driver.calls if call[0] in ('command', 'safe')] == [
        ('command', LIMIT, 0.1), ('safe', 0.0, 0.2), ('safe', 0.5, 0.3)]
    with pytest.raises(DriverError):
        _ = hosted.limit
    assert hosted.disable(0.0, 1.0)     # reports it, and has let go
    assert names(hosted)[-2:] == ['safe', 'disable']
    monkeypatch.setitem(Forgetful.limits, 'limit', 2.0)
    hosted.enable()
    assert hosted.fault() == ''
    assert hosted.command(3.0, 0.0) == 2.0


def test_what_it_measures_is_asked_once(make, monkeypatch):
    hosted = running(make(Forgetful))
    monkeypatch.setitem(Forgetful.limits, 'measured', OSError('gone'))
    hosted.driver.answers['measure'] = (1.0, 2.0)
    assert hosted.measure(0.0) == (1.0, 2.0)
    assert hosted.fault() == ''
    with pytest.raises(ConfigurationError, match='measured: OSError: gone'):
        make(Forgetful)


def test_a_diverged_simulation_ends_the_loop(make):
    hosted = running(make())
    hosted.driver.answers['measure'] = LoopError('diverged')
    with pytest.raises(LoopError, match='diverged'):
        hosted.measure(0.0)


def test_a_driver_that_measures_too_little_is_refused(make):
    with pytest.raises(ConfigurationError, match='measures 0'):
        make(Nothing)


def test_the_velocity_of_positions_is_observed_with_and_without_a_reference(make):
    a = -0.7
    with_it, without = running(make(Positions)), running(make(Positions))
    errors = []
    for k in range(400):
        t = 0.005 * k
        x, v = 0.3 * t + 0.5 * a * t * t, 0.3 + a * t
        with_it.reference(Reference(k, t, (math.sin(t), math.cos(t), -math.sin(t))))
        found = []
        for hosted in (with_it, without):
            hosted.driver.answers['measure'] = (x,)
            found.append(hosted.measure(t))
        assert found[0][0] == x
        errors.append([item[1] - v for item in found])
    # Without it nothing is left of a constant acceleration; with it, what x_d has of x_d'''.
    assert abs(errors[-1][1]) < 1e-9
    assert abs(errors[-1][0]) < 2.0 / 100.0 ** 2


def test_a_reference_that_is_old_is_not_believed(make):
    hosted = running(make(Positions))
    hosted.reference(Reference(0, 0.0, (0.0, 0.0, 100.0)))
    for k in range(3):
        hosted.driver.answers['measure'] = (0.0,)
        found = hosted.measure(10.0 + 0.005 * k)
    assert found == (0.0, 0.0)


def test_slow_calls_are_counted(make, monkeypatch):
    clock = iter([0.0, 0.001, 1.0, 1.004, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0])
    hosted = running(make())
    monkeypatch.setattr('time.perf_counter', lambda: next(clock))
    hosted.command(1.0, 0.0)
    hosted.command(1.0, 0.0)
    assert hosted.slow == 1
    assert hosted.slowest == pytest.approx(0.004)


@pytest.mark.parametrize('x', [1e308, -1e308])
def test_an_observer_that_a_reference_has_led_to_infinity_begins_again(make, x):
    hosted = running(make(Positions))
    hosted.reference(Reference(0, 0.0, (0.0, 0.0, 0.0)))
    for k in range(100):
        t = k * 0.005
        if k == 50:
            hosted.reference(Reference(k, t, (x, x, x)))
            hosted.reference(Reference(k + 1, t + 0.005, (0.0, 0.0, 0.0)))
        hosted.driver.answers['measure'] = (0.0,)
        found = hosted.measure(t)
        assert found is None or all(map(math.isfinite, found))
    assert found is not None
    assert 0 < hosted.bad < 5


def test_what_a_device_makes_a_driver_write_is_bounded_and_printable(make):
    hosted = running(make())
    text = '\x1b[2J' + 'x' * 10 ** 6
    hosted.driver.answers['fault'] = text
    hosted.driver.absence = lambda: text
    for found in (hosted.fault(), hosted.absence()):
        assert found.startswith('\\x1b[2Jx')
        assert len(found) < 1000
        assert found.isprintable()

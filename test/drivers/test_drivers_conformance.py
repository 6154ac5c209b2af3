# SPDX-License-Identifier: Apache-2.0
"""The kit against our own drivers, and against one deliberately broken driver for each check."""

from __future__ import annotations

import sys
import time
from types import SimpleNamespace

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.conformance.driver_checks import check_contract, wave
from dz_ros.drivers.mock import Mock
from dz_ros.drivers.simulated import SimulatedActuator, SimulatedParameters
from dz_ros.errors import DriverError

NAMES = ['declaration', 'opens', 'measurement', 'answers at once', 'no fault', 'safe command',
         'limit', 'stop and reset', 'restart', 'reconnect']


@pytest.mark.parametrize('name', ['simulated', 'mock'])
def test_our_own_pass_every_check(check, name):
    found = check(name, plant__command_limit=5.0)
    assert list(found) == NAMES
    assert {item.name for item in found.values() if not item.passed} == set()
    assert all(item.figure and item.limit and not item.words for item in found.values())


def test_a_stop_ends_the_check_with_the_safe_command(monkeypatch):
    commanded = []

    class Noting(SimulatedActuator):
        name = 'noting'
        Parameters = SimulatedParameters

        def command(self, v, t):
            commanded.append(v)
            super().command(v, t)

        def safe(self, v, t):
            commanded.append(('safe', v))
            super().safe(v, t)

        def disable(self):
            commanded.append('disabled')

    monkeypatch.setitem(sys.modules, 'noting', SimpleNamespace(Here=Noting))
    c = Configuration.from_flat({'driver.name': 'noting:Here'})
    results = check_contract(c, 0.1, True, lambda: 'e-stop pressed' if len(commanded) > 50 else '')
    assert [next(results).name, next(results).name] == ['declaration', 'opens']
    with pytest.raises(DriverError, match=r'^e-stop pressed$'):
        next(results)
    assert len(commanded) < 55
    assert commanded[-3:] == [('safe', 0.0), 0.0, 'disabled']     # a command, by the base class


def test_an_observed_velocity_passes_too(check):
    found = check('mock', driver__measures=1, driver__limit=3.0)
    assert all(item.passed for item in found.values())
    assert 'measures 1 of 2' in found['declaration'].figure


def test_what_cannot_be_seen_is_not_passed(check):
    class Silent(Broken):
        def applied_command(self):
            return None

    found = check(Silent, plant__command_limit=5.0)
    unseen = {item.name for item in found.values() if item.passed is None}
    assert unseen == {'safe command', 'limit', 'stop and reset'}
    assert 'applied_command' in found['limit'].words
    assert check('simulated')['limit'].passed is None           # none declared
    assert 'saturate' in check('mock', saturate=False, driver__limit=5.0)['limit'].words


class Broken(SimulatedActuator):
    """Right so far; each flaw of the tests is a subclass."""

    name = 'broken'
    Parameters = SimulatedParameters


class WrongUnits(Broken):
    @property
    def state_units(self):
        return ('m',)


class NoCommandUnit(Broken):
    command_unit = ''


class NoSummary(Broken):
    summary = ' '


class NegativeLimit(Broken):
    limit = -1.0


class DoesNotOpen(Broken):
    def open(self):
        raise OSError('no such device')


class Refuses(Broken):
    def enable(self):
        raise RuntimeError('no power')


class MeasuresNothing(Broken):
    def measure(self):
        return None


class MeasuresNow(Broken):
    """Every other sample."""

    def measure(self):
        self.turn = not getattr(self, 'turn', True)
        return super().measure() if self.turn else None


class MeasuresNan(Broken):
    def measure(self):
        return (*super().measure()[:-1], float('nan')) if self.t > 0.0 else super().measure()


class MeasuresTooFew(Broken):
    def measure(self):
        return super().measure()[:1] if self.t > 0.0 else super().measure()


class Waits(Broken):
    def command(self, v, t):
        time.sleep(0.004)
        super().command(v, t)


class Faulty(Broken):
    def fault(self):
        return 'over-temperature' if self.t > 0.1 else ''


class Raises(Broken):
    def command(self, v, t):
        raise ZeroDivisionError('by zero')


class IgnoresSafe(Broken):
    def safe(self, v, t):
        pass


class SafeIsFault(Broken):
    """A quick stop that reports it and cannot be left."""

    def safe(self, v, t):
        super().safe(v, t)
        self.stopped = self.t > 0.0

    def fault(self):
        return 'quick stop' if getattr(self, 'stopped', False) else ''


class ScalesWrong(Broken):
    limit = 5.0

    def command(self, v, t):
        super().command(1.3 * v if abs(v) >= 5.0 else v, t)


class StaysStopped(Broken):
    """After the reset nothing acts any more."""

    resets = 0

    def recover(self):
        self.resets += 1    # the kit resets once before it stops the device

    def command(self, v, t):
        super().command(0.0 if self.resets > 1 else v, t)


class ClosesBadly(Broken):
    def close(self):
        raise OSError('busy')


class OpensOnce(Broken):
    opened = 0

    def open(self):
        self.opened += 1
        if self.opened > 1:
            raise OSError('already in use')


class OpensTwice(OpensOnce):
    def open(self):
        self.opened += 1
        if self.opened > 2:
            raise OSError('already in use')


def test_the_wave_is_never_the_safe_command():
    values = [wave(k / 64) for k in range(-64, 65)]
    assert min(map(abs, values)) >= 0.5
    assert max(values) == 1.0
    assert min(values) == -1.0


def test_without_an_amplitude_the_safe_command_is_not_distinguished_from_the_last_one(check):
    found = check(IgnoresSafe, amplitude=0.0)
    assert found['safe command'].passed is None
    assert 'as small as the safe one' in found['safe command'].words


@pytest.mark.parametrize(('driver', 'name', 'words'), [
    (WrongUnits, 'declaration', 'state_units'),
    (NoCommandUnit, 'declaration', 'command_unit'),
    (NoSummary, 'declaration', 'summary'),
    (NegativeLimit, 'declaration', 'limit -1'),
    (DoesNotOpen, 'opens', 'no such device'),
    (Refuses, 'opens', 'no power'),
    (MeasuresNothing, 'opens', 'no measurement within'),
    (MeasuresNow, 'measurement', 'without a measurement'),
    (MeasuresNan, 'measurement', 'finite numbers'),
    (MeasuresTooFew, 'measurement', 'without a measurement of 2'),
    (Waits, 'answers at once', 'thread'),
    (Faulty, 'no fault', 'over-temperature'),
    (Raises, 'no fault', 'ZeroDivisionError: by zero'),
    (IgnoresSafe, 'safe command', 'still holds'),
    (SafeIsFault, 'stop and reset', 'quick stop'),
    (ScalesWrong, 'limit', 'another command'),
    (StaysStopped, 'stop and reset', 'no command acts'),
    (ClosesBadly, 'restart', 'busy'),
    (OpensOnce, 'restart', 'already in use'),
    (OpensTwice, 'reconnect', 'already in use'),
], ids=lambda item: getattr(item, '__name__', item))
def test_a_broken_driver_fails_the_check_that_is_for_it(check, driver, name, words):
    found = check(driver)
    assert found[name].passed is False, found
    assert words in found[name].words


def test_every_check_has_a_driver_that_fails_it():
    marks = test_a_broken_driver_fails_the_check_that_is_for_it.pytestmark
    cases = next(mark for mark in marks if mark.name == 'parametrize').args[1]
    assert {case[1] for case in cases} == set(NAMES)


def test_a_deaf_device_and_one_whose_link_fails_are_found(check):
    deaf = check('mock', driver__script=['0- deaf'])
    assert deaf['stop and reset'].passed is False
    gone = check('mock', driver__script=['20- raise cable'])
    assert 'RuntimeError: cable' in gone['no fault'].words
    assert not gone['measurement'].passed


def test_after_the_first_two_nothing_is_tried_with_a_device_that_is_not_there(check):
    assert list(check(DoesNotOpen)) == ['declaration', 'opens']


def test_the_device_is_let_go_whatever_happens(check):
    made = []

    class Kept(Mock):
        name = 'kept'

        def __init__(self, parameters, configuration):
            super().__init__(parameters, configuration)
            made.append(self)

    check(Kept, driver__script=['5 raise x'])
    calls = made[-1].calls
    assert calls.count('open') == calls.count('close')
    assert calls[-2:] == ['disable', 'close']
    assert made[-1].given[-1][2]        # the safe command was the last one

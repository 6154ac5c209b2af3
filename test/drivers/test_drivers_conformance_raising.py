# SPDX-License-Identifier: Apache-2.0
"""The kit against drivers that raise, or report nonsense, where they are only asked."""

from __future__ import annotations

import pytest

from dz_ros.drivers.simulated import SimulatedActuator, SimulatedParameters


class Broken(SimulatedActuator):
    """Right so far; each flaw of the tests is a subclass."""

    name = 'broken'
    Parameters = SimulatedParameters


class CannotReport(Broken):
    """Knows what it holds as long as it is not asked."""

    def applied_command(self):
        raise KeyError('demand')


class ReportsNonsense(Broken):
    def applied_command(self):
        return 'much'


class LimitRaises(Broken):
    """From the second time it is asked."""

    asked = 0

    @property
    def limit(self):
        self.asked += 1
        if self.asked > 1:
            raise OSError('not now')
        return 5.0


class UnitsRaise(Broken):
    @property
    def state_units(self):
        raise KeyError('unit')


@pytest.mark.parametrize(('driver', 'failed', 'words'), [
    (CannotReport, {'safe command', 'limit', 'stop and reset'},
     "applied_command: KeyError: 'demand'"),
    (ReportsNonsense, {'safe command', 'limit', 'stop and reset'},
     "applied_command: 'much' is neither a finite number nor None"),
    (UnitsRaise, {'declaration'}, "the driver: KeyError: 'unit'"),
])
def test_whatever_a_driver_raises_fails_that_check_and_the_rest_go_on(check, driver, failed,
                                                                      words):
    found = check(driver, plant__command_limit=5.0)
    assert list(found) == list(check('mock'))
    assert {name for name, item in found.items() if item.passed is False} == failed
    assert all(words in found[name].words for name in failed)
    assert all('test_drivers_conformance_raising.py, line' in found[name].words for name in failed
               if 'KeyError' in words)


def test_a_limit_that_raises_is_found_and_the_rest_go_on(check):
    found = check(LimitRaises)
    assert list(found)[:2] == ['declaration', 'opens']
    assert 'OSError: not now' in found['limit'].words
    assert not found['no fault'].passed

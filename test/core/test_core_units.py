# SPDX-License-Identifier: Apache-2.0
"""Unit expressions, resolved for a plant."""

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.units import Units

SERVO = Units(2, ('rad', 'rad/s'), 'N m', ('1', 'rad/s'))
VALVE = Units(3, ('m', 'm/s', 'm/s²'), 'V', ('m', 'm/s', 'm/s²'))


@pytest.mark.parametrize(('units', 'expression', 'expected'), [
    (SERVO, 'x', 'rad'), (SERVO, 'x^(1)', 'rad/s'), (SERVO, 'x^(n-1)', 'rad/s'),
    (SERVO, 'x^(n)', 'rad/s²'), (SERVO, 'v', 'N m'), (SERVO, 'v/s', 'N m/s'),
    (SERVO, 'v/x^(n)', 'N m s²/rad'), (SERVO, 'v/Y1', 'N m'), (SERVO, 'v/Y2', 'N m s/rad'),
    (SERVO, 'v/(Y2^2 x^(n-1) s)', 'N m s²/rad³'), (SERVO, 'x s', 'rad s'), (SERVO, '1', '1'),
    (SERVO, 'v/v', '1'), (SERVO, 'lm²', 'lm²'), (SERVO, 'v/Y3', ''), (SERVO, '', '1'),
    (VALVE, 'x^(n)', 'm/s³'), (VALVE, 'x^(n)/v', 'm/(s³ V)'), (VALVE, 'v/x^(n)', 'V s³/m'),
    (VALVE, 'v/Y3', 'V s²/m'), (Units(1, ('m/s',), 'N'), 'x^(n)', 'm/s²'),
    (Units(1, ('m/s',), 'N'), 'x^(n-1)', 'm/s'), (Units(2), 'x', ''), (Units(2), 'v/x^(n)', ''),
    (Units(2), 's', 's')])
def test_units_are_resolved_for_a_plant(units, expression, expected):
    assert units.resolve(expression) == expected


def test_units_of_parameters_are_resolved_from_their_words():
    assert SERVO.resolve_words('actuator unit per unit of s per s') == 'N m/rad'
    assert SERVO.resolve_words('actuator unit per unit of x^(n)') == 'N m s²/rad'
    assert SERVO.resolve_words('actuator unit per unit of Y_i') == 'N m, N m s/rad'
    assert Units(1, ('m',), 'V', ('m',)).resolve_words('actuator unit per unit of Y_i') == 'V/m'
    for text in ('', '1', 'm/s per V', 'state units', 'unit of x/s per command unit'):
        assert SERVO.resolve_words(text) == text


@pytest.mark.parametrize(('words', 'expected'), [
    ('actuator unit, rad/s', 'N m, rad/s'), ('1, rad/s', '1, rad/s'),
    ('s, unit of x^(n), s', 's, rad/s², s'), ('actuator unit per unit of x', 'N m/rad'),
    ('unit of x', 'rad')])
def test_a_list_of_different_units_has_each(words, expected):
    assert SERVO.resolve_words(words) == expected


def test_a_count_is_shown_without_a_unit():
    fields = Configuration.from_flat({}).fields()
    assert fields['loop.seed'].unit == fields['plant.substeps'].unit == ''
    assert fields['loop.rate'].unit == 'Hz'
    assert fields['plant.dead_zone.m_r'].unit == '1'


def test_a_unit_stands_behind_its_number():
    behind = Units.of(Configuration.from_flat({'plant.model': 'servo'}).plant).behind
    assert [behind(item) for item in ('x', 'x^(n-1)', 'x^(n)', 'v', 'v/x^(n-1)', '1')] == [
        ' rad', ' rad/s', ' rad/s²', ' A', ' A s/rad', '']
    assert Units(2).behind('x') == ''

# SPDX-License-Identifier: Apache-2.0
"""Declared signals: unit expressions and what is known of names alone."""

import pytest

from dz_ros.core import schema
from dz_ros.core.laws import LAWS
from dz_ros.core.plants import PLANTS
from dz_ros.core.records import Command, Reference, State, Terms, Truth
from dz_ros.core.signals import (
    declared,
    estimates,
    names,
    places,
    Role,
    Signal,
    TERMS,
    Units,
)

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


@pytest.mark.parametrize(('words', 'expected'), [
    ('actuator unit, rad/s', 'N m, rad/s'), ('1, rad/s', '1, rad/s'),
    ('s, unit of x^(n), s', 's, rad/s², s'), ('actuator unit per unit of x', 'N m/rad'),
    ('unit of x', 'rad')])
def test_a_list_of_different_units_has_each(words, expected):
    assert SERVO.resolve_words(words) == expected


@pytest.mark.parametrize('law', sorted(LAWS.all()))
@pytest.mark.parametrize('plant', sorted(PLANTS.all()))
def test_every_signal_of_every_law_has_a_unit_and_a_meaning(law, plant):
    chosen = PLANTS.load(plant)()
    signals = LAWS.load(law)(None, chosen.order, chosen.regressor_count).signals
    units = Units.of(chosen)
    fields = (*Terms.fields(signals), *State.fields(chosen.order), *Command.fields(),
              *Reference.fields(chosen.order), *Truth.fields())
    for item in fields:
        assert units.resolve(item.unit), item
        assert item.meaning, item
        assert item.label
    labels = names(Terms.fields(signals))
    assert len(set(labels)) == len(labels)
    assert labels == Terms.labels(names(signals))


@pytest.mark.parametrize(('plant', 'expected'), [
    ('wang2004', ('1', '1', 's²')), ('first_order', ('N s/m', 'N s²/m²', 'N s²/m')),
    ('servo', ('A s/rad', 'A', 'A s²/rad')), ('pendulum', ('N m', 'N m s/rad', 'N m s²/rad')),
    ('axis', ('V s/m', 'V', 'V', 'V s²/m')),
    ('valve_actuator', ('V/m', 'V s/m', 'V s²/m', 'V s³/m'))])
def test_units_of_the_estimates_make_the_parts_of_v_commands(plant, expected):
    """θ̂_i Y_i and φ̂ u_fd have the unit of v (14)."""
    chosen = PLANTS.load(plant)()
    assert len(chosen.regressor_units) == chosen.regressor_count
    assert tuple(Units.of(chosen).resolve(item.unit)
                 for item in estimates(chosen.regressor_count)) == expected


def test_units_of_parameters_are_resolved_from_their_words():
    assert SERVO.resolve_words('actuator unit per unit of s per s') == 'N m/rad'
    assert SERVO.resolve_words('actuator unit per unit of x^(n)') == 'N m s²/rad'
    assert SERVO.resolve_words('actuator unit per unit of Y_i') == 'N m, N m s/rad'
    assert Units(1, ('m',), 'V', ('m',)).resolve_words('actuator unit per unit of Y_i') == 'V/m'
    for text in ('', '1', 'm/s per V', 'state units', 'unit of x/s per command unit'):
        assert SERVO.resolve_words(text) == text


@pytest.mark.parametrize('law', sorted(LAWS.all()))
def test_adaptation_gains_have_the_units_of_their_equations(law):
    """θ̂' = −γ Y s_ε and φ̂' = −η u_fd s_ε (15), (16): both sides, in SI units of a plant."""
    units = Units(2, ('m', 'm/s'), 'V', ('kg',))
    gains = {item.name: units.resolve_words(item.spec.unit)
             for item in schema.fields(LAWS.load(law).Gains)}
    signals = {item.name: units.resolve(item.unit) for item in LAWS.load(law)(None, 2, 1).signals}
    if 'gamma' in gains and 'phi' in signals:
        assert signals['theta1'] == gains['theta_0'] == 'V/kg'
        assert signals['phi'] == gains['phi_0'] == 'V s²/m'
        assert gains['gamma'] == 'V/(kg² m)'                # θ̂ per s, over Y and m/s
        assert gains['eta'] == 'V s⁴/m³'                    # φ̂ per s, over m/s² and m/s


def test_names_alone_report_what_is_reserved():
    found = declared(('s', 'theta12', 'phi', 'kappa_f', 'phi_before', 'theta0', 'theta१'))
    assert [item.role for item in found] == [
        Role.OTHER, Role.ESTIMATE, Role.ESTIMATE, Role.OTHER, Role.MEMORY, Role.OTHER, Role.OTHER]
    assert found[1].label == 'θ̂_12'
    own = Signal('kappa_f', '1', 'a factor', Role.GUARD)
    assert declared(('kappa_f',), (own,)) == (own,)


def test_places_are_found_by_name():
    assert places(TERMS, 'v_extra', 's') == (names(TERMS).index('v_extra'), 0)
    with pytest.raises(ValueError, match='not in tuple'):
        places(TERMS, 'nothing')

# SPDX-License-Identifier: Apache-2.0
"""What the forms of the page have for each parameter: symbol, unit, meaning."""

import pytest

from dz_ros.files.configurations import load_configuration
from dz_ros.live.describe import parameters, symbol


@pytest.mark.parametrize(('name', 'letters'), [
    ('lambda', 'λ'), ('k_star', 'k*'), ('k_d', 'k_d'), ('theta_0', 'θ̂_0'), ('b_r', 'b_r'),
    ('b_r_bounds', 'b_r'), ('b_r_drift', ''), ('observer_rate', ''), ('amplitude', '')])
def test_a_symbol_is_that_of_the_documents(name, letters):
    assert symbol(name) == letters


@pytest.mark.parametrize('name', ['servo', 'valve_actuator', 'thruster'])
def test_every_number_of_a_form_has_its_unit_and_meaning(name):
    found = parameters(load_configuration(name))
    units = {item['key']: item['unit'] for item in found}
    assert [item['key'] for item in found if item['kind'] in ('float', 'floats', 'int')
            and not item['unit']] == []
    assert all(item['description'] for item in found)
    actuator = load_configuration(name).plant.actuator_unit
    assert units['plant.dead_zone.b_r'] == actuator
    assert units['plant.dead_zone.b_r_drift'] == f'{actuator}, rad/s'
    # No placeholder but that of a variable which the plant does not state.
    assert {key for key, unit in units.items() if 'unit' in unit} <= {
        'plant.dead_zone.schedule_points', 'controller.points'}

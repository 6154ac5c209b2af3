# SPDX-License-Identifier: Apache-2.0
"""The narrowest layer without chatter that the design rules name, and what they advise."""

from dataclasses import replace
import math

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.rules import check
from dz_ros.core.laws.pd import Pd


def configuration(**values):
    return Configuration.from_flat({key.replace('__', '.'): value
                                    for key, value in values.items()})


def found(rule, **values):
    """Return the findings of one rule."""
    return [item for item in check(configuration(**values)) if item.rule == rule]


ROBUST = {'controller.law': 'robust', 'controller.gain_cap': 1e4}
INTEGRAL = {'controller.law': 'extended', 'controller.integral': True}


@pytest.mark.parametrize('delay', [0, 1, 2])
@pytest.mark.parametrize(('values', 'key'), [
    (ROBUST, 'largest_margin'), (INTEGRAL, 'smallest_epsilon'),
    ({**INTEGRAL, 'controller.automatic_epsilon': True}, 'largest_margin'),
    ({'controller.law': 'wang2004'}, 'smallest_epsilon')])
def test_the_smallest_layer_is_where_the_rule_begins_to_complain(delay, values, key):
    """Of laws with an integral too, in the key that makes their ε; m small so that f < 1."""
    values = {**values, 'loop.delay': delay, 'controller.m_bounds': [2.0, 4.0],
              'controller.design_delay': min(delay, 1), 'controller.rho_0': 0.1}
    number = found('chatter', **values)[delay].numbers
    limit = number[key]
    assert 0.0 < limit < 1.0
    name = 'controller.margin' if key == 'largest_margin' else 'controller.epsilon'
    for share, above in ((0.99, False), (1.01, True)):
        item = found('chatter', **{**values, name: share * limit})[delay]
        chatters = above if key == 'largest_margin' else not above
        assert (item.numbers['share_high'] >= 1.0) is chatters
        assert ('chatters' in item.words) is chatters
        epsilon = configuration(**{**values, name: share * limit}).law.design.epsilon
        assert (epsilon < item.numbers['smallest_epsilon']) is chatters


@pytest.mark.parametrize(('values', 'parts'), [
    ({'controller.law': 'robust', 'loop.delay': 3}, ('controller.margin', 'controller.gain_cap',
                                                     'design_delay is 1 here, not 3')),
    ({'controller.law': 'robust', 'loop.delay': 2, 'controller.b_bounds': [1.0, 3.0]},
     ('controller.margin', 'controller.beta is 1.25, b_max m_max 3.75')),
    ({'controller.law': 'extended', 'controller.automatic_epsilon': True, 'loop.delay': 5},
     ('controller.margin',)),
    ({'controller.law': 'wang2004', 'loop.delay': 4}, ('controller.epsilon larger than',)),
    ({'controller.law': 'pd', 'loop.delay': 3, 'controller.k_d': 200.0}, ('k_d below 70.7',))])
def test_advice_on_chatter_names_keys_the_law_has(values, parts):
    item = found('chatter', **values)[-1]
    assert all(part in item.change for part in parts)
    known = configuration(**values).to_flat()
    for word in item.change.replace(',', ' ').replace(';', ' ').split():
        if word.startswith(('controller.', 'loop.')):
            assert word in known


def test_layer_of_a_law_of_unknown_keys(monkeypatch):
    """A law of one's own may make ε as it likes: advice without keys, no traceback."""
    strange = replace(configuration().law.design, least_gain=20.0)
    monkeypatch.setattr(Pd, 'design', strange)
    item = found('chatter', controller__law='pd', loop__delay=4)[-1]
    assert item.change.startswith('make ε larger than ')
    monkeypatch.setattr(Pd, 'design', replace(strange, least_gain=1e4))
    item = found('chatter', controller__law='pd', loop__delay=4)[-1]
    assert math.isinf(item.numbers['smallest_epsilon'])

# SPDX-License-Identifier: Apache-2.0
"""What the design rules report of configurations, and the stability limit on λ."""

from dataclasses import asdict
import json
import math

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import DeadZone
from dz_ros.core.design import along_reference
from dz_ros.core.design.along_reference import disturbance_along_reference, largest_derivatives
from dz_ros.core.design.finding import ERROR, Finding, INFO, WARNING, worst
from dz_ros.core.design.guard_noise import noise_in_s
from dz_ros.core.design.robust_gain import least_robust_gain
from dz_ros.core.design.rules import check
from dz_ros.core.laws import LAWS
from dz_ros.core.laws.extensions import break_point
from dz_ros.core.laws.pd import Pd
from dz_ros.core.loop.offline import simulate
from dz_ros.core.plants import PLANTS


def configuration(**values):
    return Configuration.from_flat({key.replace('__', '.'): value
                                    for key, value in values.items()})


def found(rule, **values):
    """Return the findings of one rule."""
    return [item for item in check(configuration(**values)) if item.rule == rule]


def test_rule_18_of_the_example():
    assert least_robust_gain(0.875, 0.85) == pytest.approx(1.0294, abs=1e-4)
    assert least_robust_gain(0.875, 0.85, 1.0, 1.25) == pytest.approx(2.5)
    assert least_robust_gain(0.875, 0.85, reserve=1.47) == pytest.approx(2.4994, abs=1e-4)
    assert least_robust_gain(0.0, 0.5, 0.25, 1.0) == 8.0


def test_disturbance_is_that_of_the_model_on_the_reference():
    """0.5 · 2.5 |sin t sin 3t| has its largest value 1.25 at t = π/2."""
    assert disturbance_along_reference(configuration()) == pytest.approx(1.25, abs=1e-3)
    assert disturbance_along_reference(configuration(plant__a3=0.0)) == 0.0


def test_the_paper_s_example_has_nothing_to_complain_of():
    findings = check(configuration())
    assert worst(findings) == INFO
    rules = [item.rule for item in findings]
    for rule in ('(A1)', '(A2)', '(A3)', '(A4)', 'state', 'structure', 'input gain', 'reference',
                 '(18)', 'Ω', 'not covered'):
        assert rules.count(rule) == 1, rule
    assert rules.count('chatter') == 3


def test_numbers_of_the_example():
    gain, = found('(18)')
    assert gain.numbers['least'] == pytest.approx(1.0294, abs=1e-4)
    assert gain.numbers['least_with_disturbance'] == pytest.approx(2.5, abs=1e-3)
    bounds, = found('Ω', controller__lambda=2.0)
    assert bounds.numbers == pytest.approx({'x0': 0.01, 'x1': 0.04})
    assert '0.04 1/s' in bounds.words
    for item, epsilon in zip(found('chatter', controller__m_bounds=[1.0, 1.0]),
                             (0.0064, 0.0132, 0.0222), strict=True):
        assert item.numbers['smallest_epsilon'] == pytest.approx(epsilon, rel=6e-3)


@pytest.mark.parametrize(('values', 'rule', 'level', 'part'), [
    ({'plant.dead_zone.m_l': 0.9}, '(A2)', INFO, 'not assumed: slopes 1 on the right'),
    ({'plant.dead_zone.m_l': 1.000001}, '(A2)', INFO, 'holds: the same slope 1 on both sides'),
    ({'plant.dead_zone.m_l': 1.000001, 'controller.m_bounds': [0.9, 1.0]}, '(A4)', INFO,
     'holds: the dead-zone lies within'),
    ({'plant.dead_zone.m_r_drift': [0.1, 1.0]}, '(A2)', INFO, 'drifting'),
    ({'plant.dead_zone.b_r': 0.7}, '(A4)', WARNING, 'b_r in [0.7, 0.7] but stated in [0.1, 0.6]'),
    ({'plant.dead_zone.b_l_drift': [0.3, 1.0]}, '(A4)', WARNING, 'b_l in [-0.9, -0.3]'),
    ({'plant.b': 2.0}, 'input gain', WARNING, 'b = 2'),
    ({'plant.b': 2.0, 'controller.b_bounds': [0.5, 2.0]}, 'input gain', INFO, 'holds'),
    ({'controller.k_star': 1.0}, '(18)', ERROR, 'rho/m_min = 1.029'),
    ({'controller.k_star': 1.5}, '(18)', WARNING, 'a disturbance of up to 0.4 1/s²'),
    ({'controller.law': 'adaptive'}, '(18)', WARNING, 'no robust term'),
    ({'controller.law': 'pid'}, 'Ω', INFO, 'promises no set'),
    ({'controller.law': 'exact_inverse'}, '(18)', INFO, 'compensates the dead-zone itself'),
    ({'controller.law': 'robust', 'controller.k_star': 2.0}, '(18)', ERROR, 'of the integral'),
    ({'controller.law': 'robust'}, '(18)', INFO, 'the model has 1.25 1/s² of it, of which the'),
    ({'controller.law': 'robust', 'controller.rho_1': 1.0}, '(18)', WARNING,
     'a disturbance of up to 0.0005 1/s²; along the reference the model has 1.25 1/s² of it, '
     'more than'),
    ({'controller.law': 'robust'}, 'projection', INFO, 'holds'),
    ({'controller.law': 'robust', 'controller.b_bounds': [0.2, 2.0]}, 'projection', WARNING,
     'φ̂ may have to be in [0.4, 5.88]'),
    ({'plant.noise': [1e-3, 1e-2]}, 'not covered', INFO, 'measurement noise (v shows 1.37 of it)'),
    ({'plant.command_limit': 10.0}, 'not covered', INFO, 'saturation at 10'),
    ({'plant.command_limit': 10.0, 'controller.law': 'robust'}, 'saturation', WARNING,
     'knows no limit'),
    ({'plant.command_limit': 10.0, 'controller.law': 'robust', 'controller.v_max': 12.0},
     'saturation', WARNING, 'believes 12')])
def test_rules(values, rule, level, part):
    item, = found(rule, **values)
    assert item.level == level
    assert part in item.words
    assert bool(item.change) == (level != INFO)


def test_the_noise_of_v_is_that_of_s_times_the_gain():
    values = {'plant__model': 'servo', 'controller__law': 'robust_eso', 'driver__measured': 1,
              'plant__resolution': 1e-3}
    c = configuration(**values)
    item, = found('not covered', **values)
    shown = float(item.words.partition('v shows ')[2].partition(' A of it')[0])
    design = c.law.design
    assert shown == pytest.approx(
        (design.gain + design.lead) * noise_in_s(c, 1, (1e-3,)), rel=5e-3)
    assert shown > 0.1


def test_a_limit_of_chatter_of_another_observer_is_worded_so():
    for kind, part in (('levant', True), ('tracking', False)):
        items = found('chatter', plant__model='servo', controller__law='robust_eso',
                      driver__measured=1, driver__observer_kind=kind)
        assert items
        assert all(('were the velocity measured' in item.words) == part for item in items)


DEVICE = {'driver.name': 'serial', 'controller.law': 'robust'}


@pytest.mark.parametrize('driven', [True, False])
def test_of_a_real_device_the_plant_s_section_proves_nothing(driven):
    """Neither for the host nor for the controller, which does not load the driver."""
    device = Configuration.from_flat(DEVICE, driven)
    assert not device.simulated
    words = {item.rule: item.words for item in check(device)}
    for rule in ('(A2)', '(A3)', '(A4)', 'input gain', 'state', 'structure', 'projection'):
        assert words[rule].startswith('stated: '), rule
    assert 'b_r in [0.1, 0.6]' in words['(A4)']
    assert all(configuration(**{**DEVICE, 'driver.name': name}).simulated
               for name in ('simulated', 'mock'))
    absent = Configuration.from_flat({'driver.name': 'nowhere.at.all:Driver'}, driven=False)
    assert not absent.simulated


@pytest.mark.parametrize(('values', 'rule'), [
    ({'plant.dead_zone.m_l': 1.9}, '(A4)'), ({'plant.dead_zone.b_r': 0.7}, '(A4)'),
    ({'plant.b': 2.0}, 'input gain'), ({'controller.b_bounds': [0.2, 2.0]}, 'projection')])
def test_a_model_outside_the_bounds_contradicts_them(values, rule):
    item, = found(rule, **DEVICE, **values)
    assert item.level == WARNING
    assert item.words.startswith('contradicted: ')
    assert "correct the plant's section" in item.change


@pytest.mark.parametrize(('on', 'v_max', 'complains'), [
    (False, 0.0, True), (False, 10.0, True), (True, 10.0, False), (True, 12.0, True)])
def test_a_limit_the_law_does_not_use_is_no_cure(on, v_max, complains):
    """With anti_windup off the law of the switches looks at no v_max."""
    values = {'plant.command_limit': 10.0, 'controller.law': 'extended',
              'controller.anti_windup': on, 'controller.v_max': v_max}
    items = found('saturation', **values)
    assert bool(items) is complains
    for item in items:
        assert 'controller.v_max to 10' in item.change
        assert ('controller.anti_windup to true' in item.change) is not on
        cured = {**values, 'controller.v_max': 10.0, 'controller.anti_windup': True}
        assert found('saturation', **cured) == []


@pytest.mark.parametrize(('values', 'levels'), [
    ({}, [INFO, INFO, INFO]),
    ({'controller.epsilon': 0.01}, [INFO, WARNING, INFO]),
    ({'controller.epsilon': 0.006}, [WARNING, WARNING, INFO]),
    ({'loop.delay': 2}, [INFO, INFO, WARNING]),
    ({'loop.delay': 2, 'controller.epsilon': 0.01}, [INFO, WARNING, ERROR]),
    ({'loop.delay': 4}, [INFO, INFO, INFO, ERROR]),
    ({'controller.law': 'robust'}, [INFO, INFO, INFO]),
    ({'controller.law': 'robust', 'loop.rate': 20.0, 'loop.delay': 2}, [INFO, WARNING, ERROR]),
    ({'loop.rate': 12.0}, [ERROR, WARNING, INFO])])
def test_chatter_levels(values, levels):
    assert [item.level for item in found('chatter', **values)] == levels


def test_no_layer_is_wide_enough_at_a_rate_too_low():
    items = found('chatter', loop__rate=12.0)
    assert math.isinf(items[1].numbers['smallest_epsilon'])
    assert 'no ε is large enough' in items[1].change


GUESSED = {'controller.law': 'extended', 'controller.dead_zone_feed_forward': True}


@pytest.mark.parametrize(('b_r', 'b_l'), [(0.35, -0.4), (0.1, -0.1), (0.6, -0.7), (0.0, 0.0),
                                          (2.0, -2.0)])
def test_rule_18_of_a_guessed_break_point_is_what_the_feed_forward_leaves(b_r, b_l):
    """Against the dead-zone itself: no v_d and no dead-zone within the bounds leave more."""
    item, = found('(18)', **GUESSED, **{'controller.b_r_guess': b_r, 'controller.b_l_guess': b_l,
                                        'controller.k_star': 4.0})
    left = 0.0
    for true_r in (0.1, 0.3, 0.6):
        for true_l in (-0.7, -0.35, -0.1):
            zone = DeadZone(m_r=1.25, m_l=1.25, b_r=true_r, b_l=true_l)
            left = max(left, *(abs(zone(v + break_point(v, b_r, b_l, 0.1)) - 1.25 * v)
                               for v in (0.001 * k for k in range(-3000, 3001))))
    assert item.numbers['rho'] == pytest.approx(left, rel=0.005)
    if b_r == 0.0:
        assert left == pytest.approx(0.875)


def test_a_bad_guess_is_an_error_and_a_good_one_needs_less_than_the_dead_zone():
    item, = found('(18)', **GUESSED)
    assert item.numbers['least'] < 0.6
    item, = found('(18)', **GUESSED, **{'controller.b_r_guess': 3.0})
    assert item.level == ERROR
    assert 'what the feed-forward leaves' in item.words
    assert 'guess the break points better' in item.change
    off, = found('(18)', **{**GUESSED, 'controller.dead_zone_feed_forward': False,
                            'controller.b_r_guess': 3.0})
    assert off.numbers['least'] == pytest.approx(1.0294, abs=1e-4)


@pytest.mark.parametrize(('values', 'certain'), [
    ({'loop.delay': 2, 'controller.epsilon': 0.018}, True),
    ({'loop.delay': 2, 'controller.epsilon': 0.03}, False),
    ({'loop.delay': 1, 'controller.epsilon': 0.011}, True),
    ({'loop.delay': 1, 'controller.epsilon': 0.016}, False)])
def test_chatters_for_certain_is_what_the_simulation_shows(values, certain):
    """With bounds of b m that fit the plant an error of the rule is chatter, and vice versa."""
    values = {**values, 'controller.m_bounds': [0.97, 1.03], 'loop.duration': 6.0}
    level = max(item.level == ERROR for item in found('chatter', **values))
    assert level is certain
    run = simulate(configuration(**values))
    half = len(run.v) // 2
    variation = sum(abs(a - b) for a, b in zip(run.v[half:-1], run.v[half + 1:], strict=True)) / 3
    assert bool(variation > 40.0) is certain


@pytest.mark.parametrize('law', LAWS.builtin)
@pytest.mark.parametrize('plant', PLANTS.builtin)
def test_every_combination_gets_sentences(law, plant):
    for item in check(configuration(controller__law=law, plant__model=plant)):
        assert item.level in (ERROR, WARNING, INFO)
        assert item.words
        assert '\n' not in item.words + item.change
        assert 'nan' not in item.words
        assert 'inf' not in item.words
        json.dumps(asdict(item))
        assert all(isinstance(value, float | int) for value in item.numbers.values())


def test_an_unknown_law_is_reported_as_unknown():
    class Stranger(Pd):
        name = 'stranger'
        design = None

    known = configuration()
    strange = Configuration(**{**{key: getattr(known, key) for key in known.__dataclass_fields__},
                               'law': Stranger()})
    assert [item.level for item in check(strange) if item.rule == 'law'] == [WARNING]


def test_a_stated_disturbance_replaces_the_model_s():
    item, = (item for item in check(configuration(), disturbance=2.0) if item.rule == '(18)')
    assert item.level == WARNING
    assert item.numbers['least_with_disturbance'] == pytest.approx((0.875 + 2.0) / 0.85)


def test_worst():
    assert worst([]) == INFO
    assert worst([Finding(INFO, 'a', ''), Finding(WARNING, 'b', '')]) == WARNING
    assert worst([Finding(ERROR, 'a', ''), Finding(WARNING, 'b', '')]) == ERROR


def test_a_reference_is_followed_once_and_asked_again_for_nothing(monkeypatch):
    followed = []
    monkeypatch.setattr(along_reference, '_known', along_reference.OrderedDict())
    sinusoid = type(configuration().trajectory)
    evaluate = sinusoid.evaluate

    def counted(t, p, x_d):
        followed.append(t)
        evaluate(t, p, x_d)

    monkeypatch.setattr(sinusoid, 'evaluate', staticmethod(counted))
    first = check(configuration())
    once = len(followed)
    assert once > 1000
    check(configuration(controller__k_d=11.0))      # a gain set while the loop runs
    assert len(followed) == once
    assert check(configuration()) == first
    moved = configuration(trajectory__frequency=2.0)
    assert largest_derivatives(moved) == pytest.approx((2.5, 5.0, 10.0), rel=1e-3)
    assert len(followed) > once
    again = len(followed)
    disturbance_along_reference(configuration(plant__a3=0.5))
    assert len(followed) > again

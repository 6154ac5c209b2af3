# SPDX-License-Identifier: Apache-2.0
"""The sampled loop and its slope λ: where it is lost, what the rule reports of it."""

import math

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import ERROR, INFO, WARNING
from dz_ros.core.design.rules import check
from dz_ros.core.design.stability import is_lost, lambda_limit, lost_from_start
from dz_ros.core.laws import LAWS
from dz_ros.core.laws.pd import Pd
from dz_ros.errors import ConfigurationError


def configuration(**values):
    return Configuration.from_flat({key.replace('__', '.'): value
                                    for key, value in values.items()})


@pytest.mark.parametrize(('limit', 'level'), [
    (0.9, ERROR), (1.1, WARNING), (8.0, INFO), (math.inf, INFO)])
def test_stability_limit_is_judged(limit, level):
    item, = (item for item in check(configuration(), stability_limit=limit) if item.rule == 'λ')
    assert item.level == level


@pytest.mark.parametrize(('lost', 'level'), [(True, ERROR), (False, INFO)])
def test_without_a_limit_one_run_is_judged(lost, level):
    item, = (item for item in check(configuration(), lost=lost) if item.rule == 'λ')
    assert item.level == level
    assert bool(item.change) is lost


@pytest.mark.parametrize('law', LAWS.builtin)
def test_a_loop_that_rests_at_its_reference_is_not_lost(law):
    """Zero error, zero excursion: what noise and dead-zone make of it is not getting lost."""
    values = {'controller__law': law, 'plant__model': 'servo', 'plant__x0': [0.0, 0.0],
              'plant__noise': [1e-4, 1e-3], 'trajectory__amplitude': 0.0}
    assert lost_from_start(configuration(**values)) is False
    if law in ('wang2004', 'extended'):
        assert lost_from_start(configuration(controller__law=law, controller__lambda=9.0)) is True


def test_a_pulse_that_comes_later_is_not_the_initial_state():
    thrown = {'plant.disturbance_pulse': [9.2, 400.0, 0.5], 'loop.duration': 10.0}
    assert is_lost(configuration(**thrown))
    assert lost_from_start(configuration(**thrown)) is False
    assert lambda_limit(configuration(**thrown)) == lambda_limit(configuration())


def test_a_law_without_a_slope_has_no_such_rule(monkeypatch):
    monkeypatch.setattr(Pd, 'design', None)
    assert lost_from_start(configuration(controller__law='pd')) is None


@pytest.mark.parametrize(('delay', 'first_lost'), [(0, 8.25), (1, 6.25), (2, 5.25)])
def test_stability_limit_of_the_example(delay, first_lost):
    """On a grid of 0.25 the first λ that diverges is 8.25, 6.25, 5.25."""
    limit = lambda_limit(configuration(loop__delay=delay))
    assert first_lost - 0.25 <= limit <= first_lost
    assert is_lost(configuration(loop__delay=delay, controller__lambda=first_lost))
    assert not is_lost(configuration(loop__delay=delay, controller__lambda=first_lost - 0.25))


def test_stability_limit_does_not_hang_on_where_the_search_starts():
    for start in (0.5, 7.9, 20.0):
        limit = lambda_limit(configuration(controller__lambda=start))
        assert limit == pytest.approx(8.05, abs=0.06)


@pytest.mark.slow
def test_projection_cures_it():
    assert lambda_limit(configuration(controller__law='extended', controller__projection=True),
                        highest=20.0) == math.inf
    assert lambda_limit(configuration(controller__law='robust'), highest=20.0) == math.inf


def test_a_slope_the_law_refuses_ends_the_search():
    refusing = configuration(controller__law='extended', controller__projection=True,
                             controller__automatic_epsilon=True, loop__rate=50.0,
                             controller__k_d=5.0)
    limit = lambda_limit(refusing)
    assert 0.0 < limit < math.inf
    item, = (item for item in check(refusing, stability_limit=limit) if item.rule == 'λ')
    assert 'is lost or has no layer above' in item.words
    with pytest.raises(ConfigurationError, match='no layer is wide enough'):
        refusing.replace(**{'controller.lambda': 64.0})


def test_a_hopeless_loop_has_no_stable_lambda():
    hopeless = configuration(controller__k_d=5000.0, loop__delay=3, plant__x0=[-2.5, 200.0])
    assert lambda_limit(hopeless, duration=1.0) == 0.0

# SPDX-License-Identifier: Apache-2.0
"""A plant with a constant force by simulations of long parts."""

from dataclasses import replace
import math

import numpy as np
import pytest

from dz_ros.core.dataset import from_run as recorded
from dz_ros.core.loop.offline import simulate
from dz_ros.core.plants import PLANTS
from dz_ros.files.configurations import load_configuration
from dz_ros.identification.estimation.long_simulation import (
    constant_term,
    LEAST,
    long_parts,
    LONGEST,
    refine_by_simulation,
)
from dz_ros.identification.estimation.prediction_error import Estimate, Fit
from dz_ros.identification.samples import from_run


@pytest.fixture(scope='module')
def axis():
    """Return a configuration of an axis with a constant force, and samples of its loop."""
    c = load_configuration('axis', [
        'plant.constant_force=-3.0', 'plant.noise=[0.0001, 0.001]', 'loop.duration=15.0',
        'plant.dead_zone.b_r=0.0', 'plant.dead_zone.b_l=0.0', 'plant.dead_zone.m_r=1.0',
        'plant.dead_zone.m_l=1.0'])
    return c, from_run(recorded(simulate(c), 10 ** 18), c)


def plant(c, a3, half_width, **others):
    names = ('a1', 'a2', 'a3', 'b_r', 'b_l', 'b·m_r', 'b·m_l')
    values = (*c.plant.a[:2], a3, 0.0, 0.0, c.plant.b, c.plant.b)
    return Fit(c.plant.name, tuple(Estimate(name, value, half_width if name == 'a3' else
                                            others.get(name[-1], 0.01))
                                   for name, value in zip(names, values, strict=True)),
               c.plant.b, (1.0, 1.0), 100, 20)


def test_which_plants_have_a_constant_term():
    found = {name: constant_term(PLANTS.load(name)()) for name in PLANTS.builtin}
    assert found['axis'] == 2
    assert {place for name, place in found.items() if name != 'axis'} == {None}


@pytest.mark.slow
@pytest.mark.parametrize('share', [0.8, 1.2])
def test_a_force_that_is_wrong_is_found(axis, share):
    c, samples = axis
    truth = c.plant.a[2]
    found = refine_by_simulation(plant(c, share * truth, abs(truth)), samples, c, 0)
    assert found['a3'].value == pytest.approx(truth, rel=0.02)
    assert found.a[:2] == pytest.approx(c.plant.a[:2], abs=0.01)


@pytest.mark.slow
def test_it_is_bound_to_the_confidence_of_the_stretches(axis):
    c, samples = axis
    truth = c.plant.a[2]
    loose = refine_by_simulation(plant(c, 1.5 * truth, abs(truth)), samples, c, 0)['a3'].value
    tight = refine_by_simulation(plant(c, 1.5 * truth, 1e-4), samples, c, 0)['a3'].value
    assert abs(loose - truth) < 0.1 * abs(tight - truth)
    assert tight == pytest.approx(1.5 * truth, rel=0.1)


@pytest.mark.slow
def test_break_points_and_intervals_stay(axis):
    c, samples = axis
    fitted = plant(c, 0.8 * c.plant.a[2], 0.5)
    found = refine_by_simulation(fitted, samples, c, 0)
    assert [item.half_width for item in found.estimates] == [
        item.half_width for item in fitted.estimates]
    assert (found['b_r'].value, found['b_l'].value) == (0.0, 0.0)


def test_what_is_not_seen_or_too_short_stays(axis):
    c, samples = axis
    fitted = plant(c, -0.05, math.inf)
    assert refine_by_simulation(fitted, samples, c, 0)['a3'] == fitted['a3']
    holes = samples.x.copy()
    holes[::200] = np.nan
    fitted = plant(c, -0.05, 0.1)
    assert refine_by_simulation(fitted, replace(samples, x=holes), c, 0) is fitted


@pytest.mark.slow
def test_a_slope_that_is_not_seen_is_not_that_of_the_other_side(axis):
    c, samples = axis
    fitted = plant(c, 0.8 * c.plant.a[2], 0.5, l=math.inf)
    kept = replace(fitted['b·m_l'], value=0.5 * c.plant.b)
    found = refine_by_simulation(replace(fitted, estimates=(*fitted.estimates[:-1], kept)),
                                 samples, c, 0)
    assert found['b·m_l'] == kept
    assert found['b·m_r'].value != found['b·m_l'].value


def test_parts_are_the_longest_without_a_hole_and_not_too_long():
    c = load_configuration('axis', ['loop.duration=70.0'])
    samples = from_run(recorded(simulate(c), 10 ** 18), c)
    x = samples.x.copy()
    x[400] = np.nan         # 2 s, too short a part before it
    found = long_parts(replace(samples, x=x), 0)
    assert len(found) == 3
    assert found[0][0] == 401
    assert found[-1][1] == len(x) - 1
    assert all(LEAST <= (high - low) * samples.period <= LONGEST for low, high in found)

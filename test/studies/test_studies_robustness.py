# SPDX-License-Identifier: Apache-2.0
"""The share of random plants within Ω_ε: what counts, what the controller is given."""

import importlib
import math
from pathlib import Path

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.files.configurations import load_configuration
from dz_ros.studies.outcome import run_row
from dz_ros.studies.scenarios import yardstick

BENCHMARKS = Path(__file__).parents[2] / 'benchmarks'


@pytest.fixture
def robustness(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module('robustness')


def cells(line):
    return [cell.strip() for cell in line.strip('|').split('|')]


@pytest.mark.parametrize(('row', 'share', 'alone', 'lost'), [
    ((0.5, 0.5, 1.0), '100.00 %', '100.00 %', '0'),
    ((0.5, 1.001, 1.0), '75.00 %', '100.00 %', '0'),    # x' leaves, x does not
    ((1.5, 0.5, 1.0), '75.00 %', '75.00 %', '0'),
    ((math.inf, math.inf, math.inf), '75.00 %', '75.00 %', '1')])
def test_a_plant_counts_where_every_state_stays_within(robustness, row, share, alone, lost):
    scale = np.array([*yardstick(), 1.0])       # of |x|, |x'| and the variation
    rows = scale * np.array([(0.5, 0.5, 1.0)] * 3 + [row])
    line = cells(robustness.table({('wang2004', 0, False): rows})[-1])
    assert (line[3], line[4], line[-1]) == (share, alone, lost)


@pytest.mark.parametrize('law', ['wang2004', 'robust'])
def test_what_is_drawn_lies_within_what_is_stated(robustness, law):
    base = robustness.base_of(law, 20.0)
    for plant in robustness.draw(50):
        within_bounds(Configuration.from_flat({**base, **plant}))


@pytest.mark.parametrize('law', ['wang2004', 'robust'])
def test_the_worst_cases_state_the_bounds_they_were_drawn_from(law):
    c = load_configuration(BENCHMARKS / 'worst' / f'{law}.yaml')
    within_bounds(c)
    assert tuple(c.controller_settings.b_bounds) == (0.5, 2.0)
    row = run_row(c, yardstick())
    assert not row['lost']
    assert (row['omega'] == 1.0) == (law == 'robust')


@pytest.mark.parametrize('law', ['wang2004', 'robust'])
def test_the_bounds_of_b_change_no_number_of_the_law(law):
    given, example = (Configuration.from_flat({'controller.law': law, **more}).law.constants
                      for more in ({'controller.b_bounds': [0.5, 2.0]}, {}))
    assert given == example


def within_bounds(c):
    known = c.controller_settings
    for value, (low, high) in ((c.plant.b, known.b_bounds), (c.dead_zone.m_r, known.m_bounds),
                               (c.dead_zone.m_l, known.m_bounds),
                               (c.dead_zone.b_r, known.b_r_bounds),
                               (c.dead_zone.b_l, known.b_l_bounds)):
        assert low <= value <= high

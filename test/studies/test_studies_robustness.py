"""The share of random plants within Ω_ε: what counts, what the controller is told."""

import importlib
from pathlib import Path

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.files import load_configuration
from dz_ros.studies.outcome import COLUMNS, run_row
from dz_ros.studies.scenarios import yardstick

BENCHMARKS = Path(__file__).parents[2] / 'benchmarks'
INSIDE = {**dict.fromkeys(COLUMNS), 'lost': 0, 'error_max': 0.01, 'omega': 1.0}


@pytest.fixture
def robustness(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module('robustness')


def cells(line):
    return [cell.strip() for cell in line.strip('|').split('|')]


@pytest.mark.parametrize(('change', 'share', 'alone'), [
    ({}, '100.00 %', '100.00 %'),
    ({'omega': 0.999}, '75.00 %', '100.00 %'),          # x' leaves, x does not
    ({'omega': 0.9, 'error_max': 0.03}, '75.00 %', '75.00 %'),
    ({'lost': 1}, '75.00 %', '75.00 %'),
    ({'lost': 1, 'omega': None, 'error_max': None}, '75.00 %', '75.00 %')])
def test_a_plant_counts_where_every_state_stays_within(robustness, change, share, alone):
    rows = [INSIDE, INSIDE, {**INSIDE, **change}, INSIDE]
    assert cells(robustness.table_line('robust', rows, 1.0))[2:4] == [share, alone]


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
    told, example = (Configuration.from_flat({'controller.law': law, **more}).law.constants
                     for more in ({'controller.b_bounds': [0.5, 2.0]}, {}))
    assert told == example


def within_bounds(c):
    known = c.controller_settings
    for value, (low, high) in ((c.plant.b, known.b_bounds), (c.dead_zone.m_r, known.m_bounds),
                               (c.dead_zone.m_l, known.m_bounds),
                               (c.dead_zone.b_r, known.b_r_bounds),
                               (c.dead_zone.b_l, known.b_l_bounds)):
        assert low <= value <= high

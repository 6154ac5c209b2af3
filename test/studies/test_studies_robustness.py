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
    scale = np.array([*yardstick(), 1.0, 0.0, 0.0])     # of |x|, |x'| and the variation
    rows = scale * np.array([(0.5, 0.5, 1.0, 1.0, 1.0)] * 3 + [(*row, 1.0, 1.0)])
    line = cells(robustness.table({('wang2004', 0, False): rows})[-1])
    assert (line[3], line[4], line[-1]) == (share, alone, lost)


def test_it_chatters_where_reference_and_noise_explain_less_than_half(robustness):
    calm = np.array([(0.0, 0.0, 3.0, 0.0, 0.0)] * 4)
    rows = np.array([(0.0, 0.0, 300.0, 297.0, 0.0), (0.0, 0.0, 602.0, 297.0, 0.0),
                     (0.0, 0.0, 598.0, 297.0, 0.0), (0.0, 0.0, 300.0, 0.0, 1.0)])
    line = cells(robustness.table({('wang2004', 0, False): calm,
                                   ('robust_eso', 2, True): rows})[-1])
    assert line[-6:] == ['2', '100', '100', '25.00 %', '50.00 %', '0']


@pytest.mark.parametrize('b', [0.5, 1.0])
def test_the_noise_of_a_calm_loop_is_explained(robustness, b):
    flat = {**robustness.base_of('robust_eso', 20.0), 'plant.b': b}
    calm = robustness.measure({**flat, 'controller.law': 'wang2004'})
    for delay in (0, 1, 2):
        row = robustness.measure({**flat, **robustness.CONDITIONS[delay, True]})
        assert row[2] == pytest.approx(calm[2] + row[3], rel=0.2)
        assert row[4] == 0.0


def test_a_loop_beyond_its_limit_chatters_with_and_without_noise(robustness):
    """The guard is kept from acting: k* far above what any oscillation reaches."""
    flat = {**robustness.base_of('robust_eso', 20.0), 'plant.b': 1.5, 'controller.k_star': 400.0}
    calm = robustness.measure({**flat, 'controller.law': 'wang2004', 'controller.k_star': 2.5})
    for noise in (False, True):
        row = robustness.measure({**flat, **robustness.CONDITIONS[2, noise]})
        assert row[4] == 1.0
        assert row[2] > robustness.CHATTER * (calm[2] + row[3])


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


def test_a_state_file_of_another_version_is_refused_by_name(robustness, tmp_path):
    path = tmp_path / 'state.jsonl'
    path.write_text('[["robust", 0, false, 0], [[0.1, 0.2, 0.3]]]\n', encoding='utf-8')
    with pytest.raises(SystemExit, match='rows of 3 numbers') as caught:
        robustness.read(path)
    assert str(path) in str(caught.value)
    path.write_text('[["robust", 0, false, 0], [[0.1, 0.2, 0.3, 0.0, 0.0]]]\n', encoding='utf-8')
    assert robustness.read(path) == {('robust', 0, False, 0): [[0.1, 0.2, 0.3, 0.0, 0.0]]}

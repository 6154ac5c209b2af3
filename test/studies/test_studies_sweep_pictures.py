# SPDX-License-Identifier: Apache-2.0
"""Sweeps: their points, their file that survives being cut, their maps, their cluster."""


import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.errors import ConfigurationError
from dz_ros.studies.sweep_pictures import crossing, is_geometric, pictures, threshold

BASE = Configuration.from_flat({'loop.duration': 2.0, 'plant.substeps': 1,
                                'plant.noise': [0.0, 0.0]}).to_flat()


def rows_of_map():
    return [{'run': i, 'a': 10.0 ** a, 'b': float(b), 'error_max': 0.1 * (a + 1),
             'v_variation': 500.0 if a + b > 4 else 5.0, 'chatter_share': (a + b) / 4.5,
             'lost': int(a == 3), 'reason': ''}
            for i, (a, b) in enumerate((a, b) for a in range(4) for b in range(4))]


def test_maps_carry_both_boundaries():
    picture, = pictures(rows_of_map())
    assert picture.name == 'sweep_a_b'
    assert len(picture.png()) > 10000
    axes = picture.figure.axes[0]
    assert axes.get_xscale() == 'log'
    assert axes.get_yscale() == 'linear'
    assert len(axes.collections) == 3       # the map, the predicted and the measured boundary
    assert threshold(rows_of_map()) == 20.0


def test_scattered_runs_are_drawn_too():
    generator = np.random.default_rng(1)
    rows = [{**row, 'a': float(generator.random()), 'b': float(generator.random())}
            for row in rows_of_map()]
    assert pictures(rows)[0].png()


def test_one_key_gives_curves_with_the_boundary():
    rows = [{k: v for k, v in row.items() if k != 'b'} for row in rows_of_map() if row['b'] == 2.0]
    picture, = pictures(rows)
    assert picture.name == 'sweep_a'
    assert any(line.get_gid() == 'predicted' for line in picture.figure.axes[1].lines)


def test_pictures_refuse_what_was_not_swept():
    with pytest.raises(ConfigurationError, match='choose of a, b'):
        pictures(rows_of_map(), 'c')
    with pytest.raises(ConfigurationError, match='no runs'):
        pictures([])
    with pytest.raises(ConfigurationError, match='names as values'):
        pictures([{**row, 'b': 'pd'} for row in rows_of_map()])


def test_crossings_and_spacings():
    assert crossing(np.array([2.0, 1.0]), np.array([0.0, 4.0]), 1.0) == 1.75
    assert crossing(np.array([1.0, 2.0]), np.array([3.0, 4.0]), 1.0) is None
    assert is_geometric(np.geomspace(1, 9, 5))
    assert not is_geometric(np.linspace(1, 9, 5))

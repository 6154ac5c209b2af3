# SPDX-License-Identifier: Apache-2.0
"""The compiled loop gives the bits of the plain one, for every law, plant and trajectory."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.laws import LAWS
from dz_ros.core.loop import compiled as module
from dz_ros.core.loop.compiled import simulate_fast, simulate_quick
from dz_ros.core.loop.offline import simulate
from dz_ros.core.plants import PLANTS
from dz_ros.core.plants.wang2004 import Wang2004
from dz_ros.core.trajectories import TRAJECTORIES
from dz_ros.errors import ConfigurationError, MissingDependencyError

WAYPOINTS = {'trajectory.kind': 'waypoints', 'trajectory.times': [0.0, 1.0, 2.0],
             'trajectory.positions': [0.0, 1.0, 0.5]}
MOTIONS = [{'trajectory.kind': name} for name in TRAJECTORIES.builtin if name != 'waypoints']
"""Compiling takes a second: the laws have one of these each, in turn."""
LAWS_AND_MOTIONS = [{'controller.law': law, **motion} for law, motion in zip(
    LAWS.builtin, itertools.cycle([*MOTIONS, WAYPOINTS]), strict=False)]
assert len(LAWS_AND_MOTIONS) > len(MOTIONS)     # every motion has had its turn
CASES = [{'plant.disturbance_pulse': [0.3, 20.0, 0.05]},
         {'loop.delay': 2, 'plant.noise': [0.001, 0.01], 'plant.command_limit': 8.0,
          'plant.dead_zone.b_r_drift': [0.2, 0.9]},
         *({'plant.model': name} for name in PLANTS.builtin), *LAWS_AND_MOTIONS]


@pytest.mark.parametrize('overrides', [*CASES[:2], *(
    pytest.param(case, marks=pytest.mark.slow) for case in CASES[2:])],
    ids=lambda case: ' '.join(map(str, case.values())))
def test_compiled_equals_plain_bit_for_bit_and_counts_no_references(overrides, monkeypatch):
    pytest.importorskip('numba', reason='numba is not installed: nothing is compiled')
    try:
        configuration = Configuration.from_flat({'loop.duration': 1.0, **overrides})
    except ConfigurationError as error:
        pytest.skip(f'not a combination of defaults: {error}')
    counted = []
    plain = module.compiled

    def watched(function, allocates=False, inner=False):
        if allocates:
            counted.append(function)
        return plain(function, allocates, inner)

    monkeypatch.setattr(module, 'compiled', watched)
    slow, fast = simulate(configuration), simulate_fast(configuration)
    for name in ('t', 'x', 'x_measured', 'x_d', 'v', 'v_applied', 'truth', 'terms'):
        assert np.array_equal(getattr(slow, name), getattr(fast, name), equal_nan=True), name
    assert not counted


class Allocating(Wang2004):
    """The paper's plant, written wastefully."""

    @staticmethod
    def regressors(x, p, y):
        found = [x[0]]
        found.append(math.sin(found[0]))
        y[0] = -math.tanh(0.5 * found[0])
        y[1] = (found[0] * found[0] + 2.0 * found[0]) * found[1]


@pytest.mark.slow
def test_a_plant_that_allocates_is_compiled_all_the_same():
    pytest.importorskip('numba', reason='numba is not installed: nothing is compiled')
    paper = Configuration.from_flat({'loop.duration': 1.0})
    wasteful = dataclasses.replace(paper, plant=Allocating(paper.plant.parameters))
    for _ in range(2):      # the second run uses what the first one compiled
        assert np.array_equal(simulate_fast(wasteful).x, simulate(paper).x)


class Refused(Wang2004):
    """The paper's plant, in Python that numba cannot compile."""

    @staticmethod
    def regressors(x, p, y):
        y[0] = -math.tanh(0.5 * math.fsum((x[0],)))
        y[1] = (x[0] * x[0] + 2.0 * x[0]) * math.sin(x[0])


@pytest.mark.slow
def test_a_plant_that_numba_refuses_is_simulated_in_plain_python(monkeypatch):
    errors = pytest.importorskip('numba.core.errors', reason='numba is not installed')
    paper = Configuration.from_flat({'loop.duration': 1.0})
    refused = dataclasses.replace(paper, plant=Refused(paper.plant.parameters))
    with pytest.raises(errors.NumbaError):
        simulate_fast(refused)
    assert np.array_equal(simulate_quick(refused).x, simulate(paper).x)
    monkeypatch.setattr(module, 'simulate_fast', lambda _: pytest.fail('refused a second time'))
    assert np.array_equal(simulate_quick(refused).x, simulate(paper).x)


def test_without_numba_the_plain_loop_answers(monkeypatch):
    monkeypatch.setattr(module, 'available', lambda: False)
    configuration = Configuration.from_flat({'loop.duration': 0.1})
    assert np.array_equal(simulate_fast(configuration).v, simulate(configuration).v)
    with pytest.raises(MissingDependencyError, match=r'dz_ros\[numba\]'):
        module.compiled(lambda x: x)

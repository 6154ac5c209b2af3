# SPDX-License-Identifier: Apache-2.0
"""Why benchmarks/coupled.py sets `controller.override_checks`, as docs/axes.md states it."""

import importlib
from pathlib import Path

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import ERROR, INFO
from dz_ros.core.design.rules import check
from dz_ros.files.configurations import load_configuration

KEY = 'controller.override_checks'


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    return importlib.import_module('benchmarks.coupled')


@pytest.fixture(scope='module')
def arm():
    return load_configuration('two_link_arm', ['loop.duration=1.0'])


def row(arm, changes, **more):
    """Return the machine that the benchmark makes of one of its rows, with a sample of delay."""
    kept = {key: value for key, value in arm.to_flat().items()
            if '.controller.' not in f'.{key}'}
    return Configuration.from_flat({**kept, **changes, 'loop.delay': 1, **more})


def found(machine):
    """Return axis → rule and level of what the design rules find."""
    return {name: {(item.rule, item.level) for item in check(c, complaints=True)
                   if item.level != INFO} for name, c in machine.axes}


@pytest.mark.parametrize('share', [1.0, 0.6])
def test_rules_judge_the_shoulder_by_bounds_that_are_not_stated(bench, arm, share):
    changes = bench.independent(arm, share, False)
    machine = row(arm, changes)
    assert machine.axis('shoulder').plant.b == pytest.approx(0.30, abs=0.005)
    assert {c.controller_settings.b_bounds for c in machine.each} == {(1.0, 1.0)}
    assert all(c.controller_settings.override_checks for c in machine.each)
    assert ('chatter', ERROR) in found(machine)['shoulder']
    assert not any(level == ERROR for _, level in found(machine)['elbow'])
    stated = {f'axes.{name}.controller.b_bounds': [0.75 * c.plant.b, 1.25 * c.plant.b]
              for name, c in arm.axes}
    for left in found(row(arm, changes, **stated)).values():
        assert not any(rule == 'chatter' or level == ERROR for rule, level in left)


def test_offline_the_figures_are_the_same_without_the_key(bench, arm):
    changes = bench.independent(arm, 1.0, False)
    machine = row(arm, changes)
    assert bench.measure(row(arm, changes, **{KEY: False})) == bench.measure(machine)

# SPDX-License-Identifier: Apache-2.0
"""Friction that sticks is named where ramps show it, and not elsewhere."""

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.hosted import HostedDriver
from dz_ros.identification.estimation.pipeline import identify
from dz_ros.identification.estimation.static_friction import excess, static_friction_note
from dz_ros.identification.experiment.moves import Experiment
from dz_ros.identification.experiment.plan import Limits, Plan
from dz_ros.identification.experiment.session import run_session


def identified(**changes):
    """Return configuration, what was identified, and where motion began."""
    c = Configuration.from_flat({
        'plant.model': 'servo', 'plant.x0': [0.0, 0.0], 'loop.timing': 'lockstep',
        'plant.noise': [1e-4, 1e-3], **changes})
    experiment = Experiment(Limits(1.5, 1.0, 4.0), Plan(repeats=4), c.plant.order, c.loop.period,
                            c.safety.safe_command)
    samples = run_session(c, experiment, lambda seq: seq, lambda: '', HostedDriver(c))
    return c, identify(samples, c, experiment.moving), [v for _, v in experiment.breakaway]


@pytest.mark.parametrize('changes', [{}, {'plant.dead_zone.b_r': 0.0, 'plant.dead_zone.b_l': 0.0},
                                     {'plant.static_friction': 1.0}])
def test_is_silent_where_nothing_sticks_more_than_it_slides(changes):
    c, found, begun = identified(**changes)
    assert static_friction_note(found, begun, c) == ''


@pytest.mark.parametrize('level', [1.5, 2.0])
def test_names_static_friction(level):
    c, found, begun = identified(**{'plant.static_friction': level})
    assert 'sticks' in static_friction_note(found, begun, c)
    right, left = excess(found, begun, c)
    for ratio, edge in ((right, 0.5), (left, 0.6)):     # a ramp goes on until motion shows
        assert (edge + level) / (edge + 1.0) <= ratio < (edge + level) / (edge + 1.0) + 0.3


def test_reports_nothing_of_a_plant_without_friction_or_a_side_without_ramps():
    c, found, begun = identified()
    assert excess(found, [v for v in begun if v > 0.0], c) is None
    assert excess(found, begun, Configuration.from_flat({})) is None

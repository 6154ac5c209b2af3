# SPDX-License-Identifier: Apache-2.0
"""A table of manoeuvres: which loop follows which motion how well, without chatter."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.linear_loop import largest_beta
from dz_ros.core.loop.offline import simulate
from dz_ros.core.plants import PLANTS
from dz_ros.core.plants.coupled import CoupledPlant
from dz_ros.core.tracking import guaranteed_bounds
from dz_ros.core.trajectories import TRAJECTORIES

CONFIG = Path(__file__).parents[2] / 'config'
# Configuration file: largest error in the last 10 s, largest total variation of v per second.
FILES = {
    'wang2004': (0.0087, 6.0),
    'zhang_feng1997': (0.0072, 7.5),
    'step': (0.0072, 1.2),
    'robust_eso': (0.00035, 5.5),
    'robust_eso_quiet': (0.0008, 5.5),
    'first_order': (0.0047, 15.0),
    'servo': (0.00034, 7.5),
    'axis': (2.4e-5, 3.1),
    'pendulum': (0.00042, 0.7),
    'valve_actuator': (0.00012, 3.6),
    'thruster': (0.0005, 100.0),
}
# Configuration file, motion instead of its own, largest error once the motion is caught.
MOTIONS = [
    ('wang2004', {'kind': 'chirp', 'amplitude': 2.0}, 0.009),
    ('wang2004', {'kind': 'multisine'}, 0.01),
    ('wang2004', {'kind': 'constant', 'value': 1.0}, 0.009),
    ('wang2004', {'kind': 'waypoints', 'times': [2.0, 5.0, 9.0, 14.0],
                  'positions': [0.0, 2.0, -2.0, 0.5]}, 0.009),
    ('zhang_feng1997', {'kind': 'reference_model', 'goal': 2.0}, 0.009),
    ('zhang_feng1997', {'kind': 'point_to_point', 'goal': -2.0, 'repeat': True}, 0.009),
    ('first_order', {'kind': 'reference_model', 'goal': 0.5}, 0.006),
    ('first_order', {'kind': 'chirp', 'amplitude': 0.3, 'end_frequency': 1.0}, 0.006),
    ('servo', {'kind': 'chirp', 'amplitude': 0.5}, 0.001),
    ('servo', {'kind': 'waypoints', 'times': [1.0, 3.0, 6.0], 'positions': [0.0, 1.0, -0.5]},
     0.001),
    ('pendulum', {'kind': 'constant', 'value': 0.0}, 0.0006),
    ('pendulum', {'kind': 'multisine', 'amplitudes': [0.3, 0.2]}, 0.0007),
    ('valve_actuator', {'kind': 'point_to_point', 'goal': 0.1, 'duration': 3.0, 'repeat': True},
     0.0003),
    ('valve_actuator', {'kind': 'sinusoid', 'amplitude': 0.08, 'frequency': 1.0}, 0.0003),
    ('valve_actuator', {'kind': 'reference_model', 'goal': 0.1, 'bandwidth': 3.0}, 0.0003),
]


def read(name):
    """Return a configuration file as dotted keys."""
    tree = yaml.safe_load((CONFIG / f'{name}.yaml').read_text(encoding='utf-8'))

    def flat(branch, prefix):
        for key, value in branch.items():
            if isinstance(value, dict):
                yield from flat(value, f'{prefix}{key}.')
            else:
                yield f'{prefix}{key}', value

    return dict(flat(tree['/**']['ros__parameters'], ''))


def follow(flat, **keys):
    """Return configuration, |x̃|, |s| and total variation of v per second, of the last 10 s."""
    c = Configuration.from_flat({**flat, **keys})
    found = simulate(c)
    late = found.t >= found.t[-1] - 10.0
    return (c, np.abs(found.x[late, 0] - found.x_d[late, 0]), np.abs(found.column('s')[late]),
            np.abs(np.diff(found.v[late])).sum() / 10.0)


def share_of_the_limit(c):
    """Return the largest β the bounds allow, over that where a loop a sample late chatters."""
    beta = c.controller_settings.b_bounds[1] * c.controller_settings.m_bounds[1]
    return beta / largest_beta(c.law.layer_model(), c.loop.period, 1)


@pytest.mark.parametrize('delay', [0, 1])
@pytest.mark.parametrize('name', FILES)
def test_configuration_files_track_and_do_not_chatter(name, delay):
    allowed, variation = FILES[name]
    c, error, s, total = follow(read(name), **{'loop.delay': delay})
    assert error.max() <= allowed
    assert total <= variation
    assert s.max() <= c.law.design.epsilon
    assert error.max() <= guaranteed_bounds(c.law.gains.lambda_, c.law.design.epsilon,
                                            c.plant.order)[0]


@pytest.mark.parametrize('name', FILES)
def test_without_its_law_the_plant_does_not_track(name):
    """The table can fail: PD with the same gain is several times worse."""
    allowed, _ = FILES[name]
    _, error, _, _ = follow(read(name), **{'controller.law': 'pd'})
    assert error.max() > 2.0 * allowed


@pytest.mark.parametrize(('name', 'motion', 'allowed'), MOTIONS)
def test_other_motions(name, motion, allowed):
    flat = {key: value for key, value in read(name).items() if not key.startswith('trajectory.')}
    _, error, _, _ = follow(flat, **{f'trajectory.{key}': value for key, value in motion.items()},
                            **{'loop.duration': 20.0, 'loop.delay': 1})
    assert error.max() <= allowed


def test_every_plant_and_every_trajectory_is_in_the_table():
    # plants of several axes: test_core_coupled_eso.py
    assert {read(name)['plant.model'] for name in FILES} == {
        name for name, plant in PLANTS.builtin.items() if not issubclass(plant, CoupledPlant)}
    assert {motion['kind'] for _, motion, _ in MOTIONS} == set(TRAJECTORIES.builtin)


@pytest.mark.parametrize('name', FILES)
def test_files_are_what_ros_can_read(name):
    """rcl takes the type from the text: 2.0 is a float, 2 is not; it cannot read an empty list."""
    c = Configuration.from_flat(read(name))
    assert c.set_aside == ()
    flat = c.to_flat()
    for key, value in read(name).items():
        assert type(value) is type(flat[key]), key
        if isinstance(value, list):
            assert value, key
            assert {type(item) for item in value} == {type(flat[key][0])}, key


OFF = {'loop.axes', 'loop.schedule_values', 'loop.schedule_times', 'loop.schedule_topic',
       'plant.derivative_resolution', 'plant.backlash', 'plant.static_friction',
       'plant.stribeck_speed', 'plant.stick_time',
       'controller.error_band', 'controller.regressors_at',
       *(f'plant.dead_zone.{item}' for item in (
           'edge_slope', 'edge_span', 'schedule_points', 'm_r_table', 'm_l_table', 'b_r_table',
           'b_l_table'))}
"""What a loop may have besides, off by default."""


@pytest.mark.parametrize('name', FILES)
def test_files_list_every_value_that_matters(name):
    missing = set(Configuration.from_flat(read(name)).to_flat()) - set(read(name))
    optional = {'loop.peers', 'trajectory.file',
                *(key for key in Configuration.from_flat({}).to_flat()
                  if key.startswith(('safety.', 'driver.', 'process.'))),
                *(f'plant.dead_zone.{item}_drift' for item in ('m_r', 'm_l', 'b_r', 'b_l'))}
    assert missing <= optional | OFF
    if name == 'wang2004':
        assert missing <= {'loop.peers', 'safety.runaway_time', 'driver.command_resolution',
                           'driver.derivative_resolution'} | OFF


def test_the_paper_s_file_is_the_defaults():
    c = Configuration.from_flat({})
    flat = Configuration.from_flat(read('wang2004')).to_flat()
    made = {**c.to_flat(), 'plant.x0': list(c.x0), 'plant.noise': list(c.noise)}
    assert {**flat, 'controller.theta_0': [0.85]} == made


@pytest.mark.parametrize('name', FILES)
def test_gains_keep_the_rules_of_design(name):
    c = Configuration.from_flat(read(name))
    k = c.controller_settings
    rho = k.m_bounds[1] * max(k.b_r_bounds[1], -k.b_l_bounds[0])
    assert c.law.gains.k_star >= rho / k.m_bounds[0]
    # The paper's own gains use more of it.
    paper_s_gains = name in ('wang2004', 'zhang_feng1997', 'step')
    assert share_of_the_limit(c) <= (0.87 if paper_s_gains else 0.67)
    for bounds, value in ((k.b_r_bounds, c.dead_zone.b_r), (k.b_l_bounds, c.dead_zone.b_l),
                          (k.m_bounds, c.dead_zone.m_r), (k.b_bounds, c.plant.b)):
        assert bounds[0] <= value <= bounds[1]


@pytest.mark.parametrize('name', FILES)
def test_every_line_of_a_file_reports_unit_and_why(name):
    lines = (CONFIG / f'{name}.yaml').read_text(encoding='utf-8').splitlines()
    assert lines[0].startswith('# ')
    for number, line in enumerate(lines, 1):
        assert len(line) <= 99, number
        key, _, value = line.strip().partition(':')
        if value.strip()[:1] in tuple('0123456789-[') and not key.endswith('_drift'):
            assert '#' in line, f'line {number} has no comment'

# SPDX-License-Identifier: Apache-2.0
"""What-ifs of all axes of a machine together: unchanged bit for bit, changed as simulated."""

import numpy as np
import pytest

from dz_ros.cli.offline import simulate_machine
from dz_ros.core.dataset import from_runs
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration
from dz_ros.recording.save import state_configuration
from dz_ros.replay.whatif import answer_axes, couples_axes, of_axis, plan, plan_axes
from dz_ros.runs.axes import axis_run

NOISY = ('loop.duration=0.5', 'plant.noise=[0.0001, 0.001]', 'loop.seed=5')
MACHINES = {'coupled law': ('two_link_arm', ()),
            'law for each': ('two_link_arm', ('controller.law=pd',)),
            'late': ('two_link_arm', ('loop.delay=1', 'plant.command_limit=60.0')),
            'pushed': ('rov_planar', ('axes.sway.plant.disturbance_pulse=[0.1, 2.0, 0.1]',)),
            'independent': ('six_axes', ())}


def made(name, more=()):
    """Return a configuration and its run offline."""
    c = load_configuration(name, [*NOISY, *more])
    return c, from_runs(simulate_axes(c), c)


def ask(run, overrides, **settings):
    planned = plan_axes(run, overrides, **settings)
    return planned, answer_axes(planned, simulate_machine(planned.configuration,
                                                          planned.memories), 'a', 0)


def same(one, other):
    assert set(one.channels) == set(other.channels)
    return all(one.channels[name].axes == other.channels[name].axes and np.array_equal(
        one.channels[name].values, other.channels[name].values, equal_nan=True)
        for name in one.channels)


@pytest.mark.parametrize('name', MACHINES)
def test_nothing_changed_gives_all_axes_bit_for_bit(name):
    _, run = made(*MACHINES[name])
    planned, answered = ask(run, {})
    assert same(run, answered)
    assert answered.configuration == run.configuration
    assert answered.info['what_if_of'] == 'a'
    assert planned.notes == ()
    assert couples_axes(run, {}) == (name != 'independent')


@pytest.mark.parametrize('overrides', [
    {'axes.yaw.controller.lambda': 3.0}, {'controller.lambda': 3.0},
    {'controller.lambda': 3.0, 'axes.sway.controller.lambda': 4.0}, {'loop.delay': 1},
    {'loop.seed': 6}, {'loop.duration': 0.3}, {'axes.surge.plant.x0': [0.2, 0.0]},
    {'axes.yaw.plant.dead_zone.b_r': 0.1}, {'controller.law': 'pd'}, {'plant.mass': 20.0}])
def test_what_changes_is_what_was_asked_of_all_axes_together(overrides):
    c, run = made('rov_planar')
    changed = c.replace(**overrides)
    _, answered = ask(run, overrides)
    expected = from_runs(simulate_axes(changed), changed)
    assert same(expected, answered)
    assert answered.configuration == expected.configuration
    assert not same(run, answered)


def test_a_law_of_all_axes_takes_the_place_of_one_for_each():
    wanted, expected = made('two_link_arm')
    _, run = made('two_link_arm', ['controller.law=pd'])
    own = {key: value for key, value in wanted.to_flat('controller').items()
           if key != 'controller.axis'}
    planned, answered = ask(run, own)
    assert [item.law.gains.axis for item in planned.configuration.each] == [0, 1]
    assert same(expected, answered)


def test_a_change_of_one_axis_moves_the_others_that_the_plant_couples_to_it():
    c, run = made('rov_planar')
    keys = of_axis({'controller.lambda': 3.0, 'loop.delay': 0}, 'yaw')
    assert keys == {'axes.yaw.controller.lambda': 3.0, 'loop.delay': 0}
    planned, answered = ask(run, keys)
    for axis in ('surge', 'sway'):
        assert planned.configuration.axis(axis).to_flat() == c.axis(axis).to_flat()
        one, other = (axis_run(item, axis).channels['state']['x0'] for item in (run, answered))
        assert not np.array_equal(one, other)


def test_each_law_begins_with_its_part_of_the_memory_that_was_stated():
    c, run = made('two_link_arm')
    size = len(c.law.initial_memory())
    assert size
    memory = [1e-3 * place for place in range(2 * size)]
    planned, answered = ask(state_configuration(run, memory), {})
    assert planned.memories == (tuple(memory[:size]), tuple(memory[size:]))
    assert not same(run, answered)
    stated = [number for item in c.each for number in item.law.initial_memory()]
    assert same(run, ask(state_configuration(run, stated), {})[1])


def test_what_ran_may_be_given_by_axis():
    c, run = made('two_link_arm')
    given = {name: c.axis(name).replace(**{'controller.lambda': 4.0}).to_flat()
             for name in c.axis_names}
    planned, _ = ask(run, {'loop.duration': 0.1}, given=given)
    assert {item.to_flat()['controller.lambda'] for item in planned.configuration.each} == {4.0}


def test_what_is_so_of_one_axis_names_it():
    _, run = made('six_axes')
    own = plan_axes(run, {'axes.yaw.plant.voltage': 3.0, 'axes.roll.plant.voltage': 3.0}).notes
    assert [text.partition(' is set aside')[0] for text in own] == [
        'axes roll, yaw: plant.voltage']
    _, run = made('two_link_arm')
    every = plan_axes(run, {'plant.voltage': 3.0}).notes
    assert [text.partition(' is set aside')[0] for text in every] == ['plant.voltage']


@pytest.mark.parametrize(('overrides', 'key'), [
    ({'loop.axes': ['a', 'b']}, 'loop.axes'), ({'axes.wrist.controller.lambda': 2.0}, 'wrist'),
    ({'axes.elbow.loop.delay': 1}, 'loop.delay is one for all axes'),
    ({'axes.elbow.controller.lamda': 1.0}, 'axis elbow: controller.lamda'),
    ({'axes.elbow.plant.substeps': 9}, 'axes.elbow.plant.substeps')])
def test_what_does_not_go_with_the_axes_is_named(overrides, key):
    _, run = made('two_link_arm')
    with pytest.raises(ConfigurationError) as caught:
        plan_axes(run, overrides)
    assert key in str(caught.value)


def test_a_plan_of_one_axis_is_that_of_the_axis_alone():
    c, run = made('six_axes')
    planned = plan(axis_run(run, 'yaw'), {})
    assert planned.configuration.to_flat() == c.axis('yaw').to_flat()

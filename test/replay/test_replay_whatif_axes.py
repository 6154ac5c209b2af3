# SPDX-License-Identifier: Apache-2.0
"""What-ifs of all axes of a machine together: unchanged bit for bit, changed as simulated."""

from dataclasses import replace
import json

import numpy as np
import pytest

from dz_ros.cli.offline import simulate_machine
from dz_ros.core import schema
from dz_ros.core.axes_keys import parts, section_of
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run, from_runs, RunData
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.loop.offline import simulate
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration
from dz_ros.recording.save import state_configuration
from dz_ros.replay.whatif import answer_axes, of_axis, plan_axes, plan_axis, ZONE
from dz_ros.runs.axes import axis_run

NOISY = ('loop.duration=0.5', 'plant.noise=[0.0001, 0.001]', 'loop.seed=5')
MACHINES = {'coupled law': ('two_link_arm', ()),
            'law for each': ('two_link_arm', ('controller.law=pd',)),
            'late': ('two_link_arm', ('loop.delay=1', 'plant.command_limit=60.0')),
            'pushed': ('rov_planar', ('axes.sway.plant.disturbance_pulse=[0.1, 2.0, 0.1]',)),
            'independent': ('six_axes', ())}
TWO = {'loop.axes': ['surge', 'yaw'], 'loop.duration': 0.5, 'loop.seed': 5,
       'plant.noise': [1e-4, 1e-3], 'axes.yaw.controller.lambda': 2.0,
       'axes.yaw.trajectory.amplitude': 0.5, 'axes.yaw.plant.x0': [0.1, 0.0]}
"""Two axes that nothing couples."""
TOGETHER = {'controller.law': 'coupled_eso', 'controller.inertia': [1.0, 0.1, 0.1, 1.0],
            'controller.lambda': 1.0}
"""What couples them by their law."""


def made(name, more=()):
    """Return a configuration and its run offline."""
    c = load_configuration(name, [*NOISY, *more])
    return c, from_runs(simulate_axes(c), c)


def ask(run, overrides, **settings):
    planned = plan_axes(run, overrides, **settings)
    return planned, answer_axes(planned, simulate_machine(planned.configuration,
                                                          planned.memories), 'a', 0)


def two(**changes):
    """Return a configuration of two independent axes, and its run offline."""
    c = Configuration.from_flat({**TWO, **changes})
    return c, from_runs(simulate_axes(c), c)


def real(c, run, begin=0):
    """Return what a run leaves of a plant that is not simulated, from a sample on."""
    channels = {}
    for topic, channel in run.channels.items():
        values = channel.values[begin:].copy()
        if topic == 'state':
            width = len(channel.labels)
            values[:, channel.labels.index('round_trip')::width] = 1e-3
        channels[topic] = replace(channel, values=values, log_time=channel.log_time[begin:],
                                  publish_time=channel.publish_time[begin:])
    del channels['truth']
    memory = [number for item in c.each for number in item.law.initial_memory()]
    stated = [(1, '/a_node', json.dumps({
        'node': '/a_node', 'event': 'configuration', 'version': '0.1.0', 'owns': [section],
        'configuration': c.to_flat(), **own})) for section, own in (
            ('controller', {} if begin else {'seq': 0, 'memory': memory}), ('trajectory', {}))]
    flat = {key: value for key, value in c.to_flat().items() if section_of(key) != 'plant'}
    return RunData(channels, flat, {'mode': 'realtime'}, tuple(stated))


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
    for axis in run.axes:
        assert plan_axis(run, axis, {}).coupled == (name != 'independent')


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
    planned = plan_axis(run, 'yaw', {})
    assert planned.configuration.to_flat() == c.axis('yaw').to_flat()


@pytest.mark.parametrize('overrides', [
    {'loop.seed': 6}, {'controller.lambda': 3.0}, {'loop.seed': 2 ** 63 - 1, 'loop.delay': 1},
    {'axes.yaw.controller.lambda': 3.0}])
def test_one_axis_alone_is_what_it_is_among_all_noise_included(overrides):
    _, run = two()
    planned = plan_axis(run, 'yaw', overrides)
    assert not planned.coupled
    alone = from_run(simulate(planned.configuration, memory=planned.memory))
    _, answered = ask(run, of_axis(overrides, 'yaw'))
    among = axis_run(answered, 'yaw')
    assert same(alone, among)
    assert among.configuration == alone.configuration
    assert not same(alone, axis_run(run, 'yaw'))


def test_a_change_of_another_axis_is_refused_and_one_of_its_own_taken():
    assert of_axis({'axes.yaw.controller.lambda': 3.0, 'controller.lambda': 2.0,
                    'controller.k_d': 4.0, 'loop.seed': 1}, 'yaw') == {
        'axes.yaw.controller.lambda': 3.0, 'axes.yaw.controller.k_d': 4.0, 'loop.seed': 1}
    for name, run in (('surge', two()[1]), ('sway', made('rov_planar')[1])):
        with pytest.raises(ConfigurationError, match=rf'^axes\.{name}\.controller\.lambda = 3\.0: '
                           'is of another axis than yaw'):
            plan_axis(run, 'yaw', {f'axes.{name}.controller.lambda': 3.0})
    with pytest.raises(ConfigurationError, match='did you mean yaw'):
        of_axis({'axes.jaw.controller.lambda': 3.0}, 'yaw')


@pytest.mark.parametrize(('overrides', 'allowed'), [
    (TOGETHER, 'must be the law of all'),
    ({'plant.model': 'two_link_arm'}, 'must be the same for all axes')])
def test_an_axis_that_the_change_couples_is_not_simulated_alone(overrides, allowed):
    _, run = two()
    assert plan_axis(run, 'yaw', overrides).coupled
    key, value = next(iter(overrides.items()))
    with pytest.raises(ConfigurationError, match=rf'axes\.yaw\.{key} = .{value}.: .*{allowed}'):
        plan_axes(run, of_axis(overrides, 'yaw'))
    planned, answered = ask(run, {**overrides, 'loop.duration': 0.1})
    assert all(item.coupled for item in planned.each.values())
    assert answered.axes == run.axes


def test_an_axis_that_the_change_frees_is_simulated_alone():
    _, run = two(**TOGETHER, **{'axes.yaw.controller.lambda': 1.0})
    assert plan_axis(run, 'yaw', {}).coupled
    assert not plan_axis(run, 'yaw', {'controller.law': 'pd'}).coupled


def test_a_real_time_run_of_a_coupled_plant_needs_its_parameters_not_its_place():
    c = load_configuration('rov_planar', ['loop.duration=0.5'])
    recorded = from_runs(simulate_axes(c), c)
    run = real(c, recorded)
    with pytest.raises(ConfigurationError, match=r'it lacks plant\.mass, ') as caught:
        plan_axes(run, {'controller.lambda': 3.0})
    assert 'plant.axis' not in str(caught.value)
    with pytest.raises(ConfigurationError, match='--fit = True: fits one axis that neither plant'):
        plan_axis(run, 'yaw', {}, fit=True)
    flat = c.to_flat('plant')
    names = [item.name for item in schema.fields(type(c.plant.parameters)) if item.name != 'axis']
    known = {key: flat[key] for key in (
        *(f'plant.{name}' for name in names), *(f'plant.dead_zone.{name}' for name in ZONE))}
    assert plan_axis(run, 'yaw', known).coupled
    planned, answered = ask(run, known)
    assert 'it starts from the first measured state' in planned.notes
    assert any('a command acted 1 ms after its state' in text for text in planned.notes)
    assert [item.plant.parameters.axis for item in planned.configuration.each] == [0, 1, 2]
    for topic in ('reference', 'command', 'terms'):
        assert np.array_equal(answered.channels[topic].values, recorded.channels[topic].values)
    _, other = ask(run, {**known, 'axes.yaw.controller.lambda': 3.0})
    assert not np.array_equal(axis_run(other, 'surge').channels['command'].values,
                              axis_run(answered, 'surge').channels['command'].values)


@pytest.mark.parametrize('moved', [(), ('yaw',), ('surge',), ('surge', 'yaw')])
def test_of_a_run_begun_late_each_axis_keeps_the_trajectory_that_it_was_given(moved):
    begin = 20
    c, recorded = two(**{'plant.noise': [0.0]})
    run = real(c, recorded, begin)
    given = {name: item.to_flat('plant') for name, item in c.axes}
    planned, answered = ask(run, {f'axes.{name}.trajectory.amplitude': 0.3 for name in moved},
                            given=given)
    for axis, item in planned.each.items():
        found = axis_run(answered, axis)
        wanted = item.configuration.to_flat('trajectory') if axis in moved else {}
        assert item.as_recorded == (axis not in moved)
        assert {key: value for key, value in found.configuration.items()
                if section_of(key) == 'trajectory'} == wanted
        assert not moved or axis not in moved or wanted['trajectory.amplitude'] == 0.3
        before, after = (data.channels['reference'].values[:, 2:]
                         for data in (axis_run(run, axis), found))
        assert np.array_equal(before, after) == (axis not in moved)
    assert len(answered.channels['state']) == len(recorded.channels['state']) - begin
    assert any(parts(key)[1].startswith('trajectory.') for key in answered.configuration) == bool(
        moved)
    again = plan_axes(answered, {})
    assert {axis for axis, item in again.each.items() if not item.as_recorded} == set(moved)

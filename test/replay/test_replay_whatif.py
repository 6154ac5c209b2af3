# SPDX-License-Identifier: Apache-2.0
"""What-ifs of runs whose answers are known."""

from dataclasses import replace
import json

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run, RunData
from dz_ros.core.loop.offline import simulate
from dz_ros.errors import ConfigurationError, RecordingError
from dz_ros.replay.audit.result import differ
from dz_ros.replay.recorded_trajectory import RecordedTrajectory
from dz_ros.replay.whatif import answer, base_configuration, is_simulated, plan

FLAT = {'loop.duration': 3.0, 'plant.noise': [1e-3], 'loop.seed': 5}


def event(owns, configuration, **details):
    return (1, '/a_node', json.dumps({
        'node': '/a_node', 'event': 'configuration', 'version': '0.1.0', 'owns': owns,
        'configuration': configuration.to_flat(), **details}))


@pytest.fixture(scope='module')
def configuration():
    return Configuration.from_flat(FLAT)


@pytest.fixture(scope='module')
def run(configuration):
    return from_run(simulate(configuration))


@pytest.fixture(scope='module')
def hardware(run, configuration):
    """The same log as a driver of a real plant would leave it: no truth, no plant section."""
    flat = {key: value for key, value in configuration.to_flat().items()
            if not key.startswith('plant.')}
    channels = {name: item for name, item in run.channels.items() if name != 'truth'}
    return RunData(channels, flat, {'mode': 'realtime'}, (
        event(['controller'], configuration, seq=0, memory=[0.85, 0.85, 0.85]),
        event(['trajectory'], configuration)))


def ask(run, overrides, **settings):
    planned = plan(run, overrides, **settings)
    return planned, answer(planned, simulate(planned.configuration, memory=planned.memory),
                           'a', 0)


def same(one, other):
    return all(not differ(one.channels[name].values, other.channels[name].values).any()
               for name in one.channels)


def test_nothing_changed_gives_the_run_bit_for_bit(run):
    planned, made = ask(run, {})
    assert same(run, made)
    assert made.info['what_if_of'] == 'a'
    assert planned.notes == ()


@pytest.mark.parametrize('overrides', [
    {'controller.gamma': 5.0}, {'controller.law': 'pd'}, {'loop.delay': 2},
    {'trajectory.kind': 'reference_model'}, {'plant.dead_zone.b_r': 0.0}, {'plant.x0': [0.0, 0.0]},
    {'controller.phi_0': 1.0}, {'loop.duration': 1.0}, {'loop.seed': 6}])
def test_what_changes_is_what_was_asked(run, configuration, overrides):
    _, made = ask(run, overrides)
    expected = from_run(simulate(configuration.replace(**overrides)))
    assert same(expected, made)
    assert made.configuration == expected.configuration


def test_a_run_cut_short_is_asked_for_its_own_length(run):
    channels = {name: replace(item, values=item.values[:101], log_time=item.log_time[:101],
                              publish_time=item.publish_time[:101])
                for name, item in run.channels.items()}
    cut = replace(run, channels=channels)
    _, made = ask(cut, {})
    assert same(cut, made)


def test_the_law_begins_with_the_memory_the_controller_stated(run, configuration):
    memory = (1.0, 0.9, 1.1)
    stated = replace(run, events=(event(['controller'], configuration, seq=0,
                                        memory=list(memory)),))
    assert plan(stated, {'controller.gamma': 1.0}).memory == memory
    assert plan(stated, {'controller.phi_0': 1.0}).memory is None
    assert plan(stated, {'controller.law': 'pd'}).memory is None
    expected = from_run(simulate(configuration, memory=memory))
    assert same(expected, ask(stated, {})[1])


def test_the_first_statement_counts_and_later_changes_are_noted(run, configuration):
    changed = configuration.replace(**{'controller.gamma': 2.0})
    stated = replace(run, configuration=changed.to_flat(), events=(
        event(['controller'], configuration, seq=0), event(['controller'], changed, seq=40)))
    assert base_configuration(stated)['controller.gamma'] == 0.5
    assert 'gain changes of the recorded run are not repeated: seq 40' in plan(stated, {}).notes[0]


def test_transport_is_noted(run):
    state = run.channels['state']
    values = state.values.copy()
    values[1:, state.labels.index('round_trip')] = 6e-4
    planned = plan(replace(run, channels={**run.channels, 'state': replace(state, values=values)}),
                   {})
    assert '0.6 ms after its state' in planned.notes[0]


def test_real_hardware_needs_a_model_and_reports_what_it_lacks(hardware):
    assert not is_simulated(hardware)
    with pytest.raises(ConfigurationError) as error:
        plan(hardware, {'controller.gamma': 1.0, 'plant.a1': 1.0})
    text = str(error.value)
    assert 'a model of the plant is needed' in text
    for key in ('plant.a2', 'plant.b', 'plant.dead_zone.b_r', 'plant.dead_zone.m_l'):
        assert key in text
    assert 'plant.a1,' not in text
    with pytest.raises(ConfigurationError, match=r'choose one by --set plant\.model'):
        plan(replace(hardware, events=()), {'controller.gamma': 1.0})


def test_real_hardware_with_its_parameters_given(hardware, run):
    given = {'plant.a1': 1.0, 'plant.a2': 1.0, 'plant.a3': 1.0, 'plant.b': 1.0,
             **{f'plant.dead_zone.{name}': value for name, value in (
                 ('m_r', 1.0), ('m_l', 1.0), ('b_r', 0.5), ('b_l', -0.6))}}
    planned, made = ask(hardware, given)
    first = run.channels['state'].values[0]
    assert planned.configuration.x0 == (first[2], first[3])
    assert 'it starts from the first measured state' in planned.notes
    assert planned.memory == (0.85, 0.85, 0.85)
    assert np.abs(made.channels['state']['x0'] - run.channels['state']['x0']).max() < 0.02


def test_real_hardware_fitted(hardware, run):
    planned, made = ask(hardware, {'controller.k_d': 12.0}, fit=True)
    assert planned.fit is not None
    for side in ('b·m_r', 'b·m_l'):
        assert planned.fit[side].value == pytest.approx(1.0, abs=0.05)
    flat = planned.configuration.to_flat()
    assert flat['plant.b'] == 1.0
    for side in ('m_r', 'm_l'):
        assert flat[f'plant.dead_zone.{side}'] == pytest.approx(
            planned.fit[f'b·{side}'].value / planned.fit.b, rel=1e-9)
    assert flat['plant.a2'] == pytest.approx(planned.fit['a2'].value, rel=1e-9)
    assert np.abs(made.channels['state']['x0'] - run.channels['state']['x0']).max() < 0.2


def test_a_reference_without_description_is_the_recorded_one(run, configuration):
    flat = {key: value for key, value in run.configuration.items()
            if not key.startswith('trajectory.')}
    planned, made = ask(replace(run, configuration=flat), {})
    assert planned.as_recorded
    assert same(run, made)
    assert not any(key.startswith('trajectory.') for key in made.configuration)
    own = replace(run, configuration=flat)
    assert not plan(own, {'trajectory.kind': 'constant'}).as_recorded


def test_recorded_reference_between_its_samples(run, configuration):
    trajectory = RecordedTrajectory.of(run, configuration, 0.0)
    for t in (0.0, 1.0, 1.0012, 2.9999):
        expected = configuration.trajectory(t)
        assert trajectory(t)[:2] == pytest.approx(expected[:2], abs=1e-5)
        assert trajectory(t)[2] == pytest.approx(expected[2], abs=0.0025 * 2.5)


@pytest.mark.parametrize(('change', 'error'), [
    ({'channels': {}}, 'no states'), ({'configuration': {}}, 'does not state which law')])
def test_logs_that_cannot_be_asked(run, change, error):
    with pytest.raises(RecordingError, match=error):
        plan(replace(run, **change), {'loop.delay': 1})


def test_unknown_key(run):
    with pytest.raises(ConfigurationError, match=r'controller\.gama'):
        plan(run, {'controller.gama': 1.0})


def with_plant_events(run, *configurations):
    return replace(run, events=tuple(event(['loop', 'plant'], item, seq=100 * number)
                                     for number, item in enumerate(configurations)))


def test_a_pulse_given_while_the_loop_ran_is_part_of_the_run(configuration):
    disturbed = configuration.replace(**{'plant.disturbance_pulse': [1.5, 20.0, 0.05]})
    recorded = with_plant_events(from_run(simulate(disturbed)), configuration, disturbed)
    planned, made = ask(recorded, {})
    assert planned.configuration.plant_settings.disturbance_pulse == (1.5, 20.0, 0.05)
    assert same(recorded, made)
    assert not any('pulse' in note for note in planned.notes)


def test_what_of_the_plant_s_changes_is_not_repeated_is_reported(run, configuration):
    first = configuration.replace(**{'plant.disturbance_pulse': [1.0, 20.0, 0.05]})
    second = first.replace(**{'plant.disturbance_pulse': [2.0, -5.0, 0.05],
                              'plant.dead_zone.b_r': 0.3})
    planned, _ = ask(with_plant_events(run, configuration, first, second), {})
    assert planned.configuration.plant_settings.disturbance_pulse[1] == 0.0
    notes = ' '.join(planned.notes)
    assert 'plant in the recorded run are not repeated: plant.dead_zone.b_r' in notes
    assert 'of 2 pulses' in notes

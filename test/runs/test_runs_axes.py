# SPDX-License-Identifier: Apache-2.0
"""A run of several axes, recorded and read: each of its axes is a run of this axis alone."""

from __future__ import annotations

from dataclasses import replace
import json

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run, from_runs, RunData
from dz_ros.core.events import ConfigurationEvent, ModeEvent
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.errors import RecordingError
from dz_ros.recording.reader import read_run, run_info
from dz_ros.recording.save import save_run, state_configuration
from dz_ros.report.view import View
from dz_ros.runs.axes import (
    axis_flat,
    axis_name,
    axis_run,
    axis_text,
    choose_axis,
    each_axis,
    named_axis,
    same_axes,
)
from dz_ros.runs.history import RunHistory
from dz_ros.runs.setting import Setting

FLAT = {'loop.axes': ['surge', 'yaw'], 'loop.duration': 0.5, 'loop.seed': 3,
        'plant.noise': [0.001, 0.01], 'axes.yaw.controller.lambda': 2.0,
        'axes.yaw.plant.dead_zone.b_r': 0.3}


@pytest.fixture(scope='module')
def machine():
    return Configuration.from_flat(FLAT)


@pytest.fixture(scope='module')
def runs(machine):
    return simulate_axes(machine)


@pytest.fixture(scope='module')
def read(machine, runs, tmp_path_factory):
    path = tmp_path_factory.mktemp('axes') / 'run'
    memory = [number for item in machine.each for number in item.law.initial_memory()]
    save_run(state_configuration(from_runs(runs, machine, 10**9), memory), path)
    return read_run(path), run_info(path)


def test_a_recording_keeps_every_bit_of_every_axis(machine, runs, read):
    data, info = read
    assert data.axes == ('surge', 'yaw')
    assert set(info.axes) == {f'/{name}' for name in data.channels}
    assert all(topic.missing == 0 for topic in info.topics.values())
    for name, run in each_axis(data).items():
        alone = from_run(runs[name], 10**9)
        assert run.axes == ()
        for topic, channel in alone.channels.items():
            found = run.channels[topic]
            assert found.labels == channel.labels
            assert found.values.tobytes() == channel.values.tobytes()
            assert (found.log_time == channel.log_time).all()
        assert run.configuration == machine.axis(name).to_flat()
        assert run.info['axis'] == name


def test_an_axis_is_looked_at_as_any_run(machine, runs, read):
    for name, run in each_axis(read[0]).items():
        found = View.of(run)
        alone = View.of(from_run(runs[name], 10**9))
        assert found.metrics == alone.metrics
        assert Setting.of(run).flat == machine.axis(name).to_flat()
        assert found.setting.true_signals == alone.setting.true_signals


def test_what_is_of_one_axis_refuses_several(read):
    for look in (View.of, lambda run: choose_axis(run, None)):
        with pytest.raises(RecordingError, match='has axes surge, yaw; choose one with --axis'):
            look(read[0])
    with pytest.raises(RecordingError, match='no axis jaw: it has surge, yaw; did you mean yaw'):
        axis_run(read[0], 'jaw')
    with pytest.raises(RecordingError, match='of one axis, without a name'):
        axis_run(RunData({}), 'yaw')
    one = RunData({}, {'loop.axes': ['yaw']})       # its messages do not name the axis
    assert axis_run(one, 'yaw') is one


@pytest.mark.parametrize('axes', [5, True, 'yaw', 'y', {'yaw': 1}, [5], [['yaw']], ['yaw', 'yaw'],
                                  [None], ['a\nb'], None, []])
def test_a_recording_that_states_no_axes_rightly_has_none_by_name(axes):
    run = RunData({}, {'loop.axes': axes})
    assert axis_name(run) == ''
    for name in ('yaw', 'y', 'a\nb', ''):
        with pytest.raises(RecordingError, match='of one axis, without a name'):
            axis_run(run, name)
    assert axis_flat(run.configuration, 'yaw')['loop.axes'] == (
        [] if isinstance(axes, list) and 'yaw' in axes else axes)


def test_one_axis_that_ran_alone_has_a_name_in_its_description(machine, runs, read):
    alone = named_axis(from_run(runs['yaw']), 'yaw')
    assert axis_name(alone) == 'yaw'
    assert axis_run(alone, 'yaw') is alone
    assert list(each_axis(alone)) == ['']
    assert axis_name(read[0]) == axis_name(from_run(runs['yaw'])) == ''
    assert axis_name(axis_run(read[0], 'yaw')) == 'yaw'
    assert axis_name(RunData({}, {}, {'axis': 'a\nb'})) == ''
    with pytest.raises(RecordingError, match=r'no axis surge: it is of axis yaw alone$'):
        axis_run(alone, 'surge')
    for pair, text in (((alone, read[0]), 'a has axis yaw alone, b has axes surge, yaw'),
                       ((read[0], alone), 'a has axes surge, yaw, b has axis yaw alone')):
        with pytest.raises(RecordingError, match=f'{text}; choose it with --axis yaw$'):
            same_axes(dict(zip('ab', pair, strict=True)))
    other = named_axis(from_run(runs['yaw']), 'roll')
    with pytest.raises(RecordingError, match=r'a has axes surge, yaw, b has axis roll alone$'):
        same_axes({'a': read[0], 'b': other})


def test_events_state_the_configuration_of_the_axis(machine):
    text = ConfigurationEvent('/controller', machine.to_flat(), owns=('controller', 'safety'),
                              seq=4, memory=(1.0, 2.0, 3.0, 4.0)).to_json()
    found = json.loads(axis_text(text, 'yaw', ('surge', 'yaw')))
    assert found['memory'] == [3.0, 4.0]
    assert found['seq'] == 4
    assert found['configuration'] == machine.axis('yaw').to_flat()
    other = ModeEvent('/controller', 'fault', 'running', 'fault', 'axis yaw: nan').to_json()
    assert axis_text(other, 'yaw', ('surge', 'yaw')) == other
    assert axis_text('{"configuration": 1}', 'yaw', ('surge', 'yaw')) == '{"configuration": 1}'


def test_the_history_of_a_machine_holds_what_its_nodes_own(machine):
    history = RunHistory()
    history.add(ConfigurationEvent('/plant_node', machine.to_flat(), owns=('loop', 'plant')))
    changed = machine.replace(**{'axes.yaw.controller.lambda': 3.0})
    history.add(ConfigurationEvent('/controller_node', machine.to_flat(), owns=('controller',)))
    different = history.add(ConfigurationEvent('/controller_node', changed.to_flat(),
                                               owns=('controller',), seq=7))
    assert different == {'axes.yaw.controller.lambda': 3.0}
    assert history.configuration.axis('yaw').law.gains.lambda_ == 3.0
    assert [item.event.seq for item in history.statements('controller')] == [0, 7]


def test_a_topic_of_other_axes_is_not_of_this_loop(machine, runs):
    run = from_runs(runs, machine, 10**9)
    alone = from_run(runs['yaw'], 10**9)
    for changed, words in ((alone.channels['command'], 'one axis'),
                           (replace(run.channels['command'], axes=('a', 'b')), 'axes a, b')):
        mixed = RunData({**run.channels, 'command': changed}, run.configuration, run.info,
                        run.events)
        wanted = f'command are of {words}, the run has axes surge'
        with pytest.raises(RecordingError, match=wanted):
            axis_run(mixed, 'yaw')


def test_the_axes_of_runs_are_matched_by_name_in_the_order_of_the_first(machine, runs):
    first = from_runs(runs, machine)
    turned = from_runs({name: runs[name] for name in ('yaw', 'surge')},
                       Configuration.from_flat({**FLAT, 'loop.axes': ['yaw', 'surge']}))
    found = same_axes({'first': first, 'turned': turned})
    assert list(found) == ['surge', 'yaw']
    for axis, named in found.items():
        assert list(named) == ['first', 'turned']
        for run in named.values():
            assert (run.channels['command']['v'] == runs[axis].v).all()
    alone = from_run(runs['yaw'])
    assert list(same_axes({'a': alone, 'b': alone})) == ['']
    other = from_runs({'surge': runs['surge'], 'roll': runs['yaw']}, machine)
    for pair, text in (((first, other), 'only a has axis yaw, only b has axis roll'),
                       ((alone, first), 'a has one axis, without a name, b has axes surge, yaw')):
        with pytest.raises(RecordingError, match=f'must have the same axes: {text}$'):
            same_axes(dict(zip('ab', pair, strict=True)))

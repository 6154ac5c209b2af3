# SPDX-License-Identifier: Apache-2.0
"""Configurations of a run by what its nodes state: tables of events, what follows from them."""

from dataclasses import replace

from dz_ros.core.dataset import RunData
from dz_ros.core.events import ConfigurationEvent
from dz_ros.runs.history import MOST_KEYS, RunHistory

PLANT = ConfigurationEvent('/plant_node', configuration={
    'plant.b': 2.0, 'loop.rate': 100.0, 'controller.k_d': 1.0, 'safety.ramp': 3.0},
    owns=('plant', 'loop'))
CONTROLLER = ConfigurationEvent('/controller_node', configuration={
    'plant.b': 1.0, 'controller.k_d': 8.0, 'controller.gamma': 0.5}, owns=('controller',),
    memory=(1.0,))
LATER = replace(CONTROLLER, configuration={**CONTROLLER.configuration, 'controller.gamma': 2.0},
                seq=40)
OLD = ConfigurationEvent('/old', configuration={'plant.b': 9.0, 'trajectory.kind': 'constant'})


def history(*events, stored=None, keep=None):
    found = RunHistory(stored, keep)
    for time, event in enumerate(events):
        found.add(event, time)
    return found


def test_each_section_is_its_owners():
    found = history(PLANT, CONTROLLER, LATER)
    assert found.owners == {'plant': '/plant_node', 'loop': '/plant_node',
                            'controller': '/controller_node'}
    assert found.owned == {'plant.b': 2.0, 'loop.rate': 100.0, 'controller.k_d': 8.0,
                           'controller.gamma': 2.0}
    assert found.latest == {**found.owned, 'safety.ramp': 3.0}
    assert found.began == {**found.owned, 'controller.gamma': 0.5}


def test_what_is_stored_holds_where_no_event_states_otherwise():
    stored = {'loop.rate': 1.0, 'loop.seed': 4, 'other.key': 1}
    found = history(PLANT, LATER, stored=stored)
    assert found.stored == {'loop.rate': 1.0, 'loop.seed': 4}
    assert found.began['loop.seed'] == found.latest['loop.seed'] == 4
    assert found.began['loop.rate'] == 100.0
    assert 'loop.seed' not in found.owned


def test_statements_that_name_no_owner_change_nothing_but_fill_what_is_unknown():
    found = history(OLD, PLANT)
    assert found.began['plant.b'] == found.latest['plant.b'] == 2.0
    assert found.began['trajectory.kind'] == 'constant'
    assert 'trajectory.kind' not in found.latest


def test_changes_are_reported_one_by_one():
    found = RunHistory()
    assert found.add(CONTROLLER) == {}
    assert found.changed
    assert found.add(CONTROLLER) == {}
    assert not found.changed
    assert found.add(LATER) == {'controller.gamma': 2.0}
    assert found.changed


def test_statements_report_from_which_sample_on_and_with_which_memory():
    found = history(PLANT, CONTROLLER, LATER)
    assert [(item.time, item.event.seq, item.event.memory)
            for item in found.statements('controller')] == [(1, 0, (1.0,)), (2, 40, (1.0,))]
    assert [item.time for item in found.statements('plant')] == [0]
    assert history(PLANT, CONTROLLER, LATER, keep=0).statements('controller') == []
    assert len(history(PLANT, CONTROLLER, LATER, keep=1).statements('controller')) == 1


def test_a_configuration_that_is_of_no_use_leaves_the_one_before():
    found = history(stored={'controller.gamma': 0.5})
    before = found.configuration
    assert (before.law.gains.gamma, found.problem) == (0.5, '')
    found.add(replace(LATER, configuration={'controller.gamma': -1.0}))
    assert 'controller.gamma' in found.problem
    assert found.configuration is before
    assert (RunHistory().problem, RunHistory({'controller.law': 'gone'}).configuration) == (
        '', None)


def test_a_run_with_any_text_among_its_events():
    run = RunData({}, {'loop.rate': 1.0}, events=(
        (1, '', 'no JSON'), (2, '/plant_node', PLANT.to_json()),
        (3, '/n', '{"event": "mode", "mode": "lost"}')))
    found = RunHistory.of(run)
    assert found.latest['loop.rate'] == 100.0
    assert [item.time for item in found.statements('loop')] == [2]


def test_nodes_cannot_state_keys_without_end():
    many = {f'controller.key{k}': k for k in range(2 * MOST_KEYS)}
    found = history(*(replace(CONTROLLER, configuration={f'{key}{n}': 1 for key in many})
                      for n in range(3)))
    assert len(found.latest) == MOST_KEYS
    assert len(found.owned) <= MOST_KEYS

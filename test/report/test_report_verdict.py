# SPDX-License-Identifier: Apache-2.0
"""The verdict on a run: faults and losses fail it; samples without the law count nowhere."""

from dataclasses import replace
import json
import re

import numpy as np
import pytest

from dz_ros.core.dataset import Channel
from dz_ros.core.records import Status
from dz_ros.report.report import compose, pictures
from dz_ros.report.sections import ages
from dz_ros.report.verdict import judge
from dz_ros.report.view import View


def with_events(run, *events):
    """Return a run with events (loop time [s], fields)."""
    state = run.channels['state']
    return replace(run, events=tuple(
        (int(np.interp(time, state['stamp'], state.log_time)), fields['node'], json.dumps(fields))
        for time, fields in events))


def mode(node, name, earlier, reason=''):
    return {'node': node, 'event': 'mode', 'mode': name, 'earlier': earlier, 'cause': name,
            'reason': reason}


@pytest.fixture
def run(simulated):
    return simulated({'loop.duration': 4.0})


def test_a_run_without_faults_has_no_failure(run):
    found = judge(View.of(run))
    assert found.failures == ()
    assert found.lines()[0] == 'verdict: no failure'
    assert any('801 samples, none lost' in fact for fact in found.facts)


def test_a_latched_fault_fails_the_run_and_is_a_banner(run):
    broken = with_events(run, (1.0, mode('/plant_node', 'running', 'waiting')),
                         (2.5, mode('/plant_node', 'fault', 'running', 'the motor is gone')))
    view = View.of(broken)
    found = judge(view)
    assert found.failures == (
        '/plant_node ended in a latched fault at 2.500 s: the motor is gone',)
    page = compose(view, None, [], 'Run')
    assert page.index('class="fault"') < page.index('<nav')
    assert 'FAILED: /plant_node ended in a latched fault' in page


def test_a_fault_that_was_reset_is_a_fact(run):
    found = judge(View.of(with_events(
        run, (1.0, mode('/plant_node', 'fault', 'running', 'x')),
        (2.0, mode('/plant_node', 'waiting', 'fault')),
        (3.0, mode('/controller_node', 'estop', 'running')),
        (3.5, mode('/controller_node', 'waiting', 'estop')))))
    assert found.failures == ()
    assert 'faults that were reset: 1; e-stops, both ends counted: 1' in found.facts


def test_lost_samples_fail_the_run(run):
    state = run.channels['state']
    keep = np.arange(len(state)) % 100 != 50
    lossy = Channel(state.labels, state.values[keep], state.log_time[keep],
                    state.publish_time[keep])
    found = judge(View.of(replace(run, channels={**run.channels, 'state': lossy})))
    assert found.failures == ('samples lost: 8 of state',)


def test_samples_without_the_law_enter_no_share(run):
    terms = run.channels['terms']
    values = terms.values.copy()
    values[:, terms.labels.index('status')] = Status.INACTIVE
    values[:, terms.labels.index('s')] = 0.0
    idle = replace(run, channels={**run.channels, 'terms': replace(terms, values=values)})
    metrics = View.of(idle).metrics
    assert metrics.s_over_epsilon_max is None
    assert metrics.layer_share is None
    assert metrics.omega_share is None
    facts = judge(View.of(idle)).facts
    assert any('the law was inactive in 801 samples' in fact for fact in facts)


def test_some_samples_without_the_law_are_left_out(run):
    terms = run.channels['terms']
    values = terms.values.copy()
    idle = slice(500, None)
    values[idle, terms.labels.index('status')] = Status.INACTIVE
    values[idle, terms.labels.index('s')] = 0.0
    some = replace(run, channels={**run.channels, 'terms': replace(terms, values=values)})
    window = (2.0, 4.0)
    before = View.of(run, window=(2.0, 499 * 0.005)).metrics
    assert View.of(some, window=window).metrics.s_over_epsilon_max == before.s_over_epsilon_max


@pytest.mark.filterwarnings('error')
def test_a_window_without_the_law_keeps_every_picture(run):
    terms = run.channels['terms']
    values = terms.values.copy()
    values[200:, terms.labels.index('status')] = Status.INACTIVE
    stopped = View.of(replace(run, channels={**run.channels, 'terms': replace(terms,
                                                                              values=values)}))
    left_out = []
    found = {item.name: item for item in pictures(stopped, left_out=left_out)}
    assert left_out == []
    assert set(found) == {item.name for item in pictures(View.of(run))}
    assert 'The law was not active in the window.' in found['filtered_error'].caption


def test_the_first_fault_is_named_first(run):
    found = judge(View.of(with_events(
        run, (0.5, mode('/controller_node', 'running', 'waiting')),
        (1.0, mode('/actuator_node', 'fault', 'running', 'the motor is gone')),
        (2.0, mode('/controller_node', 'fault', 'lost', 'no commands are taken')))))
    assert [item.partition(' ')[0] for item in found.failures] == [
        '/actuator_node', '/controller_node']


@pytest.mark.parametrize(('duration', 'words'), [
    (4.0, 'planned end; recording complete'), (0.0, 'planned end; recording complete'),
    (30.0, 'ended early, in order: 4 of 30 s; recording complete')])
def test_an_end_before_the_last_sample_is_named(run, over_topics, duration, words):
    made = with_events(over_topics(run), (4.0, {'node': '/plant_node', 'event': 'finished'}))
    made = replace(made, configuration={**run.configuration, 'loop.duration': duration})
    found = judge(View.of(made))
    assert found.failures == ()
    assert found.facts[0] == words


def test_ages_of_commands_are_listed_where_they_are_few():
    assert ages({0: 198, 1: 1}) == '1 sample in 198 cases, 2 samples in 1 case'
    assert ages({0: 198, **dict.fromkeys(range(4, 201), 1)}) == (
        '1 sample in 198 cases, 5 samples in 1 case, more than 5 samples in 196, at most 201')


def test_a_machine_that_did_not_keep_up_is_in_the_first_line(run, over_topics):
    view = View.of(over_topics(run))
    view = replace(view, setting=replace(view.setting, mode='realtime'))
    assert judge(view).headline == 'no failure'
    late = view.rows.t + np.where(np.arange(len(view.rows.t)) > 100, 0.5, 0.0)
    behind = replace(view, rows=replace(view.rows, t=late))
    assert judge(behind).failures == ()
    assert 'no failure, but the machine did not keep up: 100 of' in judge(behind).headline


def test_a_run_without_the_law_keeps_its_layer(run):
    terms = run.channels['terms']
    values = terms.values.copy()
    values[:, list(terms.labels).index('status')] = float(Status.INACTIVE)
    view = View.of(replace(run, channels={**run.channels, 'terms': replace(terms,
                                                                           values=values)}))
    assert view.has_layer
    assert view.widest == view.setting.epsilon
    assert not any('no boundary layer' in fact for fact in judge(view).facts)
    without = replace(view, setting=replace(view.setting, epsilon=None))
    assert not without.has_layer


def test_what_k_star_covers_and_since_when_the_error_is_within_are_facts(simulated):
    found = judge(View.of(simulated({'loop.duration': 8.0, 'controller.law': 'wang2004'})))
    within = next(fact for fact in found.facts if fact.startswith('within'))
    since = float(re.search(r'from ([\d.]+) s on without a break', within)[1])
    assert 4.0 < since <= 7.0
    view = View.of(simulated({'loop.duration': 18.5, 'controller.law': 'wang2004',
                              'plant.a3': 4.0}))
    assert 0.0 < view.metrics.omega_share < 0.5     # in and out again and again
    assert not any('without a break' in fact for fact in judge(view).facts)
    assert any(re.match('that promise is for a disturbance that k\\* covers: .* this run had '
                        '1.26.* of it, more than k', fact) for fact in found.facts)
    quiet = simulated({'loop.duration': 8.0, 'controller.law': 'wang2004', 'plant.a3': 0.5})
    assert not any('that promise' in fact for fact in judge(View.of(quiet)).facts)

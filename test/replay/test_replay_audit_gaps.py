# SPDX-License-Identifier: Apache-2.0
"""Audits of logs that lack something: what cannot be checked is reported, never passed."""

from dataclasses import replace
import json
import math

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import Channel, RunData
from dz_ros.replay.audit.audit import audit, GAP
from dz_ros.replay.audit.recompute import memory_names, UNKNOWN_BEFORE
from dz_ros.runs.steps import differ


@pytest.fixture(scope='module')
def simulated(logs):
    return logs.offline()


@pytest.fixture(scope='module')
def recorded(logs):
    return logs.real_time()


@pytest.mark.parametrize('name', ['reference', 'state', 'command', 'terms'])
@pytest.mark.parametrize('row', [0, 150, -1])
def test_a_missing_message_is_found_and_named(logs, simulated, name, row):
    result = audit(logs.drop(simulated, name, row))
    seq = row % 401
    assert not result.passed
    assert result.differences == 0
    reason = result.not_checkable[0]
    assert reason.first == seq
    assert reason.text == {
        'reference': 'the reference it used is not in the log',
        'state': 'the state it answers is not in the log',
        'command': 'its command is not in the log', 'terms': 'its terms are not in the log'}[name]
    if row == 150:
        assert f'{name}: 1 message(s) missing: seq 150' in result.findings


@pytest.mark.parametrize(('ranges', 'left', 'known'), [
    ([[150, 152]], '153 … 154', '150 … 152'),
    ([[0, 149], [151, 151], [153, 153], [154, 400]], '150, 152', '151, 153, 154'),
    ([[149, 155]], '', '150 … 154'),
    ([[151, 150], [150], ['150', 154], [150.0, 154.0], None, [-1, 154]], '150 … 154', ''),
    ('150', '150 … 154', ''),
])
def test_what_the_device_did_not_measure_is_not_missing(logs, recorded, ranges, left, known):
    seq = recorded.channels['state']['seq']
    run = logs.drop(recorded, 'state', *np.flatnonzero((seq >= 150) & (seq <= 154)))
    text = json.dumps({'node': '/plant_node', 'event': 'unmeasured', 'ranges': ranges})
    claimed = replace(run, events=(*run.events, (int(run.channels['state'].log_time[-1]),
                                                 '/plant_node', text)))
    result = audit(claimed)
    missing = [item for item in result.findings if item.startswith('state: ')]
    assert bool(missing) == bool(left)
    assert not left or missing[0].endswith(f' missing: seq {left}')
    notes = [item for item in result.notes if 'no measurement' in item]
    assert bool(notes) == bool(known)
    assert not known or notes[0].endswith(f'which have no state: seq {known}')
    # Here the law answered them, so that they cannot be checked, whatever an event reports.
    assert not result.passed
    assert result.not_checkable[0].text == 'the state it answers is not in the log'


def test_a_missing_truth_is_named(logs, simulated):
    result = audit(logs.drop(simulated, 'truth', 7, 8, 30))
    assert result.findings == ('truth: 3 message(s) missing: seq 7 … 8, 30',)
    assert result.checked == result.samples
    assert not result.passed


def test_a_step_that_left_no_trace(logs, simulated):
    result = audit(logs.drop(logs.drop(simulated, 'command', 30, 31), 'terms', 30, 31))
    reasons = {item.text: item for item in result.not_checkable}
    assert reasons[GAP].samples == 2
    assert reasons[GAP].first == 30
    assert reasons[UNKNOWN_BEFORE].first == 32
    assert (result.samples, result.checked) == (401, 398)
    tail = audit(logs.drop(logs.drop(simulated, 'command', -1), 'terms', -1))
    assert not tail.passed
    assert tail.findings == ('1 state(s) have no command, the first with seq 400',)


def test_an_interrupted_loop_is_no_fault(logs):
    run = logs.real_time()
    state = run.channels['state'].values[-1].copy()
    state[0] += 1.0
    channel = run.channels['state']
    later = Channel(channel.labels, np.vstack([channel.values, state]),
                    *[np.append(channel.log_time, channel.log_time[-1] + 5_000_000)] * 2)
    result = audit(replace(run, channels={**run.channels, 'state': later}))
    assert result.passed
    assert any('has no command: the loop ended before' in note for note in result.notes)


def test_lockstep_uses_no_reference_of_another_stamp(recorded):
    result = audit(replace(recorded, info={'mode': 'lockstep'}))
    assert any('a loop in this mode waits' in item for item in result.findings)


def test_without_terms_commands_are_checked_and_the_rest_is_reported(logs, simulated):
    channels = {name: item for name, item in simulated.channels.items() if name != 'terms'}
    result = audit(replace(simulated, channels=channels))
    assert not result.passed
    assert result.fields['command.v'].compared == 401
    assert result.differences == 0
    assert result.checked == 0
    assert result.not_checkable[0].text == 'its terms are not in the log'
    wrong = audit(logs.change(replace(simulated, channels=channels), 'command', 'v', 5, 1.0))
    assert (wrong.first.field, wrong.first.seq, wrong.differences) == ('command.v', 5, 1)


@pytest.mark.parametrize('name', ['reference', 'state', 'command'])
def test_a_channel_that_was_not_recorded_is_reported(simulated, name):
    channels = {key: item for key, item in simulated.channels.items() if key != name}
    result = audit(replace(simulated, channels=channels))
    assert not result.passed
    assert result.checked == 0
    assert f'{name}: the log has no messages of this channel' in result.findings


def test_nothing_known_of_the_law(simulated):
    result = audit(replace(simulated, configuration={}))
    assert not result.passed
    assert result.not_checkable[0].text == 'the log does not state which law and gains were used'
    again = Configuration.from_flat({'loop.duration': 2.0})
    assert audit(replace(simulated, configuration={}), again).passed


def test_an_empty_log_is_not_passed():
    result = audit(RunData({}))
    assert not result.passed
    assert 'nothing to check' in result.findings[0]


def test_late_recording_is_checked_from_its_signals_and_reported(logs, simulated):
    run = simulated
    for name in ('reference', 'state', 'command', 'terms', 'truth'):
        run = logs.drop(run, name, *range(100))
    result = audit(run)
    assert not result.passed
    assert result.differences == 0
    assert (result.samples, result.checked) == (401, 300)


@pytest.mark.parametrize('value', [math.nan, math.inf, 1e300])
def test_numbers_that_are_none(logs, simulated, value):
    for name, label in (('state', 'x0'), ('reference', 'xd0'), ('command', 'v'),
                        ('terms', 'theta1'), ('terms', 'dt'), ('state', 'stamp'),
                        ('command', 'seq'), ('terms', 'reference_seq'), ('terms', 'status')):
        result = audit(logs.change(simulated, name, label, 9, value))
        assert not result.passed
        json.dumps(result.to_dict(), allow_nan=False)


def test_repetition_with_other_numbers(simulated):
    channel = simulated.channels['terms']
    extra = channel.values[50].copy()
    extra[3] += 1.0
    values = np.insert(channel.values, 51, extra, axis=0)
    times = np.insert(channel.log_time, 51, channel.log_time[50])
    run = replace(simulated, channels={**simulated.channels, 'terms': Channel(
        channel.labels, values, times, times)})
    assert audit(run).findings == (
        'terms: 1 message(s) came again with other numbers, the first with seq 50',)


def test_bits_count():
    a = np.array([0.0, 1.0, math.nan, math.inf, 5e-324])
    b = np.array([-0.0, 1.0, -math.nan, -math.inf, 0.0])
    assert differ(a, b).tolist() == [True, False, False, True, True]


def test_memory_has_the_names_of_its_signals():
    c = Configuration.from_flat({})
    assert memory_names(c.law) == ('theta1', 'theta2', 'phi')
    assert memory_names(c.replace(**{'controller.law': 'pd'}).law) == ()

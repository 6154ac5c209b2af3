# SPDX-License-Identifier: Apache-2.0
"""Audits of logs that a live controller made, whole and tampered with."""

from dataclasses import replace
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.laws import LAWS
from dz_ros.core.plants import PLANTS
from dz_ros.replay.audit.audit import audit
from dz_ros.version import version

BASE = {'loop.duration': 2.0}


@pytest.fixture(scope='module')
def simulated(logs):
    return logs.offline()


@pytest.fixture(scope='module')
def recorded(logs):
    return logs.real_time()


@pytest.mark.parametrize('law', list(LAWS.builtin))
@pytest.mark.parametrize('plant', list(PLANTS.builtin))
def test_every_law_and_plant_offline(logs, law, plant):
    try:
        run = logs.offline(**{'controller.law': law, 'plant.model': plant,
                              'plant.noise': [1e-3], 'loop.duration': 0.5})
    except (OverflowError, ValueError) as error:
        pytest.skip(str(error))
    result = audit(run)
    assert result.passed, result
    assert result.samples == result.checked == 101
    assert result.compared >= 101 * 15


def test_real_time_log(recorded):
    result = audit(recorded)
    assert result.passed, result
    distinct = len(np.unique(recorded.channels['command']['seq']))
    assert result.samples == result.checked == distinct < len(recorded.channels['command'])
    reported = ' '.join(result.notes)
    assert 'reference(s) were brought' in reported
    assert 'bad interval' in reported
    assert 'passed over for newer ones' in reported


def test_gain_changes_are_followed(logs):
    changes = [(40, {'controller.gamma': 3.0}), (90, {'controller.k_d': 12.0}),
               (91, {'controller.lambda': 1.5})]
    run = logs.real_time(changes=changes)
    result = audit(run)
    assert result.passed, result
    assert [span.first for span in result.spans] == [0, 40, 90, 91]
    # One sample off: v differs there, and nowhere else.
    events = [(time, node, text.replace('"seq": 90', '"seq": 89')) for time, node, text
              in run.events]
    result = audit(replace(run, events=tuple(events)))
    assert not result.passed
    assert (result.first.seq, result.first.field) == (89, 'terms.v_damping')
    assert result.fields['command.v'].differing == 1


@pytest.mark.parametrize('restart', [{'restart': 150}, {'plant_restart': 170},
                                     {'restart': 100, 'plant_restart': 101}])
def test_restarts_are_followed(logs, restart):
    result = audit(logs.real_time(**restart))
    assert result.passed, result
    assert len(result.spans) == (2 if 'restart' in restart else 1)


def test_difference_after_a_restart_reports_which_start(logs):
    run = logs.real_time(restart=150)
    rows = np.flatnonzero(run.channels['command']['seq'] == 20)
    result = audit(logs.change(run, 'command', 'v', rows[-1], 1.0))
    assert (result.differences, result.first.start, result.first.seq) == (1, 1, 20)
    assert 'start 2 of the controller' in result.first.text()


@pytest.mark.parametrize(('name', 'label', 'first'), [
    ('command', 'v', 'command.v'), ('command', 'stamp', 'command.stamp'),
    ('command', 'echo_stamp', 'command.echo_stamp'), ('terms', 's', 'terms.s'),
    ('terms', 'v_robust', 'terms.v_robust'), ('terms', 'theta1', 'terms.theta1'),
    ('terms', 'phi', 'terms.phi'), ('terms', 'dt', 'terms.dt'),
    ('terms', 'status', 'terms.status'), ('state', 'x0', 'terms.s'),
    ('state', 'x1', 'terms.s'), ('reference', 'xd0', 'terms.s'),
    ('reference', 'xd2', 'terms.u_fd'), ('command', 'echo_seq', 'command.echo_seq'),
    ('terms', 'echo_seq', 'terms.echo_seq')])
def test_one_tampered_value_is_found_and_named(logs, simulated, name, label, first):
    row = 200
    value = simulated.channels[name][label][row]
    tampered = value + 1.0 if label in ('status', 'echo_seq') else math.nextafter(
        value, math.inf) if label in ('v', 'theta1', 'phi', 'dt', 'stamp') else value + 1e-9
    result = audit(logs.change(simulated, name, label, row, tampered))
    assert not result.passed
    assert result.first.seq == row
    assert result.first.stamp == 1.0
    assert result.first.field == first
    if name != 'state' and name != 'reference':
        assert result.differences == 1
        assert result.first.recorded == tampered
        assert result.first.recomputed == value
        assert result.largest == result.first


@settings(max_examples=4 * settings.default.max_examples // 10, deadline=None)
@given(st.data())
def test_any_flipped_bit_that_matters_is_found(logs, recorded, data):
    """Of everything but the clocks and what names no step, one flipped bit is one audit failed."""
    name = data.draw(st.sampled_from(['command', 'terms', 'reference', 'state']))
    channel = recorded.channels[name]
    label = data.draw(st.sampled_from([item for item in channel.labels if item not in (
        'hold', 'round_trip', 'echo_seq', 'echo_stamp', 'seq', 'stamp')]))
    used = {'reference': np.unique(recorded.channels['terms']['reference_seq']),
            'state': np.unique(recorded.channels['terms']['echo_seq'])}
    rows = np.flatnonzero(np.isin(channel['seq'], used[name])) if name in used else np.arange(
        len(channel))
    row = int(rows[data.draw(st.integers(0, len(rows) - 1))])
    bit = data.draw(st.integers(0, 63))
    number = np.array([channel[label][row]])
    flipped = (number.view(np.uint64) ^ np.uint64(1 << bit)).view(float)[0]
    run = logs.change(recorded, name, label, row, flipped)
    result = audit(run)
    step = next((item.first for item in result.fields.values() if item.first), None)
    if name in used and result.passed:
        # An input may change without any number noticing: below the rounding of x − x_d, or a
        # copy of a repeated state that is not the one answered.
        size = abs(flipped - number[0])
        again = np.count_nonzero(channel['seq'] == channel['seq'][row]) > 1
        assert again or size < 1e-12 * max(1.0, abs(number[0]))
        return
    assert not result.passed
    assert step is not None or result.not_checkable or result.findings


@pytest.mark.parametrize('limit', [{'safety.command_limit': 2.5}, {'safety.ramp': 0.5},
                                   {'safety.rate_limit': 400.0}])
def test_a_freeze_by_the_command_limiter_is_derived(logs, limit):
    run = logs.real_time(flat={**BASE, **limit})
    assert audit(run).passed
    status = run.channels['terms']['status']
    frozen, adapting = (np.flatnonzero(status == bits) for bits in (2.0, 0.0))
    row = adapting[adapting > 20][0]
    # One that claims to be frozen although no limit held the command back, and the reverse.
    claimed = audit(logs.change(logs.change(run, 'terms', 'dt', row, 0.0), 'terms', 'status', row,
                                2.0))
    assert {name for name, item in claimed.fields.items() if item.differing} == {
        'terms.dt', 'terms.status'}
    hidden = audit(logs.change(run, 'terms', 'status', frozen[0], 0.0))
    assert (hidden.first.field, hidden.first.recomputed) == ('terms.status', 2.0)


def test_changed_gain_is_found_by_numbers_and_by_name(logs):
    run = logs.real_time()
    wrong = audit(replace(run, configuration={**run.configuration, 'controller.gamma': 0.6}))
    assert any("controller.gamma is 0.6 in the run's configuration, 0.5" in item
               for item in wrong.findings)
    assert not wrong.passed
    given = audit(run, Configuration.from_flat({**BASE, 'controller.gamma': 0.6}))
    assert given.first.field.startswith('memory.')
    assert any('controller.gamma is 0.5' in note for note in given.notes)
    everything = audit(logs.offline(), Configuration.from_flat({**BASE, 'controller.k_star': 2.6}))
    assert {name for name, item in everything.fields.items() if item.differing} == {
        'terms.v_robust', 'command.v'}
    assert everything.fields['command.v'].differing > 390


def test_initial_estimates_are_part_of_the_audit(simulated):
    run = replace(simulated, configuration={**simulated.configuration, 'controller.phi_0': 0.9})
    result = audit(run)
    assert (result.first.field, result.first.seq) == ('memory.phi', 0)
    assert result.differences == 1


def test_another_version_is_named_and_judged_by_its_numbers(logs):
    result = audit(logs.real_time(reported='0.0.1'))
    assert result.passed
    assert result.notes[0] == f'recorded by dz_ros 0.0.1, recomputed by {version()}'


@pytest.mark.parametrize(('before', 'after', 'reported'), [
    ('"controller.law": "wang2004"', '"controller.law": "gone"', 'no such law'),
    ('"controller.k_d"', '"controller.k_dd"', 'unknown key'),
    ('"controller.law": "wang2004"', '"controller.law": "pd"', 'theta1'),
    ('"plant.model": "wang2004"', '"plant.model": "first_order"', 'has 1 states, the log has 2'),
    ('"memory": [0.85, ', '"memory": [', 'keeps 3 numbers from sample to sample')])
def test_another_law_is_named_and_not_passed(logs, before, after, reported):
    run = logs.real_time()
    events = tuple((time, node, text.replace(before, after)) for time, node, text in run.events)
    result = audit(replace(run, events=events))
    assert not result.passed
    assert result.checked == 0
    assert reported in result.not_checkable[0].text
    assert result.not_checkable[0].samples == result.samples

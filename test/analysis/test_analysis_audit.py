"""Audits of logs that a live controller made, whole and tampered with."""

from dataclasses import replace
import json
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.analysis.audit import audit, GAP
from dz_ros.analysis.audit_compare import UNKNOWN_BEFORE
from dz_ros.analysis.audit_result import differ
from dz_ros.analysis.audit_steps import memory_names
from dz_ros.core.configuration import Configuration
from dz_ros.core.controller import Controller
from dz_ros.core.dataset import Channel, from_run, RunData
from dz_ros.core.laws import LAWS
from dz_ros.core.loop import simulate
from dz_ros.core.plants import PLANTS
from dz_ros.core.records import Command, Reference, State, Terms
from dz_ros.version import version

T = 0.005
BASE = {'loop.duration': 2.0}


class Log:
    """A log written as a recorder would, one message after the other, 100 µs apart."""

    def __init__(self, configuration, mode='realtime'):
        self.configuration, self.mode = configuration, mode
        self.rows = {name: [] for name in ('reference', 'state', 'command', 'terms')}
        self.events, self.now = [], 1_700_000_000_000_000_000

    def put(self, name, numbers):
        self.now += 100_000
        self.rows[name].append((self.now, tuple(map(float, numbers))))

    def announce(self, configuration, seq, memory, said=None):
        self.now += 100_000
        self.events.append((self.now, '/controller_node', json.dumps({
            'node': '/controller_node', 'event': 'configuration', 'version': said or version(),
            'owns': ['controller'], 'configuration': configuration.to_flat(), 'set_aside': [],
            'seq': seq, 'memory': list(memory)})))

    def data(self):
        order = self.configuration.plant.order
        labels = {'reference': Reference.labels(order), 'state': State.labels(order),
                  'command': Command.labels(),
                  'terms': Terms.labels(self.configuration.law.signal_names)}
        return RunData({name: Channel(labels[name], np.array([row for _, row in rows]),
                                      *[np.array([time for time, _ in rows])] * 2)
                        for name, rows in self.rows.items() if rows},
                       self.configuration.to_flat(), {'mode': self.mode}, tuple(self.events))


def real_time(samples=300, changes=(), restart=None, plant_restart=None, said=None, flat=BASE):
    """Return a real-time log with jitter, skipped periods, lost and repeated messages.

    Args:
        samples: States published.
        changes: (seq, overrides): gain changes.
        restart: State at which the controller is started anew.
        plant_restart: State at which the plant is started anew.
        said: Version the controller states.
        flat: Configuration.
    """
    generator = np.random.default_rng(7)
    configuration = Configuration.from_flat(flat)
    log, controller, count = Log(configuration), Controller(configuration), 0
    log.announce(configuration, 0, controller.memory, said)
    x, stamp, seq = list(configuration.x0), 0.0, 0
    changes = dict(changes)
    for k in range(samples):
        if k == restart:
            controller, count = Controller(configuration), 0
            log.announce(configuration, 0, controller.memory, said)
        if k == plant_restart:
            x, stamp, seq = list(configuration.x0), 0.0, 0
        if count in changes:
            configuration = configuration.replace(**changes.pop(count))
            controller.law = configuration.law
            log.announce(configuration, count, controller.memory, said)
        sample = round(stamp / T)
        meant = Reference(seq, sample * T, configuration.trajectory(sample * T))
        log.put('reference', meant.numbers())
        if k % 37 != 5 or not controller.has_reference:    # else it arrives too late
            controller.set_reference(meant)
        state = State(seq, stamp, tuple(x), count - 1, 0.0, 0.0)
        for _ in range(2 if k % 50 == 3 else 1):       # sent again: the same answer again
            log.put('state', state.numbers())
            if k % 41 == 11:                            # never reaches the controller
                continue
            command, terms = controller.respond(state)
            count = command.seq + 1
            log.put('command', (*command.numbers()[:-1], generator.uniform(0.0, 1e-3)))
            log.put('terms', terms.numbers())
        if k % 37 == 5:
            controller.set_reference(meant)
        skipped = {60: 1, 120: 2, 180: 5}.get(k, 0)
        stamp += T * (1 + skipped) + generator.normal(0.0, 5e-5)
        x[0] += T * x[1]
        x[1] += T * (command.v - x[0]) + generator.normal(0.0, 0.01)
        seq += 1
    return log.data()


def offline(**overrides):
    return from_run(simulate(Configuration.from_flat({**BASE, **overrides})))


def change(run, name, label, row, value):
    """Return the run with one number changed."""
    channel = run.channels[name]
    values = channel.values.copy()
    values[row, channel.labels.index(label)] = value
    return replace(run, channels={**run.channels, name: replace(channel, values=values)})


def drop(run, name, *rows):
    """Return the run without some messages."""
    channel = run.channels[name]
    keep = np.setdiff1d(np.arange(len(channel)), [row % len(channel) for row in rows])
    return replace(run, channels={**run.channels, name: Channel(
        channel.labels, channel.values[keep], channel.log_time[keep],
        channel.publish_time[keep])})


@pytest.fixture(scope='module')
def simulated():
    return offline()


@pytest.fixture(scope='module')
def recorded():
    return real_time()


@pytest.mark.parametrize('law', list(LAWS.builtin))
@pytest.mark.parametrize('plant', list(PLANTS.builtin))
def test_every_law_and_plant_off_line(law, plant):
    try:
        run = offline(**{'controller.law': law, 'plant.model': plant,
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
    said = ' '.join(result.notes)
    assert 'reference(s) were brought' in said
    assert 'bad interval' in said
    assert 'passed over for newer ones' in said


def test_gain_changes_are_followed():
    changes = [(40, {'controller.gamma': 3.0}), (90, {'controller.k_d': 12.0}),
               (91, {'controller.lambda': 1.5})]
    run = real_time(changes=changes)
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
def test_restarts_are_followed(restart):
    result = audit(real_time(**restart))
    assert result.passed, result
    assert len(result.spans) == (2 if 'restart' in restart else 1)


def test_difference_after_a_restart_says_which_start():
    run = real_time(restart=150)
    rows = np.flatnonzero(run.channels['command']['seq'] == 20)
    result = audit(change(run, 'command', 'v', rows[-1], 1.0))
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
def test_one_tampered_value_is_found_and_named(simulated, name, label, first):
    row = 200
    value = simulated.channels[name][label][row]
    tampered = value + 1.0 if label in ('status', 'echo_seq') else math.nextafter(
        value, math.inf) if label in ('v', 'theta1', 'phi', 'dt', 'stamp') else value + 1e-9
    result = audit(change(simulated, name, label, row, tampered))
    assert not result.passed
    assert result.first.seq == row
    assert result.first.stamp == 1.0
    assert result.first.field == first
    if name != 'state' and name != 'reference':
        assert result.differences == 1
        assert result.first.recorded == tampered
        assert result.first.recomputed == value
        assert result.largest == result.first


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_any_flipped_bit_that_matters_is_found(recorded, data):
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
    run = change(recorded, name, label, row, flipped)
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


def test_changed_gain_is_found_by_numbers_and_by_name():
    run = real_time()
    wrong = audit(replace(run, configuration={**run.configuration, 'controller.gamma': 0.6}))
    assert any("controller.gamma is 0.6 in the run's configuration, 0.5" in item
               for item in wrong.findings)
    assert not wrong.passed
    given = audit(run, Configuration.from_flat({**BASE, 'controller.gamma': 0.6}))
    assert given.first.field.startswith('memory.')
    assert any('controller.gamma is 0.5' in note for note in given.notes)
    everything = audit(offline(), Configuration.from_flat({**BASE, 'controller.k_star': 2.6}))
    assert {name for name, item in everything.fields.items() if item.differing} == {
        'terms.v_robust', 'command.v'}
    assert everything.fields['command.v'].differing > 390


def test_initial_estimates_are_part_of_the_audit(simulated):
    run = replace(simulated, configuration={**simulated.configuration, 'controller.phi_0': 0.9})
    result = audit(run)
    assert (result.first.field, result.first.seq) == ('memory.phi', 0)
    assert result.differences == 1


def test_another_version_is_named_and_judged_by_its_numbers():
    result = audit(real_time(said='0.0.1'))
    assert result.passed
    assert result.notes[0] == f'recorded by dz_ros 0.0.1, recomputed by {version()}'


@pytest.mark.parametrize(('before', 'after', 'said'), [
    ('"controller.law": "wang2004"', '"controller.law": "gone"', 'no such law'),
    ('"controller.k_d"', '"controller.k_dd"', 'unknown key'),
    ('"controller.law": "wang2004"', '"controller.law": "pd"', 'theta1'),
    ('"plant.model": "wang2004"', '"plant.model": "first_order"', 'has 1 states, the log has 2'),
    ('"memory": [0.85, ', '"memory": [', 'keeps 3 numbers from sample to sample')])
def test_another_law_is_named_and_not_passed(before, after, said):
    run = real_time()
    events = tuple((time, node, text.replace(before, after)) for time, node, text in run.events)
    result = audit(replace(run, events=events))
    assert not result.passed
    assert result.checked == 0
    assert said in result.not_checkable[0].text
    assert result.not_checkable[0].samples == result.samples


@pytest.mark.parametrize('name', ['reference', 'state', 'command', 'terms'])
@pytest.mark.parametrize('row', [0, 150, -1])
def test_a_missing_message_is_found_and_named(simulated, name, row):
    result = audit(drop(simulated, name, row))
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


def test_a_missing_truth_is_named(simulated):
    result = audit(drop(simulated, 'truth', 7, 8, 30))
    assert result.findings == ('truth: 3 message(s) missing: seq 7 … 8, 30',)
    assert result.checked == result.samples
    assert not result.passed


def test_a_step_that_left_no_trace(simulated):
    result = audit(drop(drop(simulated, 'command', 30, 31), 'terms', 30, 31))
    reasons = {item.text: item for item in result.not_checkable}
    assert reasons[GAP].samples == 2
    assert reasons[GAP].first == 30
    assert reasons[UNKNOWN_BEFORE].first == 32
    assert (result.samples, result.checked) == (401, 398)
    tail = audit(drop(drop(simulated, 'command', -1), 'terms', -1))
    assert not tail.passed
    assert tail.findings == ('1 state(s) have no command, the first with seq 400',)


def test_an_interrupted_loop_is_no_fault():
    run = real_time()
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


def test_without_terms_commands_are_checked_and_the_rest_is_said(simulated):
    channels = {name: item for name, item in simulated.channels.items() if name != 'terms'}
    result = audit(replace(simulated, channels=channels))
    assert not result.passed
    assert result.fields['command.v'].compared == 401
    assert result.differences == 0
    assert result.checked == 0
    assert result.not_checkable[0].text == 'its terms are not in the log'
    wrong = audit(change(replace(simulated, channels=channels), 'command', 'v', 5, 1.0))
    assert (wrong.first.field, wrong.first.seq, wrong.differences) == ('command.v', 5, 1)


@pytest.mark.parametrize('name', ['reference', 'state', 'command'])
def test_a_channel_that_was_not_recorded_is_said(simulated, name):
    channels = {key: item for key, item in simulated.channels.items() if key != name}
    result = audit(replace(simulated, channels=channels))
    assert not result.passed
    assert result.checked == 0
    assert f'{name}: the log has no messages of this channel' in result.findings


def test_nothing_known_of_the_law(simulated):
    result = audit(replace(simulated, configuration={}))
    assert not result.passed
    assert result.not_checkable[0].text == 'the log does not say which law and gains were used'
    assert audit(replace(simulated, configuration={}), Configuration.from_flat(BASE)).passed


def test_an_empty_log_is_not_passed():
    result = audit(RunData({}))
    assert not result.passed
    assert 'nothing to check' in result.findings[0]


def test_late_recording_is_checked_from_its_signals_and_said(simulated):
    run = simulated
    for name in ('reference', 'state', 'command', 'terms', 'truth'):
        run = drop(run, name, *range(100))
    result = audit(run)
    assert not result.passed
    assert result.differences == 0
    assert (result.samples, result.checked) == (401, 300)


@pytest.mark.parametrize('value', [math.nan, math.inf, 1e300])
def test_numbers_that_are_none(simulated, value):
    for name, label in (('state', 'x0'), ('reference', 'xd0'), ('command', 'v'),
                        ('terms', 'theta1'), ('terms', 'dt'), ('state', 'stamp'),
                        ('command', 'seq'), ('terms', 'reference_seq'), ('terms', 'status')):
        result = audit(change(simulated, name, label, 9, value))
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

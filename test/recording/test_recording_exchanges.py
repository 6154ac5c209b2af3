# SPDX-License-Identifier: Apache-2.0
"""The samples a controller answered, read back from runs in and out of order."""

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.loop.controller import Controller
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import Reference, State, Status, Terms
from dz_ros.errors import RecordingError
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.channels import ARRAY
from dz_ros.recording.exchanges import Exchanges, WINDOW
from dz_ros.recording.messages import Message, Topic
from dz_ros.recording.run_source import open_source
from dz_ros.recording.save import save_run

T = 0.005
TERMS = ('seq', 'stamp', 'reference_seq', 'echo_seq')


class Run:
    """A run in memory, messages in the order given."""

    path = 'memory'

    def __init__(self, place='/', topics=('state', 'reference', 'terms', 'command')):
        self.topics = {place + name: Topic(place + name, ARRAY.name) for name in topics}
        self.place = place
        self.messages = []

    def recorded_topics(self):
        return self.topics

    def add(self, topic, labels, *numbers):
        self.messages.append(Message(self.place + topic, ArrayCodec(labels).encode(numbers), 0, 0))
        return self

    def state(self, seq):
        return self.add('state', State.labels(2), seq, seq * T, 0.5 + seq, -1.0, -1, 0.0, 0.0)

    def reference(self, seq):
        return self.add('reference', Reference.labels(2), seq, seq * T, 1.0 + seq, 2.0, 3.0)

    def terms(self, seq, reference_seq=None):
        return self.add('terms', TERMS, seq, seq * T,
                        seq if reference_seq is None else reference_seq, seq)

    def command(self, seq):
        return self.add('command', ('seq', 'stamp', 'v', 'echo_seq'), seq, seq * T, 0.0, seq)

    def batches(self):
        yield self.messages


def seqs(run, **options):
    return [(state.seq, reference.seq) for state, reference in Exchanges(run, **options)]


def test_a_simulated_run_fed_to_a_controller_repeats_it_bit_for_bit(tmp_path):
    run = simulate(Configuration.from_flat({'loop.duration': 3.0, 'plant.noise': [0.01]}))
    save_run(from_run(run), tmp_path / 'run')
    controller = Controller(run.configuration)
    found = []
    exchanges = Exchanges(open_source(tmp_path / 'run'))
    for state, reference in exchanges:
        controller.set_reference(reference)
        found.append(controller.respond(state)[0].v)
    assert np.array_equal(found, run.v)
    assert (exchanges.count, exchanges.missing, exchanges.carried) == (601, 0, 0)


def test_what_overtook_in_the_log_is_put_in_order():
    run = Run().terms(0).terms(1).reference(1).reference(0).state(1).state(0)
    assert seqs(run) == [(0, 0), (1, 1)]


def test_states_without_answer_and_repeated_ones_are_left_out():
    run = Run().reference(0).state(0).state(0).terms(0).terms(0).state(1)
    run.reference(2).state(2).terms(2).terms(2)
    exchanges = Exchanges(run)
    assert [item.state.seq for item in exchanges] == [0, 2]
    assert exchanges.missing == 0


def test_a_reference_used_for_another_state_keeps_its_stamp():
    run = Run().reference(0).state(0).terms(0).state(1).terms(1, reference_seq=0)
    exchanges = Exchanges(run)
    assert list(exchanges)[1].reference == Reference(1, 0.0, (1.0, 2.0, 3.0))
    assert exchanges.carried == 1


def test_late_references_and_frozen_adaptation_are_repeated_bit_for_bit():
    configuration = Configuration.from_flat({})
    then, now = Controller(configuration), Controller(configuration)
    run = Run()
    for seq in range(40):       # references come for every eighth state: late, then too late
        state = State(seq, seq * T, (0.1 * seq, 1.0))
        run.add('state', State.labels(2), *state.numbers())
        if seq % 8 == 0:
            reference = Reference(seq, seq * T, (1.0, 2.0, 3.0))
            run.add('reference', Reference.labels(2), *reference.numbers())
            then.set_reference(reference)
        _, terms = then.respond(state)
        run.add('terms', Terms.labels(configuration.law.signal_names), *terms.numbers())
    statuses = set()
    then = Controller(configuration)
    for item, (state, reference) in enumerate(Exchanges(run)):
        if item % 8 == 0:
            then.set_reference(reference)
        now.set_reference(reference)
        assert now.has_reference_for(state)
        (command, terms), (again, found) = then.respond(state), now.respond(state)
        assert again.v == command.v
        assert (found.values, found.dt, found.status) == (terms.values, terms.dt, terms.status)
        statuses.add(found.status)
    assert statuses == {Status.ADAPTING, Status.STALE_REFERENCE}


def test_without_terms_the_reference_is_that_of_the_stamp():
    run = Run(topics=('state', 'reference', 'command'))
    run.reference(0).reference(1).state(0).command(0).state(1).command(1)
    assert seqs(run) == [(0, 0), (1, 1)]


def test_what_is_not_in_the_run_is_counted_and_does_not_stop_the_rest():
    run = Run()
    for seq in range(2 * WINDOW):
        run.reference(seq)
        if seq != 7:
            run.state(seq)
        run.terms(seq)
    run.terms(5000)
    exchanges = Exchanges(run)
    assert [item.state.seq for item in exchanges] == [
        seq for seq in range(2 * WINDOW) if seq != 7]
    assert exchanges.missing == 2
    assert len(exchanges._states) <= WINDOW
    assert len(exchanges._references) <= WINDOW


def test_a_plant_that_started_again_is_followed():
    run = Run()
    for seq in (0, 1, 2, 0, 1):
        run.reference(seq).state(seq).terms(seq)
    assert [seq for seq, _ in seqs(run)] == [0, 1, 2, 0, 1]


def test_one_of_several_loops_is_chosen():
    run = Run('/left/').reference(0).state(0).terms(0)
    run.topics.update(Run('/right/').topics)
    with pytest.raises(RecordingError, match='several loops'):
        Exchanges(run)
    assert seqs(run, namespace='left') == [(0, 0)]
    with pytest.raises(RecordingError, match='no state'):
        Exchanges(run, namespace='middle')


def test_messages_of_another_program_are_left_out():
    run = Run()
    run.reference(0).state(0).terms(0)
    for topic in ('state', 'reference', 'terms'):
        run.add(topic, ('seq', 'stamp', 'y'), 1, 2.0, 3.0)
    run.reference(1).state(1).terms(1)
    found = Exchanges(run)
    assert [state.seq for state, _ in found] == [0, 1]
    assert (found.foreign, found.missing) == (3, 0)


@pytest.mark.parametrize('lacking', ['state', 'reference'])
def test_a_run_that_lacks_a_topic_is_named(lacking):
    topics = [name for name in ('state', 'reference', 'terms', 'command') if name != lacking]
    with pytest.raises(RecordingError, match=lacking):
        Exchanges(Run(topics=topics))


@pytest.mark.parametrize(('topic', 'labels', 'numbers'), [
    ('state', ('seq', 'stamp', 'x0'), (0, 0.0, 1.0)),
    ('state', State.labels(2), (float('nan'), 0.0, 1.0, 1.0, -1, 0.0, 0.0)),
    ('reference', ('a', 'b', 'c'), (0, 0.0, 1.0)),
    ('terms', ('seq', 'stamp'), (0, 0.0)),
])
def test_messages_that_are_no_records_are_an_error_of_one_line(topic, labels, numbers):
    with pytest.raises(RecordingError, match=topic) as caught:
        list(Exchanges(Run().add(topic, labels, *numbers)))
    assert '\n' not in str(caught.value)

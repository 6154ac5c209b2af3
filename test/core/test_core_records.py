# SPDX-License-Identifier: Apache-2.0
"""Records: their labels, their numbers, and a simulated run as channels of them."""

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import Channel, from_run
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import Command, Reference, State, Status, Terms, Truth
from dz_ros.core.signals import TERM_NAMES
from dz_ros.core.trajectories.sinusoid import Sinusoid

RECORDS = [
    (Reference(3, 0.015, (1.0, 2.0, 3.0)), Reference.labels(2)),
    (State(3, 0.015, (1.0, 2.0, 3.0), 2, 0.01), State.labels(3)),
    (Command(3, 0.015, 4.5, 3, 0.015), Command.labels()),
    (Terms(3, 0.015, tuple(map(float, range(8))), 0.005, Status.SATURATED, 3, 3, (0.1, 0.2)),
     Terms.labels(('theta1', 'phi'))),
    (Truth(3, 0.015, 1.0, 2.0, 3.0), Truth.labels()),
]


@pytest.mark.parametrize(('record', 'labels'), RECORDS)
def test_numbers_are_what_the_labels_name(record, labels):
    numbers = record.numbers()
    assert len(numbers) == len(labels) == len(set(labels))
    assert labels[:2] == ('seq', 'stamp')
    assert numbers[:2] == (3, 0.015)
    for name in set(labels) & set(record._fields):
        assert numbers[labels.index(name)] == getattr(record, name)
    assert all(isinstance(number, (int, float)) for number in numbers)


@pytest.mark.parametrize(('record', 'labels'), RECORDS[:3])
def test_records_that_travel_come_back_from_floats(record, labels):
    assert type(record).from_numbers([float(number) for number in record.numbers()]) == record


@pytest.mark.parametrize(('record', 'labels'), RECORDS)
def test_records_do_not_change(record, labels):
    with pytest.raises(AttributeError):
        record.seq = 4


@pytest.mark.parametrize('order', [1, 2, 3])
def test_a_reference_is_brought_to_another_instant_by_its_derivatives(order):
    trajectory = Sinusoid(order=order)
    reference = Reference(10, 1.0, trajectory(1.0))
    ahead = 0.005
    moved = reference.at(1.0 + ahead)
    assert (moved.seq, moved.stamp) == (10, 1.0 + ahead)
    exact = trajectory(1.0 + ahead)
    for i in range(order + 1):  # the first term left out, for a sinusoid of frequency 1
        assert abs(moved.x_d[i] - exact[i]) <= 2.5 * ahead ** (order + 1 - i) * 1.01
    assert reference.at(1.0) is reference


@pytest.fixture(scope='module')
def found():
    run = simulate(Configuration.from_flat({
        'plant.noise': [1e-3, 1e-2], 'loop.duration': 1.0, 'loop.delay': 1}))
    return run, from_run(run, start_ns=1_000_000_000)


def test_a_simulated_run_has_every_channel_with_its_labels(found):
    run, data = found
    assert {name: channel.labels for name, channel in data.channels.items()} == {
        'reference': Reference.labels(2), 'state': State.labels(2), 'command': Command.labels(),
        'terms': Terms.labels(('theta1', 'theta2', 'phi')), 'truth': Truth.labels()}
    for channel in data.channels.values():
        assert channel.values.shape == (201, len(channel.labels))
        assert channel['seq'].tolist() == list(range(201))
        assert channel.log_time[0] == 1_000_000_000
        assert (np.diff(channel.log_time) == 5_000_000).all()
    assert data.configuration == run.configuration.to_flat()


def test_channels_hold_what_the_run_holds(found):
    run, data = found
    assert np.array_equal(data.channels['state']['x1'], run.x_measured[:, 1])
    assert np.array_equal(data.channels['reference']['xd2'], run.x_d[:, 2])
    assert np.array_equal(data.channels['command']['v'], run.v)
    assert np.array_equal(data.channels['truth']['w'], run.truth[:, 0])
    for name in (*TERM_NAMES, 'status', 'theta1', 'theta2', 'phi'):
        assert np.array_equal(data.channels['terms'][name], run.column(name))
    assert data.channels['state']['echo_seq'].tolist() == list(range(-1, 200))


def test_a_missing_column_is_named_with_those_there_are():
    channel = Channel(('seq', 'v'), np.zeros((2, 2)), np.zeros(2, int), np.zeros(2, int))
    assert len(channel) == 2
    with pytest.raises(KeyError, match='records without w: they carry seq, v'):
        channel['w']

# SPDX-License-Identifier: Apache-2.0
"""What the kit reads from a stream of states: a right one, and each way to be wrong."""

import pytest

from dz_ros.core.records import State
from dz_ros.drivers.conformance.stream_checks import check_stream

T = 0.005
NAMES = ['order and labels', 'seq', 'stamps', 'echo', 'rate', 'latency']


def stream(count=200, **change):
    """Return states, arrivals and commands of a right node, changed as asked.

    Args:
        count: States.
        **change: Field of a state → function of k and the right value.
    """
    states = [State(k, k * T, (0.1, 0.2), k - 1, (k - 1) * T if k else 0.0, 0.0004)
              for k in range(count)]
    for name, function in change.items():
        states = [item._replace(**{name: function(k, getattr(item, name))})
                  for k, item in enumerate(states)]
    commands = {k: k * T for k in range(count)}
    return states, [100.0 + 0.0001 * (k % 3) + k * T for k in range(count)], commands


def results(states, arrivals, commands, stalls=()):
    return {item.name: item for item in check_stream(states, arrivals, commands, T, 2,
                                                     stalls=stalls)}


def test_a_right_stream_passes_everything():
    found = results(*stream())
    assert list(found) == NAMES
    assert all(item.passed for item in found.values())
    assert found['latency'].figure.startswith('round trip p50 0.400 ms')


def test_a_few_lost_samples_are_forgiven():
    states, arrivals, commands = stream()
    for index in (150, 50):
        del states[index], arrivals[index]
    assert all(item.passed for item in results(states, arrivals, commands).values())


def test_what_is_missing_while_the_machine_was_late_is_not_the_driver_s():
    states, arrivals, commands = stream()
    holes = range(10, 190, 6)       # three samples are missing after each
    keep = [k for k in range(200) if not any(hole < k <= hole + 3 for hole in holes)]
    lacking = [states[k] for k in keep], [arrivals[k] for k in keep], commands
    stalls = [(arrivals[k] + 0.001, arrivals[k] + 3.5 * T) for k in holes]
    assert results(*lacking)['seq'].passed is results(*lacking)['rate'].passed is False
    found = results(*lacking, stalls)
    assert all(item.passed for item in found.values())
    assert '30 while the machine was late' in found['seq'].figure
    assert '90 while the machine was late' in found['rate'].figure
    elsewhere = results(*lacking, [(arrivals[0] - 2.0, arrivals[0] - 1.0)])
    assert elsewhere['seq'].passed is False
    assert 'the machine was late too' in elsewhere['seq'].words
    assert 'for up to 1000.0 ms' in elsewhere['seq'].words


@pytest.mark.parametrize(('name', 'change', 'words'), [
    ('seq', {'seq': lambda k, seq: seq // 2}, 'count'),
    ('seq', {'seq': lambda k, seq: 2 * seq}, 'count'),
    ('seq', {'seq': lambda k, seq: 200 - seq}, 'count'),
    ('stamps', {'stamp': lambda k, stamp: stamp + 0.002}, 'k·T'),
    ('stamps', {'stamp': lambda k, stamp: 0.0}, 'k·T'),
    ('echo', {'echo_seq': lambda k, seq: seq + 100000}, 'was not sent'),
    ('echo', {'echo_stamp': lambda k, stamp: stamp + 0.001}, 'echo_stamp'),
    ('echo', {'echo_seq': lambda k, seq: max(199 - k, 0),
              'echo_stamp': lambda k, stamp: max(199 - k, 0) * T}, 'go back'),
    ('echo', {'echo_seq': lambda k, seq: -1, 'echo_stamp': lambda k, stamp: 0.0}, 'not at all'),
    ('rate', {'stamp': lambda k, stamp: 2.0 * stamp}, 'a period apart'),
    ('latency', {'round_trip': lambda k, trip: 0.0}, 'round_trip'),
    ('latency', {'round_trip': lambda k, trip: 0.02}, 'round_trip'),
    ('latency', {'round_trip': lambda k, trip: -0.001}, 'round_trip'),
    ('order and labels', {'x': lambda k, x: (float('nan'), 0.0)}, 'state 0 is not finite'),
])
def test_each_way_to_be_wrong_is_found(name, change, words):
    found = results(*stream(**change))
    assert found[name].passed is False
    assert words in found[name].words


def test_a_loop_time_that_does_not_run_as_the_wall_does_is_found():
    states, arrivals, commands = stream()
    found = results(states, [100.0 + 0.5 * (item - 100.0) for item in arrivals], commands)
    assert 'as the wall does' in found['rate'].words


def test_many_missing_samples_are_found():
    states, arrivals, commands = stream()
    keep = [k for k in range(200) if k % 5]
    found = results([states[k] for k in keep], [arrivals[k] for k in keep], commands)
    assert 'missing' in found['rate'].words


def held_back(trip):
    """Return the latency of a node that reports `trip(own)` where its answer took `own` [s]."""
    states, arrivals, commands = stream()
    taken = {k: 0.0025 if k % 10 == 0 else 0.0002 for k in commands}
    states = [item._replace(round_trip=trip(taken.get(item.echo_seq, 0.0))) for item in states]
    return {item.name: item for item in check_stream(states, arrivals, commands, T, 2,
                                                     taken)}['latency']


def test_a_round_trip_shows_the_time_that_answers_took():
    found = held_back(lambda own: own + 0.0003)
    assert found.passed
    assert '0 of 199 shorter' in found.figure
    made_up = held_back(lambda own: 0.001)
    assert made_up.passed is False
    assert 'does not show' in made_up.words
    assert '20 of 199 shorter' in made_up.figure    # k = 0, 10, …, 190


def test_too_few_states_are_not_judged():
    found = results(*stream(5))
    assert list(found) == ['order and labels', 'rate']
    assert 'too few' in found['rate'].words

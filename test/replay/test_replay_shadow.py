# SPDX-License-Identifier: Apache-2.0
"""Recorded and live answers side by side."""

from dataclasses import replace
import json
import math

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run, RunData
from dz_ros.core.loop.offline import simulate
from dz_ros.errors import RecordingError
from dz_ros.replay.shadow import compare_answers


@pytest.fixture(scope='module')
def run():
    return from_run(simulate(Configuration.from_flat({'loop.duration': 2.0})))


def changed(run, channel, label, seq, value):
    """The run with one number changed."""
    old = run.channels[channel]
    values = old.values.copy()
    values[seq, old.labels.index(label)] = value
    return replace(run, channels={**run.channels, channel: replace(old, values=values)})


def only(run, channel, rows):
    """The run with some rows of a channel."""
    old = run.channels[channel]
    new = replace(old, values=old.values[rows], log_time=old.log_time[rows],
                  publish_time=old.publish_time[rows])
    return replace(run, channels={**run.channels, channel: new})


def test_a_run_is_like_itself(run):
    found = compare_answers(run, run)
    assert found.same
    assert (found.recorded, found.live, found.compared) == (401, 401, 401)
    assert found.command.largest == 0.0
    assert {item.name for item in found.terms} >= {'s', 'u_fd', 'dt', 'status', 'theta1', 'phi'}
    assert found.first is None


def test_the_first_and_the_largest_difference_are_named(run):
    v = run.channels['command']['v']
    other = changed(changed(run, 'command', 'v', 17, v[17] + 0.25), 'command', 'v', 90, v[90] - 3)
    other = changed(other, 'terms', 'phi', 50, 9.0)
    found = compare_answers(run, other)
    assert not found.same
    assert found.command.differing == 2
    assert (found.command.first_seq, found.command.largest_seq) == (17, 90)
    assert found.command.largest == pytest.approx(3.0)
    assert found.first.seq == 17
    assert found.first.stamp == pytest.approx(17 * 0.005)
    assert (found.first.recorded, found.first.live) == (v[17], v[17] + 0.25)
    (phi,) = [item for item in found.terms if item.differing]
    assert (phi.name, phi.first_seq) == ('phi', 50)


def test_the_smallest_difference_counts_and_the_tolerance_passes_it(run):
    v = run.channels['command']['v'][5]
    other = changed(run, 'command', 'v', 5, np.nextafter(v, math.inf))
    assert compare_answers(run, other).command.first_seq == 5
    assert compare_answers(run, other, 1e-9).same


def test_a_nan_is_like_a_nan_and_unlike_any_number(run):
    holes = changed(run, 'terms', 's', 3, math.nan)
    assert compare_answers(holes, holes).same
    found = compare_answers(run, holes, 1e300)
    assert [item.name for item in found.terms if item.differing] == ['s']
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))['same'] is False


def test_missing_repeated_and_reordered_answers(run):
    rows = np.array([0, 1, 1, 3, 2, *range(4, 380)])
    found = compare_answers(run, only(run, 'command', rows))
    assert (found.recorded, found.live, found.compared) == (401, 380, 380)
    assert found.command.differing == 0
    assert not found.same


def test_terms_of_another_law_are_compared_as_far_as_they_go(run):
    other = from_run(simulate(Configuration.from_flat(
        {'loop.duration': 2.0, 'controller.law': 'pd'})))
    found = compare_answers(run, other)
    assert not found.same
    assert {'theta1', 'phi'} <= set(found.not_compared)
    assert 'v_damping' in {item.name for item in found.terms}


def test_nothing_to_compare_is_an_error(run):
    empty = RunData({'state': run.channels['state']})
    with pytest.raises(RecordingError, match='the run has no commands'):
        compare_answers(empty, run)
    with pytest.raises(RecordingError, match='live controller has no commands'):
        compare_answers(run, empty)

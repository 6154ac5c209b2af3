# SPDX-License-Identifier: Apache-2.0
"""One table from channels that are late, doubled, shuffled or not there at all."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core.dataset import Channel, RunData
from dz_ros.errors import RecordingError
from dz_ros.runs.sequence import DISORDER
from dz_ros.runs.table import RunTable

UNTIMED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])

NUMBERS = st.floats(-1e3, 1e3)


def test_a_clean_run_is_its_own_table(simulated):
    run = simulated()
    rows = RunTable.of(run)
    assert np.array_equal(rows.seq, np.arange(4001))
    assert np.array_equal(rows.t, run.channels['state']['stamp'])
    assert np.array_equal(rows.error[:, 1],
                          run.channels['state']['x1'] - run.channels['reference']['xd1'])
    assert np.array_equal(rows.v, run.channels['command']['v'])
    assert np.array_equal(rows.terms['phi'], run.channels['terms']['phi'])
    assert np.array_equal(rows.truth['w'], run.channels['truth']['w'])
    assert set(rows.missing.values()) == {0}
    assert (rows.carried, rows.not_finite, rows.restarts) == (0, 0, 0)
    assert all(count.clean for count in rows.counts.values())


def test_order_of_arrival_and_copies_do_not_matter(simulated, keep):
    run = simulated()
    random = np.random.default_rng(3)
    rows = np.concatenate([np.arange(4001), random.integers(1, 4001, 500)])
    late = np.where(rows, random.uniform(0.0, DISORDER - 1, len(rows)), 0.0)    # 0 comes first
    rows = rows[np.argsort(rows + late, kind='stable')]
    found = RunTable.of(keep(run, **dict.fromkeys(run.channels, rows)))
    expected = RunTable.of(run)
    for name in ('seq', 't', 'x', 'x_d', 'v'):
        assert np.array_equal(getattr(found, name), getattr(expected, name))
    assert found.counts['state'].repeated == 500
    assert found.counts['state'].reordered > 1000


def test_gaps_are_counted_and_left_empty(simulated, keep):
    run = simulated()
    all_but = np.setdiff1d(np.arange(4001), [10, 11, 500])
    rows = RunTable.of(keep(run, command=all_but, terms=all_but))
    assert np.flatnonzero(np.isnan(rows.v)).tolist() == [10, 11, 500]
    assert np.flatnonzero(np.isnan(rows.terms['s'])).tolist() == [10, 11, 500]
    assert rows.missing == {'reference': 0, 'command': 3, 'terms': 3, 'truth': 0}
    assert rows.counts['command'].missing == 3
    rows = RunTable.of(keep(run, state=all_but))
    assert len(rows.t) == 3998
    assert rows.counts['state'].missing == 3


def test_a_command_belongs_to_the_state_it_echoes_not_to_its_own_count(simulated):
    run = simulated()
    command = run.channels['command']
    values = command.values[5:].copy()
    values[:, 0] = np.arange(len(values))       # the controller counts its own answers
    shifted = Channel(command.labels, values, command.log_time[5:], command.publish_time[5:])
    rows = RunTable.of(replace(run, channels={**run.channels, 'command': shifted}))
    assert np.isnan(rows.v[:5]).all()
    assert np.array_equal(rows.v[5:], command['v'][5:])
    values[:, list(command.labels).index('echo_seq')] = -1.0    # a foreign one echoes nothing
    rows = RunTable.of(replace(run, channels={**run.channels, 'command': shifted}))
    assert np.array_equal(rows.v[:-5], command['v'][5:])


def test_a_missing_reference_is_made_from_its_neighbour(simulated, keep):
    run = simulated()
    rows = RunTable.of(keep(run, reference=np.setdiff1d(np.arange(4001), [700, 701, 702])))
    assert rows.carried == 3
    t = rows.t[700:703]
    # 5 ms of a sinusoid of amplitude 2.5: the series is wrong by 2.5 h³/6 at most
    assert np.abs(rows.x_d[700:703, 0] - 2.5 * np.sin(t)).max() < 2.5 * 0.01 ** 3 / 6.0 + 1e-12
    assert np.abs(rows.x_d[700:703, 0] - 2.5 * np.sin(t)).max() > 0.0


def test_a_state_after_a_skipped_period_gets_the_reference_of_its_own_stamp(simulated):
    run = simulated()
    state = run.channels['state']
    values = state.values.copy()
    values[2000:, 1] += 0.0025              # half a period later than the reference's stamps
    late = Channel(state.labels, values, state.log_time, state.publish_time)
    rows = RunTable.of(replace(run, channels={**run.channels, 'state': late}))
    assert rows.carried == 2001
    assert np.abs(rows.x_d[:, 0] - 2.5 * np.sin(rows.t)).max() < 1e-8
    values[2000:, 1] += 10.0                # no reference anywhere near
    rows = RunTable.of(replace(run, channels={**run.channels, 'state': late}))
    assert rows.missing['reference'] > 1900
    assert np.isnan(rows.error[-1]).all()


def test_channels_that_are_not_there_are_missing_not_wrong(simulated):
    run = simulated()
    rows = RunTable.of(replace(run, channels={'state': run.channels['state']}))
    assert np.isnan(rows.v).all()
    assert np.isnan(rows.x_d).all()
    assert rows.terms == rows.truth == rows.missing == {}


def test_what_is_not_finite_is_counted(simulated):
    run = simulated()
    state = run.channels['state']
    values = state.values.copy()
    values[7, 2] = np.inf
    values[8, 1] = np.nan
    rows = RunTable.of(replace(run, channels={**run.channels, 'state': Channel(
        state.labels, values, state.log_time, state.publish_time)}))
    assert rows.not_finite == 2
    assert 8 not in rows.seq
    assert 7 in rows.seq


@pytest.mark.parametrize('count', [0, 1])
def test_a_run_without_two_states_is_refused(simulated, keep, count):
    with pytest.raises(RecordingError, match=r'no two states.*reference'):
        RunTable.of(keep(simulated(), state=np.arange(count)))


def test_nothing_at_all_is_refused():
    with pytest.raises(RecordingError, match='channels with messages: none'):
        RunTable.of(RunData({}))


def test_a_run_whose_time_stands_still_is_refused(simulated):
    run = simulated()
    state = run.channels['state']
    values = state.values.copy()
    values[:, 1] = 3.0
    with pytest.raises(RecordingError, match='same stamp'):
        RunTable.of(replace(run, channels={'state': Channel(state.labels, values, state.log_time,
                                                            state.publish_time)}))

# SPDX-License-Identifier: Apache-2.0
"""Timing of runs whose times are known exactly."""

from __future__ import annotations

from dataclasses import replace
import json

import numpy as np
import pytest

from dz_ros.core.dataset import Channel
from dz_ros.runs.setting import Setting
from dz_ros.runs.timing import measure_timing, Spread

MS = 1_000_000


def timing_of(run):
    return measure_timing(run, Setting.of(run))


def test_an_even_run_is_on_time(simulated, over_topics):
    timing = timing_of(over_topics(simulated()))
    assert timing.judged
    assert set(timing.topics) == {'reference', 'state', 'command', 'terms', 'truth'}
    for topic in timing.topics.values():
        assert topic.clock == 'publish'
        assert topic.period.count == 4000
        assert topic.period.p50 == pytest.approx(0.005)
        assert topic.deviation.maximum < 1e-9
        assert (topic.within, topic.late, topic.too_late) == (1.0, 0, 0)
    assert timing.speed == pytest.approx(1.0)


def test_late_samples_are_counted_by_how_late_they_are(simulated, over_topics):
    timing = timing_of(over_topics(simulated(), {100: MS // 2, 200: 2 * MS, 300: 7 * MS}))
    topic = timing.topics['state']
    # half a millisecond is within, 2 ms is late, 7 ms is more than a whole period too late
    assert (topic.late, topic.too_late) == (2, 1)
    # one sample late makes one long and one short period
    assert topic.within == pytest.approx(1.0 - 4.0 / 4000.0)
    assert topic.deviation.maximum == pytest.approx(7e-3)
    assert topic.period.maximum == pytest.approx(12e-3)


def test_percentiles_are_those_of_the_sorted_values():
    values = np.random.default_rng(0).gamma(2.0, 1e-3, 1001)
    spread = Spread.of(np.append(values, np.nan))
    ranked = np.sort(values)
    assert spread.p50 == ranked[500]
    assert spread.p99 == pytest.approx(ranked[990])
    assert spread.p999 == pytest.approx(ranked[999])
    assert (spread.maximum, spread.count) == (ranked[-1], 1001)
    assert Spread.of(np.array([np.nan])) is None


def test_a_lost_message_is_lost_not_late(simulated, over_topics, keep):
    run = keep(over_topics(simulated()), state=np.setdiff1d(np.arange(4001), [50, 51]))
    topic = timing_of(run).topics['state']
    assert topic.sequence.missing == 2
    assert (topic.late, topic.period.count) == (0, 3997)


def test_latency_matches_question_and_answer(simulated, over_topics):
    run = over_topics(simulated())
    command = run.channels['command']
    values, published = command.values.copy(), command.publish_time.copy()
    values[:, 0] += 1000.0                      # its own count reports nothing of the question
    published[1234] += 3 * MS
    timing = timing_of(replace(run, channels={**run.channels, 'command': Channel(
        command.labels, values, command.log_time, published)}))
    found = timing.latencies
    assert found['publish'].p50 == pytest.approx(0.4e-3)
    assert found['publish'].maximum == pytest.approx(3.4e-3)
    assert found['log'].maximum == pytest.approx(0.4e-3)
    assert found['hold'].p50 == pytest.approx(0.2e-3)
    assert found['round_trip'].p50 == pytest.approx(0.6e-3)
    assert found['round_trip'].count == 4000    # the first state answers no command


def test_age_of_the_newest_command_in_whole_samples(simulated, over_topics):
    run = over_topics(simulated())
    state = run.channels['state']
    values = state.values.copy()
    stamp, echo = list(state.labels).index('stamp'), list(state.labels).index('echo_stamp')
    values[100:103, echo] = values[100:103, stamp] - 0.010
    timing = timing_of(replace(run, channels={**run.channels, 'state': Channel(
        state.labels, values, state.log_time, state.publish_time)}))
    assert timing.samples_late == {0: 3997, 1: 3}


def test_times_of_the_recorder_serve_where_there_are_no_others(simulated, over_topics):
    run = over_topics(simulated())
    logged = {name: Channel(channel.labels, channel.values, channel.log_time, channel.log_time)
              for name, channel in run.channels.items()}
    timing = timing_of(replace(run, channels=logged))
    assert {topic.clock for topic in timing.topics.values()} == {'log'}
    assert 'publish' not in timing.latencies
    assert timing.latencies['log'].p50 == pytest.approx(0.4e-3)


def test_an_offline_run_has_no_timing_and_reports_it(simulated):
    timing = timing_of(simulated())
    assert not timing.judged
    assert 'offline' in timing.note
    assert timing.latencies == {}
    assert timing.speed is None
    assert all(topic.period is None for topic in timing.topics.values())
    assert timing.topics['state'].sequence.clean


def test_a_lockstep_run_is_timed_but_not_judged(simulated, over_topics):
    run = replace(over_topics(simulated()), info={'mode': 'lockstep'})
    timing = timing_of(run)
    assert 'lockstep' in timing.note
    assert timing.topics['state'].period.p50 == pytest.approx(0.005)
    assert timing.topics['state'].late is timing.topics['state'].deviation is None


def test_empty_channels_and_no_configuration(simulated, over_topics, keep):
    run = keep(over_topics(simulated()), command=np.arange(0), terms=np.arange(1))
    timing = timing_of(replace(run, configuration={}))
    assert timing.topics['command'].period is timing.topics['terms'].period is None
    assert timing.period == pytest.approx(0.005)            # from the stamps
    assert set(timing.latencies) == {'round_trip'}


def test_timing_is_json(simulated, over_topics):
    for run in (simulated(), over_topics(simulated())):
        found = json.loads(json.dumps(timing_of(run).to_dict(), allow_nan=False))
        assert found['period'] == 0.005
        assert found['topics']['state']['messages'] == 4001


def test_transport_is_what_the_controller_did_not_hold(simulated, over_topics):
    run = over_topics(simulated())
    state = run.channels['state']
    values = state.values.copy()
    values[500, list(state.labels).index('round_trip')] = 2.2e-3
    values[900, list(state.labels).index('round_trip')] = 7.2e-3
    timing = timing_of(replace(run, channels={**run.channels, 'state': Channel(
        state.labels, values, state.log_time, state.publish_time)}))
    assert timing.latencies['transport'].p50 == pytest.approx(0.4e-3)
    assert timing.latencies['transport'].maximum == pytest.approx(7.0e-3)
    assert timing.late('round_trip') == (2, 1)
    assert timing.late('hold') == (0, 0)
    assert timing.to_dict()['latencies']['transport']['too_late'] == 1

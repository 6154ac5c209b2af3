# SPDX-License-Identifier: Apache-2.0
"""Histograms of a hop: against numpy's percentiles, classes and windows."""

import json
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core.loop.latency import edges, Latency, PER_DECADE, quantile
from dz_ros.core.safety.health import Level, Report

DURATIONS = st.lists(st.floats(0.0, 100.0), min_size=1, max_size=30)


def filled(values, period=0.005):
    latency = Latency(period)
    for value in values:
        latency.add(value)
    return latency


@given(DURATIONS)
def test_every_duration_lies_in_its_class(values):
    latency = filled(values)
    lowers, uppers = (0.0, *edges()), (*edges(), math.inf)
    expected = [sum(low * (1 + 1e-8) < v <= up * (1 + 1e-8) or (v == low == 0.0) for v in values)
                for low, up in zip(lowers, uppers, strict=True)]
    assert sum(latency.counts) == len(values) == latency.count
    assert np.abs(np.cumsum(latency.counts) - np.cumsum(expected)).max() <= sum(
        any(math.isclose(v, edge, rel_tol=1e-7) for edge in edges()) for v in values)


@given(DURATIONS)
def test_late_and_too_late_are_counted(values):
    latency = filled(values)
    assert latency.late == sum(v > 0.001 for v in values)
    assert latency.too_late == sum(v > 0.005 for v in values)
    assert latency.largest == max(values)


@pytest.mark.parametrize('share', [0.5, 0.99, 0.999])
def test_quantiles_are_those_of_numpy_within_a_class(share):
    values = np.random.default_rng(3).lognormal(math.log(3e-4), 0.7, 20_000)
    found = quantile(filled(values).counts, share)
    exact = np.percentile(values, 100.0 * share)
    assert exact * 0.999 <= found <= exact * 10.0 ** (1.0 / PER_DECADE) * 1.001


def test_a_report_begins_a_window_and_keeps_totals():
    latency, report = filled([0.0002] * 98 + [0.002, 0.006]), Report()
    latency.report(report, 'round trip', True)
    assert report.level is Level.OK
    assert report.values['round trip p50 [ms]'] == '0.200'
    assert report.values['round trip p99.9 [ms]'] == '6.000'
    assert report.values['round trip late (> 1 ms)'] == '2'
    assert report.values['round trip too late (> T)'] == '1'
    latency.add(0.0003)
    second = Report()
    latency.report(second, 'round trip', True)
    assert second.values['round trip max [ms]'] == '0.300'
    assert second.values['round trip too late (> T)'] == '1'


@pytest.mark.parametrize(('judged', 'level'), [(True, Level.WARN), (False, Level.OK)])
def test_many_answers_too_late_are_worth_a_warning_in_real_time(judged, level):
    latency, report = filled([0.0002] * 8 + [0.007] * 2), Report()
    latency.report(report, 'round trip', judged)
    assert report.level is level
    assert ('2 of 10 round trip too late' in report.message) is judged


@given(DURATIONS)
def test_a_summary_is_json_and_complete(values):
    summary = json.loads(json.dumps(filled(values).summary(), allow_nan=False))
    assert sum(summary['in_class']) == summary['count'] == len(values)
    assert len(summary['up_to']) == len(summary['in_class'])
    assert summary['max'] == max(values)


def test_nothing_counted_is_nothing_reported():
    report = Report()
    Latency(0.005).report(report, 'round trip', True)
    assert 'round trip p50 [ms]' not in report.values
    assert Latency(0.005).summary()['p50'] is None

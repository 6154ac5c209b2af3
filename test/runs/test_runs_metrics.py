# SPDX-License-Identifier: Apache-2.0
"""Metrics against the published figures, closed forms and plain loops."""

from __future__ import annotations

from dataclasses import replace
import itertools
import json
import math
from pathlib import Path

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.loop.compiled import quick
from dz_ros.core.records import Command, Reference, State
from dz_ros.errors import ConfigurationError
from dz_ros.report.view import View
from dz_ros.runs.metrics import (
    both_ways,
    choose_window,
    high_pass,
    high_passed,
    jsonable,
    Metrics,
    settled_after,
    SHORT,
    variation,
)
from dz_ros.runs.setting import Setting

UNTIMED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])

DATA = Path(__file__).parents[1] / 'data'


@pytest.fixture(scope='module')
def minute(simulated):
    """The paper's example over 60 s."""
    return View.of(simulated({'loop.duration': 60.0}))


def test_the_figures_of_the_mathematics(minute):
    m = minute.metrics
    assert m.window == (50.0, 60.0)
    assert m.samples == 2001
    assert m.error_max == pytest.approx(0.00843, abs=5e-6)
    assert m.error_rms == pytest.approx(0.00652, abs=5e-6)
    assert m.s_over_epsilon_max == pytest.approx(0.66, abs=5e-3)
    assert m.v_peak_run == pytest.approx(16.7, abs=0.05)
    assert m.settling_time == pytest.approx(4.11, abs=1e-9)
    assert m.v_variation == pytest.approx(5.6, abs=0.05)
    assert m.layer_share == m.omega_share == 1.0
    assert m.recovery_time is None


def test_the_figures_without_dead_zone_and_of_the_baseline(simulated):
    without = simulated({'loop.duration': 60.0, 'plant.dead_zone.b_r': 0.0,
                         'plant.dead_zone.b_l': 0.0})
    assert View.of(without).metrics.error_max == pytest.approx(0.0053, abs=5e-5)
    m = View.of(simulated({'loop.duration': 60.0, 'controller.law': 'pd'})).metrics
    assert m.error_max == pytest.approx(0.37, abs=5e-3)
    assert m.settling_time is None
    assert m.s_over_epsilon_max is m.layer_share is m.omega_share is None


def test_a_run_of_another_program_gives_what_plain_loops_give():
    """The reference run, made by an independent program, without terms and configuration."""
    table = np.loadtxt(DATA / 'wang2004_lambda1_rk4.csv', delimiter=',', skiprows=2)
    k, t, x, velocity, v = table[:, :5].T
    none, times = np.full(len(k), -1.0), (t * 1e9).astype(np.int64)
    zeros = np.zeros(len(k))

    def channel(labels, *columns):
        return Channel(labels, np.column_stack(columns), times, times)

    view = View.of(RunData({
        'state': channel(State.labels(2), k, t, x, velocity, none, zeros, zeros),
        'reference': channel(Reference.labels(2), k, t, 2.5 * np.sin(t), 2.5 * np.cos(t),
                             -2.5 * np.sin(t)),
        'command': channel(Command.labels(), k, t, v, k, t, zeros)},
        {'controller.lambda': 1.0, 'controller.epsilon': 0.02, 'controller.law': 'foreign'}))
    m = view.metrics
    last = [(float(x[i] - 2.5 * math.sin(t[i])), float(velocity[i] - 2.5 * math.cos(t[i])),
             float(v[i])) for i in range(len(k)) if t[i] >= 10.0 - 1e-9]
    assert m.samples == len(last)
    assert m.error_max == pytest.approx(max(abs(e) for e, _, _ in last), rel=1e-12)
    assert m.error_rms == pytest.approx(
        math.sqrt(math.fsum(e * e for e, _, _ in last) / len(last)), rel=1e-12)
    assert m.v_rms == pytest.approx(
        math.sqrt(math.fsum(u * u for _, _, u in last) / len(last)), rel=1e-12)
    assert m.v_variation == pytest.approx(
        math.fsum(abs(b[2] - a[2]) for a, b in itertools.pairwise(last)) / 10.0)
    assert m.s_over_epsilon_max == pytest.approx(max(abs(e + f) for e, f, _ in last) / 0.02)
    assert np.allclose(view.s, table[:, 8], atol=1e-10)
    outside = [i for i in range(len(k)) if abs(x[i] - 2.5 * math.sin(t[i])) >= 0.05]
    assert m.settling_time == t[max(outside) + 1]


def test_share_in_omega_is_a_plain_count(simulated):
    view = View.of(simulated({'controller.epsilon': 0.002, 'loop.duration': 30.0}))
    error, inside = view.rows.error, view.rows.t >= 20.0 - 1e-9
    assert view.metrics.omega_share == pytest.approx(
        np.mean([abs(e) <= 0.002 and abs(f) <= 0.004 for e, f in error[inside]]))
    assert view.metrics.layer_share == pytest.approx(np.mean(np.abs(view.s[inside]) <= 0.002))
    assert 0.0 < view.metrics.omega_share < 1.0


@pytest.mark.parametrize('frequency', [2.0, 10.0, 20.0, 60.0])
def test_high_pass_has_the_gain_of_butterworth_squared_and_no_phase(frequency):
    rate = 200.0
    t = np.arange(8000) / rate
    wave = np.sin(2.0 * np.pi * frequency * t)
    rest = high_passed(wave, rate)
    warp = math.tan(math.pi * 10.0 / rate) / math.tan(math.pi * frequency / rate)
    middle = slice(2000, 6000)
    gain = 2.0 * np.mean(rest[middle] * wave[middle])
    phase = 2.0 * np.mean(rest[middle] * np.cos(2.0 * np.pi * frequency * t[middle]))
    assert gain == pytest.approx(1.0 / (1.0 + warp ** 8), abs=1e-3)
    assert phase == pytest.approx(0.0, abs=1e-3)


def test_high_pass_of_what_has_no_fast_part_or_cannot_be_filtered():
    assert np.abs(high_passed(np.full(400, 3.0), 200.0)).max() < 1e-9
    assert high_passed(np.zeros(400), 20.0) is None         # 10 Hz is above half the rate
    assert high_passed(np.zeros(10), 200.0) is None
    assert high_passed(np.full(400, np.nan), 200.0) is None


def test_metrics_of_a_noisy_run_see_what_the_noise_costs(simulated, minute):
    noisy = View.of(simulated({'loop.duration': 60.0, 'plant.noise': (1e-3, 1e-2)})).metrics
    assert noisy.v_highpass == pytest.approx(1.40, abs=0.05)
    assert noisy.v_highpass > 50.0 * minute.metrics.v_highpass
    assert noisy.v_variation > 20.0 * minute.metrics.v_variation


def test_total_variation_of_a_sinusoid_is_four_amplitudes_a_period():
    t = np.arange(0.0, 10.0 + 1e-9, 1e-3)
    assert variation(t, 3.0 * np.sin(2.0 * np.pi * t)) == pytest.approx(12.0, rel=1e-4)
    v = np.where(np.arange(len(t)) % 7 == 3, np.nan, t)     # missing commands are left out
    assert variation(t, v) == pytest.approx(1.0)
    assert variation(t[:1], t[:1]) is None


@UNTIMED
@given(st.lists(st.floats(-1.0, 1.0, allow_nan=False), min_size=1, max_size=30),
       st.floats(0.01, 0.9), st.integers(0, 10))
def test_settling_is_the_first_instant_after_the_last_one_outside(errors, tolerance, since):
    t = np.arange(len(errors), dtype=float)
    expected = None
    for i in range(len(errors) - 1, -1, -1):
        if abs(errors[i]) >= tolerance or i < since:
            break
        expected = float(i)
    assert settled_after(t, np.array(errors), tolerance, float(since)) == expected


def test_settling_needs_to_last(simulated):
    t = np.linspace(0.0, 10.0, 1001)
    error = np.where(t < 9.5, 1.0, 0.0)
    assert settled_after(t, error, 0.05) == 9.5
    assert settled_after(t, error, 0.05, remain=1.0) is None
    assert settled_after(t, np.full(1001, np.nan), 0.05) is None


def test_recovery_counts_from_the_pulse(simulated):
    run = simulated()
    state = run.channels['state']
    values = state.values.copy()
    t = values[:, 1]
    hit = (t >= 12.0) & (t < 13.0)
    values[hit, 2] += np.exp(-5.0 * (t[hit] - 12.0))
    disturbed = replace(run, channels={**run.channels, 'state': Channel(
        state.labels, values, state.log_time, state.publish_time)})
    view = View.of(disturbed, pulse=12.0)
    error = np.abs(view.rows.error[:, 0])
    expected = t[np.flatnonzero(error >= 0.05)[-1] + 1] - 12.0
    assert view.metrics.recovery_time == pytest.approx(expected)
    assert 0.3 < expected < 1.0
    assert View.of(run, pulse=12.0).metrics.recovery_time == pytest.approx(0.0, abs=1e-9)
    assert View.of(run, pulse=99.0).metrics.recovery_time is None
    assert View.of(simulated({'controller.law': 'pd'}), pulse=12.0).metrics.recovery_time is None


def test_window_by_default_and_given(simulated):
    assert choose_window(np.linspace(0.0, 60.0, 601)) == (50.0, 60.0)
    assert choose_window(np.linspace(0.0, 4.0, 401)) == (2.0, 4.0)
    m = View.of(simulated(), window=(5.0, 6.0)).metrics
    assert (m.window, m.samples) == ((5.0, 6.0), 201)


@pytest.mark.parametrize('window', [(5.0, 5.0), (6.0, 5.0), (30.0, 40.0), (math.nan, 5.0)])
def test_a_window_that_is_none_is_refused(simulated, window):
    with pytest.raises(ConfigurationError, match=r'window = .*the run goes from 0 to 20 s'):
        View.of(simulated(), window=window)


@pytest.mark.parametrize('tolerance', [0.0, -1.0, math.nan])
def test_a_tolerance_that_is_none_is_refused(simulated, tolerance):
    with pytest.raises(ConfigurationError, match='tolerance'):
        View.of(simulated(), tolerance=tolerance)


def test_tolerance_is_the_examples_or_two_percent_of_the_motion(simulated):
    assert View.of(simulated()).metrics.tolerance == 0.05
    run = simulated({'plant.model': 'first_order', 'loop.duration': 2.0})
    expected = 0.02 * np.abs(run.channels['reference']['xd0']).max()
    assert View.of(run).metrics.tolerance == pytest.approx(expected)


def test_metrics_are_json_without_nan_and_described(minute, simulated):
    bare = View.of(replace(simulated(), channels={'state': simulated().channels['state']}))
    for view in (minute, bare):
        text = json.dumps(view.to_dict(), allow_nan=False)
        assert json.loads(text)['metrics']['samples'] == view.metrics.samples
    assert bare.metrics.error_max is bare.metrics.v_rms is None
    for name, metadata in Metrics.described():
        assert name in minute.metrics.to_dict()
        assert set(metadata) == {'label', 'unit', 'sentence'}


@UNTIMED
@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(),
                    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)))
def test_jsonable_leaves_no_nan(value):
    json.dumps(jsonable(value), allow_nan=False)
    assert jsonable(np.float64(math.inf)) is None
    assert jsonable((np.int64(3), np.bool_(True))) == [3, True]


def test_setting_knows_units_and_true_values(simulated):
    setting = Setting.of(simulated({'plant.b': 2.0, 'plant.a1': 3.0, 'plant.dead_zone.m_r': 1.25,
                                    'plant.dead_zone.m_l': 0.5, 'loop.duration': 1.0}))
    assert setting.true_signals['theta1'] == (3.0, 1.2)
    assert setting.true_signals['phi'] == (1.0, 0.4)
    assert [setting.unit(name) for name in ('x', 'x^(1)', 'x^(n-1)', 'v', 'v/s', 's')] == [
        '1', '1/s', '1/s', '1', '1/s', 's']
    run = replace(simulated(), configuration={'plant.model': 'not_installed', 'loop.rate': 200.0,
                                              'controller.lambda': 3.0, 'driver.name': 'x'})
    setting = Setting.of(run)
    assert (setting.configuration, setting.lambda_, setting.epsilon) == (None, 3.0, None)
    assert setting.unit('x') == setting.unit('v/s') == ''
    real = replace(simulated(), info={'mode': 'realtime'}, channels={
        name: channel for name, channel in simulated().channels.items() if name != 'truth'})
    assert not Setting.of(real).simulated
    assert Setting.of(real).true_signals == {}


def test_the_high_pass_is_the_same_where_it_is_compiled(monkeypatch):
    v = np.random.default_rng(3).standard_normal(500).cumsum()
    monkeypatch.setattr('dz_ros.runs.metrics.quick', lambda function: function)
    plain = both_ways(v, 200.0, 10.0)
    monkeypatch.undo()
    pytest.importorskip('numba', reason='numba is not installed: nothing is compiled')
    assert quick(high_pass) is not high_pass
    assert np.array_equal(both_ways(v, 200.0, 10.0), plain)


@pytest.mark.parametrize('rate', [50.0, 200.0, 1000.0])
@pytest.mark.parametrize('length', [30, 200, SHORT])
def test_the_high_pass_is_that_of_scipy(rate, length):
    signal = pytest.importorskip('scipy.signal')
    v = np.random.default_rng(length).standard_normal(length).cumsum() + 7.0
    sections = signal.butter(4, 10.0, 'highpass', fs=rate, output='sos')
    expected = signal.sosfiltfilt(sections, v)
    assert np.abs(both_ways(v, rate, 10.0) - expected).max() < 1e-9 * np.abs(v).max()
    longer = np.concatenate((v, np.full(SHORT, v[-1])))     # filtered by scipy itself
    assert high_passed(longer, rate).shape == longer.shape
    for whole in (v, longer):       # what is left out changes nothing of the rest
        for since in (0, 1, length // 2, length - 1):
            assert np.array_equal(high_passed(whole, rate, since=since),
                                  high_passed(whole, rate)[since:])

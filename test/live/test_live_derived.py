# SPDX-License-Identifier: Apache-2.0
"""Bounds and bands beside the rows, against the formulas written out and a simulated run."""

import asyncio
from dataclasses import replace
import json
import math

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import Status
from dz_ros.errors import ConfigurationError
from dz_ros.live import counts as counts_module
from dz_ros.live import recorded_source as recorded_module
from dz_ros.live.columns import Layout
from dz_ros.live.counts import counts
from dz_ros.live.derived import Deriver
from dz_ros.live.history import HEAD
from dz_ros.live.node_configurations import labels_of
from dz_ros.live.recorded_source import Recorded


def completed(values, *stated, flat=None):
    """Return name → column of rows given as name → numbers."""
    layout = Layout(labels_of(Configuration.from_flat(flat or {})))
    deriver = Deriver(layout)
    for time, configuration in stated:
        deriver.state(time, configuration)
    count = len(next(iter(values.values())))
    rows = np.full((count, layout.base), np.nan)
    for name, column in values.items():
        rows[:, layout.place(name)] = column
    found = deriver.complete(rows)
    return {name: found[:, place] for place, name in enumerate(layout.names)}


def test_what_follows_from_a_configuration():
    c = Configuration.from_flat({'controller.lambda': 2.0})
    found = completed({'published': [1.0, 2.0], 'stamp': [0.0, 0.5], 'x0': [1.0, 2.0],
                       'xd0': [0.5, 2.5], 's': [0.1, -0.2], 'phi': [0.5, 1.0],
                       'w': [0.0, 0.0]}, (0.0, c))
    epsilon = c.law.gains.epsilon
    assert found['error'].tolist() == [0.5, -0.5]
    assert found['s_over_epsilon'] == pytest.approx([0.1 / epsilon, -0.2 / epsilon])
    assert found['omega'] == pytest.approx([epsilon / 2.0] * 2)     # 2^0 λ^(1−2) ε
    b_r, m = c.controller_settings.b_r_bounds[1], c.controller_settings.m_bounds[1]
    assert found['band_high'] == pytest.approx([m * b_r * 0.5, m * b_r])
    assert found['band_low'] == pytest.approx([m * -0.7 * 0.5, m * -0.7])
    assert found['zone_high'].tolist() == [0.5, 0.5]
    assert found['zone_low'].tolist() == [-0.6, -0.6]


def test_the_bound_is_steady_where_terms_are_late_or_the_law_was_not_active():
    flat = {'controller.law': 'robust_eso'}
    c = Configuration.from_flat(flat)
    unit = c.law.gains.lambda_ ** (1 - c.plant.order)
    target = c.law.design.target / c.law.design.epsilon
    times, nan = np.arange(6.0), math.nan
    found = completed({'published': times, 'stamp': times, 's': 0.0 * times,
                       'epsilon': [nan, 0.04, nan, 0.0, nan, 0.05]}, (0.0, c), flat=flat)
    expected = [c.law.design.epsilon, 0.04, 0.04, 0.04, 0.04, 0.05]
    assert found['omega'] == pytest.approx([unit * target * each for each in expected])


def test_the_place_in_the_layer_is_unknown_while_the_law_is_not_active():
    c = Configuration.from_flat({'controller.law': 'robust_eso'})
    times = np.arange(4.0)
    found = completed({'published': times, 'stamp': times, 's': [0.0, 0.0, 0.1, 0.1],
                       'epsilon': [0.2] * 4, 'status': [
                           Status.INACTIVE, Status.INACTIVE | 1, 0.0, math.nan]}, (0.0, c),
                      flat={'controller.law': 'robust_eso'})
    assert found['s_over_epsilon'] == pytest.approx([math.nan, math.nan, 0.5, 0.5], nan_ok=True)


def test_a_drifting_dead_zone_drifts():
    c = Configuration.from_flat({'plant.dead_zone.b_r_drift': [0.1, 3.0]})
    stamps = np.linspace(0.0, 4.0, 9)
    found = completed({'published': stamps, 'stamp': stamps, 'w': 0.0 * stamps}, (0.0, c))
    assert found['zone_high'] == pytest.approx([0.5 + 0.1 * math.sin(3.0 * t) for t in stamps])


def test_a_change_holds_for_the_rows_published_after_it():
    before = Configuration.from_flat({})
    after = before.replace(**{'plant.dead_zone.b_r': 0.3})
    times = np.arange(10.0)
    found = completed({'published': times, 'stamp': times, 'w': 0.0 * times},
                      (0.0, before), (4.5, after))
    assert found['zone_high'].tolist() == [0.5] * 5 + [0.3] * 5


def test_nothing_is_made_up_where_nothing_is_known():
    found = completed({'published': [1.0], 'stamp': [0.0], 'x0': [1.0], 'xd0': [0.0]})
    assert found['error'].tolist() == [1.0]
    for name in ('omega', 's_over_epsilon', 'band_low', 'zone_high'):
        assert np.isnan(found[name]).all(), name


def test_intervals_are_between_neighbours_only():
    layout = Layout(labels_of(Configuration.from_flat({})))
    deriver = Deriver(layout)

    def intervals(seq, published):
        rows = np.full((len(seq), layout.base), np.nan)
        rows[:, 0], rows[:, 2] = seq, published
        return deriver.complete(rows)[:, layout.place('interval')]

    assert np.isnan(intervals([0.0], [10.0])).all()
    assert intervals([1.0, 2.0], [10.004, 10.01]) == pytest.approx([0.004, 0.006])
    found = intervals([5.0, 6.0], [10.03, 10.035])
    assert np.isnan(found[0])
    assert found[1] == pytest.approx(0.005)


@pytest.mark.parametrize('law', ['wang2004', 'robust', 'pd', 'adaptive_inverse', 'fuzzy'])
def test_every_kind_of_law_can_be_shown(law):
    run = from_run(simulate(Configuration.from_flat({
        'controller.law': law, 'loop.duration': 1.0, 'controller.override_checks': True})),
        10 ** 18)
    recorded = Recorded({'run': run})
    hello = recorded.hello()
    table = recorded.tables[0]
    names = [item['name'] for item in hello['columns']]
    assert len(table) == hello['lengths'][0] == 201
    v = table[:, names.index('v')]
    parts = sum(table[:, names.index(name)] for name in (
        'v_damping', 'v_feed_forward', 'v_regressor', 'v_robust', 'v_extra'))
    assert v == pytest.approx(parts)
    assert table[:, names.index('error')] == pytest.approx(
        table[:, names.index('x0')] - table[:, names.index('xd0')])
    inside = (table[:, names.index('v')] > table[:, names.index('zone_low')]) & (
        v < table[:, names.index('zone_high')])
    assert (table[inside, names.index('w')] == 0.0).all()


def test_a_run_of_many_events_is_introduced_in_few_texts():
    run = from_run(simulate(Configuration.from_flat({'loop.duration': 1.0})), 10 ** 18)
    events = tuple((10 ** 18 + number, '/plant_node', json.dumps(
        {'node': '/plant_node', 'event': 'mode', 'mode': 'lost'})) for number in range(3000))
    odd = ((10 ** 18, '', 'no JSON'), (10 ** 18, '', '[1]'), (10 ** 18, '', '{"event": 7}'))
    recorded = Recorded({'run': replace(run, events=events + odd)})
    reported = recorded.now()
    assert len(reported) == 1
    assert len(reported[0]['events']) == 3000    # what is no event is left out
    assert max(item['stamp'] for item in reported[0]['events']) < 1e-5
    assert json.dumps([recorded.hello(), *reported], allow_nan=False)


def test_a_long_run_is_thinned_without_losing_a_peak(monkeypatch):
    monkeypatch.setattr(recorded_module, 'MOST_ROWS', 400)
    c = Configuration.from_flat({'loop.duration': 20.0,
                                 'plant.disturbance_pulse': [11.03, 50.0, 0.01]})
    recorded = Recorded({'run': from_run(simulate(c), 10 ** 18)})
    table = recorded.tables[0]

    def ask(**limits):
        packed = asyncio.run(recorded.ask({'do': 'rows', 'id': 3, 'run': 0, **limits}))
        return np.frombuffer(packed, '<f8', offset=HEAD.size).reshape(-1, table.shape[1])

    rows = ask()
    assert len(rows) <= 1.3 * 400
    assert (np.diff(rows[:, 1]) > 0.0).all()
    for name in recorded_module.PEAK_COLUMNS:
        at = recorded.layout.place(name)
        assert np.nanmax(rows[:, at]) == np.nanmax(table[:, at])
        assert np.nanmin(rows[:, at]) == np.nanmin(table[:, at])
    pieces, taken = [], 0
    monkeypatch.setattr(recorded_module, 'PIECE', 90)
    while len(piece := ask(**{'from': 1.0, 'to': 9.0, 'skip': taken})):
        taken += len(piece)
        pieces.append(piece)
    assert len(pieces) > 10
    whole = table[(table[:, 1] >= 1.0) & (table[:, 1] < 9.0)]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)
    part = ask(**{'from': 11.0, 'to': 12.0})
    inside = (table[:, 1] >= 11.0) & (table[:, 1] <= 12.0)
    assert len(part) == inside.sum() + 1
    for wrong in ({'run': 1}, {'run': True}, {'run': 0, 'from': 'x'}, {},
                  {'run': 0, 'to': 10 ** 400}, {'run': 0, 'from': None}, {'run': 10 ** 400},
                  {'run': 0, 'skip': -1}, {'run': 0, 'skip': 1.5}, {'run': 0, 'skip': True}):
        with pytest.raises(ConfigurationError):
            asyncio.run(recorded.ask({'do': 'rows', 'id': 1, **wrong}))


@pytest.mark.parametrize(('name', 'base'), [('interval', 0.005), ('round_trip', 0.0)])
def test_times_are_counted_as_the_report_counts_them(name, base):
    rng = np.random.default_rng(7)
    values = np.concatenate([base + rng.exponential(1e-3, 5000), [np.nan, 0.0, -1.0],
                             base + np.array([0.0011, 0.0049, 0.0051, 3.0])])
    found = counts(values, name, 0.005)
    good = values[values > 0.0]
    assert found['count'] == len(good) == sum(found['bins'])
    assert found['late'] == sum(value - base > 1e-3 for value in good)
    assert found['too_late'] == sum(value - base > 0.005 for value in good)
    assert 2 <= found['too_late'] < found['late']
    assert found['p99'] == pytest.approx(np.quantile(good, 0.99), rel=2e-2)
    assert found['max'] == base + 3.0
    inside = (good >= found['low']) & (good < found['high'])
    expected, _ = np.histogram(good[inside], counts_module.BINS, (found['low'], found['high']))
    assert found['bins'][1:-1] == expected[1:-1].tolist()
    assert counts(np.array([np.nan, 0.0]), name, 0.005) == {'count': 0}

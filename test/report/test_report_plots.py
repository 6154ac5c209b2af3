# SPDX-License-Identifier: Apache-2.0
"""Pictures hold the data, name it with units, and leave it uncovered."""

from __future__ import annotations

from dataclasses import replace
import subprocess
import sys

import numpy as np
import pytest

from dz_ros.core.records import Status
from dz_ros.report import plots, plots_law, plots_timing
from dz_ros.report.report import pictures
from dz_ros.report.style import derivative, thin
from dz_ros.report.view import View

pytestmark = pytest.mark.slow

PNG = b'\x89PNG\r\n\x1a\n'
WITHOUT = {'plant.dead_zone.b_r': 0.0, 'plant.dead_zone.b_l': 0.0}
CASES = {
    'paper': {}, 'pd': {'controller.law': 'pd', 'loop.duration': 60.0},
    'first order': {'plant.model': 'first_order', 'loop.duration': 4.0},
    'third order': {'plant.model': 'valve_actuator', 'trajectory.amplitude': 0.02,
                    'loop.duration': 4.0},
    'noise': {'plant.noise': (1e-3, 1e-2), 'loop.delay': 2, 'plant.command_limit': 10.0,
              'loop.duration': 6.0},
    'two samples': {'loop.duration': 0.005},
}


def lines(picture, panel):
    """Return gid → (x, y) of a panel: what it really shows."""
    ax = picture.figure.axes[panel]
    return {item.get_gid(): (np.asarray(item.get_xdata()), np.asarray(item.get_ydata()))
            for item in ax.lines if item.get_gid()}


@pytest.fixture(scope='module')
def paper(simulated):
    return View.of(simulated())


def test_every_panel_over_time_holds_its_stretch_of_the_data(paper):
    rows = paper.rows
    stretches = [np.ones(len(rows.t), dtype=bool), rows.t <= 5.1375, rows.t >= 10.0 - 1e-9]
    for make, expected in ((plots.tracking, {'x': rows.x[:, 0], 'x_d': rows.x_d[:, 0]}),
                           (plots.error, {'error': rows.error[:, 0]}),
                           (plots.command, {'command': rows.v}),
                           (plots.filtered, {'s': rows.terms['s']}),
                           (plots_law.parts, {name: rows.terms[name] for name in (
                               'v_damping', 'v_feed_forward', 'v_regressor', 'v_robust')})):
        picture = make(paper)
        assert len(picture.figure.axes) == 3
        for panel, stretch in enumerate(stretches):
            shown = lines(picture, panel)
            for name, values in expected.items():
                assert np.array_equal(shown[name][0], rows.t[stretch])
                assert np.array_equal(shown[name][1], values[stretch])


def test_parts_sum_up_to_the_command(paper):
    shown = lines(plots_law.parts(paper), 0)
    total = sum(values for name, (_, values) in shown.items() if name != 'command')
    assert np.allclose(total, shown['command'][1], atol=1e-12)


def test_bounds_and_layer_are_where_the_theory_puts_them(simulated):
    view = View.of(simulated({'plant.model': 'valve_actuator', 'trajectory.amplitude': 0.02,
                              'controller.lambda': 4.0, 'controller.epsilon': 0.32,
                              'loop.duration': 4.0}))
    bounds = [item.get_ydata()[0] for item in plots.error(view).figure.axes[-1].lines
              if item.get_gid() == 'bound']
    assert sorted(bounds) == pytest.approx([-0.02, 0.02])       # λ^(1−3) ε
    layer = lines(plots.filtered(view), 0)['layer'][1]
    assert np.unique(np.abs(layer)) == pytest.approx([0.32])


def test_axes_carry_the_units_of_the_plant(simulated):
    view = View.of(simulated(CASES['third order']))
    for make, words in ((plots.tracking, '[m]'), (plots.error, '[m]'), (plots.command, '[V]'),
                        (plots.filtered, '[m/s²]'), (plots_law.dead_zone, '[V]')):
        figure = make(view).figure
        assert figure.axes[0].get_ylabel().endswith(words)
        assert any('[s]' in text for text in
                   [ax.get_xlabel() + ax.get_ylabel() for ax in figure.axes])
    assert [ax.get_ylabel()[-6:] for ax in plots.states(view).figure.axes[::2]] == [
        ' [m/s]', '[m/s²]']


def test_true_values_are_dashed_where_the_plant_is_known(simulated):
    run = simulated({'plant.b': 2.0, 'plant.a1': 3.0, 'loop.duration': 4.0})
    picture = plots_law.estimates(View.of(run))
    true = {item.get_gid(): item.get_ydata()[0] for ax in picture.figure.axes
            for item in ax.lines if str(item.get_gid()).endswith('_true')}
    assert true == {'theta1_true': 1.5, 'theta2_true': 0.5, 'phi_true': 0.5}
    assert np.array_equal(lines(picture, -1)['phi'][1], run.channels['terms']['phi'])
    real = replace(run, info={'mode': 'realtime'}, channels={
        name: channel for name, channel in run.channels.items() if name != 'truth'})
    picture = plots_law.estimates(View.of(real))
    assert not any(str(item.get_gid()).endswith('_true') for ax in picture.figure.axes
                   for item in ax.lines)
    assert 'Dashed' not in picture.caption


def test_estimates_of_samples_without_the_law_are_not_drawn(simulated):
    run = simulated({'loop.duration': 4.0})
    terms = run.channels['terms']
    values = terms.values.copy()
    estimate = float(values[399, terms.labels.index('theta1')])
    values[400:, terms.labels.index('status')] = Status.INACTIVE
    values[400:, terms.labels.index('theta1')] = 0.0
    picture = plots_law.estimates(View.of(replace(run, channels={
        **run.channels, 'terms': replace(terms, values=values)})))
    drawn = [item.get_ydata() for ax in picture.figure.axes for item in ax.lines
             if item.get_gid() == 'theta1'][-1]
    assert np.isfinite(drawn).sum() == 400
    assert f'At the end theta1 = {estimate:.4g}' in picture.caption


def test_estimates_of_different_size_get_panels_of_their_own(simulated):
    view = View.of(simulated({'controller.theta_0': (0.85, 40.0), 'loop.duration': 4.0}))
    names = [{item.get_gid() for item in ax.lines} for ax in
             plots_law.estimates(view).figure.axes]
    assert not any({'theta1', 'theta2'} <= panel for panel in names)
    alike = View.of(simulated({'controller.theta_0': (0.85, 1.0), 'loop.duration': 4.0}))
    assert {'theta1', 'theta2'} <= {item.get_gid() for item in
                                    plots_law.estimates(alike).figure.axes[0].lines}


def test_the_dead_zone_is_drawn_against_what_the_actuator_held(simulated):
    run = simulated({'loop.delay': 2, 'plant.command_limit': 10.0, 'loop.duration': 6.0,
                     'plant.dead_zone.m_r': 1.25, 'plant.dead_zone.m_l': 0.5,
                     'plant.dead_zone.m_r_drift': (0.2, 3.0)})
    view = View.of(run)
    held = np.clip(np.concatenate([[0.0, 0.0], run.channels['command']['v'][:-2]]), -10.0, 10.0)
    picture = plots_law.dead_zone(view)
    points = picture.figure.axes[0].collections[0]
    assert np.allclose(points.get_offsets()[:, 0], held, atol=1e-12)
    assert np.array_equal(points.get_offsets()[:, 1], run.channels['truth']['w'])
    assert np.array_equal(points.get_array(), view.rows.t)
    assert 'drift' in picture.caption


def test_without_a_configuration_the_slope_is_not_guessed(simulated):
    run = replace(simulated({'plant.dead_zone.m_r': 1.25}), configuration={})
    picture = plots_law.dead_zone(View.of(run))
    truth = run.channels['truth']
    points = picture.figure.axes[0].collections[0].get_offsets()
    assert np.allclose(points[:, 0], truth['w'] - truth['d'])
    assert 'm' in picture.figure.axes[0].get_xlabel()


def test_the_other_run_lies_behind(simulated, paper):
    other = View.of(simulated(WITHOUT))
    shown = lines(plots.error(other, 'error_without', paper), 0)
    assert np.array_equal(shown['error'][1], other.rows.error[:, 0])
    assert np.array_equal(shown['error_beside'][1], paper.rows.error[:, 0])
    window = plots.command(other, 'command_without', paper).figure.axes[-1]
    low, high = window.get_ylim()
    inside = paper.rows.v[paper.rows.t >= 10.0]
    assert low < inside.min()
    assert high > inside.max()


def test_histograms_hold_every_message(simulated, over_topics):
    view = View.of(over_topics(simulated(), {300: 300_000, 500: 2_000_000, 900: 80_000_000}))
    picture = plots_timing.periods(view)
    for ax, topic in zip(picture.figure.axes, view.timing.topics.values(), strict=False):
        drawn = sum(patch.get_height() for patch in ax.patches)
        low, high = ax.get_xlim()
        within = 1e3 * topic.period.values
        assert drawn == np.count_nonzero((within >= low) & (within <= high))
        beyond = int(topic.period.count - drawn)
        words = ' '.join(text.get_text() for text in ax.texts)
        assert words == (f'{beyond} beyond' if beyond else '')
        assert 'missing 0, late 2, too late 1' in ax.get_title('left')
    marks = {item.get_gid() for ax in plots_timing.latencies(view).figure.axes
             for item in ax.lines}
    assert {'publish_p50', 'publish_p99', 'publish_max', 'hold_p50', 'round_trip_p50'} <= marks


def test_gaps_are_shaded(simulated, keep):
    view = View.of(keep(simulated(), state=np.setdiff1d(np.arange(4001), np.arange(600, 660))))
    shaded = [patch for patch in plots.error(view).figure.axes[0].patches
              if patch.get_gid() == 'gap']
    assert len(shaded) == 1
    edges = shaded[0].get_extents().transformed(
        plots.error(view).figure.axes[0].transData.inverted())
    assert shaded[0].get_label() == 'no samples'
    assert edges.width > 0.0


@pytest.mark.parametrize('case', CASES)
def test_every_kind_of_run_can_be_drawn(simulated, over_topics, case):
    run = simulated(CASES[case])
    for data in (run, over_topics(run)):
        found = {picture.name: picture for picture in pictures(View.of(data))}
        assert {'tracking', 'error', 'command', 'filtered_error', 'dead_zone'} <= set(found)
        assert ('estimates' in found) == (case != 'pd')
        assert ('states' in found) == (case != 'first order')
        assert ('periods' in found) == ('latencies' in found) == (data is not run)
        for picture in found.values():
            assert picture.caption
            assert picture.alt
            assert 'nan' not in picture.caption.lower().split()


def test_legends_do_not_cover_data_and_text_stays_inside(paper):
    for picture in pictures(paper):
        assert picture.png().startswith(PNG)
        renderer = picture.figure.canvas.get_renderer()
        frame = picture.figure.bbox
        for ax in picture.figure.axes:
            box = ax.get_legend() and ax.get_legend().get_window_extent(renderer)
            if box:
                assert not any(box.overlaps(other.get_window_extent(renderer))
                               for other in picture.figure.axes)
                title = ax.title if not ax.get_title('left') else ax._left_title
                assert not box.overlaps(title.get_window_extent(renderer))
                assert frame.x0 <= box.x0
                assert box.x1 <= frame.x1


def test_a_long_line_keeps_its_peaks():
    random = np.random.default_rng(0)
    t = np.arange(100_000.0)
    y = random.standard_normal(100_000)
    y[[12_345, 99_999]] = 50.0, -50.0
    y[40_000:50_000] = np.nan
    few_t, few_y = thin(t, y, 1000)
    assert len(few_t) < 1100
    assert (np.nanmax(few_y), np.nanmin(few_y)) == (50.0, -50.0)
    assert np.isnan(few_y[(few_t > 40_200) & (few_t < 49_800)]).all()
    assert (np.diff(few_t) > 0.0).all()
    assert np.array_equal(y[few_t.astype(int)], few_y, equal_nan=True)
    assert thin(t[:1000], y[:1000], 1000)[1] is not None


def test_derivatives_are_named():
    assert [derivative('x', i) for i in range(4)] == ['x', r'\dot{x}', r'\ddot{x}', 'x^{(3)}']


def test_heavy_packages_are_imported_late_and_no_global_state_is_used():
    code = ('import sys; from dz_ros.report import compare, report; '
            'assert not {"matplotlib", "scipy", "rosbags"} & set(sys.modules); '
            'from dz_ros.core.configuration import Configuration; '
            'from dz_ros.core.loop.offline import simulate; '
            'from dz_ros.core.dataset import from_run; from dz_ros.report.view import View; '
            'run = from_run(simulate(Configuration.from_flat({"loop.duration": 1.0}))); '
            '[picture.png() for picture in report.pictures(View.of(run))]; '
            'import matplotlib; '
            'assert "matplotlib.pyplot" not in sys.modules; '
            'assert matplotlib.rcParams["font.size"] == matplotlib.rcParamsDefault["font.size"]')
    subprocess.run([sys.executable, '-c', code], check=True, timeout=120)

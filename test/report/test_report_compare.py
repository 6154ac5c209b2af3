# SPDX-License-Identifier: Apache-2.0
"""Runs side by side."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from dz_ros.core.dataset import from_run
from dz_ros.core.loop.offline import simulate
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration
from dz_ros.report.compare import compare, overlaid, write_comparison
from dz_ros.report.view import View
from dz_ros.runs.axes import named_axis


@pytest.fixture(scope='module')
def runs(simulated):
    return {'paper': simulated(), 'pd': simulated({'controller.law': 'pd'}),
            'λ = 3 <fast>': simulated({'controller.lambda': 3.0, 'loop.duration': 12.0})}


def test_the_table_has_each_runs_own_numbers(runs):
    table = {row[0]: row[1:] for row in compare(runs).rows()}
    for place, run in enumerate(runs.values()):
        assert table['max |x̃|'][place] == f'{View.of(run).metrics.error_max:.4g}'
    assert table['max |s| / ε'][1] == '–'
    assert table['settled after'][1] == 'never'
    assert 'recovered after the pulse' not in table
    assert 'never' in {row[0]: row[2] for row in compare(
        runs, window=(5.0, 12.0), pulse=6.0).rows()}['recovered after the pulse']


def test_a_window_given_is_everybodys(runs):
    views = compare(runs, window=(5.0, 12.0)).views
    assert {view.metrics.window for view in views.values()} == {(5.0, 12.0)}
    with pytest.raises(ConfigurationError, match='window'):
        compare(runs, window=(15.0, 20.0))


def test_a_tolerance_is_that_of_the_first_run_of_an_axis():
    def made(amplitude):        # of a plant whose x has a unit
        return from_run(simulate(load_configuration('servo', [
            'trajectory.kind=sinusoid', f'trajectory.amplitude={amplitude}',
            'loop.duration=1.0'])))

    runs = {'yaw0': named_axis(made(1.0), 'yaw'), 'surge0': named_axis(made(3.0), 'surge'),
            'yaw1': named_axis(made(4.0), 'yaw'), 'surge1': named_axis(made(5.0), 'surge')}
    own = {name: View.of(run).metrics.tolerance for name, run in runs.items()}
    assert len(set(own.values())) == 4

    def found(**given):
        return [view.metrics.tolerance for view in compare(runs, **given).views.values()]

    assert found() == [own['yaw0'], own['surge0'], own['yaw0'], own['surge0']]
    assert found(tolerance=0.5) == [0.5] * 4
    # A run whose axis is not known is compared as one of the same.
    of_one = {'a': runs['yaw0'], 'b': made(3.0)}
    views = compare(of_one).views
    assert [view.metrics.tolerance for view in views.values()] == [own['yaw0']] * 2


def test_what_differs_is_listed(runs, simulated):
    differing = {row[0]: row[1:] for row in compare(runs).differences()}
    assert differing['controller.law'] == ['wang2004', 'pd', 'wang2004']
    assert differing['controller.epsilon'] == ['0.02', '–', '0.02']
    assert differing['loop.duration'] == ['20.0', '20.0', '12.0']
    assert 'plant.model' not in differing
    assert compare({'a': simulated(), 'b': simulated()}).differences() == []


def test_every_run_is_a_line_of_its_own_colour(runs):
    comparison = compare(runs)
    found = {picture.name: picture for picture in overlaid(comparison)}
    assert set(found) == {'compare_error', 'compare_command', 'compare_layer'}
    colours = {}
    for name, values in (('compare_error', lambda view: view.rows.error[:, 0]),
                         ('compare_command', lambda view: view.rows.v),
                         ('compare_layer', lambda view: view.s / 0.02)):
        lines = {item.get_gid(): item for item in found[name].figure.axes[0].lines}
        assert ('pd' in lines) == (name != 'compare_layer')
        for label in set(lines) & set(runs):
            assert np.allclose(lines[label].get_ydata(), values(comparison.views[label]))
            assert colours.setdefault(label, lines[label].get_color()) == lines[label].get_color()
    assert len(set(colours.values())) == 3
    assert 'Without it: pd' in found['compare_layer'].caption


def test_numbers_are_json(runs):
    found = json.loads(json.dumps(compare(runs).to_dict(), allow_nan=False))
    assert list(found) == list(runs)
    assert found['pd']['metrics']['s_over_epsilon_max'] is None


def test_the_page_is_self_contained(runs, tmp_path):
    path = write_comparison(compare(runs), tmp_path / 'out', title='Three')
    source = path.read_text(encoding='utf-8')
    addresses = re.findall(r'(?:src|href)="([^"]*)"', source)
    assert len([item for item in addresses if item.startswith('data:image/png')]) == 3
    assert all(item.startswith(('data:', '#')) for item in addresses)
    assert '<fast>' not in source
    assert 'λ = 3 &lt;fast&gt;' in source
    assert sorted(item.name for item in path.parent.iterdir()) == [
        'compare_command.png', 'compare_error.png', 'compare_layer.png', 'comparison.html']


def test_one_run_is_nothing_to_compare(runs):
    with pytest.raises(ConfigurationError, match='at least two'):
        compare({'paper': runs['paper']})


def test_plants_of_different_order_and_unit_can_be_compared(simulated):
    found = compare({'example': simulated({'loop.duration': 4.0}), 'axis': simulated(
        {'plant.model': 'first_order', 'loop.duration': 4.0})})
    table = {row[0]: row[1:] for row in found.rows()}
    assert {view.metrics.tolerance for view in found.views.values()} == {0.05}  # the first one's
    assert table['max |x̃|'][1].endswith(' m/s')
    label = overlaid(found)[0].figure.axes[0].get_ylabel()
    assert '[' not in label                 # no unit is true for both

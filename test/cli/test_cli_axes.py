# SPDX-License-Identifier: Apache-2.0
"""The verbs of `dz` with several axes: each of them, or the one of --axis.

Over 300 lines: every verb, of one machine and its run.
"""

from __future__ import annotations

from dataclasses import replace
from html import escape
import json
import re

import numpy as np
import pytest

import dz_ros as dz
from dz_ros.cli.main import main
from dz_ros.core.dataset import from_run
from dz_ros.core.loop.offline import simulate
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration
from dz_ros.recording.reader import read_run
from dz_ros.recording.save import save_run
from dz_ros.report import sections
from dz_ros.report.view import View
from dz_ros.runs.axes import axis_run

FILE = """
loop: {axes: [surge, yaw], duration: 2.0}
controller: {b_r_bounds: [0.1, 0.6], b_l_bounds: [-0.7, -0.1], m_bounds: [0.85, 1.25],
             b_bounds: [1.0, 1.0]}
axes:
  yaw:
    controller: {lambda: 2.0}
    plant: {x0: [1.0, 0.0], dead_zone: {b_r: 0.3}}
"""


@pytest.fixture(scope='module')
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp('axes') / 'two.yaml'
    path.write_text(FILE, encoding='ascii')
    return str(path)


@pytest.fixture(scope='module')
def recorded(config, tmp_path_factory):
    path = tmp_path_factory.mktemp('runs') / 'two'
    assert main(['simulate', config, '--record', str(path)]) == 0
    return str(path)


def test_simulate_writes_all_axes_beside_each_other(config, capsys, tmp_path):
    out = tmp_path / 'samples.csv'
    assert main(['simulate', config, '--csv', str(out)]) == 0
    shown = capsys.readouterr().out
    assert [line.split(':')[0] for line in shown.splitlines() if line.startswith('axis')] == [
        'axis surge', 'axis yaw']
    table = np.genfromtxt(out, delimiter=',', names=True, deletechars='')
    for name in ('surge', 'yaw'):
        alone = simulate(load_configuration(config).axis(name))
        assert np.array_equal(table[f'{name}.v'], alone.v)
        assert np.array_equal(table[f'{name}.x0'], alone.x[:, 0])
    assert np.array_equal(table['k'], np.arange(401))


def test_one_axis_alone_is_a_run_of_one(config, capsys, tmp_path):
    out = tmp_path / 'alone'
    assert main(['simulate', config, '--axis', 'yaw', '--record', str(out)]) == 0
    capsys.readouterr()
    assert main(['bag', 'info', str(out)]) == 0
    assert 'axes:' not in capsys.readouterr().out


def test_check_speaks_of_each_axis(config, capsys):
    assert main(['check', config, '--quick', '--json']) in (0, 1)
    found = json.loads(capsys.readouterr().out)
    assert list(found['axes']) == ['surge', 'yaw']
    assert main(['check', config, '--quick', '--axis', 'yaw', '--json']) in (0, 1)
    assert json.loads(capsys.readouterr().out) == found['axes']['yaw']
    bad = ['--set', 'axes.yaw.controller.k_star=0.01']
    assert main(['check', config, '--quick', *bad]) == 1
    text = capsys.readouterr().out
    assert 'ERROR' not in text.partition('== axis yaw')[0]
    assert 'ERROR' in text.partition('== axis yaw')[2]


class Proposal:
    """What `tune` returns, of a gain that depends on the axis."""

    def __init__(self, before):
        value = 3.0 * before.law.gains.lambda_
        self.before, self.after = before, before.replace(**{'controller.lambda': value})
        self.reasons, self.rows = {'controller.lambda': 'three times'}, {}
        self.findings = ()


@pytest.fixture
def tuned(monkeypatch):
    """Return (effort, disturbance) of each call of `tune`, which proposes three times λ."""
    calls = []

    def tune(c, *values):
        calls.append(values)
        return Proposal(c)

    monkeypatch.setattr('dz_ros.cli.tune.tune', tune)
    return calls


def test_tune_writes_what_it_proposes_for_each_axis(config, capsys, tmp_path, tuned):
    out = tmp_path / 'tuned.yaml'
    assert main(['tune', config, '--out', str(out)]) == 0
    assert tuned == [(0.0, None)] * 2
    assert capsys.readouterr().out.count('three times') == 2
    written = load_configuration(out)
    assert [item.law.gains.lambda_ for item in written.each] == [3.0, 6.0]
    assert written.axis('yaw').dead_zone.b_r == 0.3


def test_tune_of_one_axis_writes_the_machine_with_its_gains_alone(config, capsys, tmp_path, tuned):
    out = tmp_path / 'tuned.yaml'
    assert main(['tune', config, '--axis', 'yaw', '--effort', '5', '--out', str(out)]) == 0
    assert tuned == [(5.0, None)]
    assert '== axis' not in capsys.readouterr().out
    before, after = (load_configuration(item).to_flat() for item in (config, out))
    assert {key: value for key, value in after.items() if before[key] != value} == {
        'axes.yaw.controller.lambda': 6.0}
    assert set(before) == set(after)


@pytest.mark.parametrize(('words', 'wanted'), [
    ('--effort 40', [(40.0, None), (40.0, None)]),
    ('--effort yaw=5', [(0.0, None), (5.0, None)]),
    ('--effort surge=40 --effort yaw=5 --effort yaw=6', [(40.0, None), (6.0, None)]),
    ('--effort yaw=5 --effort 40 --disturbance surge=0.5', [(40.0, 0.5), (5.0, None)]),
    ('--axis yaw --effort yaw=5 --disturbance 0', [(5.0, 0.0)])])
def test_tune_takes_a_value_for_all_axes_or_for_one(config, capsys, tuned, words, wanted):
    assert main(['tune', config, *words.split()]) == 0
    assert tuned == wanted


@pytest.mark.parametrize(('words', 'wanted'), [
    ('--effort jaw=5', "--effort = 'jaw=5': names axis jaw, must be one of surge, yaw; did you "
     'mean yaw?'),
    ('--disturbance yaw=', "--disturbance = 'yaw=': must be a finite number >= 0"),
    ('--effort yaw=-1', "--effort = 'yaw=-1': must be a finite number > 0"),
    ('--effort 5 --effort yaw=0', "--effort = 'yaw=0': must be a finite number > 0"),
    ('--disturbance -1', "--disturbance = '-1': must be a finite number >= 0"),
    ('--effort =1', "--effort = '=1': must be"), ('--effort inf', "--effort = 'inf': must be"),
    ('--axis yaw --effort surge=5', "--effort = 'surge=5': is of another axis than yaw"),
    ('--axis jaw', "--axis = 'jaw': must be one of surge, yaw"),
    ('--out /no/such/folder/tuned.yaml', '/no/such/folder: no such directory')])
def test_what_tune_is_not_given_rightly_is_one_line_before_anything_is_computed(
        config, capsys, tuned, words, wanted):
    assert main(['tune', config, *words.split()]) == 2
    assert wanted in (error := capsys.readouterr().err)
    assert error.count('\n') == 1
    assert tuned == []


def test_tune_names_the_axis_whose_effort_is_too_little(config, capsys, monkeypatch):
    def tune(c, effort, _):
        if effort:
            raise ConfigurationError('--effort', effort, 'no slope keeps within it')
        return Proposal(c)

    assert main(['tune', 'robust', '--effort', 'yaw=1']) == 2
    assert 'one axis, without a name: give the number alone' in capsys.readouterr().err
    monkeypatch.setattr('dz_ros.cli.tune.tune', tune)
    assert main(['tune', config, '--effort', 'yaw=1']) == 2
    assert capsys.readouterr().err == (
        'dz: error: axis yaw: --effort = 1.0: no slope keeps within it\n')
    assert main(['tune', 'robust', '--effort', '1']) == 2
    assert capsys.readouterr().err == 'dz: error: --effort = 1.0: no slope keeps within it\n'


@pytest.mark.slow
def test_what_is_tuned_for_one_axis_is_a_machine_that_runs(capsys, tmp_path):
    out = str(tmp_path / 'tuned.yaml')
    assert main(['tune', 'rov_planar', '--duration', '1', '--axis', 'yaw', '--effort', 'yaw=5',
                 '--out', out]) == 0
    assert 'configuration, the other axes at rest' in capsys.readouterr().out
    assert main(['check', out, '--quick']) == 0
    assert main(['simulate', out, '--record', str(tmp_path / 'run')]) == 0
    assert read_run(tmp_path / 'run').axes == ('surge', 'sway', 'yaw')
    before, after = load_configuration('rov_planar'), load_configuration(out)
    for name in ('surge', 'sway'):
        assert after.axis(name).law.gains == before.axis(name).law.gains
    assert after.axis('yaw').law.gains != before.axis('yaw').law.gains


def test_info_names_the_axes(recorded, capsys):
    assert main(['bag', 'info', recorded]) == 0
    assert 'axes: surge, yaw' in capsys.readouterr().out


def test_audit_audits_each_axis_or_one(recorded, capsys):
    assert main(['bag', 'audit', recorded]) == 0
    assert capsys.readouterr().out.count('reproduced bit for bit') == 2
    assert main(['bag', 'audit', recorded, '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert {name: item['checked'] for name, item in found['axes'].items()} == {
        'surge': 401, 'yaw': 401}
    assert main(['bag', 'audit', recorded, '--axis', 'yaw', '--json']) == 0
    assert json.loads(capsys.readouterr().out) == found['axes']['yaw']
    assert main(['bag', 'audit', recorded, '--axis', 'jaw']) == 2
    assert 'must be one of surge, yaw' in capsys.readouterr().err


def test_another_configuration_fails_the_audit_of_its_axis_alone(recorded, config, capsys):
    given = ['--config', config, '--set', 'axes.yaw.controller.lambda=2.5']
    assert main(['bag', 'audit', recorded, *given, '--json']) == 1
    found = json.loads(capsys.readouterr().out)['axes']
    assert found['surge']['differences'] == 0
    assert found['yaw']['differences'] > 0


def test_export_names_the_columns_of_each_axis(recorded, config, capsys, tmp_path):
    out = tmp_path / 'table.csv'
    assert main(['bag', 'export', recorded, '--out', str(out)]) == 0
    assert 'yaw.x0' in capsys.readouterr().out
    table = np.genfromtxt(out, delimiter=',', names=True, deletechars='')
    alone = simulate(load_configuration(config).axis('yaw'))
    assert np.array_equal(table['yaw.v'], alone.v)
    assert 'surge.seq' not in table.dtype.names


def test_compare_lays_the_axes_of_a_run_side_by_side(recorded, capsys):
    assert main(['bag', 'compare', recorded, '--json']) == 0
    assert list(json.loads(capsys.readouterr().out)) == ['surge', 'yaw']


@pytest.fixture(scope='module')
def vehicle(tmp_path_factory):
    """Return the path of a run whose axes have other ranges, so other tolerances."""
    path = tmp_path_factory.mktemp('runs') / 'rov'
    assert main(['simulate', 'rov_planar', '--duration', '3', '--record', str(path)]) == 0
    return str(path)


@pytest.mark.slow
def test_axes_side_by_side_have_each_its_own_numbers(vehicle, capsys, tmp_path):
    """The tolerance of settling is in the unit of an axis: it is not that of the first one."""
    run, out = read_run(vehicle), tmp_path / 'out'
    views = {axis: View.of(axis_run(run, axis)) for axis in run.axes}
    assert len({view.metrics.tolerance for view in views.values()}) > 1
    capsys.readouterr()
    assert main(['report', vehicle, '--json', '--out', str(out)]) == 0
    reported = json.loads(capsys.readouterr().out)['axes']
    assert main(['bag', 'compare', vehicle, '--json']) == 0
    compared = json.loads(capsys.readouterr().out)
    for axis, view in views.items():
        assert reported[axis].pop('verdict')
        assert reported[axis] == compared[axis] == json.loads(json.dumps(view.to_dict()))
    rows = tables_of(out / 'report.html')
    for label, *cells in sections.metric_rows(list(views.values())):
        assert [escape(text) for text in (label, *cells[:-1])] in rows
    both = dz.read(vehicle)
    found = dz.compare(*(both.axis(axis) for axis in run.axes)).comparison
    assert [view.metrics for view in found.views.values()] == [
        view.metrics for view in views.values()]


def test_a_page_of_two_runs_has_the_numbers_of_their_comparison(vehicle, capsys, tmp_path,
                                                                monkeypatch):
    other, served = str(tmp_path / 'other'), []
    assert main(['simulate', 'rov_planar', '--duration', '3', '--set',
                 'axes.yaw.trajectory.amplitude=0.2', '--record', other]) == 0
    tolerances = [View.of(axis_run(read_run(item), 'yaw')).metrics.tolerance
                  for item in (vehicle, other)]
    assert tolerances[0] != tolerances[1]
    monkeypatch.setattr('dz_ros.cli.serve.serve', lambda *given: served.append(given[1]) or 0)
    capsys.readouterr()
    assert main(['report', vehicle, '--serve', '--over', other]) == 0
    capsys.readouterr()
    assert main(['bag', 'compare', vehicle, other, '--json']) == 0
    found = json.loads(capsys.readouterr().out)['axes']
    assert {axis: item.to_dict() for axis, item in served[0].items()} == found


@pytest.mark.parametrize('words', [['--json'], ['--out', 'somewhere']], ids=' '.join)
def test_a_page_that_is_served_writes_no_report(recorded, capsys, words):
    assert main(['report', recorded, '--serve', *words]) == 2
    out, error = capsys.readouterr()
    assert out == ''
    assert error.startswith(f'dz: error: {words[0]} = ')
    assert 'does not go with --serve' in error
    assert error.count('\n') == 1


@pytest.mark.parametrize('verb', ['whatif', 'simulate'])
def test_an_axis_that_ran_alone_is_compared_with_the_run_it_came_from(recorded, config, capsys,
                                                                      tmp_path, verb):
    alone = str(tmp_path / 'alone')
    if verb == 'whatif':
        words = ['bag', 'whatif', recorded, '--set', 'controller.lambda=3', '--out',
                 str(tmp_path / 'whatif')]
    else:
        words = ['simulate', config, '--set', 'axes.yaw.controller.lambda=3']
    assert main([*words, '--axis', 'yaw', '--record', alone]) == 0
    capsys.readouterr()
    for pair in ([recorded, alone], [alone, recorded]):
        assert main(['bag', 'compare', *pair, '--axis', 'yaw', '--json']) == 0
        found = json.loads(capsys.readouterr().out)
        assert [item['metrics']['tolerance'] for item in found.values()] == [
            next(iter(found.values()))['metrics']['tolerance']] * 2
        assert main(['bag', 'compare', *pair]) == 2
        error = capsys.readouterr().err
        assert 'alone has axis yaw alone' in error
        assert error.endswith('; choose it with --axis yaw\n')
    for words in (['report', alone, '--axis', 'yaw', '--json'],
                  ['bag', 'audit', alone, '--axis', 'yaw'], ['bag', 'audit', alone]):
        assert main(words) == 0
    assert main(['bag', 'compare', recorded, alone, '--axis', 'surge']) == 2
    assert 'has no axis surge: it is of axis yaw alone\n' in capsys.readouterr().err


def test_an_axis_of_a_coupled_law_that_ran_alone_is_audited_alone(capsys, tmp_path):
    alone = str(tmp_path / 'alone')
    assert main(['simulate', 'two_link_arm', '--axis', 'elbow', '--duration', '0.2', '--record',
                 alone]) == 0
    assert main(['bag', 'audit', alone]) == 0


@pytest.mark.parametrize('axes', [5, True, 'yaw', {'yaw': 1}, [['yaw']]])
def test_a_recording_that_states_no_axes_rightly_is_one_line(capsys, tmp_path, axes):
    path = tmp_path / 'odd'
    run = from_run(simulate(load_configuration('wang2004', ['loop.duration=0.2'])))
    save_run(replace(run, configuration={**run.configuration, 'loop.axes': axes}), path)
    for verb, words in (('report', '--json'), ('bag compare', '--json'), ('bag audit', '--json'),
                        ('bag whatif', '--set controller.lambda=3'), ('report', '--serve'),
                        ('bag compare', str(path))):
        assert main([*verb.split(), str(path), *words.split(), '--axis', 'yaw']) == 2, words
        out, error = capsys.readouterr()
        assert out == ''
        assert 'one axis, without a name' in error
        assert error.count('\n') == 1


@pytest.mark.slow
def test_a_summary_replaces_the_report_of_one_axis(recorded, tmp_path):
    out = tmp_path / 'out'
    assert main(['report', recorded, '--axis', 'yaw', '--out', str(out)]) == 0
    assert (out / 'tracking.png').is_file()
    assert main(['report', recorded, '--out', str(out)]) == 0
    assert {item.name for item in out.iterdir() if not item.is_dir()} == {
        'report.html', 'compare_error.png', 'compare_command.png', 'compare_layer.png'}


def test_axes_side_by_side_are_titled_with_their_run(recorded, tmp_path):
    assert main(['bag', 'compare', recorded, '--out', str(tmp_path)]) == 0
    assert '<h1>two: surge · yaw</h1>' in (tmp_path / 'comparison.html').read_text('utf-8')


@pytest.fixture(scope='module')
def slower(config, tmp_path_factory):
    """Return the path of a run whose delay differs in both axes, and a gain in one."""
    path = tmp_path_factory.mktemp('runs') / 'slower'
    assert main(['simulate', config, '--set', 'axes.yaw.controller.lambda=1.5', '--set',
                 'loop.delay=1', '--record', str(path)]) == 0
    return str(path)


def test_compare_of_two_runs_has_a_summary_and_a_page_for_each_axis(recorded, slower, capsys,
                                                                    tmp_path):
    out = tmp_path / 'out'
    for name in ('compare_error.png', 'of_mine.txt'):
        out.mkdir(exist_ok=True)
        (out / name).write_text('before')
    assert main(['bag', 'compare', recorded, slower, '--out', str(out)]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert [line for line in shown if line.startswith('axis ')] == ['axis surge', 'axis yaw']
    assert shown[-1] == f'comparison: {out}/comparison.html'
    assert sorted(item.name for item in out.iterdir()) == [
        'comparison.html', 'of_mine.txt', 'surge', 'yaw']
    rows = tables_of(out / 'comparison.html')
    assert rows[0] == ['quantity', 'run', 'surge', 'yaw']
    assert ['controller.lambda', 'yaw', '2.0', '1.5'] in rows
    assert ['loop.delay', 'all', '0', '1'] in rows
    assert main(['bag', 'compare', recorded, slower, '--json']) == 0
    found = json.loads(capsys.readouterr().out)['axes']
    summary = (out / 'comparison.html').read_text(encoding='utf-8')
    for axis in ('surge', 'yaw'):
        assert f'href="{axis}/comparison.html"' in summary
        page = (out / axis / 'comparison.html').read_text(encoding='utf-8')
        assert f'<h1>axis {axis}: two · slower</h1>' in page
        assert (out / axis / 'compare_error.png').stat().st_size > 1000
        assert main(['bag', 'compare', recorded, slower, '--json', '--axis', axis]) == 0
        assert json.loads(capsys.readouterr().out) == found[axis]
    for run in ('two', 'slower'):
        assert ['max |x̃|', run, *(f'{found[axis][run]["metrics"]["error_max"]:.4g}'
                                   for axis in ('surge', 'yaw'))] in rows


def tables_of(path):
    """Return the rows of all tables of a page, their texts."""
    cells = re.compile(r'<t[hd][^>]*>(.*?)</t[hd]>')
    return [cells.findall(row) for row in
            re.findall(r'<tr[^>]*>(.*?)</tr>', path.read_text(encoding='utf-8'))]


def test_runs_with_other_axes_are_not_compared(recorded, config, capsys, tmp_path):
    three, one = str(tmp_path / 'three'), str(tmp_path / 'one')
    assert main(['simulate', config, '--duration', '0.5', '--set', 'loop.axes=[yaw,roll,surge]',
                 '--record', three]) == 0
    assert main(['simulate', '--duration', '0.5', '--record', one]) == 0
    capsys.readouterr()
    for words, wanted in (
            (['bag', 'compare', recorded, three], 'same axes: only three has axis roll\n'),
            (['bag', 'compare', recorded, one, '--json'],
             'same axes: two has axes surge, yaw, one has one axis, without a name\n'),
            (['bag', 'compare', one, recorded],
             'same axes: one has one axis, without a name, two has axes surge, yaw\n'),
            (['bag', 'compare', three, recorded, '--axis', 'roll'], 'has no axis roll: it has'),
            (['report', recorded, '--serve', '--over', three], 'only three has axis roll\n'),
            (['report', recorded, '--serve', '--axis', 'roll'], 'has no axis roll: it has')):
        assert main(words) == 2
        out, error = capsys.readouterr()
        assert out == ''
        assert wanted in error
        assert error.count('\n') == 1
    assert not list(tmp_path.glob('*-comparison'))
    # The axes are compared by their names, in the order of the first run.
    assert main(['bag', 'compare', three, recorded, '--axis', 'yaw', '--json']) == 0


@pytest.mark.slow
def test_a_report_has_a_summary_and_a_page_for_each_axis(recorded, capsys, tmp_path):
    out = tmp_path / 'report'
    assert main(['report', recorded, '--out', str(out)]) == 0
    assert capsys.readouterr().out.count('verdict:') == 2
    summary = (out / 'report.html').read_text(encoding='utf-8')
    for name in ('surge', 'yaw'):
        assert f'href="{name}/report.html"' in summary
        page = (out / name / 'report.html').read_text(encoding='utf-8')
        assert f'axis {name}' in page
        assert (out / name / 'tracking.png').stat().st_size > 1000
    assert 'controller.lambda' in summary       # in which they differ
    assert '<img' in summary


def test_whatif_and_other_verbs_of_one_axis_ask_for_it(recorded, config, capsys, tmp_path):
    for words in (['bag', 'whatif', recorded, '--fit'], ['certify', config]):
        assert main(words) == 2, words
        error = capsys.readouterr().err
        assert 'axis' in error, words
        assert error.count('\n') == 1
    out = tmp_path / 'whatif'
    assert main(['bag', 'whatif', recorded, '--axis', 'yaw', '--set', 'controller.lambda=3',
                 '--out', str(out), '--record', str(tmp_path / 'made')]) == 0
    capsys.readouterr()
    assert main(['bag', 'audit', str(tmp_path / 'made')]) == 0
    assert main(['bag', 'info', str(tmp_path / 'made')]) == 0
    assert 'axes:' not in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize('name', ['two', 'rov_planar'])
def test_whatif_without_an_axis_is_of_all_of_them(config, capsys, tmp_path, name):
    run, made, out = (str(tmp_path / item) for item in ('run', 'made', 'out'))
    own = ['--set', 'loop.duration=0.5']
    assert main(['simulate', config if name == 'two' else name, *own, '--record', run]) == 0
    axes = read_run(run).axes
    capsys.readouterr()
    # What it had: the same run again, bit for bit, through two files.
    assert main(['bag', 'whatif', run, *own, '--out', out, '--record', made]) == 0
    shown = capsys.readouterr().out
    assert [line for line in shown.splitlines() if line.startswith('axis ')] == [
        f'axis {axis}' for axis in axes]
    assert f'0.5 s of loop, {len(axes)} axes, in ' in shown
    assert shown.splitlines()[-1] == f'comparison: {out}/comparison.html'
    summary = (tmp_path / 'out' / 'comparison.html').read_text(encoding='utf-8')
    for axis in axes:
        assert f'href="{axis}/comparison.html"' in summary
        assert (tmp_path / 'out' / axis / 'comparison.html').is_file()
    for topic, channel in read_run(run).channels.items():
        again = read_run(made).channels[topic]
        assert again.axes == axes
        assert np.array_equal(again.values, channel.values, equal_nan=True)
    assert main(['bag', 'audit', made]) == 0


def test_whatif_of_an_axis_that_others_depend_on_simulates_all(capsys, tmp_path):
    run, made, out = (str(tmp_path / item) for item in ('run', 'made', 'out'))
    assert main(['simulate', 'rov_planar', '--duration', '0.5', '--record', run]) == 0
    capsys.readouterr()
    assert main(['bag', 'whatif', run, '--axis', 'yaw', '--set', 'controller.lambda=3', '--out',
                 out, '--record', made]) == 0
    shown = capsys.readouterr().out
    assert 'axis yaw\n' in shown
    assert 'axis surge' not in shown
    assert '3 axes' in shown
    assert f'comparison: {out}/comparison.html' in shown
    before, after = read_run(run), read_run(made)
    assert after.axes == before.axes
    assert after.configuration['axes.yaw.controller.lambda'] == 3.0
    assert after.configuration['controller.lambda'] == before.configuration['controller.lambda']
    assert not np.array_equal(axis_run(before, 'surge').channels['state'].values,
                              axis_run(after, 'surge').channels['state'].values)
    for words, wanted in (
            (['--axis', 'yaw', '--fit'], '--fit = True: fits one axis that neither plant nor law'),
            (['--axis', 'yaw', '--set', 'plant.mass=20'],
             'axes.yaw.plant.mass = 20.0: must be the same for all axes'),
            (['--axis', 'jaw', '--set', 'controller.lambda=3'], 'did you mean yaw'),
            (['--set', 'axes.jaw.controller.lambda=3'], 'did you mean yaw')):
        assert main(['bag', 'whatif', run, *words]) == 2
        error = capsys.readouterr().err
        assert wanted in error
        assert error.count('\n') == 1


@pytest.mark.slow
def test_whatif_takes_what_ran_from_a_file_for_all_axes(recorded, config, capsys, tmp_path):
    assert main(['bag', 'whatif', recorded, '--config', config, '--set', 'loop.duration=0.5',
                 '--out', str(tmp_path / 'out'), '--record', str(tmp_path / 'made')]) == 0
    made = read_run(tmp_path / 'made')
    assert made.configuration == {**read_run(recorded).configuration, 'loop.duration': 0.5}
    for words, wanted in (
            (['two_link_arm'], "--config = 'two_link_arm': is of axes shoulder, elbow, and lacks "
             'axes surge, yaw of the run'),
            (['wang2004'], "--config = 'wang2004': is of one axis, without a name, and lacks"),
            (['two_link_arm', '--axis', 'yaw'], 'and lacks axis yaw of the run')):
        assert main(['bag', 'whatif', recorded, '--set', 'loop.duration=0.5', '--config',
                     *words]) == 2
        assert wanted in capsys.readouterr().err


@pytest.mark.slow
def test_whatif_of_one_axis_needs_no_other_of_the_file_and_keeps_its_noise(capsys, tmp_path):
    """But where plant or law couple the axes: then all are needed."""
    own, both, run = (str(tmp_path / item) for item in ('own.yaml', 'both.yaml', 'run'))
    text = 'loop: {{axes: [{}], duration: 0.5, seed: 5}}\nplant: {{noise: [0.0001, 0.001]}}\n'
    (tmp_path / 'own.yaml').write_text(text.format('yaw, roll'), encoding='ascii')
    (tmp_path / 'both.yaml').write_text(text.format('surge, yaw'), encoding='ascii')
    assert main(['simulate', both, '--record', run]) == 0
    expected = read_run(run).channels['state'].axis('yaw').values
    for place, (file, words) in enumerate(((own, []), (both, []), (both, ['loop.seed=5']))):
        made, set_ = str(tmp_path / f'made{place}'), words or ['loop.duration=0.5']
        assert main(['bag', 'whatif', run, '--axis', 'yaw', '--config', file, '--set', *set_,
                     '--out', str(tmp_path / f'out{place}'), '--record', made]) == 0
        assert np.array_equal(read_run(made).channels['state'].values, expected)
    capsys.readouterr()
    assert main(['bag', 'whatif', run, '--axis', 'yaw', '--config', own, '--set',
                 'controller.law=coupled_eso']) == 2
    assert 'is of axes yaw, roll, and lacks axis surge of the run' in capsys.readouterr().err


@pytest.mark.slow
def test_whatif_of_an_axis_that_the_change_couples_does_not_hold_the_others(recorded, capsys,
                                                                            tmp_path):
    words = ['bag', 'whatif', recorded, '--out', str(tmp_path / 'out')]
    for key in ('controller.law=coupled_eso', 'controller.inertia=[1.0, 0.1, 0.1, 1.0]',
                'controller.lambda=1.0', 'loop.duration=0.2'):
        words += ['--set', key]
    assert main([*words, '--axis', 'yaw']) == 2
    error = capsys.readouterr().err
    assert "axes.yaw.controller.law = 'coupled_eso'" in error
    assert 'must be the law of all' in error
    assert error.count('\n') == 1
    assert not (tmp_path / 'out').exists()
    assert main(words) == 0
    assert '0.2 s of loop, 2 axes, in ' in capsys.readouterr().out


def test_a_coupled_what_if_that_diverges_or_has_no_room_is_one_line(capsys, tmp_path, monkeypatch):
    run = str(tmp_path / 'run')
    assert main(['simulate', 'rov_planar', '--duration', '0.2', '--record', run]) == 0
    capsys.readouterr()
    assert main(['bag', 'whatif', run, '--axis', 'yaw', '--set', 'plant.x0=[0.0, 1e200]']) == 2
    error = capsys.readouterr().err
    assert re.search(r'ax(is|es) .*: the loop diverged, .* at t = \S+ s: try a smaller', error)
    assert error.count('\n') == 1

    def full(*_):
        raise MemoryError

    monkeypatch.setattr('dz_ros.cli.offline.simulate_together', full)
    assert main(['bag', 'whatif', run, '--set', 'loop.duration=1e9']) == 2
    error = capsys.readouterr().err
    assert 'loop.duration = 1000000000.0: this machine has no room for 2000' in error
    assert error.count('\n') == 1


def test_what_does_not_go_with_the_axes_of_a_run_is_one_line(recorded, config, capsys, tmp_path):
    one = str(tmp_path / 'one')
    assert main(['simulate', '--duration', '0.1', '--record', one]) == 0
    log = tmp_path / 'log.csv'
    log.write_text('t,x\n0,0\n0.005,0\n', encoding='ascii')
    convert = ['bag', 'import', str(log), '--out', str(tmp_path / 'run'), '--map', 'stamp=t,x0=x',
               '--config', config]
    capsys.readouterr()
    for words, wanted in (
            (['bag', 'whatif', one, '--set', 'loop.axes=[a,b]'], 'loop.axes'),
            (['bag', 'whatif', recorded, '--axis', 'yaw', '--set', 'loop.axes=[a,b]'],
             'loop.axes'),
            (['bag', 'whatif', recorded, '--axis', 'yaw', '--set',
              'axes.surge.controller.lambda=3'],
             'axes.surge.controller.lambda = 3: is of another axis than yaw'),
            (['bag', 'audit', one, '--config', config], 'is of axes surge, yaw, the run of one'),
            (['bag', 'audit', recorded, '--config', 'two_link_arm'],
             'is of axes shoulder, elbow, the run of surge, yaw'),
            (['bag', 'audit', one, '--axis', 'yaw'], 'has one axis, without a name'),
            (convert, 'choose it with --axis')):
        assert main(words) == 2, words
        error = capsys.readouterr().err
        assert wanted in error, (words, error)
        assert error.count('\n') == 1, error
    assert main([*convert, '--axis', 'yaw']) == 0
    capsys.readouterr()
    assert main(['bag', 'info', str(tmp_path / 'run')]) == 0
    assert 'axes:' not in capsys.readouterr().out


def checked(capsys, monkeypatch, *words):
    """Return (exit code, check → result) of `dz driver check` in this process alone."""
    monkeypatch.setattr('dz_ros.cli.driver.check.find_spec', lambda _name: None)
    monkeypatch.setattr('dz_ros.drivers.conformance.driver_checks.RUN_DURATION', 0.3)
    code = main(['driver', 'check', *words, '--yes', '--json'])
    lines = map(json.loads, capsys.readouterr().out.splitlines())
    return code, {item['name']: item for item in lines}


LATE = {'measurement', 'answers at once'}
"""Checks that a busy machine may fail."""


def failed(found):
    return {name for name, item in found.items() if item['passed'] is False
            and name.partition(': ')[2] not in LATE}


def test_the_kit_checks_the_driver_of_each_axis_and_all_together(config, capsys, monkeypatch):
    _, found = checked(capsys, monkeypatch, config)
    assert failed(found) == set()
    for axis in ('surge', 'yaw'):
        assert {f'{axis}: {name}' for name in (
            'declaration', 'opens', 'measurement', 'answers at once', 'no fault', 'safe command',
            'limit', 'stop and reset', 'restart', 'reconnect', 'as a node')} <= set(found)
    assert [name for name in found if name.startswith('all axes: ')] == [
        f'all axes: {name}' for name in ('opens', 'measurement', 'answers at once', 'no fault',
                                         'restart')]
    _, alone = checked(capsys, monkeypatch, config, '--axis', 'yaw')
    assert not any(': ' in name for name in alone)
    of_yaw = {name for name in found if name.startswith('yaw: ')}
    assert {f'yaw: {name}' for name in alone} == of_yaw


def test_the_kit_names_the_axis_that_fails(config, capsys, monkeypatch):
    code, found = checked(
        capsys, monkeypatch, 'mock', '--config', config, '--set',
        'axes.yaw.driver.script=["0- fault burnt"]')
    assert code == 1
    assert {name.partition(': ')[0] for name in failed(found)} == {'yaw', 'all axes'}
    assert 'axis yaw: burnt' in found['all axes: no fault']['words']


def test_what_cannot_be_checked_is_one_line(config, capsys):
    for words, text in ((['--topics', '--config', config, '--axis', 'none'], '--axis'),
                        ([], 'give a driver, a configuration or --topics'),
                        (['mock', '--topics'], 'give a driver, a configuration or --topics'),
                        ([config, '--amplitude', '-1', '--yes'], 'of axis surge'),
                        (['nothing'], 'nothing')):
        assert main(['driver', 'check', *words]) == 2
        assert text in capsys.readouterr().err

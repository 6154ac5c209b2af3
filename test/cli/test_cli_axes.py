# SPDX-License-Identifier: Apache-2.0
"""The verbs of `dz` with several axes: each of them, or the one of --axis.

Over 300 lines: every verb, of one machine and its run.
"""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from dz_ros.cli.main import main
from dz_ros.core.loop.offline import simulate
from dz_ros.files.configurations import load_configuration
from dz_ros.recording.reader import read_run
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


def test_tune_writes_what_it_proposes_for_each_axis(config, capsys, tmp_path, monkeypatch):
    class Proposal:
        """What `tune` returns, of a gain that depends on the axis."""

        def __init__(self, before):
            value = 3.0 * before.law.gains.lambda_
            self.before, self.after = before, before.replace(**{'controller.lambda': value})
            self.reasons, self.rows = {'controller.lambda': 'three times'}, {}
            self.findings = ()

    monkeypatch.setattr('dz_ros.cli.tune.tune', lambda c, *_: Proposal(c))
    out = tmp_path / 'tuned.yaml'
    assert main(['tune', config, '--out', str(out)]) == 0
    assert capsys.readouterr().out.count('three times') == 2
    tuned = load_configuration(out)
    assert [item.law.gains.lambda_ for item in tuned.each] == [3.0, 6.0]
    assert tuned.axis('yaw').dead_zone.b_r == 0.3


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
    assert main(['bag', 'compare', recorded, recorded, '--json']) == 2
    assert 'choose one with --axis' in capsys.readouterr().err


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
    for words in (['bag', 'whatif', recorded, '--fit'], ['certify', config],
                  ['report', recorded, '--serve']):
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
    for axis in axes:
        assert f'comparison: {out}/{axis}/comparison.html' in shown
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

# SPDX-License-Identifier: Apache-2.0
"""`dz simulate`: what it writes is the loop, to the last digit; what it refuses leaves nothing."""

import csv
from pathlib import Path
import re

import numpy as np
import pytest

from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.offline import simulate
from dz_ros.files.configurations import load_configuration
from dz_ros.recording.reader import read_run

REFERENCE = Path(__file__).parents[1] / 'data' / 'wang2004_lambda1_rk4.csv'
SHORT = ('--duration', '0.5')
TERMS = 's,s_eps,u_fd,v_damping,v_feed_forward,v_regressor,v_robust,v_extra'


def read(path):
    with path.open(newline='') as file:
        header, *rows = csv.reader(file)
    return header, rows


def test_csv_is_the_reference_run(tmp_path, capsys):
    out = tmp_path / 'run.csv'
    assert main(['simulate', 'wang2004', '--set', 'plant.substeps=1', '--csv', str(out)]) == 0
    header, rows = read(out)
    assert ','.join(header) == f'k,t,x0,x1,xd0,xd1,xd2,v,w,theta1,theta2,phi,{TERMS}'
    found = np.array(rows, dtype=float)
    known = np.loadtxt(REFERENCE, delimiter=',', skiprows=2)
    assert found.shape == (4001, 20)
    column = {name: found[:, i] for i, name in enumerate(header)}
    for place, (name, tolerance) in enumerate([
            ('k', 0.0), ('t', 1e-12), ('x0', 1e-10), ('x1', 1e-10), ('v', 1e-8),
            ('theta1', 1e-10), ('theta2', 1e-10), ('phi', 1e-10), ('s', 1e-10), ('s_eps', 1e-10)]):
        assert np.abs(column[name] - known[:, place]).max() <= tolerance, name
    assert np.abs(column['xd0'] - 2.5 * np.sin(column['t'])).max() < 1e-14
    assert np.abs(column['w'] - np.where(
        column['v'] >= 0.5, column['v'] - 0.5,
        np.where(column['v'] <= -0.6, column['v'] + 0.6, 0.0))).max() < 1e-14
    assert 'max |x̃|' in capsys.readouterr().out


def test_csv_loses_no_digit(tmp_path):
    out = tmp_path / 'run.csv'
    assert main(['simulate', 'wang2004', *SHORT, '--csv', str(out)]) == 0
    header, rows = read(out)
    run = simulate(Configuration.from_flat({'loop.duration': 0.5}))
    for k, row in enumerate(rows):
        assert row[0] == str(k)
        number = dict(zip(header, row, strict=True))
        assert float(number['x1']) == run.x[k, 1]
        assert float(number['v']) == run.v[k]
        assert float(number['phi']) == run.column('phi')[k]
        assert float(number['s_eps']) == run.column('s_eps')[k]
    assert len(rows) == 101


@pytest.mark.parametrize(('config', 'law', 'expected'), [
    ('wang2004', 'pd', 'k,t,x0,x1,xd0,xd1,xd2,v,w'),
    ('valve_actuator', 'wang2004',
     'k,t,x0,x1,x2,xd0,xd1,xd2,xd3,v,w,theta1,theta2,theta3,phi'),
    ('first_order', 'wang2004', 'k,t,x0,xd0,xd1,v,w,theta1,theta2,phi'),
])
def test_columns_follow_order_and_law(config, law, expected, tmp_path):
    out = tmp_path / 'run.csv'
    assert main(['simulate', config, '--duration', '0.05', '--set', f'controller.law={law}',
                 '--csv', str(out)]) == 0
    assert ','.join(read(out)[0]) == f'{expected},{TERMS}'


def test_csv_has_the_true_state_though_the_law_sees_noise(tmp_path):
    out = tmp_path / 'run.csv'
    overrides = {'plant.noise': [0.01, 0.1], 'loop.duration': 0.5}
    assert main(['simulate', 'wang2004', '--set', 'plant.noise=[0.01, 0.1]', *SHORT, '--csv',
                 str(out)]) == 0
    header, rows = read(out)
    run = simulate(Configuration.from_flat(overrides))
    assert not np.array_equal(run.x, run.x_measured)
    assert [float(row[header.index('x0')]) for row in rows] == list(run.x[:, 0])
    assert [float(row[header.index('v')]) for row in rows] == list(run.v)


def test_csv_on_standard_output_stands_alone_there(capsys):
    assert main(['simulate', 'wang2004', *SHORT, '--csv', '-']) == 0
    out, err = capsys.readouterr()
    assert len(out.splitlines()) == 102
    assert all(line.count(',') == 19 for line in out.splitlines())
    assert 'max |x̃|' in err


def test_recording_is_the_run(tmp_path):
    out = tmp_path / 'run'
    assert main(['simulate', 'wang2004', '--set', 'controller.lambda=2', *SHORT, '--record',
                 str(out)]) == 0
    data = read_run(out)
    run = simulate(load_configuration('wang2004', ['controller.lambda=2', 'loop.duration=0.5']))
    assert np.array_equal(data.channels['state'].values[:, 2:4], run.x)
    assert np.array_equal(data.channels['command']['v'], run.v)
    assert data.configuration == run.configuration.to_flat()
    assert data.info['mode'] == 'offline'
    assert (out / 'metadata.yaml').is_file()


@pytest.mark.parametrize('law', ['robust', 'pid'])
def test_a_converted_recording_is_audited_without_its_configuration(tmp_path, capsys, law):
    """Other tools keep the topics and drop the metadata."""
    convert = pytest.importorskip('rosbags.convert.converter').convert
    out = tmp_path / 'run'
    assert main(['simulate', 'servo', '--set', f'controller.law={law}', *SHORT, '--record',
                 str(out)]) == 0
    convert([out], tmp_path / 'converted', dst_storage='sqlite3', dst_version=9,
            compress=None, compress_mode='none', default_typestore=None, typestore=None,
            exclude_topics=(), include_topics=(), exclude_msgtypes=(), include_msgtypes=())
    capsys.readouterr()
    assert main(['bag', 'audit', str(tmp_path / 'converted')]) == 0, capsys.readouterr().out
    assert 'stated by /simulation' in capsys.readouterr().out


def test_metrics_are_those_of_the_paper_s_example(capsys):
    assert main(['simulate', 'wang2004', '--duration', '60']) == 0
    table = dict(re.findall(r'^  (.+?)  +([-\d.e]+)', capsys.readouterr().out, re.MULTILINE))
    # mathematics of the example: last 10 s of 60 s, 4 substeps
    assert float(table['max |x̃|']) == pytest.approx(0.00843, abs=5e-6)
    assert float(table['RMS x̃']) == pytest.approx(0.00652, abs=5e-6)
    assert float(table['max |s| / ε']) == pytest.approx(0.66, abs=5e-3)
    assert float(table['peak |v|, whole run']) == pytest.approx(16.7, abs=0.05)
    assert float(table['total variation of v']) == pytest.approx(5.64, abs=0.05)
    assert float(table['settled after']) == pytest.approx(4.11, abs=0.005)


@pytest.mark.parametrize('words', [
    ['nowhere.yaml'], ['--set', 'controller.lambda=x'], ['--set', 'nope=1'],
    ['--duration', '0'], ['--duration', '0.001'], ['--duration', '-1'], ['--duration', 'nan'],
    ['--duration', 'inf'], ['--duration', 'long'], ['--duration', ''],
    ['--set', 'trajectory.file=nowhere.csv'], ['--set', 'plant.model=nowhere'],
    ['wang2004', '--set', 'controller.lambda=12'], ['--set', 'plant.x0=[1]'],
])
def test_mistakes_are_one_line_and_leave_nothing(words, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(['simulate', *words, '--csv', 'run.csv', '--record', 'run']) == 2
    out, err = capsys.readouterr()
    assert out == ''
    assert err.startswith('dz: error: ')
    assert err.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path('run.csv').write_text('precious')
    assert main(['simulate', 'wang2004', *SHORT, '--csv', 'run.csv']) == 2
    assert 'run.csv: exists already' in capsys.readouterr().err
    assert Path('run.csv').read_text() == 'precious'
    Path('run').mkdir()
    assert main(['simulate', 'wang2004', *SHORT, '--csv', 'new.csv', '--record', 'run']) == 2
    assert 'run: exists already' in capsys.readouterr().err
    assert not Path('new.csv').exists()
    assert list(Path('run').iterdir()) == []


def test_a_folder_that_is_not_there(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(['simulate', 'wang2004', *SHORT, '--csv', 'nowhere/run.csv']) == 2
    assert 'nowhere: no such directory' in capsys.readouterr().err


@pytest.mark.parametrize('overrides', [
    {'controller.lambda': 9.0},
    {'controller.lambda': 40.0, 'plant.model': 'zhang_feng1997'},
])
def test_divergence_names_the_time(overrides, capsys):
    words = [word for key, value in overrides.items() for word in ('--set', f'{key}={value}')]
    assert main(['simulate', 'wang2004', *words]) == 2
    err = capsys.readouterr().err
    assert err.count('\n') == 1
    last = round(float(re.search(r'at t = ([\d.e-]+) s', err).group(1)) / 0.005)

    def finite(samples):
        try:
            run = simulate(Configuration.from_flat({
                **overrides, 'loop.duration': samples * 0.005}))
        except (OverflowError, ValueError):
            return False
        return bool(np.isfinite(run.x).all() and np.isfinite(run.terms).all())

    assert finite(last - 1)
    assert not finite(last)


def test_what_is_typed_in_vain_is_reported(capsys):
    assert main(['simulate', 'wang2004', *SHORT, '--set', 'controller.law=pd', '--set',
                 'controller.k_star=3']) == 0
    err = capsys.readouterr().err
    assert err.startswith('dz: note: controller.k_star is set aside')
    assert err.count('\n') == 1

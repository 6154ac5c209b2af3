# SPDX-License-Identifier: Apache-2.0
"""`dz bag whatif` and `dz bag compare`: what they write and what they report."""

import numpy as np
import pytest

from dz_ros.cli.bag.compare import names
from dz_ros.cli.main import main
from dz_ros.cli.output import aligned
from dz_ros.core.dataset import RunData
from dz_ros.recording.reader import read_run
from dz_ros.recording.save import save_run


@pytest.fixture(scope='module')
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp('runs')
    assert main(['simulate', 'wang2004', '--duration', '3', '--set', 'plant.noise=[0.001,0.01]',
                 '--record', str(folder / 'a')]) == 0
    data = read_run(folder / 'a')
    flat = {key: value for key, value in data.configuration.items()
            if not key.startswith('plant.')}
    real = RunData({name: item for name, item in data.channels.items() if name != 'truth'}, flat,
                   {'mode': 'realtime'})
    save_run(real, folder / 'real')
    return folder


def test_answer_is_a_run_and_a_comparison(runs, tmp_path, capsys):
    out, made = tmp_path / 'out', tmp_path / 'b'
    assert main(['bag', 'whatif', str(runs / 'a'), '--set', 'controller.epsilon=0.1', '--set',
                 'controller.gamma=1', '--record', str(made), '--out', str(out)]) == 0
    text = capsys.readouterr().out
    assert (out / 'comparison.html').is_file()
    assert (out / 'compare_error.png').read_bytes()[:4] == b'\x89PNG'
    assert 'controller.epsilon  0.02      0.1' in text
    data = read_run(made)
    assert data.info['what_if_of'] == 'a'
    assert data.configuration['controller.gamma'] == 1.0
    assert main(['bag', 'audit', str(made)]) == 0
    capsys.readouterr()
    before = {path: path.read_bytes() for path in made.iterdir()}
    assert main(['bag', 'whatif', str(runs / 'a'), '--set', 'loop.delay=1', '--record',
                 str(made), '--out', str(out)]) == 2
    assert 'never overwritten' in capsys.readouterr().err
    assert before == {path: path.read_bytes() for path in made.iterdir()}


@pytest.mark.slow
def test_default_place_is_beside_the_run(runs, capsys):
    assert main(['bag', 'whatif', str(runs / 'a'), '--set', 'controller.law=pd']) == 0
    assert f'comparison: {runs / "a-whatif" / "comparison.html"}' in capsys.readouterr().out


@pytest.mark.slow
def test_real_hardware(runs, tmp_path, capsys):
    real = str(runs / 'real')
    assert main(['bag', 'whatif', real, '--set', 'loop.delay=1']) == 2
    assert 'choose one by --set plant.model' in capsys.readouterr().err
    assert main(['bag', 'whatif', real, '--set', 'plant.model=wang2004']) == 2
    assert 'it lacks plant.a1, plant.a2' in capsys.readouterr().err
    assert main(['bag', 'whatif', real, '--set', 'plant.model=wang2004', '--fit', '--out',
                 str(tmp_path / 'out')]) == 0
    text = capsys.readouterr().out
    assert 'b and m show only as their product: b = 1 is kept' in text
    line = next(line for line in text.splitlines() if line.strip().startswith('b·m'))
    value, _, width = line.split()[1:]
    assert abs(float(value) - 1.0) < 3.0 * float(width) < 0.3
    assert main(['bag', 'whatif', real, '--config', 'wang2004', '--set', 'loop.delay=1', '--out',
                 str(tmp_path / 'out')]) == 0


def test_a_what_if_that_diverges_reports_when(runs, tmp_path, capsys):
    assert main(['bag', 'whatif', str(runs / 'a'), '--set', 'controller.lambda=40', '--set',
                 'loop.delay=4', '--out', str(tmp_path / 'out')]) == 2
    assert 'the loop diverged' in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize('words', [
    ['{run}'], ['{run}', '--set', 'controller.gama=1'], ['{run}', '--set', 'nonsense'],
    ['{run}', '--set', 'controller.gamma=x'], ['nowhere', '--set', 'loop.delay=1']])
def test_mistakes_are_one_line(runs, capsys, words):
    assert main(['bag', 'whatif', *(word.format(run=runs / 'a') for word in words)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.slow
def test_compare(runs, tmp_path, capsys):
    other = tmp_path / 'b'
    assert main(['simulate', 'wang2004', '--duration', '3', '--set', 'loop.delay=1', '--record',
                 str(other)]) == 0
    capsys.readouterr()
    assert main(['bag', 'compare', str(runs / 'a'), str(other), '--out',
                 str(tmp_path / 'out')]) == 0
    text = capsys.readouterr().out
    assert text.splitlines()[0].split() == ['a', 'b']
    assert 'loop.delay' in text
    assert (tmp_path / 'out' / 'comparison.html').is_file()
    assert main(['bag', 'compare', str(runs / 'a'), str(other), '--json', '--window', '1',
                 '2']) == 0
    assert '"window"' in capsys.readouterr().out
    assert main(['bag', 'compare', str(runs / 'a')]) == 2
    assert 'at least two' in capsys.readouterr().err


def test_runs_get_names_that_distinguish_them(tmp_path):
    assert names([tmp_path / 'a', tmp_path / 'b']) == ['a', 'b']
    assert names([tmp_path / 'x' / 'a', tmp_path / 'y' / 'a']) == ['x/a', 'y/a']
    assert names([tmp_path / 'a', tmp_path / 'a']) == ['1: a', '2: a']


def test_columns_line_up_whatever_marks_a_letter_carries():
    lines = aligned([['', 'a'], ['max |x̃|', '1'], ['RMS vv', '22']])
    assert [len(line.replace('\N{COMBINING TILDE}', '')) for line in lines] == [11, 11, 11]
    assert np.unique([line[-1] for line in lines]).tolist() == ['1', '2', 'a']

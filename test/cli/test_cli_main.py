# SPDX-License-Identifier: Apache-2.0
"""What every verb has in common: help, exit codes, errors on one line, a quick start."""

import importlib
import os
from pathlib import Path
import subprocess
import sys

import pytest

import dz_ros
from dz_ros.cli.main import main
from dz_ros.cli.verbs import NOUNS, Verb, VERBS
from dz_ros.errors import RecordingError
from dz_ros.version import version


def test_help_names_every_verb_and_noun(capsys):
    assert main(['--help']) == 0
    text = capsys.readouterr().out
    for path, verb in VERBS.items():
        assert path[0] in text
        if len(path) == 1:
            assert verb.summary in text
        else:
            assert f'{path[0]} ' in text
            assert path[1] in text


@pytest.mark.parametrize('path', sorted(VERBS), ids=' '.join)
def test_every_verb_has_help_of_its_own(path, capsys):
    assert main([*path, '--help']) == 0
    text = capsys.readouterr().out
    assert text.startswith(f'usage: dz {" ".join(path)}')
    module = importlib.import_module(f'dz_ros.cli.{VERBS[path].module}')
    assert module.__doc__
    assert f'dz {" ".join(path)}' in module.__doc__.splitlines()[0]


@pytest.mark.parametrize('noun', sorted(NOUNS))
def test_a_noun_lists_its_verbs(noun, capsys):
    assert main([noun, '--help']) == 0
    text = capsys.readouterr().out
    for path, verb in VERBS.items():
        if path[0] == noun:
            assert verb.summary in text


LIMITED = """
import errno, resource
from dz_ros.cli.processes import ParameterFiles
limits = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
with ParameterFiles() as files:
    try:
        print(files.add('x' * 5000))
    except OSError as error:
        print(errno.errorcode[error.errno])
    with open(files.add('x' * 4096), 'rb') as whole:
        print(len(whole.read()))
resource.setrlimit(resource.RLIMIT_FSIZE, limits)       # coverage writes its own
"""


def test_parameters_of_nodes_are_whole_or_an_error():
    done = subprocess.run([sys.executable, '-c', LIMITED], capture_output=True, text=True,
                          timeout=300, check=False, env={
                              **os.environ, 'PYTHONPATH': str(Path(dz_ros.__file__).parents[1])})
    assert done.stdout.split() == ['EFBIG', '4096'], done.stderr


def test_version(capsys):
    assert main(['--version']) == 0
    assert capsys.readouterr().out == f'dz_ros {version()}\n'


@pytest.mark.parametrize('words', [
    ['nope'], ['bag', 'nope'], ['simulate', '--nope'], ['simulate', '--dur', '1'],
    ['simulate', '--set'], ['simulate', 'a', 'b'], ['list', 'nope'], ['report'],
    ['bag', 'info'], ['bag', 'recover', 'a', 'b', 'c'], ['report', 'r', '--window', '1'],
    ['report', 'r', '--window', 'a', 'b'],
])
def test_what_argparse_refuses_is_one_line_and_exit_code_two(words, capsys):
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ''
    assert err.startswith('dz: error: ')
    assert err.count('\n') == 1
    assert '--help' in err


@pytest.mark.parametrize(('words', 'wanted'), [
    (['run', '--lve'], 'did you mean --live?'), (['simulate', '--reprt'], None),
    (['--nope'], None), (['bag', 'exprt'], 'did you mean export?'),
    (['arena', '--laws', 'robst_eso'], 'did you mean robust_eso?'),
    (['arena', '--scenarios', 'nominl'], 'did you mean nominal?'),
    (['arena', '--scenarios', 'drift,noise'], '; b=2, delay 1; ')])
def test_a_misspelt_name_gets_the_suggestion_that_fits(words, wanted, capsys):
    assert main(words) == 2
    err = capsys.readouterr().err
    assert err.count('\n') == 1
    assert wanted in err if wanted else 'did you mean' not in err


def a_verb_that(monkeypatch, action):
    """Make `dz list` do something else."""
    module = importlib.import_module('dz_ros.cli.listing')
    monkeypatch.setattr(module, 'run', action)


def raising(error):
    def action(arguments):
        raise error
    return action


def test_errors_of_the_library_are_one_line(monkeypatch, capsys):
    a_verb_that(monkeypatch, raising(RecordingError('two\n   lines')))
    assert main(['list', 'plants']) == 2
    assert capsys.readouterr().err == 'dz: error: two lines\n'


@pytest.mark.parametrize(('error', 'line'), [
    (PermissionError(13, 'Permission denied', 'a/b'), 'a/b: Permission denied'),
    (OSError(28, 'No space left on device'), 'No space left on device'),
    (OSError('odd'), 'odd'),
])
def test_errors_of_the_machine_are_one_line(error, line, monkeypatch, capsys):
    a_verb_that(monkeypatch, raising(error))
    assert main(['list', 'plants']) == 2
    assert capsys.readouterr().err == f'dz: error: {line}\n'


def test_interrupt_is_one_line(monkeypatch, capsys):
    a_verb_that(monkeypatch, raising(KeyboardInterrupt()))
    assert main(['list', 'plants']) == 130
    assert capsys.readouterr() == ('', 'dz: interrupted\n')


def test_our_own_mistakes_are_not_hidden(monkeypatch):
    a_verb_that(monkeypatch, raising(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        main(['list', 'plants'])


def test_a_reader_that_goes_away_is_no_error(tmp_path):
    command = f'{sys.executable} -m dz_ros simulate --csv - | head -n 1'
    done = subprocess.run(['bash', '-c', f'{command}; exit ${{PIPESTATUS[0]}}'], timeout=120,
                          capture_output=True, text=True, check=False, cwd=tmp_path,
                          env=with_sources())
    assert done.stdout.startswith('k,t,x0,x1')
    assert done.stdout.count('\n') == 1
    # What takes longer than 3 s shows its progress.
    assert [line for line in done.stderr.splitlines() if not line.startswith('simulating ')] == []
    assert done.returncode == 141


def with_sources():
    """Return an environment in which the package under test is found from any directory."""
    root = str(Path(dz_ros.__file__).parents[1])
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(
        [root, *filter(None, [os.environ.get('PYTHONPATH')])])}


def test_python_m_dz_ros_is_dz(tmp_path):
    done = subprocess.run([sys.executable, '-m', 'dz_ros', 'list', 'nope'], timeout=300,
                          capture_output=True, text=True, check=False, cwd=tmp_path,
                          env=with_sources())
    assert done.returncode == 2
    assert done.stderr.startswith('dz: error: ')


@pytest.mark.parametrize(('words', 'unwanted'), [
    (['--help'], {'numpy', 'yaml', 'dz_ros.core', 'mcap', 'rclpy'}),
    (['--version'], {'numpy', 'yaml', 'dz_ros.core', 'mcap', 'rclpy'}),
    (['bag', '--help'], {'numpy', 'yaml', 'dz_ros.core', 'mcap', 'rclpy'}),
    (['list', 'plants'], {'mcap', 'matplotlib', 'scipy', 'rosbags', 'rclpy'}),
    (['simulate', '--help'], {'matplotlib', 'scipy', 'rosbags', 'rclpy'}),
    (['report', '--help'], {'matplotlib', 'scipy', 'rosbags', 'rclpy'}),
    (['run', '--help'], {'matplotlib', 'scipy', 'rosbags', 'rclpy'}),
])
def test_a_verb_loads_no_more_than_it_needs(words, unwanted, tmp_path):
    code = ('import sys; from dz_ros.cli.main import main; main(sys.argv[1:]); '
            'print("loaded", *sys.modules)')
    done = subprocess.run([sys.executable, '-c', code, *words], timeout=300, capture_output=True,
                          text=True, check=True, cwd=tmp_path, env=with_sources())
    loaded = set(done.stdout.splitlines()[-1].split()[1:])
    assert 'dz_ros.cli.main' in loaded
    assert not loaded & unwanted


def test_a_terminal_without_greek_is_no_error(tmp_path):
    done = subprocess.run([sys.executable, '-m', 'dz_ros', 'list', 'trajectories'], timeout=300,
                          capture_output=True, check=False, cwd=tmp_path,
                          env={**with_sources(), 'PYTHONIOENCODING': 'ascii', 'PYTHONUTF8': '0'})
    assert done.returncode == 0, done.stderr
    assert b'sinusoid' in done.stdout


def test_the_table_of_verbs_is_complete():
    assert all(isinstance(verb, Verb) for verb in VERBS.values())
    assert {path[0] for path in VERBS if len(path) == 2} == set(NOUNS)

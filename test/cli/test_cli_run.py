# SPDX-License-Identifier: Apache-2.0
"""`dz run`: what is refused before a node starts."""

import socket

import pytest

from dz_ros.cli.main import main


@pytest.mark.parametrize(('words', 'message'), [
    (('--set', 'controller.lambda=fast'), 'controller.lambda = '),
    (('--set', 'controller.lambda=-1'), '> 0'),
    (('--set', 'controller.lambda=.inf'), 'finite'),
    (('--set', 'plant.model=unicorn'), 'known: wang2004'),
    (('--set', 'controller.theta_0=[1, 2, 3]'), '2 numbers'),
    (('--namespace', 'not a name'), '--namespace'),
    (('no_such_file.yaml',), 'no_such_file.yaml'),
])
def test_a_users_mistake_is_one_line_and_exit_code_two(tmp_path, capsys, words, message):
    assert main(['run', *words, '--record', str(tmp_path / 'run')]) == 2
    printed, error = capsys.readouterr()
    assert printed == ''
    assert error.startswith('dz: error: ')
    assert error.count('\n') == 1
    assert message in error
    assert not (tmp_path / 'run').exists()


@pytest.mark.parametrize('verb', [('run', '--live'), ('report', 'no-run', '--serve')])
@pytest.mark.parametrize(('words', 'message'), [
    (('--port', '80000'), '--port = 80000: must be from 1 to 65535'),
    (('--host', 'no.such.host.invalid'), '--host = '),
    (('--host', ''), '--host = '),
    (('--host', '203.0.113.1'), '--host = '),       # of no machine
    (('--port', 'taken'), 'cannot be served: Address already in use')])
def test_a_page_that_cannot_be_served_is_refused_first(verb, words, message, capsys):
    with socket.create_server(('127.0.0.1', 0)) as other:
        words = [str(other.getsockname()[1]) if word == 'taken' else word for word in words]
        assert main([*verb, *words]) == 2
    printed, error = capsys.readouterr()
    assert printed == ''
    assert error.count('\n') == 1
    assert message in error


@pytest.mark.parametrize('verb', [('run',), ('simulate', 'servo')], ids=' '.join)
def test_a_directory_that_cannot_be_made_is_refused_first(verb, tmp_path, capsys):
    (tmp_path / 'file').touch()
    assert main([*verb, '--record', str(tmp_path / 'file' / 'a' / 'run')]) == 2
    printed, error = capsys.readouterr()
    assert printed == ''
    assert error == f'dz: error: {tmp_path / "file"}: no directory\n'


def test_an_existing_directory_is_not_touched(tmp_path, capsys):
    assert main(['run', '--record', str(tmp_path)]) == 2
    assert 'never overwritten' in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []

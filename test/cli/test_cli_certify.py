# SPDX-License-Identifier: Apache-2.0
"""``dz certify``: its words, its JSON, its exit codes."""

import json

import pytest

from dz_ros.cli.main import main

pytest.importorskip('flint')

SHORT = ['--set', 'loop.duration=2', '--delay', '0']


def test_certified_loop_gives_bounds_and_what_they_rest_on(capsys):
    assert main(['certify', 'robust_eso', *SHORT]) == 0
    text = capsys.readouterr().out
    assert ': certified' in text
    for title in ('assumed', 'proven by this machine', 'not proven', 'identifier switched off'):
        assert title in text


def test_json_has_the_error_bound_as_a_list_over_the_state(capsys):
    assert main(['certify', 'robust_eso', '--json', *SHORT]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['certified'] is True
    assert len(found['error_bound']) == 2
    assert found['error_bound'] == found['delays'][0]['error_bound']


@pytest.mark.slow
def test_loop_that_is_not_certified_names_inequality_and_gain(capsys):
    assert main(['certify', 'wang2004', *SHORT]) == 1
    text = capsys.readouterr().out
    assert 'NOT CERTIFIED' in text
    assert 'fails: |s| <=' in text
    assert 'controller.k_star = ' in text


@pytest.mark.slow
def test_picture_is_written_once(tmp_path, capsys):
    path = tmp_path / 'bound.png'
    assert main(['certify', 'robust_eso', '--picture', str(path), *SHORT]) == 0
    assert path.read_bytes().startswith(b'\x89PNG')
    assert 'runs reach' in capsys.readouterr().out
    assert main(['certify', 'robust_eso', '--picture', str(path), *SHORT]) == 2


@pytest.mark.parametrize('arguments', [['--delay', '-1'], ['--set', 'controller.law=pid']])
def test_what_cannot_be_certified_is_one_line(arguments, capsys):
    assert main(['certify', 'wang2004', *arguments]) == 2
    assert capsys.readouterr().err.count('\n') == 1

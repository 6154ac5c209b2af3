# SPDX-License-Identifier: Apache-2.0
"""`dz show` and suggestions: what a configuration is, and what a misspelt name may mean."""

import json
import os
import re
import subprocess
import sys

import pytest

from dz_ros.cli.main import main, parser_of
from dz_ros.core.axes_keys import is_machines, parts
from dz_ros.core.configuration import every_field
from dz_ros.files.configurations import load_configuration, shipped_configurations


@pytest.mark.parametrize('name', shipped_configurations())
def test_every_key_is_shown_with_its_source(name, capsys):
    assert main(['show', name, '--set', 'loop.delay=1']) == 0
    lines = capsys.readouterr().out.splitlines()[1:]
    found = {line.split()[0]: line for line in lines}
    c = load_configuration(name, ['loop.delay=1'])
    # Of several axes each has its own line, and what is not the machine's none without an axis.
    assert {key for key in c.to_flat()
            if not c.axes or parts(key)[0] or is_machines(key)} <= set(found)
    assert found['loop.delay'].split()[1:] == ['1', '[samples]', '(--set)']
    assert found['loop.rate'].endswith('[Hz]  (file)')
    assert found['safety.state_hold'].endswith(('(default)', '(file)'))


def test_of_several_axes_the_source_is_that_of_each(capsys):
    typed = ['--set', 'controller.lambda=3', '--set', 'axes.yaw.controller.k_d=2']
    assert main(['show', 'six_axes', *typed]) == 0
    found = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()[1:]}
    assert found['axes.roll.controller.lambda'].split()[1:] == ['3.0', '[1/s]', '(--set)']
    assert found['axes.yaw.controller.k_d'].endswith('(--set)')
    assert found['axes.roll.controller.k_d'].endswith('(file)')
    assert found['axes.roll.plant.dead_zone.b_r'].split()[1] == '0.15'
    assert 'controller.lambda' not in found
    assert main(['show', 'six_axes', '--axis', 'yaw', *typed]) == 0
    found = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()[1:]}
    assert found['controller.k_d'].endswith('(--set)')
    assert main(['show', 'six_axes', '--axis', 'jaw']) == 2
    assert 'must be one of base' in capsys.readouterr().err


def test_units_are_those_of_the_plant(capsys):
    assert main(['show', 'pendulum']) == 0
    out = capsys.readouterr().out
    assert re.search(r'controller.b_r_bounds +\[0.01, 0.06\] \[N m\]  \(file\)', out)
    assert re.search(r'controller.k_d +\S+ \[N m s/rad\]', out)
    assert re.search(r'plant.noise +\[0.0, 0.0\] \[rad, rad/s\]', out)
    assert not re.search(r'\[\S*\(\S*\) per ', out)
    assert 'actuator unit' not in out


def test_keys_of_another_class_are_named(capsys):
    assert main(['show', 'wang2004', '--set', 'controller.law=pid']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith('controller.k_star') and 'set aside' in line for line in lines)


def test_json_is_the_flat_configuration(capsys):
    assert main(['show', 'servo', '--json']) == 0
    assert json.loads(capsys.readouterr().out) == load_configuration('servo').to_flat()


@pytest.mark.parametrize('words', [['show'], ['check', '--quick']])
def test_json_of_a_file_from_outside_is_plain_text(words, tmp_path, capsys):
    path = tmp_path / 'a.yaml'
    port = '\u202e\x9b2J\x7f\x1bε\U000e0001'
    path.write_text(f'driver: {{name: serial, port: {json.dumps(port)}}}')
    main([*words, str(path), '--json'])
    out = capsys.readouterr().out
    assert all(item == '\n' or item.isprintable() for item in out)
    if words == ['show']:
        assert json.loads(out)['driver.port'] == port
        assert 'ε' in out


def test_files_complete_wherever_they_are(tmp_path):
    (tmp_path / 'a[1').mkdir()
    (tmp_path / 'a[1' / 'b.yaml').write_text('')
    config = next(item for item in parser_of(['show']).verb._actions if item.dest == 'config')
    assert config.completer(f'{tmp_path}/a[') == [f'{tmp_path}/a[1/']
    assert config.completer(f'{tmp_path}/none/') == []
    assert config.completer(f'{tmp_path}/a[1/') == [f'{tmp_path}/a[1/b.yaml']


@pytest.mark.parametrize(('words', 'hint'), [
    (['simulat'], 'did you mean simulate?'),
    (['simulate', 'robst'], 'did you mean robust?'),
    (['simulate', '--set', 'lambda=2'], 'did you mean controller.lambda?'),
    (['simulate', '--set', 'controler.lambda=2'], 'did you mean controller.lambda?'),
    (['simulate', '--set', 'controller.lamda=2'], 'did you mean controller.lambda?'),
    (['simulate', '--set', 'controller.law=robst'], 'did you mean robust?'),
    (['simulate', '--durations', '2'], 'did you mean --duration?'),
    (['report', 'runs/a', '--kick', '2'], 'it is called --pulse now'),
    (['simulate', '--set', 'plant.kick=[1,2,3]'], 'is called plant.disturbance_pulse now'),
    (['list', 'law'], 'did you mean laws?'), (['bag', 'infoo'], 'did you mean info?'),
    (['completion', 'zhs'], 'did you mean zsh?'),
])
def test_a_misspelt_name_gets_a_suggestion(words, hint, capsys):
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ''
    assert hint in err
    assert err.count('\n') == 1


def test_list_alone_lists_everything(capsys):
    assert main(['list']) == 0
    out = capsys.readouterr().out
    for word in ('plants:', 'drivers:', 'configurations:', 'keys:', 'robust_eso', 'mock',
                 *every_field()):
        assert word in out


@pytest.mark.parametrize('words', [[], ['bag'], ['driver']])
def test_a_bare_noun_prints_help(words, capsys):
    assert main(words) == 0
    assert capsys.readouterr().out.startswith(f'usage: dz{" " if words else ""}{"".join(words)}')


@pytest.mark.parametrize(('typed', 'wanted'), [
    ('dz sim', {'simulate'}), ('dz bag ex', {'export'}), ('dz simulate robust_eso_', {
        'robust_eso_quiet'}), ('dz run --read', {'--read-only'}),
    ('dz tune --set controller.law', {'controller.law='})])
def test_the_shell_completes(typed, wanted, tmp_path):
    pytest.importorskip('argcomplete')
    done = subprocess.run(
        [sys.executable, '-m', 'dz_ros'], check=False, timeout=300, cwd=tmp_path,
        env={**os.environ, '_ARGCOMPLETE': '1', '_ARGCOMPLETE_IFS': '\n', 'COMP_LINE': typed,
             'COMP_POINT': str(len(typed)), '_ARGCOMPLETE_STDOUT_FILENAME': str(tmp_path / 'out'),
             'PYTHONPATH': os.pathsep.join(sys.path)})
    assert done.returncode == 0
    found = (tmp_path / 'out').read_text().split('\n')
    assert {item.strip() for item in found} == wanted


def test_the_completion_code_is_printed(capsys):
    pytest.importorskip('argcomplete')
    assert main(['completion', 'bash']) == 0
    assert 'complete' in capsys.readouterr().out

# SPDX-License-Identifier: Apache-2.0
"""A configuration of a user's package: its law, plant and trajectory can be replaced by name."""

from pathlib import Path
import re
import sys

import pytest

from dz_ros.cli.main import main
from dz_ros.files.configurations import load_configuration

NAMES = {'model: tank': 'model: dz_ros_example.tank:Tank', 'law: pi': 'law: dz_ros_example.pi:Pi',
         'kind: logistic': 'kind: dz_ros_example.logistic:Logistic'}
EXAMPLE = Path(__file__).parents[2] / 'examples' / 'dz_ros_example'


@pytest.fixture
def example(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(EXAMPLE))
    monkeypatch.setenv('PYTHONPATH', str(EXAMPLE))
    text = (EXAMPLE / 'config' / 'tank.yaml').read_text(encoding='utf-8')
    for name, path in NAMES.items():
        text = text.replace(name, path)
    file = tmp_path / 'tank.yaml'
    file.write_text(text, encoding='utf-8')
    yield file
    for name in [name for name in sys.modules if name.startswith('dz_ros_example')]:
        del sys.modules[name]


@pytest.mark.parametrize('law', ['robust', 'robust_eso', 'wang2004', 'pid'])
def test_keys_of_the_file_s_law_are_set_aside(example, law):
    own = load_configuration(example)
    c = load_configuration(example, [f'controller.law={law}'])
    assert c.law.name == law
    assert set(c.set_aside) >= {
        key for key in own.to_flat('controller') if key not in c.to_flat('controller')}


@pytest.mark.parametrize('change', ['plant.model=first_order', 'trajectory.kind=sinusoid'])
def test_keys_of_other_classes_are_set_aside_too(example, change):
    key, _, name = change.partition('=')
    c = load_configuration(example, [change])
    assert c.to_flat()[key] == name


def test_another_plant_takes_a_file_with_lists_of_its_own(example, capsys):
    assert main(['simulate', str(example), '--duration', '1', '--set', 'plant.model=pendulum',
                 '--set', 'trajectory.kind=sinusoid', '--set', 'controller.law=robust']) == 0
    assert 'dz: note: plant.x0 is set aside: the list does not fit pendulum' in (
        capsys.readouterr().err)
    assert main(['show', str(example), '--set', 'plant.model=pendulum', '--set',
                 'trajectory.kind=sinusoid', '--set', 'controller.law=robust']) == 0
    assert re.search(r'plant\.x0 +set aside: does not fit pendulum', capsys.readouterr().out)


def test_a_key_that_no_class_has_is_still_refused(example, capsys):
    assert main(['simulate', str(example), '--set', 'controller.law=robust', '--set',
                 'controller.nonsense=1']) == 2
    assert 'controller.nonsense' in capsys.readouterr().err


@pytest.mark.slow
def test_simulate_whatif_and_sweep_take_another_law(example, tmp_path, capsys):
    run = tmp_path / 'run'
    assert main(['simulate', str(example), '--duration', '2', '--record', str(run)]) == 0
    assert main(['simulate', str(example), '--duration', '2', '--set',
                 'controller.law=robust']) == 0
    assert main(['bag', 'whatif', str(run), '--allow-import', 'dz_ros_example', '--set',
                 'controller.law=robust', '--out', str(tmp_path / 'page')]) == 0
    own = load_configuration(example).to_flat()['controller.law']
    assert main(['sweep', str(example), '--duration', '2', '--over',
                 f'controller.law=robust,{own}', '--out', str(tmp_path / 'a.csv'), '-j', '1',
                 '--quiet']) == 0
    assert '2 runs, 0 of them lost' in capsys.readouterr().out

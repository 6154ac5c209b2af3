# SPDX-License-Identifier: Apache-2.0
"""launch/replay.launch.py, run with replacements for launch, which has no wheels."""

from pathlib import Path
import re

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture
def launch_file(load_launch_file):
    return load_launch_file('replay')


def declared(launch_file):
    """Argument → default; None = must be given."""
    return {item.positional[0]: item.named.get('default_value')
            for item in launch_file.generate_launch_description().positional[0]
            if type(item).__name__ == 'DeclareLaunchArgument'}


def started(launch_file, **given):
    """The node that is started with these arguments."""
    context = {**declared(launch_file), **given}
    node, handler = launch_file.nodes(context)
    assert type(node).__name__ == 'Node'
    assert handler.positional[0].named['target_action'] is node     # its end ends the launch
    return node.named


def test_only_the_run_must_be_given(launch_file):
    assert [name for name, default in declared(launch_file).items() if default is None] == ['run']
    assert set(declared(launch_file)) == set(launch_file.NAMES)


def test_defaults_play_the_whole_run_once(launch_file, tmp_path):
    node = started(launch_file, run=str(tmp_path))
    assert (node['package'], node['executable'], node['namespace']) == ('dz_ros', 'replay_node',
                                                                        '')
    assert node['parameters'] == [{'run': str(tmp_path), 'rate': 1.0, 'start': 0.0,
                                   'duration': 0.0, 'clock': 0.0, 'loop': False, 'paused': False}]


def test_what_is_given_reaches_the_node_with_its_type(launch_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'relative').mkdir()
    node = started(launch_file, run='relative', rate='2', loop='true', topics='state, reference',
                   namespace='again', wait_for='state')
    (parameters,) = node['parameters']
    assert Path(parameters['run']).is_absolute()
    assert parameters['rate'] == 2.0
    assert parameters['loop'] is True
    assert parameters['topics'] == ['state', 'reference']
    assert parameters['wait_for'] == ['state']
    assert node['namespace'] == 'again'


@pytest.mark.parametrize(('key', 'value', 'allowed'), [
    ('run', '/no/such/run', 'no such run'),
    ('run', '', 'no such run'),
    ('rate', 'abc', 'must be a number, greater than 0'),
    ('rate', '0', 'must be a number, greater than 0'),
    ('rate', 'nan', 'must be a number, greater than 0'),
    ('start', '-1', 'must be a number of seconds, at least 0'),
    ('duration', 'all', 'must be a number of seconds, at least 0'),
    ('clock', 'yes', 'must be a number of Hz, at least 0'),
    ('loop', 'maybe', 'must be true or false'),
    ('paused', '', 'must be true or false'),
    ('topics', 'state, a b', "'a b' is no name of ROS"),
    ('wait_for', '1st', "'1st' is no name of ROS"),
    ('namespace', 'a//b', 'must be a namespace of ROS'),
])
def test_mistakes_are_named(launch_file, tmp_path, key, value, allowed):
    with pytest.raises(RuntimeError, match=re.escape(f'{key}:={value}: {allowed}')) as caught:
        started(launch_file, **{'run': str(tmp_path), key: value})
    assert '\n' not in str(caught.value)


def test_every_parameter_is_one_of_the_node_and_every_executable_is_installed(launch_file):
    source = (ROOT / 'dz_ros' / 'nodes' / 'replay_node.py').read_text(encoding='utf-8')
    known = set(re.findall(r"_given\('(\w+)'", source))
    assert set(declared(launch_file)) - {'namespace'} == known
    assert "'replay_node = " in (ROOT / 'setup.py').read_text(encoding='utf-8')

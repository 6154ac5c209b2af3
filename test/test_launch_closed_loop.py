# SPDX-License-Identifier: Apache-2.0
"""launch/closed_loop.launch.py, run with replacements for launch, which has no wheels."""

from pathlib import Path
import re

import pytest

ROOT = Path(__file__).parent.parent
PEERS = ['plant_node', 'controller_node', 'trajectory_node']


@pytest.fixture
def launch_file(load_launch_file):
    return load_launch_file('closed_loop')


def started(launch_file, **given):
    """Executable → node, for these arguments; check that each one's end ends the launch."""
    defaults = {item.positional[0]: item.named['default_value']
                for item in launch_file.generate_launch_description().positional[0]
                if type(item).__name__ == 'DeclareLaunchArgument'}
    assert set(given) <= set(defaults)
    actions = launch_file.nodes({**defaults, **given})
    nodes = [item for item in actions if type(item).__name__ == 'Node']
    watched = [item.positional[0] for item in actions if item not in nodes]
    assert [handler.named['target_action'] for handler in watched] == nodes
    for handler in watched:
        (end,) = handler.named['on_exit']
        assert type(end.named['event']).__name__ == 'Shutdown'
    return {node.named['executable']: node.named for node in nodes}


def test_defaults_start_three_nodes_of_the_recommended_configuration(launch_file):
    nodes = started(launch_file)
    assert list(nodes) == PEERS
    for name, node in nodes.items():
        config, settings = node['parameters']
        assert node['name'] == name
        assert Path(config) == ROOT / 'config' / 'robust_eso.yaml'
        assert settings == {'loop.peers': PEERS}


def test_arguments_reach_every_node(launch_file, tmp_path):
    file = tmp_path / 'mine.yaml'
    file.write_text('')
    nodes = started(launch_file, config=str(file), duration='60', record='relative',
                    namespace='left')
    assert list(nodes) == [*PEERS, 'recorder_node']
    for node in nodes.values():
        config, settings = node['parameters']
        assert (config, node['namespace']) == (str(file), 'left')
        assert settings['loop.duration'] == 60.0
        assert settings['loop.peers'] == [*PEERS, 'recorder_node']
    assert nodes['recorder_node']['parameters'][1]['directory'] == str(Path('relative').absolute())


def test_a_driver_is_hosted_in_the_plant_s_place(launch_file):
    nodes = started(launch_file, driver='mock')
    assert list(nodes) == ['actuator_node', *PEERS[1:]]
    for node in nodes.values():
        assert node['parameters'][1] == {'loop.peers': PEERS, 'driver.name': 'mock'}


@pytest.mark.parametrize(('key', 'value', 'allowed'), [
    ('duration', 'long', 'must be a number of seconds, at least 0'),
    ('duration', '-1', 'must be a number of seconds, at least 0'),
    ('duration', 'inf', 'must be a number of seconds, at least 0'),
    ('config', 'none_of_that_name', 'no such file; shipped configurations: axis, '),
    ('namespace', '9th', 'must be a namespace of ROS'),
    ('namespace', 'a b', 'must be a namespace of ROS'),
    ('driver', 'none', 'no such driver; known: simulated, mock, '),
    ('record', str(ROOT), 'exists already'),
])
def test_mistakes_are_named(launch_file, key, value, allowed):
    with pytest.raises(RuntimeError, match=re.escape(f'{key}:={value}: {allowed}')) as caught:
        started(launch_file, **{key: value})
    assert '\n' not in str(caught.value)

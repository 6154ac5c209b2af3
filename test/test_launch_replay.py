"""launch/replay.launch.py, run with stand-ins for launch, which has no wheels."""

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


def test_defaults_play_the_whole_run_once(launch_file):
    node = started(launch_file, run='/data/run')
    assert (node['package'], node['executable'], node['namespace']) == ('dz_ros', 'replay_node',
                                                                        '')
    assert node['parameters'] == [{'run': '/data/run', 'rate': 1.0, 'start': 0.0, 'duration': 0.0,
                                   'clock': 0.0, 'loop': False, 'paused': False}]


def test_what_is_given_reaches_the_node_with_its_type(launch_file):
    node = started(launch_file, run='relative', rate='2', loop='true', topics='state, reference',
                   namespace='again', wait_for='state')
    (parameters,) = node['parameters']
    assert Path(parameters['run']).is_absolute()
    assert parameters['rate'] == 2.0
    assert parameters['loop'] is True
    assert parameters['topics'] == ['state', 'reference']
    assert parameters['wait_for'] == ['state']
    assert node['namespace'] == 'again'


def test_every_parameter_is_one_of_the_node_and_every_executable_is_installed(launch_file):
    source = (ROOT / 'dz_ros' / 'nodes' / 'replay_node.py').read_text(encoding='utf-8')
    known = set(re.findall(r"_given\('(\w+)'", source))
    assert set(declared(launch_file)) - {'namespace'} == known
    assert "'replay_node = " in (ROOT / 'setup.py').read_text(encoding='utf-8')

"""launch/ros2_control.launch.py, run with stand-ins for launch; and the controllers it names."""

from pathlib import Path

import pytest
import yaml

from dz_ros.files import load_configuration

ROOT = Path(__file__).parent.parent
CONTROLLERS = ROOT / 'launch' / 'joint_controllers.yaml'
NODES = ['actuator_node', 'controller_node', 'trajectory_node']


@pytest.fixture
def launch_file(load_launch_file):
    return load_launch_file('ros2_control')


def started(launch_file, **given):
    """Executable → node for these arguments; each of ours ends the launch with it."""
    defaults = {item.positional[0]: item.named['default_value']
                for item in launch_file.generate_launch_description().positional[0]
                if type(item).__name__ == 'DeclareLaunchArgument'}
    assert set(given) <= set(defaults)
    actions = launch_file.nodes({**defaults, **given})
    nodes = [item for item in actions if type(item).__name__ == 'Node']
    watched = [item.positional[0].named['target_action'] for item in actions if item not in nodes]
    # A spawner ends when it is done.
    assert watched == [node for node in nodes if node.named['package'] == 'dz_ros']
    return {node.named['executable']: node.named for node in nodes}


def test_defaults_start_the_loop_alone(launch_file):
    nodes = started(launch_file)
    assert list(nodes) == NODES
    for name, node in nodes.items():
        config, settings = node['parameters']
        assert node['name'] == name
        assert Path(config) == ROOT / 'config' / 'joint.yaml'
        assert settings == {'loop.peers': ['plant_node', 'controller_node', 'trajectory_node'],
                            'driver.name': 'joint'}


def test_arguments_reach_every_node(launch_file, tmp_path):
    file = tmp_path / 'mine.yaml'
    file.write_text('')
    nodes = started(launch_file, config=str(file), duration='60', record='relative',
                    joint='elbow', spawn='joint_state_broadcaster, effort_controller')
    assert list(nodes) == ['spawner', *NODES, 'recorder_node']
    spawner = nodes.pop('spawner')
    assert spawner['package'] == 'controller_manager'
    assert spawner['arguments'] == ['joint_state_broadcaster', 'effort_controller',
                                    '--param-file', str(CONTROLLERS)]
    for node in nodes.values():
        config, settings = node['parameters']
        assert config == str(file)
        assert settings['loop.duration'] == 60.0
        assert settings['driver.joint'] == 'elbow'
        assert settings['loop.peers'][-1] == 'recorder_node'
    assert nodes['recorder_node']['parameters'][1]['directory'] == str(Path('relative').absolute())


@pytest.mark.parametrize('given', [{'duration': 'long'}, {'config': 'none_of_that_name'}])
def test_mistakes_are_named(launch_file, given):
    ((key, value),) = given.items()
    with pytest.raises(RuntimeError, match=f'{key}:={value}: '):
        started(launch_file, **given)


def test_controllers_and_configuration_agree():
    content = yaml.safe_load(CONTROLLERS.read_text(encoding='utf-8'))
    manager = content.pop('controller_manager')['ros__parameters']
    configuration = load_configuration('joint')
    assert manager.pop('update_rate') >= configuration.loop.rate
    types = {name: value['type'] for name, value in manager.items()}
    assert types == {
        'joint_state_broadcaster': 'joint_state_broadcaster/JointStateBroadcaster',
        'effort_controller': 'forward_command_controller/ForwardCommandController'}
    sections = {name: section['ros__parameters'] for name, section in content.items()}
    # With --param-file a spawner takes the type from the controller's own section.
    assert {name: section.pop('type') for name, section in sections.items()} == types
    driver = configuration.driver_parameters
    assert driver.command_topic == '/effort_controller/commands'
    assert sections == {'joint_state_broadcaster': {}, 'effort_controller': {
        'joints': [driver.joint], 'interface_name': 'effort'}}

# SPDX-License-Identifier: Apache-2.0
"""launch/ros2_control.launch.py, launch replaced; and the controllers it names."""

from pathlib import Path
import re

import pytest
import yaml

from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration
from dz_ros.files.launch_arguments import joint_controllers

ROOT = Path(__file__).parent.parent
CONTROLLERS = ROOT / 'launch' / 'joint_controllers.yaml'
NODES = ['actuator_node', 'controller_node', 'trajectory_node']


@pytest.fixture
def launch_file(load_launch_file):
    return load_launch_file('ros2_control')


class Ended:
    """The end of a process."""

    def __init__(self, returncode):
        self.returncode = returncode


class Context(dict):
    """Launch's context: arguments, and whether it is shutting down."""

    is_shutdown = False


def actions(launch_file, **given):
    """What the launch file makes of these arguments."""
    defaults = {item.positional[0]: item.named['default_value']
                for item in launch_file.generate_launch_description().positional[0]
                if type(item).__name__ == 'DeclareLaunchArgument'}
    assert set(given) <= set(defaults) == set(launch_file.ARGUMENTS)
    return launch_file.nodes(Context({**defaults, **given}))


def loop_of(made):
    """Executable → node of the loop; each of ours ends the launch with it."""
    nodes = [item for item in made if type(item).__name__ == 'Node']
    watched = [item.positional[0].named['target_action'] for item in made if item not in nodes]
    assert watched == nodes
    return {node.named['executable']: node.named for node in nodes}


def spawned(made):
    """Return the spawner's node and what happens when it has ended."""
    spawner, handler = made
    assert handler.positional[0].named['target_action'] is spawner
    return spawner.named, handler.positional[0].named['on_exit']


def test_defaults_start_the_loop_alone(launch_file):
    nodes = loop_of(actions(launch_file))
    assert list(nodes) == NODES
    for name, node in nodes.items():
        config, settings = node['parameters']
        assert node['name'] == name
        assert Path(config) == ROOT / 'config' / 'joint.yaml'
        assert settings == {'loop.peers': ['plant_node', 'controller_node', 'trajectory_node'],
                            'driver.name': 'joint'}


def test_arguments_reach_every_node(launch_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / 'mine.yaml'
    file.write_text('driver: {name: joint}\n')
    nodes = loop_of(actions(launch_file, config=str(file), duration='60', record='relative',
                            joint='1', namespace='left'))
    assert list(nodes) == [*NODES, 'recorder_node']
    for node in nodes.values():
        config, settings = node['parameters']
        assert (config, node['namespace']) == (str(file), 'left')
        assert settings['loop.duration'] == 60.0
        assert settings['driver.joint'] == '1'      # a text, whatever it looks like
        assert settings['loop.peers'][-1] == 'recorder_node'
    assert nodes['recorder_node']['parameters'][1]['directory'] == str(tmp_path / 'relative')


SPAWN = 'joint_state_broadcaster, effort_controller'


@pytest.mark.parametrize(('given', 'joint', 'interface'), [
    ({}, 'joint1', 'effort'),
    ({'joint': 'joint2'}, 'joint2', 'effort'),
    ({'config': 'mine'}, 'elbow', 'velocity'),
    ({'config': 'mine', 'joint': 'wrist'}, 'wrist', 'velocity'),
])
def test_controllers_are_those_of_the_joint_that_is_driven(
        launch_file, tmp_path, given, joint, interface):
    if 'config' in given:
        mine = tmp_path / 'mine.yaml'
        mine.write_text('driver: {name: joint, joint: elbow, interface: velocity}\n')
        given = {**given, 'config': str(mine)}
    spawner, end = spawned(actions(launch_file, spawn=SPAWN, **given))
    assert (spawner['package'], spawner['executable']) == ('controller_manager', 'spawner')
    *names, flag, file = spawner['arguments']
    assert names == ['joint_state_broadcaster', 'effort_controller']
    assert flag == '--param-file'
    assert spawner['namespace'] == ''
    shipped = yaml.safe_load(CONTROLLERS.read_text(encoding='utf-8'))
    expected = {**shipped['effort_controller']['ros__parameters'],
                'joints': [joint], 'interface_name': interface}
    found = yaml.safe_load(Path(file).read_text(encoding='utf-8'))
    assert found['effort_controller']['ros__parameters'] == expected
    assert found['joint_state_broadcaster'] == shipped['joint_state_broadcaster']
    # The same joint reaches the driver.
    settings = loop_of(end(Ended(0), Context()))['actuator_node']['parameters'][1]
    assert settings.get('driver.joint', joint) == joint


AXES = """
loop: {axes: [base, shoulder, elbow]}
driver: {name: joint, command_topic: /arm/commands}
axes:
  base: {driver: {joint: a, command_topic: /turntable/commands, interface: velocity}}
  shoulder: {driver: {joint: b}}
  elbow: {driver: {joint: c}}
"""


def test_two_controllers_of_one_name_are_refused(tmp_path):
    mine = tmp_path / 'mine.yaml'
    mine.write_text(AXES.replace('/turntable/', '/left/arm/'))
    with pytest.raises(ConfigurationError, match='a manager has one of a name') as caught:
        joint_controllers(CONTROLLERS, load_configuration(str(mine)), tmp_path)
    assert caught.value.key == 'axes.shoulder.driver.command_topic'
    assert not (tmp_path / 'joint_controllers.yaml').exists()


def test_axes_of_one_command_topic_are_the_joints_of_one_controller(launch_file, tmp_path):
    mine = tmp_path / 'mine.yaml'
    mine.write_text(AXES)
    spawner, end = spawned(actions(
        launch_file, spawn='joint_state_broadcaster,arm,turntable', config=str(mine)))
    found = yaml.safe_load(Path(spawner['arguments'][-1]).read_text(encoding='utf-8'))
    kind = 'forward_command_controller/ForwardCommandController'
    assert found['arm'] == {'ros__parameters': {
        'type': kind, 'joints': ['b', 'c'], 'interface_name': 'effort'}}
    assert found['turntable'] == {'ros__parameters': {
        'type': kind, 'joints': ['a'], 'interface_name': 'velocity'}}
    manager = found['controller_manager']['ros__parameters']
    assert manager['arm'] == manager['turntable'] == {'type': kind}
    assert 'effort_controller' not in (manager | found)
    settings = loop_of(end(Ended(0), Context()))['actuator_node']['parameters'][1]
    assert set(settings) == {'loop.peers', 'driver.name'}


def test_another_controller_manager_gives_its_namespace_to_controllers_and_topics(
        launch_file, tmp_path):
    mine = tmp_path / 'mine.yaml'
    mine.write_text(AXES.replace('/turntable', '/left/turntable').replace(
        'joint: a,', 'joint: a, controller: turntable,'))
    spawner, end = spawned(actions(
        launch_file, spawn='arm', config=str(mine), namespace='left',
        controller_manager='left/manager'))
    name, flag, manager, _, file = spawner['arguments']
    assert (spawner['namespace'], name, flag, manager) == (
        '/left', 'arm', '--controller-manager', '/left/manager')
    found = yaml.safe_load(Path(file).read_text(encoding='utf-8'))
    assert set(found) == {f'/left/{item}' for item in (
        'controller_manager', 'joint_state_broadcaster', 'arm', 'turntable')}
    for node in loop_of(end(Ended(0), Context())).values():
        assert node['namespace'] == 'left'
        settings = node['parameters'][1]
        assert {key: value for key, value in settings.items() if key.startswith('axes.')} == {
            f'axes.{axis}.driver.{key}': value for axis in ('base', 'shoulder', 'elbow')
            for key, value in {'command_topic': '/left/arm/commands',
                               'state_topic': '/left/joint_states',
                               'activity_topic': '/left/manager/activity',
                               'controller': '/left/turntable'}.items()
            if (axis == 'base') == (key == 'controller') or key.endswith('_topic')
            if (axis, key) != ('base', 'command_topic')}


def test_the_manager_of_one_joint_is_given_by_its_keys(launch_file):
    settings = loop_of(actions(launch_file, controller_manager='/manager'))[
        'actuator_node']['parameters'][1]
    assert {key: value for key, value in settings.items() if key.startswith('driver.')} == {
        'driver.name': 'joint', 'driver.activity_topic': '/manager/activity'}


def test_one_joint_is_none_of_several_axes(launch_file, tmp_path):
    mine = tmp_path / 'mine.yaml'
    mine.write_text(AXES)
    with pytest.raises(RuntimeError, match='joint:=d: the loop has the axes base, shoulder, '
                       r'elbow: name their joints in its file, axes\.NAME\.driver\.joint'):
        actions(launch_file, config=str(mine), joint='d')


def test_a_parameter_file_of_the_user_is_left_alone(launch_file, tmp_path):
    file = tmp_path / 'controllers.yaml'
    file.write_text('')
    spawner, _ = spawned(actions(launch_file, spawn='mine', controllers=str(file)))
    assert spawner['arguments'] == ['mine', '--param-file', str(file)]


def test_a_spawner_that_fails_stops_the_launch(launch_file):
    _, end = spawned(actions(launch_file, spawn=SPAWN))
    with pytest.raises(RuntimeError, match='spawn:=joint_state_broadcaster,effort_controller: the '
                       'spawner has failed with exit code 1; the loop is not started'):
        end(Ended(1), Context())
    leaving = Context()
    leaving.is_shutdown = True          # Ctrl-C ends the spawner, too
    assert end(Ended(1), leaving) is None


@pytest.mark.parametrize(('key', 'value', 'allowed'), [
    ('duration', 'long', 'must be a number of seconds, at least 0'),
    ('config', 'none_of_that_name', 'no such file; shipped configurations: '),
    ('namespace', '-', 'must be a namespace of ROS'),
    ('controller_manager', 'left/', 'must be the name of a node'),
    ('controller_manager', '/', 'must be the name of a node'),
    ('spawn', 'effort controller', "'effort controller' is no name of ROS"),
    ('controllers', '/no/such.yaml', 'no such file'),
    ('record', str(ROOT), 'exists already'),
])
def test_mistakes_are_named(launch_file, key, value, allowed):
    with pytest.raises(RuntimeError, match=re.escape(f'{key}:={value}: {allowed}')) as caught:
        actions(launch_file, **{key: value})
    assert '\n' not in str(caught.value)


def test_a_mistake_in_the_configuration_is_named_before_anything_is_spawned(launch_file, tmp_path):
    mine = tmp_path / 'mine.yaml'
    mine.write_text('driver: {name: joint, fresh: never}\n')
    with pytest.raises(RuntimeError, match=r'config:=.*driver\.fresh'):
        actions(launch_file, spawn=SPAWN, config=str(mine))


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

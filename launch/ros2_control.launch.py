"""The loop around a joint of ros2_control, whose controller_manager runs already.

ros2 launch dz_ros ros2_control.launch.py
ros2 launch dz_ros ros2_control.launch.py config:=/path/to/file.yaml joint:=elbow
ros2 launch dz_ros ros2_control.launch.py spawn:=effort_controller,joint_state_broadcaster
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

PEERS = ['plant_node', 'controller_node', 'trajectory_node']
"""Whom the loop waits for; actuator_node takes the place of plant_node."""


def nodes(context):
    """Return the actions for the arguments given."""
    share = Path(get_package_share_directory('dz_ros'))
    config = configuration_file(LaunchConfiguration('config').perform(context), share)
    record = LaunchConfiguration('record').perform(context)
    joint = LaunchConfiguration('joint').perform(context)
    spawn = [name.strip() for name in LaunchConfiguration('spawn').perform(context).split(',')
             if name.strip()]
    settings = {'loop.peers': PEERS + (['recorder_node'] if record else []),
                'driver.name': 'joint'}
    if joint:
        settings['driver.joint'] = joint
    if LaunchConfiguration('duration').perform(context):
        settings['loop.duration'] = number(context, 'duration')

    def node(name, **extra):
        return Node(package='dz_ros', executable=name, name=name, output='screen',
                    parameters=[config, {**settings, **extra}])

    started = {name: node(name) for name in ('actuator_node', 'controller_node',
                                             'trajectory_node')}
    if record:
        started['recorder_node'] = node('recorder_node', directory=str(Path(record).absolute()))
    spawner = [Node(package='controller_manager', executable='spawner', output='screen',
                    arguments=[*spawn, '--param-file',
                               LaunchConfiguration('controllers').perform(context)
                               or str(share / 'launch' / 'joint_controllers.yaml')])]
    # The actuator is the loop's clock: when it has ended, the run is over. When another node has
    # ended before it, the loop is broken, and the rest must not go on without it.
    return [*(spawner if spawn else []), *started.values(), *(
        RegisterEventHandler(OnProcessExit(
            target_action=action, on_exit=[EmitEvent(event=Shutdown(reason=f'{name} has ended'))]))
        for name, action in started.items())]


def number(context, name):
    """Return an argument that is a number."""
    text = LaunchConfiguration(name).perform(context)
    try:
        return float(text)
    except ValueError:
        raise RuntimeError(f'{name}:={text}: must be a number of seconds') from None


def configuration_file(config, share):
    """Return the path of a configuration given by path or by the name of one that ships."""
    shipped = share / 'config' / f'{config}.yaml'
    if not Path(config).exists() and shipped.exists():
        return str(shipped)
    if not Path(config).is_file():
        raise RuntimeError(f'config:={config}: no such file, and no configuration of that name')
    return config


def generate_launch_description():
    """Return the launch description."""
    return LaunchDescription([
        DeclareLaunchArgument('config', default_value='joint',
                              description='parameter file of the loop, or the name of one that '
                                          'ships with dz_ros'),
        DeclareLaunchArgument('joint', default_value='',
                              description='name of the joint; empty = as the parameter file says'),
        DeclareLaunchArgument('duration', default_value='',
                              description='length of the run [s]; 0 = until stopped; '
                                          'empty = as the parameter file says'),
        DeclareLaunchArgument('record', default_value='',
                              description='directory to record the run to; must not exist yet; '
                                          'empty = no recording'),
        DeclareLaunchArgument('spawn', default_value='',
                              description='controllers to load and activate first, separated by '
                                          'commas; empty = they run already'),
        DeclareLaunchArgument('controllers', default_value='',
                              description='parameter file of the controllers to spawn; empty = '
                                          'launch/joint_controllers.yaml of dz_ros'),
        OpaqueFunction(function=nodes),
    ])

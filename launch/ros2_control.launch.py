# SPDX-License-Identifier: Apache-2.0
"""The loop around joints of ros2_control, whose controller_manager runs already.

ros2 launch dz_ros ros2_control.launch.py
ros2 launch dz_ros ros2_control.launch.py config:=/path/to/file.yaml joint:=elbow
ros2 launch dz_ros ros2_control.launch.py spawn:=joint_state_broadcaster,effort_controller
ros2 launch dz_ros ros2_control.launch.py controller_manager:=/left/controller_manager

Controllers that are spawned are configured for the joints that the loop drives; the loop starts
when they are active, and nothing goes on when they cannot be.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.logging import launch_config
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from dz_ros.files.launch_arguments import joint_controllers, LaunchArguments, of_manager
from launch import LaunchDescription

PEERS = ['plant_node', 'controller_node', 'trajectory_node']
"""Peers that the loop waits for; actuator_node takes the place of plant_node."""
ARGUMENTS = ('config', 'joint', 'duration', 'record', 'namespace', 'controller_manager', 'spawn',
             'controllers')


def nodes(context):
    """Return the actions for the arguments given."""
    given = LaunchArguments({name: LaunchConfiguration(name).perform(context)
                             for name in ARGUMENTS})
    config, record, namespace = given.configuration(), given.new_directory(), given.namespace()
    joint, spawn = given.text('joint'), given.names('spawn')
    manager = given.node('controller_manager')
    configuration = None
    if joint or manager or spawn:
        configuration = given.read(**{'driver.name': 'joint'})
    if joint and configuration.axes:
        raise given.wrong('joint', f'the loop has the axes {", ".join(configuration.axis_names)}: '
                          'name their joints in its file, axes.NAME.driver.joint')
    if joint:
        configuration = configuration.replace(**{'driver.joint': joint})
    settings = {'loop.peers': PEERS + (['recorder_node'] if record else []),
                'driver.name': 'joint'}
    if joint:
        settings['driver.joint'] = ParameterValue(joint, value_type=str)
    if manager:
        settings.update(of_manager(configuration, manager))
    if given.text('duration'):
        settings['loop.duration'] = given.number('duration', 'seconds')
    controllers = given.existing('controllers', 'file') if given.text('controllers') else ''

    def node(name, **extra):
        return Node(package='dz_ros', executable=name, name=name, namespace=namespace,
                    output='screen', parameters=[config, {**settings, **extra}])

    started = {name: node(name) for name in ('actuator_node', 'controller_node',
                                             'trajectory_node')}
    if record:
        started['recorder_node'] = node('recorder_node',
                                        directory=ParameterValue(record, value_type=str))
    # The actuator is the loop's clock: when it has ended, the run is over. When another node has
    # ended before it, the loop is broken, and the rest must not go on without it.
    loop = [*started.values(), *(
        RegisterEventHandler(OnProcessExit(
            target_action=action, on_exit=[EmitEvent(event=Shutdown(reason=f'{name} has ended'))]))
        for name, action in started.items())]
    if not spawn:
        return loop
    if not controllers:
        # The manager reads it when it loads a controller, so it stays with the launch's log.
        share = Path(get_package_share_directory('dz_ros'))
        controllers = str(joint_controllers(share / 'launch' / 'joint_controllers.yaml',
                                            configuration, Path(launch_config.log_dir),
                                            manager.rpartition('/')[0]))
    spawner = Node(package='controller_manager', executable='spawner', output='screen',
                   namespace=manager.rpartition('/')[0],
                   arguments=[*spawn, *(['--controller-manager', manager] if manager else []),
                              '--param-file', controllers])

    def spawned(event, context):
        """Start the loop when the controllers are active, else end the launch with an error."""
        if event.returncode == 0:
            return loop
        if context.is_shutdown:
            return None
        raise RuntimeError(f'spawn:={",".join(spawn)}: the spawner has failed with exit code '
                           f'{event.returncode}; the loop is not started')

    return [spawner, RegisterEventHandler(OnProcessExit(target_action=spawner, on_exit=spawned))]


def generate_launch_description():
    """Return the launch description."""
    return LaunchDescription([
        DeclareLaunchArgument('config', default_value='joint',
                              description='parameter file of the loop, or the name of one that '
                                          'ships with dz_ros'),
        DeclareLaunchArgument('joint', default_value='',
                              description='name of the joint of a loop of one axis; empty = as '
                                          'in the parameter file'),
        DeclareLaunchArgument('duration', default_value='',
                              description='length of the run [s]; 0 = until stopped; '
                                          'empty = as in the parameter file'),
        DeclareLaunchArgument('record', default_value='',
                              description='directory to record the run to; must not exist yet; '
                                          'empty = no recording'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='ROS namespace of the loop; not of the controllers'),
        DeclareLaunchArgument('controller_manager', default_value='',
                              description='node of another controller manager; its namespace is '
                                          'put before the names of controller and topics in the '
                                          'parameter file; empty = /controller_manager, and '
                                          'the names as they are'),
        DeclareLaunchArgument('spawn', default_value='',
                              description='controllers to load and activate first, separated by '
                                          'commas; empty = they run already'),
        DeclareLaunchArgument('controllers', default_value='',
                              description='parameter file of the controllers to spawn; empty = '
                                          'launch/joint_controllers.yaml of dz_ros, for the '
                                          'joints of the loop'),
        OpaqueFunction(function=nodes),
    ])

# SPDX-License-Identifier: Apache-2.0
"""The whole loop: plant, controller and trajectory, with an optional recorder.

ros2 launch dz_ros closed_loop.launch.py
ros2 launch dz_ros closed_loop.launch.py config:=/path/to/file.yaml duration:=60.0
ros2 launch dz_ros closed_loop.launch.py record:=/path/to/new_run namespace:=left_valve
ros2 launch dz_ros closed_loop.launch.py driver:=cia402
"""

from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from dz_ros.files.launch_arguments import LaunchArguments
from launch import LaunchDescription

PEERS = ['plant_node', 'controller_node', 'trajectory_node']
ARGUMENTS = ('config', 'duration', 'record', 'namespace', 'driver')


def nodes(context):
    """Return the actions for the arguments given."""
    given = LaunchArguments({name: LaunchConfiguration(name).perform(context)
                             for name in ARGUMENTS})
    config, record = given.configuration(), given.new_directory()
    namespace, driver = given.namespace(), given.driver()

    settings = {'loop.peers': PEERS + (['recorder_node'] if record else [])}
    peers = PEERS
    if driver:
        settings['driver.name'] = ParameterValue(driver, value_type=str)
        peers = ['actuator_node', *PEERS[1:]]
    if given.text('duration'):
        settings['loop.duration'] = given.number('duration', 'seconds')

    def node(name, **extra):
        return Node(package='dz_ros', executable=name, name=name, namespace=namespace,
                    output='screen', parameters=[config, {**settings, **extra}])

    started = {name: node(name) for name in peers}
    if record:
        started['recorder_node'] = node('recorder_node',
                                        directory=ParameterValue(record, value_type=str))
    # The plant is the loop's clock: when it has ended, the run is over. When another node has
    # ended before it, the loop is broken, and the rest must not go on without it.
    return [*started.values(), *(
        RegisterEventHandler(OnProcessExit(
            target_action=action, on_exit=[EmitEvent(event=Shutdown(reason=f'{name} has ended'))]))
        for name, action in started.items())]


def generate_launch_description():
    """Return the launch description."""
    return LaunchDescription([
        DeclareLaunchArgument('config', default_value='robust_eso',
                              description='parameter file of the loop, or the name of one that '
                                          'ships with dz_ros'),
        DeclareLaunchArgument('duration', default_value='',
                              description='length of the run [s]; 0 = until stopped; '
                                          'empty = as in the parameter file'),
        DeclareLaunchArgument('record', default_value='',
                              description='directory to record the run to; must not exist yet; '
                                          'empty = no recording'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='ROS namespace of the loop'),
        DeclareLaunchArgument('driver', default_value='',
                              description='driver of the actuator, see dz driver list; '
                                          'empty = the simulated one'),
        OpaqueFunction(function=nodes),
    ])

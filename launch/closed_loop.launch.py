"""The whole loop: plant, controller and trajectory, with an optional recorder.

ros2 launch dz_ros closed_loop.launch.py
ros2 launch dz_ros closed_loop.launch.py config:=/path/to/file.yaml duration:=60.0
ros2 launch dz_ros closed_loop.launch.py record:=/path/to/new_run namespace:=left_valve
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


def nodes(context):
    """Return the actions for the arguments given."""
    config = LaunchConfiguration('config').perform(context)
    duration = LaunchConfiguration('duration').perform(context)
    record = LaunchConfiguration('record').perform(context)
    namespace = LaunchConfiguration('namespace').perform(context)

    settings = {'loop.peers': PEERS + (['recorder_node'] if record else [])}
    if duration:
        settings['loop.duration'] = float(duration)

    def node(name, **extra):
        return Node(package='dz_ros', executable=name, name=name, namespace=namespace,
                    output='screen', parameters=[config, {**settings, **extra}])

    plant = node('plant_node')
    actions = [plant, node('controller_node'), node('trajectory_node')]
    if record:
        actions.append(node('recorder_node', directory=str(Path(record).absolute())))
    # The plant is the loop's clock: when it has ended, the run is over.
    actions.append(RegisterEventHandler(OnProcessExit(
        target_action=plant, on_exit=[EmitEvent(event=Shutdown(reason='the run is over'))])))
    return actions


def generate_launch_description():
    """Return the launch description."""
    share = Path(get_package_share_directory('dz_ros'))
    return LaunchDescription([
        DeclareLaunchArgument('config', default_value=str(share / 'config' / 'wang2004.yaml'),
                              description='parameter file of the loop'),
        DeclareLaunchArgument('duration', default_value='',
                              description='length of the run [s]; 0 = until stopped; '
                                          'empty = as the parameter file says'),
        DeclareLaunchArgument('record', default_value='',
                              description='directory to record the run to; must not exist yet; '
                                          'empty = no recording'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='ROS namespace of the loop'),
        OpaqueFunction(function=nodes),
    ])

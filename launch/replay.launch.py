# SPDX-License-Identifier: Apache-2.0
"""A recorded run published again.

ros2 launch dz_ros replay.launch.py run:=/path/to/run
ros2 launch dz_ros replay.launch.py run:=/path/to/run rate:=2.0 start:=3.0 clock:=40.0 loop:=true
ros2 launch dz_ros replay.launch.py run:=/path/to/run namespace:=again topics:=state,reference
"""

from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from dz_ros.files.launch_arguments import LaunchArguments
from launch import LaunchDescription

NAMES = ('run', 'rate', 'start', 'duration', 'loop', 'paused', 'clock', 'topics', 'wait_for',
         'namespace')


def nodes(context):
    """Return the actions for the arguments given."""
    given = LaunchArguments({name: LaunchConfiguration(name).perform(context) for name in NAMES})
    run = given.existing('run', 'run')
    parameters = {'run': ParameterValue(run, value_type=str),
                  'rate': given.number('rate', '', above=0.0)}
    for name, unit in (('start', 'seconds'), ('duration', 'seconds'), ('clock', 'Hz')):
        parameters[name] = given.number(name, unit)
    for name in ('loop', 'paused'):
        parameters[name] = given.flag(name)
    for name in ('topics', 'wait_for'):
        if words := given.names(name):
            parameters[name] = words
    replay = Node(package='dz_ros', executable='replay_node', name='replay_node',
                  namespace=given.namespace(), output='screen', parameters=[parameters])
    return [replay, RegisterEventHandler(OnProcessExit(
        target_action=replay, on_exit=[EmitEvent(event=Shutdown(reason='the run is over'))]))]


def generate_launch_description():
    """Return the launch description."""
    return LaunchDescription([
        DeclareLaunchArgument('run', description='directory of the run, or its .mcap; any rosbag2 '
                                                 'bag'),
        DeclareLaunchArgument('rate', default_value='1.0',
                              description='how many times faster than recorded'),
        DeclareLaunchArgument('start', default_value='0.0',
                              description='where to begin, from the first message on [s]'),
        DeclareLaunchArgument('duration', default_value='0.0',
                              description='how much to play, in recorded time [s]; 0 = to the '
                                          'end'),
        DeclareLaunchArgument('loop', default_value='false', description='begin again at the end'),
        DeclareLaunchArgument('paused', default_value='false', description='begin paused'),
        DeclareLaunchArgument('clock', default_value='0.0',
                              description='publish the time of the recording on /clock at '
                                          'this rate [Hz]; 0 = never'),
        DeclareLaunchArgument('topics', default_value='',
                              description='topics to play, separated by commas; empty = all'),
        DeclareLaunchArgument('wait_for', default_value='',
                              description='topics that must have a subscriber before the first '
                                          'message, separated by commas'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='ROS namespace to publish in'),
        OpaqueFunction(function=nodes),
    ])

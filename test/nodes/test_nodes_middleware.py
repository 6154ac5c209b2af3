# SPDX-License-Identifier: Apache-2.0
"""What the nodes ask of Fast DDS: no shared memory, the discovery range the user asked for."""

import contextlib
from pathlib import Path
import sys
from xml.etree import ElementTree

import pytest

from dz_ros.nodes.ros import middleware
from dz_ros.nodes.ros.middleware import wishes

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

PLANT = ('-m', 'dz_ros.nodes.main', 'plant_node')
PEERLESS = ('--ros-args', '-p', 'loop.peers:=["absent_node"]')
PROFILE, RANGE = 'FASTRTPS_DEFAULT_PROFILES_FILE', 'ROS_AUTOMATIC_DISCOVERY_RANGE'
SIZE = 400_000
SPEAKER = f"""
import os, pathlib, sys, rclpy
from dz_ros.nodes.ros.middleware import wishes
from std_msgs.msg import String
os.environ.update(wishes(os.environ, pathlib.Path.cwd()))
rclpy.init()
node = rclpy.create_node('speaker')
qos = rclpy.qos.QoSProfile(depth=200, durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL)
node.create_publisher(String, 'events', qos).publish(String(data='x' * {SIZE}))
rclpy.spin(node)
"""


def shared_memory(pid):
    """Return the files of Fast DDS's shared memory that a process has mapped."""
    lines = Path(f'/proc/{pid}/maps').read_text().splitlines()
    return {line.split()[-1] for line in lines if '/dev/shm/fast' in line}


def ports(pid):
    """Return the UDP ports a process has bound."""
    own = set()
    for link in Path(f'/proc/{pid}/fd').iterdir():
        with contextlib.suppress(FileNotFoundError):    # closed meanwhile
            own.add(str(link.readlink()).removeprefix('socket:[').removesuffix(']'))
    rows = [line.split() for line in Path('/proc/net/udp').read_text().splitlines()[1:]]
    return {int(row[1].rsplit(':', 1)[1], 16) for row in rows if row[9] in own}


class Stranger:
    """An ordinary node in this process, with the middleware as it comes."""

    def __init__(self):
        from std_msgs.msg import Float64MultiArray, String
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node('stranger', context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.events = []
        qos = rclpy.qos.QoSProfile(depth=200,
                                   durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(Float64MultiArray, 'state', lambda _message: None, 1)
        self.node.create_subscription(
            String, 'events', lambda message: self.events.append(message.data), qos)

    def wait(self, process, condition):
        while not condition():
            assert process.poll() is None, process.output
            self.executor.spin_once(timeout_sec=0.1)

    def parameter(self, process, name):
        from rcl_interfaces.srv import GetParameters
        client = self.node.create_client(GetParameters, 'plant_node/get_parameters')
        self.wait(process, client.service_is_ready)
        future = client.call_async(GetParameters.Request(names=[name]))
        self.wait(process, future.done)
        return future.result().values[0]


@pytest.fixture
def stranger(request, monkeypatch):
    """Yield an idle node of another package in the discovery range of the test."""
    for name, value in request.param.items():
        monkeypatch.setenv(name, value)
    found = Stranger()
    yield found
    found.executor.shutdown()
    found.node.destroy_node()
    found.context.shutdown()


RANGES = {'localhost': ({RANGE: 'LOCALHOST'}, False),
          'localhost only': ({'ROS_LOCALHOST_ONLY': '1'}, False),
          'subnet': ({RANGE: 'SUBNET'}, True)}


@pytest.mark.parametrize(('stranger', 'multicast'), RANGES.values(), ids=RANGES,
                         indirect=['stranger'])
def test_a_node_sees_a_stranger_without_shared_memory(stranger, multicast, processes, ros_domain):
    plant = processes(*PLANT, *PEERLESS)
    stranger.wait(plant, lambda: stranger.events)
    assert stranger.parameter(plant, 'loop.rate').double_value == 200.0
    assert shared_memory(plant.pid) == set()
    # A node that queries the whole network receives its queries as well.
    assert (7400 + 250 * ros_domain in ports(plant.pid)) == multicast


@pytest.mark.parametrize('stranger', [{RANGE: 'LOCALHOST'}], ids=['localhost'],
                         indirect=True)
def test_a_user_can_have_shared_memory(stranger, processes):
    plant = processes(*PLANT, *PEERLESS, FASTDDS_BUILTIN_TRANSPORTS='DEFAULT')
    stranger.wait(plant, lambda: stranger.events)
    assert shared_memory(plant.pid)


@pytest.mark.parametrize('stranger', [RANGES['localhost'][0], RANGES['subnet'][0]],
                         ids=['localhost', 'subnet'], indirect=True)
def test_a_stranger_receives_a_large_event(stranger, processes):
    speaker = processes(sys.executable, '-c', SPEAKER)
    stranger.wait(speaker, lambda: stranger.events)
    assert [len(text) for text in stranger.events] == [SIZE]


LOCAL, ALL = 'fastdds_localhost.xml', 'fastdds.xml'


@pytest.mark.parametrize(('environment', 'profile', 'transport', 'discovery'), [
    ({}, ALL, 'UDPv4', None),
    ({RANGE: 'SUBNET'}, ALL, 'UDPv4', None),
    ({RANGE: 'OFF'}, ALL, 'UDPv4', None),
    ({RANGE: 'LOCALHOST'}, LOCAL, 'UDPv4', 'SYSTEM_DEFAULT'),
    ({RANGE: 'LOCALHOST', 'ROS_STATIC_PEERS': '192.0.2.1'}, ALL, 'UDPv4', None),
    ({RANGE: 'SUBNET', 'ROS_LOCALHOST_ONLY': '1', 'ROS_STATIC_PEERS': '192.0.2.1'}, LOCAL,
     'UDPv4', 'SYSTEM_DEFAULT'),
    ({RANGE: 'LOCALHOST', 'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4'}, LOCAL, 'UDPv4',
     'SYSTEM_DEFAULT'),
    ({RANGE: 'LOCALHOST', 'FASTDDS_BUILTIN_TRANSPORTS': 'LARGE_DATA'}, ALL, None, None)])
def test_what_is_asked_of_the_middleware(environment, profile, transport, discovery, tmp_path):
    found = wishes(environment, tmp_path)
    assert Path(found[PROFILE]).name == profile
    assert Path(found[PROFILE]).is_file()
    assert found.get(middleware.TRANSPORTS) == transport
    assert found.get(RANGE) == discovery


@pytest.mark.parametrize('name', middleware.PROFILES)
def test_a_profile_of_the_user_is_left_alone(name, tmp_path):
    assert wishes({name: 'mine.xml', RANGE: 'LOCALHOST'}, tmp_path) == {}


def test_a_profile_in_the_folder_keeps_its_discovery(tmp_path):
    (tmp_path / middleware.LOCAL_PROFILES).write_text('<profiles/>')
    found = wishes({RANGE: 'LOCALHOST'}, tmp_path)
    assert set(found) == {PROFILE}


def test_both_profiles_set_writers_up_alike():
    folder = Path(middleware.__file__).parents[1]
    writers = [ElementTree.parse(folder / name).getroot().find('{*}data_writer')
               for name in (LOCAL, ALL)]
    assert writers[0] is not None
    assert ElementTree.canonicalize(ElementTree.tostring(writers[0]), strip_text=True) == \
        ElementTree.canonicalize(ElementTree.tostring(writers[1]), strip_text=True)

# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest
import yaml

from dz_ros.recording.channels import CHANNELS, Qos, TYPES


@pytest.mark.parametrize('name', TYPES)
def test_definition_and_hash_are_those_of_jazzy(name):
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    definition, _ = store.generate_msgdef(name, ros_version=2)
    assert TYPES[name].definition == definition
    assert TYPES[name].type_hash == store.hash_rihs01(name)
    assert TYPES[name].encoding == 'ros2msg'


@pytest.mark.parametrize('name', TYPES)
def test_hash_is_that_of_the_installed_messages(name):
    found = importlib.util.find_spec('std_msgs')
    if found is None or found.origin is None:
        pytest.skip('std_msgs is not installed')
    short = name.rpartition('/')[2]
    places = [parent / 'share' / 'std_msgs' / 'msg' / f'{short}.json'
              for parent in Path(found.origin).parents]
    described = next((place for place in places if place.is_file()), None)
    if described is None:
        pytest.skip('std_msgs is installed without its type descriptions')
    hashes = {item['type_name']: item['hash_string']
              for item in json.loads(described.read_text())['type_hashes']}
    assert TYPES[name].type_hash == hashes[name]


def test_rclpy_accepts_the_qos():
    qos = pytest.importorskip('rclpy.qos', reason='rclpy is not installed')
    duration = pytest.importorskip('rclpy.duration').Duration
    for channel in CHANNELS.values():
        stored = channel.qos.to_dict()
        times = {name: duration(seconds=stored[name]['sec'], nanoseconds=stored[name]['nsec'])
                 for name in ('deadline', 'lifespan', 'liveliness_lease_duration')}
        profile = qos.QoSProfile(
            depth=stored['depth'],
            history=getattr(qos.HistoryPolicy, stored['history'].upper()),
            reliability=getattr(qos.ReliabilityPolicy, stored['reliability'].upper()),
            durability=getattr(qos.DurabilityPolicy, stored['durability'].upper()),
            liveliness=getattr(qos.LivelinessPolicy, stored['liveliness'].upper()), **times)
        assert profile.depth == channel.qos.depth
        assert {item.nanoseconds for item in times.values()} == {2**63 - 1}   # infinite to rmw


def test_another_library_reads_the_qos():
    metadata = pytest.importorskip('rosbags.rosbag2.metadata')
    interfaces = pytest.importorskip('rosbags.interfaces')
    for channel in CHANNELS.values():
        profile, = metadata.parse_qos(yaml.safe_dump([channel.qos.to_dict()]))
        assert profile.reliability == interfaces.QosReliability.RELIABLE
        assert profile.history == interfaces.QosHistory.KEEP_LAST
        assert profile.durability.name.lower() == channel.qos.durability
        assert profile.depth == channel.qos.depth
        assert metadata.dump_qos_v9([profile]) == [channel.qos.to_dict()]


def test_channels_are_those_of_a_run():
    assert list(CHANNELS) == ['reference', 'state', 'command', 'terms', 'truth', 'events']
    assert {name: channel.type.name for name, channel in CHANNELS.items()} == {
        **dict.fromkeys(['reference', 'state', 'command', 'terms', 'truth'],
                        'std_msgs/msg/Float64MultiArray'), 'events': 'std_msgs/msg/String'}
    assert CHANNELS['events'].qos.durability == 'transient_local'
    assert CHANNELS['state'].qos.durability == Qos().durability == 'volatile'

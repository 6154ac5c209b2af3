# SPDX-License-Identifier: Apache-2.0
"""What the nodes that show a loop are given, and what Foxglove's passes on."""

import asyncio
import json
import time

import pytest

from dz_ros.recording.axes_cdr import codec_for
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.channels import CHANNELS
from dz_ros.recording.reader import read_run

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
aiohttp = pytest.importorskip('aiohttp', reason='aiohttp is not installed: no page to serve')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

DZ = ('-m', 'dz_ros')
NODE = ('-m', 'dz_ros.nodes.main')
TIME_OUT = 180.0


@pytest.mark.parametrize(('parameter', 'message'), [
    ('port:=70000', 'port = 70000: must be 0 to 65535'), ('minutes:=0.0', 'minutes = 0.0'),
    ('host:=no.such.host.invalid', "host = 'no.such.host.invalid'")])
def test_bad_parameters_are_one_line(processes, parameter, message):
    process = processes(*NODE, 'live_node', '--ros-args', '-p', parameter)
    assert process.wait() == 2
    assert message in process.output
    assert 'Traceback' not in process.output


def received(address):
    """Return the channels that a server offers, and topic → (time [ns], payload) of five of them.

    Each has at least a hundred.
    """
    async def look():
        found = {}
        async with aiohttp.ClientSession() as session, session.ws_connect(
                address, protocols=('foxglove.sdk.v1', 'foxglove.websocket.v1')) as ws:
            channels = {}
            while len(found) < 5 or any(len(item) < 100 for item in found.values()):
                message = await ws.receive(TIME_OUT)
                if message.type is aiohttp.WSMsgType.TEXT:
                    text = json.loads(message.data)
                    for channel in text.get('channels', ()):
                        channels[channel['id']] = channel
                        await ws.send_json({'op': 'subscribe', 'subscriptions': [
                            {'id': channel['id'], 'channelId': channel['id']}]})
                elif message.data[0] == 1:
                    channel = channels[int.from_bytes(message.data[1:5], 'little')]
                    if channel['topic'] != '/events':
                        found.setdefault(channel['topic'], []).append(
                            (int.from_bytes(message.data[5:13], 'little'), message.data[13:]))
        return channels, found

    return asyncio.run(look())


def test_foxglove_gets_the_very_bytes(processes, tmp_path):
    pytest.importorskip('foxglove', reason='foxglove-sdk is not installed')
    from dz_ros.nodes.ros import topics
    process = processes(*DZ, 'run', 'servo', '--quiet', '--duration', '600', '--record',
                        tmp_path / 'run')
    server = processes(*NODE, 'foxglove_node', '--ros-args', '-p', 'foxglove_port:=0')
    address = server.wait_for_line('foxglove: ').split()[-1].replace('ws://', 'http://')

    unusable = ArrayCodec(('seq', 'stamp', *(f'n{k}' for k in range(4000)))).encode([0.0] * 4002)
    rclpy.init()
    node = rclpy.create_node('of_others')
    rival = node.create_publisher(topics.TYPES['terms'], 'terms', 10)
    texts = node.create_publisher(topics.TYPES['events'], 'events', topics.offered('events'))
    try:
        deadline = time.monotonic() + TIME_OUT
        while 'terms: more than' not in server.output or 'events: ' not in server.output:
            assert time.monotonic() < deadline, server.output
            rival.publish(unusable)
            texts.publish(topics.TYPES['events'](data='[' * 1000))
            time.sleep(0.1)
    finally:
        node.destroy_node()
        rclpy.shutdown()

    channels, found = received(address)
    process.interrupt()
    data = read_run(tmp_path / 'run')
    assert {item['topic'] for item in channels.values()} == {f'/{name}' for name in CHANNELS}
    for item in channels.values():
        expected = CHANNELS[item['topic'].strip('/')].type
        assert (item['encoding'], item['schemaName'], item['schema']) == (
            'cdr', expected.name, expected.definition)
    for topic, messages in found.items():
        channel = data.channels[topic.strip('/')]
        decode = ArrayCodec(channel.labels).decode
        # A sample is published again while the loop starts.
        recorded = {(tuple(row), when) for row, when in zip(
            channel.values.tolist(), channel.publish_time.tolist(), strict=True)}
        for when, payload in messages[:-20]:
            assert (decode(payload), when) in recorded


def test_foxglove_gets_the_rows_of_all_axes(processes, tmp_path):
    pytest.importorskip('foxglove', reason='foxglove-sdk is not installed')
    from std_msgs.msg import MultiArrayDimension

    from dz_ros.nodes.ros import topics
    axes = ('surge', 'sway', 'yaw')
    server = processes(*NODE, 'foxglove_node', '--ros-args', '-p', 'foxglove_port:=0')
    address = server.wait_for_line('foxglove: ').split()[-1].replace('ws://', 'http://')
    process = processes(*DZ, 'run', 'rov_planar', '--quiet', '--duration', '600', '--record',
                        tmp_path / 'run')
    rclpy.init()
    node = rclpy.create_node('of_others')
    rival = node.create_publisher(topics.TYPES['terms'], 'terms', 10)
    short = topics.TYPES['terms'](data=[0.0, 0.0])      # two rows announced, one there
    short.layout.dim = [MultiArrayDimension(label=label, size=2, stride=stride)
                        for label, stride in (('surge,sway', 4), ('seq,stamp', 2))]
    try:
        deadline = time.monotonic() + TIME_OUT
        while 'terms: a row missing' not in server.output:
            assert time.monotonic() < deadline, server.output
            rival.publish(short)
            time.sleep(0.1)
    finally:
        node.destroy_node()
        rclpy.shutdown()
    _, found = received(address)
    process.interrupt()
    data = read_run(tmp_path / 'run')
    assert data.axes == axes
    assert set(found) == {'/reference', '/state', '/command', '/terms', '/truth'}
    for topic, messages in found.items():
        channel = data.channels[topic.strip('/')]
        decode = codec_for(channel.labels, axes).decode
        # A sample is published again while the loop starts.
        recorded = {(tuple(row), when) for row, when in zip(
            channel.values.tolist(), channel.publish_time.tolist(), strict=True)}
        for when, payload in messages[:-20]:
            numbers = decode(payload)
            assert len(numbers) == len(axes) * len(channel.labels)
            assert (numbers, when) in recorded

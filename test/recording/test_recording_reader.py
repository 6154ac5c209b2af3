# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import shutil
import struct

from mcap.writer import CompressionType, Writer
import numpy as np
import pytest

from dz_ros.core.dataset import Channel, RunData
from dz_ros.errors import RecordingError, RunNotFoundError
from dz_ros.recording.axes_cdr import AxesCodec
from dz_ros.recording.cdr import ArrayCodec, encode_string
from dz_ros.recording.channels import ARRAY, TEXT
from dz_ros.recording.reader import read_run, run_info
from dz_ros.recording.save import save_run
from dz_ros.recording.writer import RunWriter

STATE = ArrayCodec(('seq', 'stamp', 'x0'))


def test_round_trip(tmp_path, make_run, same):
    data = make_run()
    save_run(data, tmp_path / 'run')
    for path in (tmp_path / 'run', tmp_path / 'run/run_0.mcap', str(tmp_path / 'run')):
        found = read_run(path)
        same(data, found)
        assert found.configuration == data.configuration
        assert found.info['host'] == 'bench'
        assert (found.info['plant'], found.info['law']) == ('wang2004', 'pd')
        assert 'cut' not in found.info
    with pytest.raises(ValueError, match='read-only'):
        found.channels['state'].values[0, 0] = 1.0


def test_awkward_numbers(tmp_path, awkward, same):
    values = np.array([[0.0, 0.0, *awkward], [1.0, 0.005, *reversed(awkward)]])
    labels = ('seq', 'stamp', *(f'x{i}' for i in range(len(awkward))))
    times = np.array([0, 2**63 - 1])
    data = RunData({'state': Channel(labels, values, times, times[::-1].copy())})
    save_run(data, tmp_path / 'run')
    same(data, read_run(tmp_path / 'run'))


def test_configuration_from_events(tmp_path):
    """What ``ros2 bag record`` stores has no metadata of ours, but the nodes' own words."""
    with RunWriter(tmp_path / 'run', {}, {}) as writer:
        writer.add_topic('/events', TEXT.name)
        writer.add_topic('/state', ARRAY.name)
        for node, owns, configuration in (
                ('/plant_node', ['plant', 'loop'], {'plant.b': 2.0, 'loop.rate': 100.0,
                                                    'controller.law': 'pd'}),
                ('/controller_node', ['controller'], {'plant.b': 1.0, 'controller.law': 'pid'}),
                ('/controller_node', ['controller'], {'controller.law': 'later'})):
            writer.write('/events', encode_string(json.dumps(
                {'node': node, 'event': 'configuration', 'owns': owns,
                 'configuration': configuration})), 5, 5)
        for text in ('not json', '[1]', '"a"', '{"event": "configuration"}', '[' * 100_000):
            writer.write('/events', encode_string(text), 6, 6)
        writer.write('/state', STATE.encode([0, 0, 0]), 7, 7)
    found = read_run(tmp_path / 'run')
    assert found.configuration == {'plant.b': 2.0, 'loop.rate': 100.0, 'controller.law': 'pid'}
    assert found.info['law'] == 'pid'
    assert [node for _, node, _ in found.events] == [
        '/plant_node', '/controller_node', '/controller_node', '', '', '', '', '']


def test_metadata_wins_over_events_and_adds_up(tmp_path):
    with RunWriter(tmp_path / 'run', {'plant': 'mine'}, {'loop.rate': 1.0, 'plant.b': 1.0}) as w:
        w.add_configuration({'plant.b': 2.0, 'controller.law': 'pd'})
        w.add_topic('/events', TEXT.name)
        w.add_topic('/state', ARRAY.name)
        w.write('/events', encode_string(
            '{"event": "configuration", "configuration": {"plant.b": 9.0}}'), 5, 5)
        w.write('/state', STATE.encode([0, 0, 0]), 7, 7)
    found = read_run(tmp_path / 'run')
    assert found.configuration == {'loop.rate': 1.0, 'plant.b': 2.0, 'controller.law': 'pd'}
    assert found.info['plant'] == 'mine'


def test_channels_come_in_the_order_of_the_loop(tmp_path, make_run):
    data = make_run(3)
    shuffled = RunData(dict(reversed(data.channels.items())))
    for channel in shuffled.channels.values():
        channel.log_time[:] = 0
    save_run(shuffled, tmp_path / 'run')
    assert list(read_run(tmp_path / 'run').channels) == list(data.channels)


def two_loops(path):
    with RunWriter(path, {}, {}) as writer:
        for number, place in enumerate(('/left', '/right/valve')):
            writer.add_topic(f'{place}/state', ARRAY.name)
            writer.add_topic(f'{place}/events', TEXT.name)
            for k in range(3):
                writer.write(f'{place}/state', STATE.encode([k, 0, number]), k, k)
            writer.write(f'{place}/events', encode_string(
                f'{{"event": "started", "node": "{place}"}}'), 9, 9)


def test_namespaces(tmp_path):
    two_loops(tmp_path / 'run')
    with pytest.raises(RecordingError, match='several loops: /left, /right/valve; choose one'):
        read_run(tmp_path / 'run')
    for place, number in (('/left', 0), ('left', 0), ('/right/valve/', 1), ('right/valve', 1)):
        found = read_run(tmp_path / 'run', namespace=place)
        assert found.channels['state']['x0'].tolist() == [number] * 3
        assert [node for _, node, _ in found.events] == ['/' + place.strip('/')]
    with pytest.raises(RecordingError, match='no messages of /; it has /left, /right/valve'):
        read_run(tmp_path / 'run', namespace='')
    assert set(run_info(tmp_path / 'run').topics) == {
        '/left/state', '/left/events', '/right/valve/state', '/right/valve/events'}


def test_run_info(tmp_path, make_run):
    data = make_run(200)
    written = save_run(data, tmp_path / 'run')
    info = run_info(tmp_path / 'run')
    assert info.topics == written.topics
    assert info.messages == written.messages == 5 * 200 + 2
    assert (info.start_ns, info.duration) == (written.start_ns, written.duration)
    assert info.size == written.bytes
    assert info.files == ('run_0.mcap',)
    assert info.complete
    assert info.info['mode'] == 'realtime'
    assert info.info['law'] == 'pd'
    assert info.info['dz_ros']


def test_gaps_are_found_again(tmp_path):
    with RunWriter(tmp_path / 'run', {}, {}) as writer:
        writer.add_topic('/state', ARRAY.name)
        writer.add_topic('/command', ARRAY.name)
        for k in (0, 1, 4, 4, 3):
            writer.write('/state', STATE.encode([k, 0, 0]), k, k)
    found = run_info(tmp_path / 'run').topics
    assert (found['/state'].missing, found['/state'].duplicates, found['/state'].reordered) == (
        1, 1, 1)
    assert found['/command'].messages == 0


def test_split_bags_are_read_in_order(tmp_path):
    bag = tmp_path / 'bag'
    for number in range(12):
        with RunWriter(tmp_path / f'part{number}', {}, {}) as writer:
            writer.add_topic('/state', ARRAY.name)
            writer.write('/state', STATE.encode([number, 0, 0]), number, number)
        bag.mkdir(exist_ok=True)
        shutil.move(writer.path, bag / f'bag_{number}.mcap')
    assert read_run(bag).channels['state']['seq'].tolist() == list(range(12))
    names = ', '.join(f'bag_{number}.mcap' for number in (3, 1))
    (bag / 'metadata.yaml').write_text('rosbag2_bagfile_information:\n  storage_identifier: mcap\n'
                                       f'  relative_file_paths: [{names}]\n')
    assert read_run(bag).channels['state']['seq'].tolist() == [3, 1]
    (bag / 'bag_3.mcap').unlink()
    with pytest.raises(RunNotFoundError, match=r'bag_3\.mcap: metadata\.yaml names it'):
        read_run(bag)


@pytest.mark.parametrize('text', ['', '][', 'a: b', '[1]', 'rosbag2_bagfile_information: 3',
                                  '\0', 'rosbag2_bagfile_information: {storage_identifier: mcap}'])
def test_without_a_readable_metadata_file_the_recording_speaks(tmp_path, make_run, text, same):
    data = make_run(20)
    save_run(data, tmp_path / 'run')
    (tmp_path / 'run/metadata.yaml').write_text(text)
    same(data, read_run(tmp_path / 'run'))
    (tmp_path / 'run/metadata.yaml').write_bytes(b'\xff\xfe\xfa')
    same(data, read_run(tmp_path / 'run'))


def other_mcap(path, compression=CompressionType.NONE, chunks=True, **topics):
    """Write an MCAP file as another recorder might, without checksums or metadata."""
    with path.open('wb') as file:
        writer = Writer(file, compression=compression, use_chunking=chunks, enable_crcs=False)
        writer.start('ros2')
        for number, (name, (kind, encoding, payloads)) in enumerate(topics.items()):
            schema = writer.register_schema(kind, 'ros2msg', b'')
            channel = writer.register_channel(f'/{name}', encoding, schema)
            for payload in payloads:
                writer.add_message(channel, number, payload, number)
        writer.finish()
    return path


@pytest.mark.parametrize('compression', list(CompressionType))
@pytest.mark.parametrize('chunks', [True, False])
def test_other_recorders_settings(tmp_path, compression, chunks):
    payloads = [STATE.encode([k, k * 0.5, -k]) for k in range(2500)]
    path = other_mcap(tmp_path / 'a.mcap', compression, chunks,
                      state=(ARRAY.name, 'cdr', payloads))
    found = read_run(path)
    assert found.channels['state'].values.tolist() == [[k, k * 0.5, -k] for k in range(2500)]


def test_other_byte_order_and_mixed_layouts(tmp_path):
    store = pytest.importorskip('rosbags.typesys')
    store = store.get_typestore(store.Stores.ROS2_JAZZY)
    ours = [STATE.encode([k, 0, k]) for k in range(4)]
    theirs = [bytes(store.serialize_cdr(store.deserialize_cdr(item, ARRAY.name), ARRAY.name,
                                        little_endian=False)) for item in ours]
    path = other_mcap(tmp_path / 'a.mcap', state=(ARRAY.name, 'cdr', [
        theirs[0], ours[1], theirs[2], ours[3] + b'\0']))
    assert read_run(path).channels['state']['x0'].tolist() == [0, 1, 2, 3]


BARE = struct.pack('<4sIII4x2d', b'\x00\x01\x00\x00', 0, 0, 2, 1.0, 2.0)


@pytest.mark.parametrize(('topics', 'reason'), [
    ({}, 'not a run of dz_ros: none of its topics is .*; it has none at all'),
    ({'imu': ('sensor_msgs/msg/Imu', 'cdr', [b''])}, 'it has /imu'),
    ({'state': ('sensor_msgs/msg/Imu', 'cdr', [b''])}, 'it has /state'),
    ({'state': (ARRAY.name, 'json', [b'{}'])}, 'it has /state'),
    ({'state': (ARRAY.name, 'cdr', [])}, 'holds no messages'),
    ({'state': (ARRAY.name, 'cdr', [BARE])}, r'/state does not carry .* 2 numbers without names'),
    ({'state': (ARRAY.name, 'cdr', [ArrayCodec(('x', 'y')).encode([1, 2])])}, 'carries x, y'),
    ({'state': (ARRAY.name, 'cdr', [b'nonsense'])}, '/state: message 0: not a CDR message'),
    ({'events': (TEXT.name, 'cdr', [b'\x00\x01\x00\x00\xff\xff\xff\xff'])}, '/events: message is'),
])
def test_foreign_contents_are_named(tmp_path, topics, reason):
    path = other_mcap(tmp_path / 'a.mcap', **topics)
    with pytest.raises(RecordingError, match=reason) as error:
        read_run(path)
    assert '\n' not in str(error.value)


OTHER = ArrayCodec(('seq', 'stamp', 'y0')).encode([7, 0, 0])
SEVERAL = AxesCodec(('seq', 'stamp', 'x0'), ('left', 'right')).encode([7, 0, 0, 7, 0, 0])


@pytest.mark.parametrize(('foreign', 'reason'), [
    (OTHER, 'of another layout left out, the first is message {}: message carries seq, stamp, '
            'y0; expected seq, stamp, x0'),
    (SEVERAL, 'of another layout left out, the first is message {}: message carries 6 numbers'),
    (BARE, '2 numbers without names'), (b'nonsense', 'message {}: not a CDR message'),
    (STATE.encode([float('nan'), 0, 0]), 'message {}: seq is nan')], ids=[
        'labels', 'axes', 'no names', 'no message', 'no count'])
@pytest.mark.parametrize('place', [0, 1, 3])
def test_messages_of_another_program_are_left_out(tmp_path, foreign, reason, place):
    payloads = [STATE.encode([k, 0.1 * k, k]) for k in range(3)]
    payloads.insert(place, foreign)
    data = read_run(other_mcap(tmp_path / 'a.mcap', state=(ARRAY.name, 'cdr', payloads)))
    assert data.channels['state']['x0'].tolist() == [0, 1, 2]
    assert data.info['notes'].count('1 message') == 1
    assert 'topic /state' in data.info['notes']
    assert reason.format(place) in data.info['notes']


def test_many_layouts_are_left_out(tmp_path):
    others = [ArrayCodec(('seq', 'stamp', f'y{k}')).encode([k, 0, 0]) for k in range(40)]
    payloads = [STATE.encode([k, 0.1 * k, k]) for k in range(2)]
    data = read_run(other_mcap(tmp_path / 'a.mcap', state=(
        ARRAY.name, 'cdr', [*others[:8], *payloads, *others[8:]])))
    assert data.channels['state']['x0'].tolist() == [0, 1]
    assert '25 messages left out: ' in data.info['notes']
    assert 'more than 16 layouts' in data.info['notes']


def test_what_is_no_run(tmp_path):
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'notes.txt').write_text('hello')
    (tmp_path / 'log.csv').write_text('t,x\n0,1\n')
    (tmp_path / 'zero.mcap').write_bytes(b'')
    for path, kind, reason in (
            (tmp_path / 'nowhere', RunNotFoundError, 'no such run'),
            (tmp_path / 'empty', RecordingError, 'neither metadata.yaml nor an .mcap file'),
            (tmp_path / 'notes.txt', RecordingError, 'not an MCAP file$'),
            (tmp_path / 'log.csv', RecordingError, 'becomes a run by dz bag import'),
            (tmp_path / 'zero.mcap', RecordingError, 'it is empty'),
            (tmp_path / 'notes.txt/run', RecordingError, 'no such run|cannot be read')):
        for read in (read_run, run_info):
            with pytest.raises(kind, match=reason):
                read(path)

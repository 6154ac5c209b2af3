# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from pathlib import Path

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from mcap.reader import make_reader, NonSeekingReader
import pytest
import yaml

from dz_ros.errors import RecordingError, RunExistsError
from dz_ros.recording.cdr import ArrayCodec, encode_string
from dz_ros.recording.channels import CHANNELS, Qos, TYPES
from dz_ros.recording.mcap_file import McapFile
from dz_ros.recording.writer import CHUNK_BYTES, CHUNK_SECONDS, RunWriter

ARRAY, TEXT = TYPES
START = 1_700_000_000_000_000_000
STATE = ArrayCodec(('seq', 'stamp', 'x0'))
SLOW = settings(suppress_health_check=[HealthCheck.function_scoped_fixture],
                max_examples=settings.default.max_examples // 4)


def write(directory: Path, messages, **options):
    """Write (topic, payload, log, publish) messages on /state, /ns/command and /events."""
    with RunWriter(directory, options.get('info', {'mode': 'offline', 'host': 'bench'}),
                   options.get('configuration', {'loop.rate': 200.0})) as writer:
        writer.add_topic('/state', ARRAY)
        writer.add_topic('/ns/command', ARRAY, Qos(depth=7))
        writer.add_topic('/events', TEXT)
        for message in messages:
            writer.write(*message)
        return writer.close()


def some(count: int):
    """Return messages of three topics in turn."""
    for k in range(count):
        log = START + 5_000_000 * k
        yield '/state', STATE.encode([k, k * 0.005, -k]), log, log - 900
        yield '/ns/command', STATE.encode([k, k * 0.005, k]), log + 1, log - 800
        if k % 100 == 0:
            yield '/events', encode_string(f'{{"k": {k}}}'), log + 2, log - 700


def test_another_reader_gets_every_message(tmp_path):
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    written = list(some(1000))
    summary = write(tmp_path / 'run', written)
    with rosbag2.Reader(tmp_path / 'run') as reader:
        found = [(item.topic, payload, time) for item, time, payload in reader.messages()]
        assert found == [message[:3] for message in written]
        assert reader.message_count == summary.messages == 2010
        assert reader.start_time == START
        assert reader.end_time - 1 == START + 999 * 5_000_000 + 1
        assert {item.topic: item.digest for item in reader.connections} == {
            '/state': TYPES[ARRAY].type_hash, '/ns/command': TYPES[ARRAY].type_hash,
            '/events': TYPES[TEXT].type_hash}
        assert {item.topic: (item.ext.offered_qos_profiles[0].depth,
                             item.ext.offered_qos_profiles[0].durability.name)
                for item in reader.connections} == {
            '/state': (CHANNELS['state'].qos.depth, 'VOLATILE'), '/ns/command': (7, 'VOLATILE'),
            '/events': (CHANNELS['events'].qos.depth, 'TRANSIENT_LOCAL')}
    with rosbag2.Reader(tmp_path / 'run' / 'run_0.mcap') as reader:       # the file alone
        assert reader.message_count == 2010


def test_another_library_decodes_every_message(tmp_path):
    highlevel = pytest.importorskip('rosbags.highlevel')
    write(tmp_path / 'run', some(300))
    with highlevel.AnyReader([tmp_path / 'run']) as reader:     # types from the file, not from us
        numbers = [list(reader.deserialize(payload, item.msgtype).data)
                   for item, _, payload in reader.messages(
                       item for item in reader.connections if item.topic == '/state')]
    assert numbers == [[k, k * 0.005, -k] for k in range(300)]


def test_the_format_s_own_reader(tmp_path):
    written = list(some(1000))
    write(tmp_path / 'run', written)
    path = tmp_path / 'run' / 'run_0.mcap'
    for whole in (False, True):
        with path.open('rb') as file:
            reader = (NonSeekingReader if whole else make_reader)(file, validate_crcs=True)
            found = [(channel.topic, message.data, message.log_time, message.publish_time)
                     for _, channel, message in reader.iter_messages()]
            assert found == written
    with path.open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
        assert {item.compression for item in summary.chunk_indexes} == {'zstd'}
        assert max(item.uncompressed_size for item in summary.chunk_indexes) < 1.1 * CHUNK_BYTES
        assert {(item.name, item.encoding) for item in summary.schemas.values()} == {
            (ARRAY, 'ros2msg'), (TEXT, 'ros2msg')}
        assert {item.message_encoding for item in summary.channels.values()} == {'cdr'}
        for item in summary.channels.values():
            profile, = yaml.safe_load(item.metadata['offered_qos_profiles'])
            assert profile['reliability'] == 'reliable'
            assert item.metadata['topic_type_hash'].startswith('RIHS01_')
        records = {item.name: item.metadata for item in reader.iter_metadata()}
        assert records['dz_ros.info']['host'] == 'bench'
        assert json.loads(records['dz_ros.configuration']['flat']) == {'loop.rate': 200.0}
        assert yaml.safe_load(records['dz_ros.configuration']['loop']) == {'rate': 200.0}
        assert json.loads(records['dz_ros.summary']['topics'])['/state']['messages'] == 1000
        inside = yaml.safe_load(records['rosbag2']['serialized_metadata'])
    assert inside == yaml.safe_load(
        (tmp_path / 'run/metadata.yaml').read_text())['rosbag2_bagfile_information']


def test_metadata_is_what_rosbag2_writes(tmp_path):
    """Fields, order and types of rosbag2_storage's yaml.hpp, version 9."""
    write(tmp_path / 'run', some(10))
    contents = yaml.safe_load((tmp_path / 'run/metadata.yaml').read_text())
    assert list(contents) == ['rosbag2_bagfile_information']
    bag = contents['rosbag2_bagfile_information']
    topics = bag.pop('topics_with_message_count')
    assert list(bag) == ['version', 'storage_identifier', 'duration', 'starting_time',
                         'message_count', 'compression_format', 'compression_mode',
                         'relative_file_paths', 'files', 'custom_data', 'ros_distro']
    times = {'starting_time': {'nanoseconds_since_epoch': START},
             'duration': {'nanoseconds': 9 * 5_000_000 + 1}}
    assert bag == {
        'version': 9, 'storage_identifier': 'mcap', **times, 'message_count': 21,
        'compression_format': '', 'compression_mode': '', 'relative_file_paths': ['run_0.mcap'],
        'files': [{'path': 'run_0.mcap', **times, 'message_count': 21}],
        'custom_data': {'mode': 'offline', 'host': 'bench'}, 'ros_distro': 'jazzy'}
    assert [(item['topic_metadata']['name'], item['message_count']) for item in topics] == [
        ('/state', 10), ('/ns/command', 10), ('/events', 1)]
    infinite = {'sec': 9223372036, 'nsec': 854775807}
    assert topics[1]['topic_metadata'] == {
        'name': '/ns/command', 'type': ARRAY, 'serialization_format': 'cdr',
        'offered_qos_profiles': [{
            'history': 'keep_last', 'depth': 7, 'reliability': 'reliable',
            'durability': 'volatile', 'deadline': infinite, 'lifespan': infinite,
            'liveliness': 'automatic', 'liveliness_lease_duration': infinite,
            'avoid_ros_namespace_conventions': False}],
        'type_description_hash': TYPES[ARRAY].type_hash}


def test_metadata_has_the_fields_another_writer_gives(tmp_path):
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    with rosbag2.Writer(tmp_path / 'theirs', version=9,
                        storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        writer.set_custom_data('mode', 'offline')
        topic = writer.add_connection('/state', ARRAY, typestore=store)
        writer.write(topic, START, STATE.encode([0, 0, 0]))
    with RunWriter(tmp_path / 'ours', {'mode': 'offline'}, {}) as ours:
        ours.add_topic('/state', ARRAY, [])
        ours.write('/state', STATE.encode([0, 0, 0]), START, START)

    def read(name):
        text = (tmp_path / name / 'metadata.yaml').read_text()
        bag = yaml.safe_load(text.replace('ours_0.mcap', 'theirs.mcap'))
        return bag['rosbag2_bagfile_information']

    assert read('ours') == {**read('theirs'), 'ros_distro': 'jazzy'}


def test_empty_run(tmp_path):
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    summary = write(tmp_path / 'run', [], info={}, configuration={})
    assert (summary.messages, summary.start_ns, summary.duration) == (0, None, 0.0)
    bag = yaml.safe_load((tmp_path / 'run/metadata.yaml').read_text())[
        'rosbag2_bagfile_information']
    assert bag['starting_time']['nanoseconds_since_epoch'] == 2**63 - 1   # as rosbag2 does
    assert bag['custom_data'] is None
    with rosbag2.Reader(tmp_path / 'run') as reader:
        assert list(reader.messages()) == []


@SLOW
@given(st.lists(st.tuples(st.sampled_from(['/state', '/ns/command', '/events']), st.binary(),
                          st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1)), max_size=60))
def test_any_bytes_at_any_time_come_back(place, messages):
    run = place()
    summary = write(run, messages)
    found = [tuple(item) for batch in McapFile(summary.directory / f'{run.name}_0.mcap').batches()
             for item in batch]
    assert found == messages
    assert summary.messages == len(messages)
    assert sum(item.bytes for item in summary.topics.values()) == sum(
        len(item[1]) for item in messages)


def test_gaps_are_counted(tmp_path):
    numbers = [0, 1, 2, 5, 6, 6, 4, 7]
    summary = write(tmp_path / 'run', [('/state', STATE.encode([k, 0, 0]), START, START)
                                       for k in numbers])
    found = summary.topics['/state']
    assert (found.missing, found.duplicates, found.reordered) == (1, 1, 1)
    assert summary.missing == 1


def test_never_overwrites(tmp_path):
    summary = write(tmp_path / 'run', some(3))
    before = {path: path.read_bytes() for path in summary.directory.iterdir()}
    with pytest.raises(RunExistsError, match='never overwritten'):
        RunWriter(tmp_path / 'run', {}, {})
    (tmp_path / 'file').write_text('mine')
    with pytest.raises(RunExistsError):
        RunWriter(tmp_path / 'file', {}, {})
    assert {path: path.read_bytes() for path in summary.directory.iterdir()} == before
    assert (tmp_path / 'file').read_text() == 'mine'


def test_refusals_leave_nothing_behind(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(RecordingError, match='cannot be created'):
        RunWriter(tmp_path / 'file' / 'run', {}, {})
    with pytest.raises(RecordingError, match='configuration cannot be stored'):
        RunWriter(tmp_path / 'run', {}, {'plant.b': object()})
    assert [path.name for path in tmp_path.iterdir()] == ['file']


def test_topics_are_checked(tmp_path):
    with RunWriter(tmp_path / 'run', {}, {}) as writer:
        for topic, kind in (('state', ARRAY), ('/', ARRAY), ('/state/', ARRAY),
                            ('/state', 'sensor_msgs/msg/Imu')):
            with pytest.raises(RecordingError, match='cannot be recorded'):
                writer.add_topic(topic, kind)
        writer.add_topic('/state', ARRAY)
        writer.add_topic('/state', ARRAY)
        with pytest.raises(RecordingError, match='it cannot be'):
            writer.add_topic('/state', TEXT)
        with pytest.raises(RecordingError, match='not registered'):
            writer.write('/command', b'', 0, 0)
        for times in ((-1, 0), (0, 2**63), (2**64, 0)):
            with pytest.raises(RecordingError, match='are not times'):
                writer.write('/state', b'', *times)
        writer.write('/state', STATE.encode([0, 0, 0]), 0, 0)
    assert writer.summary().messages == 1
    assert writer.close() is writer.close()
    for late in (lambda: writer.write('/state', b'', 0, 0), writer.flush,
                 lambda: writer.add_metadata('a', {})):
        with pytest.raises(RecordingError, match='is closed'):
            late()


def test_text_that_utf8_cannot_hold_does_not_stop_a_recording(tmp_path):
    write(tmp_path / 'run', some(3), info={'host': 'bad\udcff'})
    file = McapFile(tmp_path / 'run/run_0.mcap')
    list(file.batches())
    assert dict(file.metadata)['dz_ros.info']['host'] == 'bad?'


def test_a_chunk_never_stays_open_long(tmp_path):
    now = 100.0
    with RunWriter(tmp_path / 'run', {}, {}, clock=lambda: now) as writer:
        writer.add_topic('/state', ARRAY)

        def stored() -> int:
            return sum(len(batch) for batch in McapFile(writer.path).batches())

        writer.write('/state', STATE.encode([0, 0, 0]), START, START)
        now += 0.9 * CHUNK_SECONDS
        writer.flush_if_due()
        assert stored() == 0
        now += 0.2 * CHUNK_SECONDS
        writer.flush_if_due()                       # without a writer
        assert stored() == 1
        writer.write('/state', STATE.encode([1, 0, 0]), START, START)
        assert stored() == 1
        now += 1.1 * CHUNK_SECONDS
        writer.write('/state', STATE.encode([2, 0, 0]), START, START)     # the next one comes
        assert stored() == 2
        writer.write('/state', bytes(CHUNK_BYTES), START, START)          # a chunk is full
        assert stored() == 4


def test_a_file_states_its_origin_before_its_first_message(tmp_path):
    writer = RunWriter(tmp_path / 'run', {'mode': 'realtime'}, {'loop.rate': 100.0})
    writer.add_configuration({'plant.model': 'servo'})
    file = McapFile(writer.path)
    assert list(file.batches()) == []
    assert [name for name, _ in file.metadata] == ['dz_ros.info', 'dz_ros.configuration',
                                                   'dz_ros.configuration']
    assert file.cut
    writer.close()

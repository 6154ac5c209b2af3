# SPDX-License-Identifier: Apache-2.0
"""Files that were cut off or altered: a clear error or a recovered run, never a wrong number."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
import numpy as np
import pytest

from dz_ros.errors import DamagedRunError, RecordingError, RunExistsError, RunNotFoundError
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.channels import ARRAY
from dz_ros.recording.mcap_file import McapFile
from dz_ros.recording.reader import read_run, run_info
from dz_ros.recording.recover import recover
from dz_ros.recording.save import save_run
from dz_ros.recording.writer import RunWriter

MANY = settings(suppress_health_check=[HealthCheck.function_scoped_fixture],
                max_examples=6 * settings.default.max_examples // 10)


class Whole:
    """A run of several chunks: its data, the bytes of its file, where its chunks begin and end."""

    def __init__(self, data, directory: Path) -> None:
        path = save_run(data, directory).directory / f'{directory.name}_0.mcap'
        self.data = data
        self.contents = path.read_bytes()
        with path.open('rb') as file:       # by the index, which we do not use
            indexes = make_reader(file).get_summary().chunk_indexes
        self.offsets = [item.chunk_start_offset for item in indexes]
        self.first_end = self.offsets[0] + indexes[0].chunk_length


@pytest.fixture
def whole(tmp_path, make_run):
    found = Whole(make_run(1200), tmp_path / 'whole')
    assert len(found.offsets) >= 5
    return found


def bare(directory: Path, contents: bytes) -> Path:
    """Return a run directory with this file and no metadata.yaml, as a kill leaves it."""
    directory.mkdir()
    (directory / f'{directory.name}_0.mcap').write_bytes(contents)
    return directory


def attempt(read, *arguments):
    """Return what reading gives, or the error, which must be one line."""
    try:
        return read(*arguments)
    except RecordingError as error:
        text = str(error)
        found = error
    assert '\n' not in text
    return found


def assert_part_of(found, data, *, prefix: bool) -> int:
    """Fail unless what was found are rows of the data, in order; return their number."""
    for name, channel in found.channels.items():
        original = data.channels[name]
        assert channel.labels == original.labels
        rows = channel['seq'].astype(int)
        if prefix:
            assert rows.tolist() == list(range(len(rows)))
        assert (np.diff(rows) > 0).all()
        assert channel.values.tobytes() == original.values[rows].tobytes()
        assert channel.log_time.tolist() == original.log_time[rows].tolist()
        assert channel.publish_time.tolist() == original.publish_time[rows].tolist()
    return sum(len(channel) for channel in found.channels.values())


@pytest.mark.slow
@MANY
@given(st.data())
def test_cut_anywhere(whole, place, data):
    run, contents = whole.data, whole.contents
    kept = data.draw(st.integers(0, len(contents) - 1))
    path = bare(place(), contents[:kept])
    found = attempt(read_run, path)
    if isinstance(found, RecordingError):
        assert not isinstance(found, DamagedRunError)       # cut, not damaged
        assert kept < whole.first_end
        with pytest.raises(RecordingError):
            recover(path, place())
        return
    assert 'cut off' in found.info['cut']
    assert found.configuration == dict(run.configuration)
    assert_part_of(found, run, prefix=True)
    info = run_info(path)
    assert not info.complete
    assert info.cut == found.info['cut']
    target = place()
    summary = recover(path, target)
    assert summary.notes == (found.info['cut'],)
    again = read_run(target)
    for name, channel in found.channels.items():
        assert channel.values.tobytes() == again.channels[name].values.tobytes()
    assert again.events == found.events
    assert again.configuration == found.configuration
    assert again.info['recovered'] == found.info['cut']
    assert 'cut' not in again.info
    assert run_info(target).complete


@pytest.mark.slow
@MANY
@given(st.data())
def test_flipped_bits_in_a_whole_file(whole, place, data):
    run, contents = whole.data, whole.contents
    broken = bytearray(contents)
    for _ in range(data.draw(st.integers(1, 3))):
        broken[data.draw(st.integers(0, len(broken) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    path = bare(place(), bytes(broken))
    found = attempt(read_run, path)
    if not isinstance(found, RecordingError):       # the closing magic or nothing was hit
        assert_part_of(found, run, prefix=True)
        assert found.configuration == dict(run.configuration)
        if bytes(broken) != contents:
            assert 'cut' in found.info
    target = place()
    if isinstance(attempt(recover, path, target), RecordingError):
        assert not target.exists()
    else:
        assert_part_of(read_run(target), run, prefix=False)


@MANY
@given(st.data())
def test_flipped_bits_in_a_cut_file(whole, place, data):
    """Without the checksum of the whole, those of chunks and of our metadata must do."""
    run, contents = whole.data, whole.contents
    broken = bytearray(contents[:data.draw(st.integers(60_000, len(contents) - 1))])
    broken[data.draw(st.integers(0, len(broken) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    path = bare(place(), bytes(broken))
    found = attempt(read_run, path)
    if not isinstance(found, RecordingError):
        assert_part_of(found, run, prefix=False)
        assert found.configuration in ({}, dict(run.configuration))


@MANY
@given(st.binary(max_size=300), st.booleans(), st.booleans())
def test_garbage(place, noise, begins, ends):
    magic = b'\x89MCAP0\r\n'
    path = bare(place(), magic * begins + noise + magic * ends)
    attempt(read_run, path)
    attempt(run_info, path)
    target = place()
    with pytest.raises(RecordingError):
        recover(path, target)
    assert not target.exists()


@MANY
@given(st.data())
def test_zeros_where_a_power_cut_left_holes(whole, place, data):
    run, contents = whole.data, whole.contents
    start = data.draw(st.integers(0, len(contents)))
    size = data.draw(st.integers(1, 200_000))
    path = bare(place(), contents[:start] + bytes(size))
    found = attempt(read_run, path)
    if not isinstance(found, RecordingError):
        assert_part_of(found, run, prefix=True)


def test_a_damaged_chunk_costs_that_chunk(whole, tmp_path):
    run, contents = whole.data, whole.contents
    offsets = whole.offsets
    broken = bytearray(contents)
    broken[offsets[2] + 1000] ^= 16
    path = bare(tmp_path / 'broken', bytes(broken))
    with pytest.raises(DamagedRunError, match='dz bag recover') as error:
        read_run(path)
    assert f'damaged at byte {offsets[2]}, ' in str(error.value)
    assert f'dz bag recover {path / "broken_0.mcap"}' in str(error.value)
    summary = recover(path, tmp_path / 'mended')
    assert summary.missing > 0
    assert any(f'damaged at byte {offsets[2]}' in note for note in summary.notes)
    kept = assert_part_of(read_run(tmp_path / 'mended'), run, prefix=False)
    assert 6000 * (1 - 1.5 / len(offsets)) < kept < 6000
    assert path.joinpath('broken_0.mcap').read_bytes() == bytes(broken)      # never touched


def test_damage_to_the_first_chunk_costs_no_other(whole, tmp_path):
    """The definitions of the channels are in it; the summary repeats them."""
    broken = bytearray(whole.contents)
    broken[whole.offsets[0] + 1000] ^= 16
    summary = recover(bare(tmp_path / 'broken', bytes(broken)), tmp_path / 'mended')
    assert len(summary.notes) == 2                      # the chunk, the checksum of the file
    found = read_run(tmp_path / 'mended')
    kept = assert_part_of(found, whole.data, prefix=False)
    assert 6000 * (1 - 1.5 / len(whole.offsets)) < kept < 6000
    broken[-30] ^= 1                                    # the summary as well: nothing is believed
    with pytest.raises(RecordingError, match='not one message can be read'):
        recover(bare(tmp_path / 'worse', bytes(broken)), tmp_path / 'none')


def test_behind_a_wrong_length_the_index_shows_the_way(whole, tmp_path):
    run, contents = whole.data, whole.contents
    offsets = whole.offsets
    broken = bytearray(contents)
    broken[offsets[1] + 7] = 0xFF           # a chunk of 2^55 bytes
    path = bare(tmp_path / 'broken', bytes(broken))
    with pytest.raises(DamagedRunError, match='a record that cannot be'):
        read_run(path)
    recover(path, tmp_path / 'mended')
    found = read_run(tmp_path / 'mended')
    kept = assert_part_of(found, run, prefix=False)
    assert 6000 * (1 - 1.5 / len(offsets)) < kept < 6000
    assert found.channels['state']['seq'][-1] == 1199


def test_a_false_end_is_damage_not_a_cut(whole, tmp_path):
    contents = whole.contents
    path = bare(tmp_path / 'short', contents[:90_000] + contents[-8:])
    with pytest.raises(DamagedRunError, match='a record that cannot be'):
        read_run(path)


def test_an_altered_configuration_is_noticed_even_in_a_cut_file(whole, tmp_path):
    contents = whole.contents
    assert contents.count(b'"loop.rate": 200.0') == 1
    broken = contents[:100_000].replace(b'"loop.rate": 200.0', b'"loop.rate": 900.0')
    path = bare(tmp_path / 'broken', broken)
    with pytest.raises(DamagedRunError, match=r'dz_ros\.configuration: checksum does not fit'):
        read_run(path)
    summary = recover(path, tmp_path / 'mended')
    assert any('dz_ros.configuration' in note for note in summary.notes)
    assert read_run(tmp_path / 'mended').configuration == {}


def test_recover_refuses(whole, tmp_path):
    with pytest.raises(RunNotFoundError):
        recover(tmp_path / 'nowhere', tmp_path / 'new')
    (tmp_path / 'there').mkdir()
    with pytest.raises(RunExistsError, match='never overwritten'):
        recover(tmp_path / 'whole', tmp_path / 'there')
    with pytest.raises(RunExistsError):
        recover(tmp_path / 'whole', tmp_path / 'whole')
    bare(tmp_path / 'empty', whole.contents[:200])
    with pytest.raises(RecordingError, match='not one message can be read: cut off at byte'):
        recover(tmp_path / 'empty', tmp_path / 'new')
    assert not (tmp_path / 'new').exists()


def test_recover_of_a_whole_run_is_a_copy(whole, tmp_path):
    run = whole.data
    summary = recover(tmp_path / 'whole', tmp_path / 'copy')
    assert summary.notes == ()
    found = read_run(tmp_path / 'copy')
    assert assert_part_of(found, run, prefix=True) == 6000
    assert found.info['recovered_from'] == 'whole'
    assert 'recovered' not in found.info
    assert run_info(tmp_path / 'copy').topics == run_info(tmp_path / 'whole').topics


def test_recover_keeps_foreign_topics_and_metadata(tmp_path):
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    with rosbag2.Writer(tmp_path / 'theirs', version=9,
                        storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        imu = writer.add_connection('/imu', 'sensor_msgs/msg/Imu', typestore=store)
        state = writer.add_connection('/state', ARRAY.name, typestore=store)
        for k in range(50):
            writer.write(imu, k, bytes([0, 1, 0, 0, k]))
            writer.write(state, k, ArrayCodec(('seq', 'stamp')).encode([k, 0]))
    recover(tmp_path / 'theirs', tmp_path / 'ours')
    with rosbag2.Reader(tmp_path / 'ours') as reader:
        found = [(item.topic, item.msgtype, time, payload)
                 for item, time, payload in reader.messages()]
        definitions = {item.msgtype: item.msgdef.data for item in reader.connections}
    with rosbag2.Reader(tmp_path / 'theirs') as reader:
        assert found == [(item.topic, item.msgtype, time, payload)
                         for item, time, payload in reader.messages()]
        assert definitions == {item.msgtype: item.msgdef.data for item in reader.connections}
    with RunWriter(tmp_path / 'noted', {}, {}) as writer:
        writer.add_topic('/state', ARRAY.name)
        writer.write('/state', ArrayCodec(('seq', 'stamp')).encode([0, 0]), 1, 1)
        writer.add_metadata('operator', {'name': 'Ada'})
        writer.add_metadata('dz_ros.node./plant_node', {'rmw': 'x'})
    recover(tmp_path / 'noted', tmp_path / 'again')
    file = McapFile(tmp_path / 'again/again_0.mcap')
    list(file.batches())
    records = dict(file.metadata)
    assert records['operator'] == {'name': 'Ada'}
    assert records['dz_ros.node./plant_node']['rmw'] == 'x'
    assert [name for name, _ in file.metadata].count('dz_ros.summary') == 1

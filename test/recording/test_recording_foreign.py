# SPDX-License-Identifier: Apache-2.0
"""Bags of other libraries: the same numbers, and a clear word where they are broken."""

from __future__ import annotations

import contextlib
from contextlib import closing
import sqlite3

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import pytest

from dz_ros.errors import RecordingError
from dz_ros.recording.cdr import ArrayCodec, encode_string
from dz_ros.recording.channels import ARRAY, TEXT
from dz_ros.recording.reader import read_run, run_info


@pytest.fixture
def foreign(tmp_path, make_run):
    """Return bags of the same run made by another library: (path, publish times are kept)."""
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)

    def write(name, data, plugin, mode=None, names=None):
        writer = rosbag2.Writer(tmp_path / name, version=9, storage_plugin=plugin)
        if mode is not None:
            writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
        with writer:
            rows = []
            for channel, table in data.channels.items():
                topic = writer.add_connection((names or {}).get(channel, f'/{channel}'),
                                              ARRAY.name, typestore=store)
                codec = ArrayCodec(table.labels)
                rows += [(time, topic, codec.encode(row)) for time, row in zip(
                    table.log_time.tolist(), table.values.tolist(), strict=True)]
            topic = writer.add_connection('/events', TEXT.name, typestore=store)
            rows += [(time, topic, encode_string(text)) for time, _, text in data.events]
            rosout = writer.add_connection('/chatter', TEXT.name, typestore=store)
            rows.append((0, rosout, encode_string('hello')))
            for time, topic, payload in sorted(rows, key=lambda row: row[0]):
                writer.write(topic, time, payload)
        return tmp_path / name

    return write


@pytest.mark.parametrize(('plugin', 'mode'), [
    ('MCAP', None), ('MCAP', 'STORAGE'), ('MCAP', 'FILE'), ('MCAP', 'MESSAGE'),
    ('SQLITE3', None), ('SQLITE3', 'FILE'), ('SQLITE3', 'MESSAGE')])
def test_bags_of_another_library(foreign, make_run, plugin, mode, same):
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    data = make_run(300)
    path = foreign('theirs', data, rosbag2.StoragePlugin[plugin],
                   mode and rosbag2.CompressionMode[mode])
    found = read_run(path)
    same(data, found, publish=False)
    for channel in found.channels.values():       # their writer knows one time only
        assert channel.publish_time.tolist() == channel.log_time.tolist()
    assert found.configuration == {}
    info = run_info(path)
    assert info.storage == {'MCAP': 'mcap', 'SQLITE3': 'sqlite3'}[plugin]
    assert info.topics['/state'].messages == 300
    assert info.topics['/chatter'].messages == 1


def test_a_bare_database(foreign, make_run, same):
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    data = make_run(50)
    path = foreign('theirs', data, rosbag2.StoragePlugin.SQLITE3)
    (path / 'metadata.yaml').unlink()
    same(data, read_run(path), publish=False)
    same(data, read_run(path / 'theirs.db3'), publish=False)
    (path / 'theirs.db3').write_bytes((path / 'theirs.db3').read_bytes()[:5000])
    for bad in (path, path / 'theirs.db3'):
        with pytest.raises(RecordingError):
            read_run(bad)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture],
          max_examples=6 * settings.default.max_examples // 10)
@given(data=st.data())
def test_a_broken_database_is_named_or_read_whole(foreign, make_run, place, data):
    """Pages of a database carry no checksum: lost order is found, an altered digit is not."""
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    path = place()
    foreign(path.name, make_run(60), rosbag2.StoragePlugin.SQLITE3)
    file = path / f'{path.name}.db3'
    broken = bytearray(file.read_bytes())
    if data.draw(st.booleans(), 'cut'):
        del broken[data.draw(st.integers(0, len(broken) - 1)):]
    for _ in range(data.draw(st.integers(0 if len(broken) < 60_000 else 1, 3))):
        if broken:
            broken[data.draw(st.integers(0, len(broken) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    file.write_bytes(bytes(broken))
    for read in (read_run, run_info):
        with contextlib.suppress(RecordingError):     # anything else is a failure
            read(path)


def test_a_database_whose_index_lost_a_page_is_not_believed(foreign, make_run):
    """Without a look at the pages, SQLite itself answers from what the damage left."""
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    path = foreign('theirs', make_run(300), rosbag2.StoragePlugin.SQLITE3)
    file = path / 'theirs.db3'
    with closing(sqlite3.connect(file)) as database:
        size = database.execute('PRAGMA page_size').fetchone()[0]
        root = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
                                ).fetchone()[0]
    broken = bytearray(file.read_bytes())
    at = (root - 1) * size
    broken[at + 3:at + 5] = (1).to_bytes(2, 'big')      # the page reports it has one cell
    file.write_bytes(bytes(broken))
    with pytest.raises(RecordingError, match='damaged'):
        read_run(path)

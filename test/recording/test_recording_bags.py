# SPDX-License-Identifier: Apache-2.0
"""Bags as other tools, versions and killed recorders leave them: all is read, the rest named.

Over 300 lines: one bag of each storage is made once for all, and altered.
"""

from __future__ import annotations

from contextlib import closing
import importlib.util
from pathlib import Path
import shutil
import sqlite3

import pytest
import yaml

from dz_ros.cli.main import main as dz
from dz_ros.errors import DamagedRunError, RecordingError, RunNotFoundError
from dz_ros.recording.cdr import encode_string
from dz_ros.recording.channels import ARRAY
from dz_ros.recording.mcap_file import McapFile
from dz_ros.recording.reader import read_run, run_info
from dz_ros.recording.recover import recover
from dz_ros.recording.run_source import open_source
from dz_ros.recording.save import save_run


def beside(name):
    """Return a module of this folder; it is no package."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f'{name}.py'))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


parts = beside('mcap_parts')
FORMS = [('sqlite3', ''), ('sqlite3', 'message'), ('sqlite3', 'file'), ('mcap', ''),
         ('mcap', 'message'), ('mcap', 'file')]
INFINITE = {'sec': 0, 'nsec': 0}
BEST_EFFORT = {'history': 'keep_last', 'depth': 10, 'reliability': 'best_effort',
               'durability': 'volatile', 'deadline': INFINITE, 'lifespan': INFINITE,
               'liveliness': 'automatic', 'liveliness_lease_duration': INFINITE,
               'avoid_ros_namespace_conventions': False}


@pytest.fixture
def data(make_run):
    return make_run(60)


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """Return where bags are kept once made: each is the same run."""
    return tmp_path_factory.mktemp('made')


@pytest.fixture
def make_bag(tmp_path, data, made):
    """Return a maker of bags of the run: storage, compression mode, version of metadata.yaml."""
    pytest.importorskip('rosbags.rosbag2')

    def make(storage, mode='', version=9):
        kept = made / f'{storage}-{mode}-{version}' / 'bag'
        if not kept.exists():
            kept.parent.mkdir()
            ours = save_run(data, kept.parent / 'ours').directory
            assert beside('fuzz').bag(ours, kept, storage, mode, version)
        return shutil.copytree(kept, tmp_path / 'bag')

    return make


def edit(bag, change):
    """Change what metadata.yaml reports."""
    path = bag / 'metadata.yaml'
    contents = yaml.safe_load(path.read_text())
    change(contents['rosbag2_bagfile_information'])
    path.write_text(yaml.safe_dump(contents))


def topic_of(info, name='/reference'):
    return next(item for item in info['topics_with_message_count']
                if item['topic_metadata']['name'] == name)


@pytest.mark.parametrize(('storage', 'mode'), FORMS)
@pytest.mark.parametrize(('change', 'reported'), [
    (lambda info: topic_of(info)['topic_metadata'].update(offered_qos_profiles=[BEST_EFFORT]),
     'offered_qos_profiles'),
    (lambda info: topic_of(info)['topic_metadata'].update(offered_qos_profiles='- history: ['),
     'offered_qos_profiles'),
    (lambda info: topic_of(info).update(message_count=7), '/reference: message_count is 7'),
    (lambda info: topic_of(info).update(message_count='many'), 'message_count is many'),
    (lambda info: info.update(version=99), 'version is 99'),
    (lambda info: info.update(version='x'), 'version is x'),
    (lambda info: info.update(storage_identifier=''), "storage_identifier is ''"),
    (lambda info: info.update(storage_identifier='fast'), 'storage_identifier is fast'),
    (lambda info: topic_of(info)['topic_metadata'].update(type='x/msg/Y'), 'x/msg/Y'),
    (lambda info: topic_of(info)['topic_metadata'].update(serialization_format='cbor'), 'cbor'),
    (lambda info: info['topics_with_message_count'].pop(0), 'is not named'),
    (lambda info: info.update(topics_with_message_count=[3]), 'topic_metadata'),
    (lambda info: info.update(relative_file_paths=['other.db3']), 'other.db3'),
    (lambda info: info.update(compression_format='lz4', compression_mode='message'),
     'compression_mode'),
])
def test_what_metadata_yaml_reports_otherwise_is_named(make_bag, data, same, storage, mode, change,
                                                       reported):
    bag = make_bag(storage, mode)
    assert run_info(bag).notes == ()
    edit(bag, change)
    same(read_run(bag), data, publish=False)
    info = run_info(bag)
    if not (mode == 'message' and reported == 'compression_mode'):
        assert any(reported in note for note in info.notes), info.notes
    assert recover(bag, bag.with_name('copy')).notes == info.notes
    topics = open_source(bag).recorded_topics().values()
    assert {topic.name for topic in topics} == set(info.topics)


@pytest.mark.parametrize('change', [
    lambda info: [info.pop(key) for key in list(info) if key != 'relative_file_paths'],
    lambda info: info.update(relative_file_paths=[f'old/place/{name}' for name
                                                  in info['relative_file_paths']], version=3),
    lambda info: [item['topic_metadata'].pop('offered_qos_profiles')
                  for item in info['topics_with_message_count']],
    lambda info: [item['topic_metadata'].update(offered_qos_profiles='')
                  for item in info['topics_with_message_count']],
    lambda info: info.pop('topics_with_message_count'),
    lambda info: info.pop('relative_file_paths'),
])
@pytest.mark.parametrize(('storage', 'mode'), FORMS)
def test_what_metadata_yaml_leaves_out_is_no_loss(make_bag, data, same, storage, mode, change):
    bag = make_bag(storage, mode)
    edit(bag, change)
    same(read_run(bag), data, publish=False)


@pytest.mark.parametrize(('storage', 'mode'), FORMS)
@pytest.mark.parametrize('text', ['', '{', 'a: &a [*a]\n', '- 1\n',
                                  'rosbag2_bagfile_information:\n',
                                  '\udcff', 'a: ' + '[' * 5000])
def test_an_unreadable_metadata_yaml_is_named(make_bag, data, same, storage, mode, text):
    bag = make_bag(storage, mode)
    (bag / 'metadata.yaml').write_bytes(text.encode(errors='surrogateescape'))
    same(read_run(bag), data, publish=False)
    assert any('metadata.yaml: it ' in note for note in run_info(bag).notes)


@pytest.mark.parametrize('storage', ['sqlite3', 'mcap'])
@pytest.mark.parametrize('version', [8, 9])
@pytest.mark.parametrize('mode', ['', 'message', 'file'])
def test_without_metadata_yaml(make_bag, data, same, storage, version, mode):
    bag = make_bag(storage, mode, version=version)
    (bag / 'metadata.yaml').unlink()
    same(read_run(bag), data, publish=False)
    file = next(bag.iterdir())
    same(read_run(file), data, publish=False)
    same(read_run(recover(file, bag.with_name('copy')).directory), data, publish=False)


@pytest.mark.parametrize('older', [1, 2, 3])
def test_databases_of_earlier_schemas(make_bag, data, same, older):
    bag = make_bag('sqlite3')
    with closing(sqlite3.connect(bag / 'bag.db3')) as database:
        for table in ('schema', 'metadata', 'message_definitions'):
            database.execute(f'DROP TABLE {table}')
        if older < 3:
            database.execute('ALTER TABLE topics DROP COLUMN type_description_hash')
        if older < 2:
            database.execute('ALTER TABLE topics DROP COLUMN offered_qos_profiles')
        database.commit()
    same(read_run(bag), data, publish=False)
    assert run_info(bag).complete
    (bag / 'metadata.yaml').unlink()
    same(read_run(bag), data, publish=False)
    assert not run_info(bag).complete       # nothing reports that it is whole


@pytest.fixture
def killed(make_bag, tmp_path):
    """Return what a killed recorder leaves: half of the messages in the write-ahead log."""
    bag = make_bag('sqlite3')
    live = tmp_path / 'live'
    live.mkdir()
    with closing(sqlite3.connect(bag / 'bag.db3')) as whole, closing(
            sqlite3.connect(live / 'x_0.db3', isolation_level=None)) as database:
        database.execute('PRAGMA journal_mode=WAL')
        database.execute('PRAGMA wal_autocheckpoint=0')
        for table, sql in whole.execute("SELECT name, sql FROM sqlite_master WHERE type='table'"):
            database.execute(sql)
            rows = whole.execute(f'SELECT * FROM {table}').fetchall()
            half = len(rows) // 2 if table == 'messages' else len(rows)
            for piece in (rows[:half], rows[half:]):
                if piece and table != 'metadata':
                    database.execute('BEGIN')
                    database.executemany(f'INSERT INTO {table} VALUES '
                                         f'({",".join("?" * len(piece[0]))})', piece)
                    database.execute('COMMIT')
                if table == 'messages' and piece is not rows[half:]:
                    database.execute('PRAGMA wal_checkpoint(FULL)').fetchall()
        shutil.copytree(live, tmp_path / 'killed')
    return tmp_path / 'killed'


def test_a_killed_database_recorder(killed, data, same):
    before = {item.name: item.read_bytes() for item in killed.iterdir()}
    assert len(before['x_0.db3-wal']) > 0
    for path in (killed, killed / 'x_0.db3'):
        same(read_run(path), data, publish=False)
        info = run_info(path)
        assert not info.complete
        assert 'not closed' in info.cut
    copy = recover(killed, killed.with_name('copy'))
    assert copy.notes == (info.cut,)
    same(read_run(copy.directory), data, publish=False)
    assert {item.name: item.read_bytes() for item in killed.iterdir()} == before


def test_a_write_ahead_log_that_was_cut_gives_what_is_whole(killed, data):
    log = killed / 'x_0.db3-wal'
    log.write_bytes(log.read_bytes()[:len(log.read_bytes()) // 2])
    found = read_run(killed)
    assert 'not closed' in found.info['cut']
    for name, channel in found.channels.items():
        rows = channel['seq'].astype(int)
        assert channel.values.tobytes() == data.channels[name].values[rows].tobytes()


def test_a_journal_that_names_another_file_is_left_alone(make_bag, tmp_path):
    bag = make_bag('sqlite3')
    (tmp_path / 'precious').write_text('kept')
    (bag / 'bag.db3-journal').write_bytes(b'\0' * 512 + bytes.fromhex('d9d505f920a163d7'))
    with pytest.raises(RecordingError, match='several databases'):
        read_run(bag)


def test_a_database_that_computes_is_refused(make_bag):
    bag = make_bag('sqlite3')
    with closing(sqlite3.connect(bag / 'bag.db3')) as database:
        database.executescript(
            'ALTER TABLE messages RENAME TO hidden; CREATE VIEW messages AS '
            'WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) '
            "SELECT x AS id, 1 AS topic_id, x AS timestamp, x'00' AS data FROM c;")
    with pytest.raises(RecordingError, match='table messages'):
        read_run(bag)


@pytest.mark.parametrize('ordered', [True, False])
def test_an_index_that_leaves_messages_out_is_not_asked(make_bag, data, same, ordered):
    bag = make_bag('sqlite3')
    with closing(sqlite3.connect(bag / 'bag.db3')) as database:
        for (name,) in list(database.execute("SELECT name FROM sqlite_master WHERE type = 'index'"
                                             ' AND sql IS NOT NULL')):
            database.execute(f'DROP INDEX {name}')
        if not ordered:
            database.execute('UPDATE messages SET id = -id')
        database.executescript(
            'CREATE INDEX timestamp_idx ON messages (timestamp ASC) WHERE id % 2; '
            'PRAGMA writable_schema = ON; '
            "UPDATE sqlite_master SET sql = 'CREATE INDEX timestamp_idx ON messages (timestamp "
            "ASC)' WHERE name = 'timestamp_idx'")
    same(read_run(bag), data, publish=False)


def test_a_damaged_database_gives_what_is_readable(make_bag, data):
    bag = make_bag('sqlite3')
    contents = bytearray((bag / 'bag.db3').read_bytes())
    contents[-2 * 4096:] = bytes(2 * 4096)
    (bag / 'bag.db3').write_bytes(contents)
    with pytest.raises(DamagedRunError, match='dz bag recover'):
        read_run(bag)
    copy = recover(bag, bag.with_name('copy'))
    assert copy.notes
    assert copy.messages > 0


def split(tmp_path, data, numbers):
    """Return a bag of several MCAP files, one for each number, without metadata.yaml."""
    bag = tmp_path / 'split'
    bag.mkdir()
    for number in numbers:
        run = save_run(data, tmp_path / f'part{number}').directory
        shutil.copy(next(run.glob('*.mcap')), bag / f'split_{number}.mcap')
    return bag


def test_a_missing_file_of_several_is_reported(tmp_path, data):
    bag = split(tmp_path, data, (0, 2, 11))
    info = run_info(bag)
    assert info.messages == 3 * (5 * 60 + 2)
    assert not info.complete
    assert 'split_1.mcap, split_3.mcap' in info.cut
    assert any('split_1.mcap' in note for note in recover(bag, tmp_path / 'copy').notes)


def test_a_file_that_metadata_yaml_names_and_one_that_it_does_not(tmp_path, data):
    bag = split(tmp_path, data, (0, 1))
    (bag / 'metadata.yaml').write_text('rosbag2_bagfile_information:\n  version: 9\n  '
                                       'storage_identifier: mcap\n  relative_file_paths: '
                                       '[split_0.mcap, split_7.mcap]\n')
    with pytest.raises(RunNotFoundError, match=r'split_7\.mcap.*dz bag recover'):
        read_run(bag)
    copy = recover(bag, tmp_path / 'copy')
    assert any('split_7.mcap' in note for note in copy.notes)
    assert any('split_1.mcap' in note for note in copy.notes)
    assert copy.messages == 5 * 60 + 2


@pytest.fixture
def composed(tmp_path, data):
    """Return a maker of files that hold the run, among other records."""
    source = open_source(save_run(data, tmp_path / 'source').directory)
    found = [item for batch in source.batches() for item in batch]
    numbers = {key: place + 1 for place, key in enumerate(source.topics)}
    definitions = b''.join(
        parts.schema(number, topic.type_name, topic.definition.encode())
        + parts.channel(number, number, topic.name, qos=topic.qos)
        for (key, number), topic in zip(numbers.items(), source.topics.values(), strict=True))
    messages = b''.join(parts.message(numbers[item.topic], item.log_time, item.payload)
                        for item in found)

    def make(before=b'', between=b'', after=b'', outside=b''):
        path = tmp_path / 'composed.mcap'
        path.write_bytes(parts.HEAD + outside + parts.chunk(before + definitions + between
                                                            + messages + after) + parts.TAIL)
        return path

    make.time = found[0].log_time
    return make


OTHER = parts.schema(50, 'std_msgs/msg/String', b'string data\n') + parts.channel(50, 50, '/state')
WORD = encode_string('hi')


@pytest.mark.parametrize('where', ['before', 'between', 'after'])
@pytest.mark.parametrize('reported', [0, 3])
def test_another_type_on_our_name(composed, data, same, tmp_path, where, reported):
    path = composed(**{where: OTHER + parts.message(50, composed.time, WORD) * reported})
    same(read_run(path), data, publish=False)
    info = run_info(path)
    assert info.topics['/state'].type_name == ARRAY.name
    assert info.topics['/state (std_msgs/msg/String)'].messages == reported
    copy = recover(path, tmp_path / 'copy')
    same(read_run(copy.directory), data, publish=False)
    assert any('3 messages' in note and 'another type' in note
               for note in copy.notes) == bool(reported)


@pytest.mark.parametrize('encoding', ['protobuf', 'flatbuffer', 'json', 'ros1', 'cbor', ''])
def test_other_encodings_with_binary_schemas(composed, data, same, tmp_path, encoding):
    path = composed(before=parts.schema(60, 'x.Imu', b'\n\x0b\xff\xfe\x00\x01', encoding)
                    + parts.channel(60, 60, '/imu', encoding)
                    + parts.message(60, composed.time, b'\x08\xff'))
    same(read_run(path), data, publish=False)
    assert run_info(path).topics['/imu'].messages == 1
    copy = recover(path, tmp_path / 'copy')
    same(read_run(copy.directory), data, publish=False)
    assert any('/imu' in note for note in copy.notes)


def test_a_binary_definition_of_cdr_is_kept_to_the_byte(composed, tmp_path):
    definition = b'\n\x0b\xff\xfe\x00\x01'
    path = composed(before=parts.schema(60, 'x/msg/Imu', definition, 'omgidl')
                    + parts.channel(60, 60, '/imu') + parts.message(60, composed.time, WORD))
    copy = recover(path, tmp_path / 'copy')
    assert copy.notes == ()
    assert definition in b''.join(
        topic.definition.encode(errors='surrogateescape')
        for topic in open_source(copy.directory).recorded_topics().values())


def test_attachments_and_metadata_are_kept(composed, data, same, tmp_path):
    path = composed(outside=parts.attachment('zero.json', b'{"zero": 12}', 5)
                    + parts.metadata('lab', {'operator': 'A'}))
    copy = recover(path, tmp_path / 'copy')
    same(read_run(copy.directory), data, publish=False)
    file = McapFile(next(copy.directory.glob('*.mcap')), skip_damage=True)
    for _ in file.batches():
        pass
    assert [(item.name, item.data, item.media_type) for item in file.attachments] == [
        ('zero.json', b'{"zero": 12}', 'application/json')]
    assert ('lab', {'operator': 'A'}) in file.metadata


def test_what_recover_cannot_keep_it_names(composed, tmp_path):
    broken = bytearray(parts.attachment('zero.json', b'{"zero": 12}', 5))
    broken[-8] ^= 1
    path = composed(outside=bytes(broken) + parts.metadata('dz_ros.mine', {'a': 'b'})
                    + parts.record(0x90, b'private'))
    notes = ' '.join(recover(path, tmp_path / 'copy').notes)
    assert 'attachment' in notes
    assert 'dz_ros.mine' in notes
    assert 'private' in notes


def test_an_id_that_is_defined_twice_is_damage(composed):
    path = composed(between=parts.channel(1, 1, '/elsewhere'))
    with pytest.raises(DamagedRunError, match='defined twice'):
        read_run(path)


def test_notes_are_printed(make_bag, capsys):
    bag = make_bag('sqlite3')
    edit(bag, lambda info: info.update(version=99))
    assert dz(['bag', 'info', str(bag)]) == 0
    assert 'note: metadata.yaml: version is 99' in capsys.readouterr().out
    assert dz(['report', '--json', str(bag)]) == 0
    assert 'version is 99' in capsys.readouterr().err

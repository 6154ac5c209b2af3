# SPDX-License-Identifier: Apache-2.0
"""Reading one SQLite file of rosbag2, whole or as a killed recorder left it.

    topics     id, name, type, serialization_format, offered_qos_profiles, type_description_hash
    messages   id, topic_id, timestamp, data
    message_definitions   topic_type, encoding, encoded_message_definition      from Iron on
    metadata   metadata_version, metadata: the text of metadata.yaml            from Iron on

The last columns of topics came later. The file knows one time a message: its publish times are its
log times. Pages carry no checksum, so the order among them is checked before anything is believed.
What a recorder had not moved into the file when it ended lies beside it, in the write-ahead log
(``-wal``) or rollback journal (``-journal``); SQLite puts it in, in a copy: a recording is never
changed by reading it. A file may hold queries and programs of its own (views, triggers, computed
columns): none is run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
import shutil
import sqlite3
from tempfile import TemporaryDirectory

from mcap.records import Attachment

from dz_ros.errors import DamagedRunError, RecordingError
from dz_ros.recording.decompression import LARGEST
from dz_ros.recording.messages import add_topic, Message, Topic

MAGIC = b'SQLite format 3\0'
_SUPER_JOURNAL = bytes.fromhex('d9d505f920a163d7')
"""End of a journal that names another file, which SQLite might delete."""
_BATCH = 5000
_BATCH_BYTES = 2**24
_MOST_TOPICS = 100_000
_LARGEST_TEXT = 2**20
_NEEDED = {'topics': ('id', 'name', 'type'), 'messages': ('id', 'topic_id', 'timestamp', 'data')}


class SqliteFile:
    """One file; `batches` reads it once, the attributes fill up as it goes.

    Attributes:
        path: The file.
        topics: Key → topic (`dz_ros.recording.messages.add_topic`).
        metadata: (``rosbag2``, record) of the metadata.yaml stored inside.
        attachments: None; there are none in this storage.
        cut: Where the file was not closed; empty while reading and if it was.
        damage: What was left out, as text.
    """

    def __init__(self, path: Path, skip_damage: bool = False, since: int = 0,
                 topics: dict[str, Topic] | None = None) -> None:
        """Prepare to read.

        Args:
            path: The file.
            skip_damage: Leave out what is damaged and go on, instead of raising.
            since: Leave out what is earlier [ns since the epoch].
            topics: Those of the files before, which are added to.
        """
        self.path = path
        self.topics: dict[str, Topic] = {} if topics is None else topics
        self.metadata: list[tuple[str, Mapping[str, str]]] = []
        self.attachments: list[Attachment] = []
        self.cut = ''
        self.damage: list[str] = []
        self._skip_damage = skip_damage
        self._since = since
        self._keys: dict[int, str] = {}

    def outline(self) -> None:
        """Fill in the topics alone.

        Raises:
            RecordingError: Not such a file, or it cannot be opened.
        """
        with self._opened() as database:
            self._define(database)

    def batches(self) -> Iterator[list[Message]]:
        """Yield all messages by log time, some at a time; of a damaged file, by their number.

        Raises:
            RecordingError: Not such a file, or it cannot be opened.
            DamagedRunError: Its pages do not belong together, or a row is wrong.
        """
        with self._opened() as database:
            whole = self._whole(database)
            self._define(database)
            if whole:
                where = 'WHERE timestamp >= ?' if self._since else ''
                if not self._disordered(database):
                    rows = f'messages NOT INDEXED {where} ORDER BY id'
                elif self._numbered(database):      # numbers are sorted, not what they stand for
                    rows = (f'(SELECT id AS number FROM messages NOT INDEXED {where} ORDER BY '
                            'timestamp, id LIMIT -1) CROSS JOIN messages NOT INDEXED '
                            'ON messages.id = number')
                else:
                    rows = f'messages NOT INDEXED {where} ORDER BY timestamp, id'
                yield from self._rows(database, rows, *([self._since] if self._since else []))
                return
            reached = -1
            for batch in self._rows(database, 'messages WHERE id > ? ORDER BY id', -1):
                reached = self._reached
                yield batch
            rest = [item for batch in self._rows(
                database, 'messages WHERE id > ? ORDER BY id DESC', reached) for item in batch]
            if rest:
                yield rest[::-1]

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """Yield the database, what lies beside it put in."""
        try:
            beside = [item for end in ('-wal', '-journal')
                      if (item := Path(f'{self.path}{end}')).is_file() and item.stat().st_size]
            with TemporaryDirectory(prefix='dz_ros-') as folder:
                path, mode = self.path, 'mode=ro&immutable=1'
                if beside:
                    path, mode = self._copy(beside, Path(folder)), 'mode=rw'
                    self.cut = ('not closed by its recorder; '
                                f'{sum(item.stat().st_size for item in beside)} bytes that lay '
                                'beside it are read')
                uri = f'{path.absolute().as_uri()}?{mode}'
                with closing(sqlite3.connect(uri, uri=True)) as database:
                    for setting in ('trusted_schema=OFF', 'ignore_check_constraints=ON'):
                        database.execute(f'PRAGMA {setting}')
                    database.text_factory = lambda data: data.decode(errors='replace')
                    self._check_tables(database)
                    yield database
        except sqlite3.Error as error:
            raise self._damage_error(str(error)) from None
        except OSError as error:
            raise RecordingError(f'{self.path} cannot be read: '
                                 f'{error.strerror or error}') from None

    def _copy(self, beside: list[Path], folder: Path) -> Path:
        """Return a copy of the file with what lies beside it."""
        for item in beside:
            with item.open('rb') as file:
                file.seek(max(item.stat().st_size - len(_SUPER_JOURNAL), 0))
                if file.read() == _SUPER_JOURNAL:
                    raise RecordingError(f'{item} belongs to several databases: no recorder '
                                         'leaves that')
            shutil.copyfile(item, folder / item.name)
        shutil.copyfile(self.path, folder / self.path.name)
        return folder / self.path.name

    def _check_tables(self, database: sqlite3.Connection) -> None:
        """Look whether the tables are tables, with plain columns."""
        tables = dict(database.execute(
            "SELECT name, sql FROM sqlite_master WHERE type = 'table' AND length(sql) < 100000"))
        for name, needed in _NEEDED.items():
            columns = {row[1]: row[6] for row in database.execute(f'PRAGMA table_xinfo({name})')}
            if (name not in tables or not set(needed) <= columns.keys() or any(columns.values())
                    or 'VIRTUAL' in tables[name].upper().split('(')[0]):
                raise RecordingError(f'{self.path} is no recording: an SQLite file without the '
                                     f'table {name} of rosbag2')

    def _whole(self, database: sqlite3.Connection) -> bool:
        """Look whether the pages belong together; note or raise that they do not."""
        try:
            found = str(database.execute('PRAGMA quick_check(1)').fetchone()[0])
        except sqlite3.Error as error:
            found = str(error)
        if found != 'ok':
            self._damaged(' '.join(found.split()))
        return found == 'ok'

    @staticmethod
    def _disordered(database: sqlite3.Connection) -> bool:
        """Return whether times go back from one number to the next, as they do in some bags.

        The index of times is not asked, here or later: nothing shows whether it is damaged but
        reading all it leads to.
        """
        back = database.execute(
            'SELECT 1 FROM (SELECT timestamp AS time, lag(timestamp) OVER (ORDER BY id) AS before '
            'FROM messages NOT INDEXED) WHERE time < before OR time IS NULL LIMIT 1')
        return back.fetchone() is not None

    @staticmethod
    def _numbered(database: sqlite3.Connection) -> bool:
        """Return whether a message is found by its number without an index, as rosbag2 has it."""
        keys = [row[1:3] for row in database.execute('PRAGMA table_info(messages)') if row[5]]
        (text,), = database.execute("SELECT sql FROM sqlite_master WHERE name = 'messages'")
        words = text.upper().split()
        return [(name, kind.upper()) for name, kind in keys] == [('id', 'INTEGER')] and not (
            {'WITHOUT', 'DESC'} & set(words))

    def _define(self, database: sqlite3.Connection) -> None:
        """Take in topics, definitions and metadata."""
        def columns(table: str, *wanted: str) -> str:
            there = {row[1] for row in database.execute(f'PRAGMA table_xinfo({table})')
                     if not row[6]}
            return ', '.join(f'CAST(substr({name}, 1, {_LARGEST_TEXT}) AS TEXT)'
                             if name in there else "''" for name in wanted)

        definitions: dict[str, tuple[str, str]] = {}
        tables = {row[0] for row in database.execute(
            "SELECT name FROM sqlite_master WHERE type = 'table' AND sql NOT LIKE '%VIRTUAL%'")}
        if 'message_definitions' in tables:
            chosen = columns('message_definitions', 'topic_type', 'encoding',
                             'encoded_message_definition')
            for name, encoding, text in database.execute(
                    f'SELECT {chosen} FROM message_definitions LIMIT {_MOST_TOPICS}'):
                definitions.setdefault(str(name), (str(text or ''), str(encoding or '')))
        if 'metadata' in tables:
            for (text,) in database.execute(
                    f'SELECT {columns("metadata", "metadata")} FROM metadata '
                    'ORDER BY rowid DESC LIMIT 1'):
                self.metadata.append(('rosbag2', {'serialized_metadata': str(text or '')}))
        chosen = columns('topics', 'name', 'type', 'serialization_format', 'offered_qos_profiles',
                         'type_description_hash')
        for number, name, kind, encoding, qos, type_hash in database.execute(
                f'SELECT id, {chosen} FROM topics LIMIT {_MOST_TOPICS}'):
            if not name:
                self._damaged(f'topic {number} has no name')
                continue
            definition = definitions.get(str(kind), ('', 'ros2msg'))
            self._keys[number] = add_topic(self.topics, Topic(
                name, str(kind or ''), str(encoding or 'cdr'), *definition, qos or '',
                type_hash or ''))

    def _rows(self, database: sqlite3.Connection, rows: str, *limit: int
              ) -> Iterator[list[Message]]:
        """Yield the messages of a query, as far as it goes."""
        found: list[Message] = []
        size = wrong = 0
        why = ''
        try:
            for number, topic_id, time, data, length in database.execute(
                    "SELECT id, topic_id, timestamp, CASE WHEN typeof(data) = 'blob' AND "
                    f'length(data) <= {LARGEST} THEN data END, length(data) FROM {rows}',
                    limit):
                self._reached = number
                key = self._keys.get(topic_id)
                if key is None or data is None or not isinstance(time, int) or time < 0:
                    wrong += 1
                    why = why or (f'message {number} has topic {topic_id!r}, time {time!r}, '
                                  f'{length} bytes')
                    if not self._skip_damage:
                        break
                    continue
                found.append(Message(key, data, time, time))
                size += len(data)
                if len(found) == _BATCH or size > _BATCH_BYTES:
                    yield found
                    found, size = [], 0
        except (sqlite3.Error, OverflowError) as error:
            self._damaged(str(error))
        if wrong:
            self._damaged(f'{why}, which cannot be'
                          + (f', and {wrong - 1} more' if wrong > 1 else ''))
        if found:
            yield found

    def _damaged(self, reason: str) -> None:
        """Note damage, or raise it."""
        if not self._skip_damage:
            raise self._damage_error(reason)
        if reason not in self.damage:
            self.damage.append(reason)

    def _damage_error(self, reason: str) -> DamagedRunError:
        return DamagedRunError(f'{self.path} is damaged: {" ".join(reason.split())}; keep what is '
                               f'readable with dz bag recover {self.path}')

# SPDX-License-Identifier: Apache-2.0
"""Where messages come from: one way of reading for every kind of run.

    directory with metadata.yaml     its files, in its order
    directory without                its .mcap files by number, else its .db3 files: a run that was
                                     cut off
    file                             that file

What a file is (MCAP, SQLite, or either compressed as a whole) is decided by its first bytes, not
by its name or metadata.yaml. Messages that rosbag2 compressed one by one are expanded. The storage
decides where metadata.yaml differs, and `Source.notes` name it.

`Source.batches` streams, so a run may be larger than memory.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from operator import itemgetter
from pathlib import Path
from typing import Any

from mcap.records import Attachment

from dz_ros.errors import DamagedRunError, RecordingError
from dz_ros.files.yaml12 import parse, YamlError
from dz_ros.recording import run_description as description
from dz_ros.recording.bag_files import find_files
from dz_ros.recording.bag_metadata import FILE_NAME
from dz_ros.recording.decompression import Allowance, BROKEN, expanded, LZ4, plain_file, ZSTD
from dz_ros.recording.mcap_file import MAGIC as MCAP_MAGIC
from dz_ros.recording.mcap_file import McapFile
from dz_ros.recording.messages import Message, Topic
from dz_ros.recording.metadata_check import disagreements
from dz_ros.recording.sqlite_file import MAGIC as SQLITE_MAGIC
from dz_ros.recording.sqlite_file import SqliteFile


class Source:
    """A run as a stream of messages; its description is known when the stream has ended.

    Attributes:
        path: What was opened.
        files: The files it consists of.
        topics: Key → topic, those met so far (`dz_ros.recording.messages.add_topic`).
        metadata: (name, record) of the metadata records met so far.
        attachments: Those met so far; only if damage is skipped.
        cut: Where the run was cut off; empty while reading and if it is whole.
        damage: What was left out, as text.
        notes: Where metadata.yaml differs from the files, as text.
        bag: Contents of metadata.yaml; {} without one.
        storage: ``mcap`` or ``sqlite3``.
    """

    def __init__(self, path: Path, files: list[Path], bag: Mapping[str, Any] | None = None,
                 skip_damage: bool = False, notes: tuple[str, ...] = (), cut: str = '',
                 damage: tuple[str, ...] = ()) -> None:
        self.path = path
        self.files = files
        self.bag = bag or {}
        self.storage = 'sqlite3' if any('.db3' in file.name for file in files) else 'mcap'
        self.topics: dict[str, Topic] = {}
        self.metadata: list[tuple[str, Mapping[str, str]]] = []
        self.attachments: list[Attachment] = []
        self.cut = ''
        self.damage = list(damage)
        self.notes = list(notes)
        self._stated_cut = cut
        self._skip_damage = skip_damage
        self._packed = 0

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.stat().st_size for file in self.files)

    def outline(self) -> None:
        """Fill in the topics alone, without reading messages where the files have an index.

        Raises:
            RecordingError: As `batches`.
        """
        for path in self.files:
            with self._opened(path, 0) as file:
                file.outline()

    def recorded_topics(self) -> dict[str, Topic]:
        """Return key → topic; without an index, the source is read to its end for it.

        Raises:
            RecordingError: As `batches`.
        """
        if not self.topics:
            self.outline()
        return dict(self.topics)

    def batches(self, since: int = 0) -> Iterator[list[Message]]:
        """Yield all messages in the order in which they were recorded, some at a time.

        Args:
            since: Messages before the first one as late as this may be left out [ns since the
                epoch].

        Raises:
            RecordingError: A file is missing or not what it should be.
            DamagedRunError: A checksum, record, page or compressed message is wrong.
        """
        counts: Counter[str] = Counter()
        everything = not since
        storages = set()
        for path in self.files:
            allowance = Allowance(path.stat().st_size)
            with self._opened(path, since) as file:
                storages.add('sqlite3' if isinstance(file, SqliteFile) else 'mcap')
                for batch in file.batches():
                    plain = self._plain(batch, allowance, path)
                    counts.update(map(itemgetter(0), plain))
                    since = 0       # what follows is wanted, whatever its time
                    yield plain
                self.metadata += file.metadata
                self.attachments += file.attachments
                self.damage += file.damage
                self.cut = self.cut or file.cut
        self.storage = '+'.join(sorted(storages))
        if everything:
            self._compare(counts)
        self.cut = '; '.join(filter(None, dict.fromkeys([self.cut, self._stated_cut])))

    @contextmanager
    def _opened(self, path: Path, since: int) -> Iterator[McapFile | SqliteFile]:
        """Yield the reader of a file, which what is in it decides."""
        damage: list[str] = []
        try:
            with plain_file(path, damage if self._skip_damage else None) as plain:
                with plain.open('rb') as file:
                    start = file.read(len(SQLITE_MAGIC))
                is_database = start == SQLITE_MAGIC or (
                    plain.suffix == '.db3' and not start.startswith(MCAP_MAGIC))
                reader = (SqliteFile if is_database else McapFile)(
                    plain, self._skip_damage, since, self.topics)
                try:
                    yield reader
                except RecordingError as error:
                    text = str(error).replace(str(plain), str(path))
                    raise type(error)(text) from None
        except OSError as error:
            if isinstance(error, RecordingError):
                raise
            raise RecordingError(f'{path} cannot be read: {error.strerror or error}') from None
        self.damage += damage

    def _plain(self, batch: list[Message], allowance: Allowance, path: Path) -> list[Message]:
        """Return messages as they were before rosbag2 compressed each one."""
        if not any(message.payload[:4] in (ZSTD, LZ4) for message in batch):
            return batch
        found = []
        for message in batch:
            payload = message.payload
            compression = {ZSTD: 'zstd', LZ4: 'lz4'}.get(payload[:4])
            if compression is not None and self.topics[message.topic].encoding == 'cdr':
                try:
                    payload = expanded(payload, compression, allowance)
                except BROKEN as error:
                    reason = f'{path} is damaged: a compressed message of {message.topic}: {error}'
                    if not self._skip_damage:
                        raise DamagedRunError(f'{reason}; keep what is readable with dz bag '
                                              f'recover {self.path}') from None
                    self.damage.append(reason)
                    continue
                self._packed += 1
            found.append(message._replace(payload=payload))
        return found

    def _compare(self, counts: Mapping[str, int]) -> None:
        """Note where metadata.yaml, or without it the one stored inside, differs."""
        if not self.bag and self.storage == 'sqlite3' and not self._stated_cut and not self.cut:
            # This storage has no mark of its own end.
            total = _inner(self.metadata).get('message_count')
            if total != sum(counts.values()):
                self._stated_cut = ('not closed by its recorder, or not whole: '
                                    + (f'it counts {total} messages, holds {sum(counts.values())}'
                                       if isinstance(total, int) else f'there is no {FILE_NAME}'))
        if self.bag and not self.damage:
            found = disagreements(self.bag, self.storage, bool(self._packed), self.topics, counts)
            self.notes += [f'{FILE_NAME}: {item}' for item in found]
            total = self.bag.get('message_count')
            if type(total) is int and total > sum(counts.values()) and not self.cut:
                self.cut = f'not whole: {FILE_NAME} counts {total} messages'

    def info(self) -> dict[str, str]:
        """Return the description of the run, as far as the stream has come.

        Raises:
            DamagedRunError: It has a wrong checksum.
        """
        custom = self.bag.get('custom_data')
        found = {str(name): str(text) for name, text in custom.items()} if isinstance(
            custom, dict) else {}
        for record in self._records(description.INFO, dict):
            found.update(record)
        return found

    def configuration(self) -> dict[str, Any]:
        """Return the configuration stored in the run, dotted keys, as far as it has come.

        Raises:
            DamagedRunError: It is stored with a wrong checksum.
        """
        found: dict[str, Any] = {}
        for record in self._records(description.CONFIGURATION,
                                    description.unpack_configuration):
            found.update(record)
        return found

    def _records(self, wanted: str, unpack: Callable[[Mapping[str, str]], dict[str, Any]]
                 ) -> Iterator[dict[str, Any]]:
        """Yield the metadata records of a name, checked and unpacked."""
        for name, record in self.metadata:
            if name == wanted:
                try:
                    yield unpack(description.unsealed(record))
                except ValueError as error:
                    reason = f'{self.path}: {wanted}: {error}'
                    if not self._skip_damage:
                        raise DamagedRunError(f'{reason}; keep what is readable with '
                                              f'dz bag recover {self.path}') from None
                    self.damage.append(f'{wanted}: {error}')


def _inner(metadata: list[tuple[str, Mapping[str, str]]]) -> dict[str, Any]:
    """Return the metadata.yaml that the storage holds; {} where there is none."""
    text = next((record.get('serialized_metadata', '') for name, record in reversed(metadata)
                 if name == 'rosbag2'), '')
    try:
        found = parse(text, aliases=True)
    except YamlError:
        return {}
    found = found.get('rosbag2_bagfile_information', found) if isinstance(found, dict) else {}
    return found if isinstance(found, dict) else {}


def open_source(path: Path, skip_damage: bool = False) -> Source:
    """Return the run at a path, ready to be read.

    Args:
        path: Directory or file.
        skip_damage: Leave out what is damaged and go on, instead of raising.

    Raises:
        RunNotFoundError: Nothing there.
        RecordingError: Something else than a run.
    """
    found = find_files(Path(path), skip_damage)
    return Source(Path(path), found.files, found.bag, skip_damage, tuple(found.notes), found.cut,
                  tuple(found.damage))

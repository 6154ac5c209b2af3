"""Where messages come from: one way of reading for every kind of run.

    directory with metadata.yaml     its files, in its order
    directory without                its .mcap files by number: a run that was cut off
    .mcap file                       that file
    sqlite3, compressed files        through rosbags, which knows no publish times: they are those
                                     of the log

`Source.batches` streams, so a run may be larger than memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
import re
import sqlite3
from typing import Any

from dz_ros.errors import DamagedRunError, MissingDependencyError, RecordingError, RunNotFoundError
from dz_ros.recording import description
from dz_ros.recording.bag_metadata import FILE_NAME, read_metadata
from dz_ros.recording.mcap_file import McapFile, Message, Topic

_BATCH = 5000


class Source:
    """A run as a stream of messages; what else it says is known when the stream has ended.

    Attributes:
        path: What was opened.
        files: The files it consists of.
        topics: Topic name → topic, those met so far.
        metadata: (name, record) of the metadata records met so far.
        cut: Where the run was cut off; empty while reading and if it is whole.
        damage: What was left out, in words.
        bag: What metadata.yaml says; {} without one.
        storage: ``mcap`` or ``sqlite3``.
    """

    def __init__(self, path: Path, files: list[Path], bag: Mapping[str, Any],
                 skip_damage: bool = False) -> None:
        self.path = path
        self.files = files
        self.bag = bag
        self.storage = 'sqlite3' if any('.db3' in file.name for file in files) else 'mcap'
        self.topics: dict[str, Topic] = {}
        self.metadata: list[tuple[str, Mapping[str, str]]] = []
        self.cut = ''
        self.damage: list[str] = []
        self._skip_damage = skip_damage

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.stat().st_size for file in self.files)

    def batches(self, since: int = 0) -> Iterator[list[Message]]:
        """Yield all messages in the order in which they were recorded, some at a time.

        Args:
            since: Messages before the first one as late as this may be left out [ns since the
                epoch].

        Raises:
            RecordingError: A file is missing or not what it should be.
            DamagedRunError: A checksum or record is wrong.
        """
        for path in self.files:
            file = McapFile(path, self._skip_damage, since)
            for batch in file.batches():
                self.topics.update(file.topics)
                since = 0       # what follows is wanted, whatever its time
                yield batch
            self.topics.update(file.topics)
            self.metadata += file.metadata
            self.damage += file.damage
            self.cut = self.cut or file.cut

    def info(self) -> dict[str, str]:
        """Return what the run says of itself, as far as the stream has come.

        Raises:
            DamagedRunError: It says so with a wrong checksum.
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


class RosbagsSource(Source):
    """A bag that only rosbags can open."""

    def batches(self, since: int = 0) -> Iterator[list[Message]]:
        """Yield all messages by log time, some at a time; publish times are log times.

        Args:
            since: Leave out what is earlier [ns since the epoch].

        Raises:
            MissingDependencyError: rosbags is not installed.
            DamagedRunError: rosbags cannot read it.
        """
        try:
            from rosbags.rosbag2 import Reader
        except ImportError:
            raise MissingDependencyError(f'{self.path} needs the package rosbags: pip install '
                                         'rosbags') from None
        found: list[Message] = []
        for file in self.files:
            _check_database(file)
        try:
            with Reader(self.path) as reader:
                for item in reader.connections:
                    self.topics[item.topic] = Topic(item.topic, item.msgtype,
                                                    item.ext.serialization_format,
                                                    item.msgdef.data, type_hash=item.digest)
                for connection, time, payload in reader.messages(start=since or None):
                    found.append(Message(connection.topic, bytes(payload), time, time))
                    if len(found) == _BATCH:
                        yield found
                        found = []
        except RecordingError:
            raise
        except Exception as error:
            raise DamagedRunError(f'{self.path} cannot be read: {error}') from error
        if found:
            yield found


def _check_database(file: Path) -> None:
    """Look whether the pages of an SQLite file belong together; they carry no checksum.

    Raises:
        DamagedRunError: They do not.
    """
    if file.suffix != '.db3':
        return
    try:
        with closing(sqlite3.connect(f'{file.absolute().as_uri()}?mode=ro', uri=True)) as database:
            found = database.execute('PRAGMA quick_check(1)').fetchone()[0]
    except sqlite3.Error as error:
        found = str(error)
    if found != 'ok':
        raise DamagedRunError(f'{file} is damaged: {" ".join(str(found).split())}')


def open_source(path: Path, skip_damage: bool = False) -> Source:
    """Return the run at a path, ready to be read.

    Args:
        path: Directory or file.
        skip_damage: Leave out what is damaged and go on, instead of raising.

    Raises:
        RunNotFoundError: Nothing there.
        RecordingError: Something else than a run.
    """
    path = Path(path)
    try:
        there, is_directory = path.exists(), path.is_dir()
        found = sorted(path.glob('*.mcap'), key=_by_number)
        databases = sorted(path.glob('*.db3*'), key=_by_number)
    except OSError as error:
        raise RecordingError(f'{path} cannot be read: {error.strerror or error}') from None
    if not there:
        raise RunNotFoundError(f'{path}: no such run')
    if not is_directory:
        kind = RosbagsSource if path.suffix == '.db3' else Source
        return kind(path, [path], {}, skip_damage)
    bag = read_metadata(path)
    if bag is not None:
        return _described(path, bag, skip_damage)
    if found:
        return Source(path, found, {}, skip_damage)
    if len(databases) == 1:
        return RosbagsSource(databases[0], databases, {}, skip_damage)
    raise RecordingError(f'{path} is not a run: it holds neither {FILE_NAME} nor an .mcap file')


def _described(path: Path, bag: Mapping[str, Any], skip_damage: bool) -> Source:
    """Return the bag in a directory as its metadata.yaml describes it.

    Raises:
        RunNotFoundError: A file that it names is missing.
    """
    names = bag.get('relative_file_paths')
    files = [path / Path(str(name)).name for name in names] if isinstance(names, list) else []
    for file in files:
        if not file.is_file():
            raise RunNotFoundError(f'{file}: {FILE_NAME} names it, but it is not there')
    if bag.get('storage_identifier') == 'mcap' and not bag.get('compression_format'):
        return Source(path, files or sorted(path.glob('*.mcap'), key=_by_number), bag,
                      skip_damage)
    return RosbagsSource(path, files, bag, skip_damage)


def _by_number(path: Path) -> tuple[int, str]:
    """Return a key that puts NAME_2 before NAME_10."""
    digits = re.search(r'(\d+)\.[^.]*$', path.name)
    return int(digits[1]) if digits else 0, path.name

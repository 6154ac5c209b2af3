"""Writing a run: a directory that rosbag2, rosbags, PlotJuggler and Foxglove open as it is.

    NAME/NAME_0.mcap      profile ros2, messages as cdr, definitions as ros2msg, zstd chunks
    NAME/metadata.yaml    rosbag2's description, written when the run is closed

A chunk is closed after `CHUNK_BYTES` or `CHUNK_SECONDS`, whichever comes first, and handed to the
system at once: what a killed process loses is the chunk it was filling. Every chunk, and in a
closed file the whole of it, carries a CRC-32.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
import json
from pathlib import Path
import time
from typing import Any, BinaryIO

from mcap.exceptions import McapError
from mcap.writer import CompressionType, Writer

from dz_ros.errors import RecordingError, RunExistsError
from dz_ros.recording import description
from dz_ros.recording.bag_metadata import BagTopic, make_metadata, to_yaml, write_metadata
from dz_ros.recording.channels import ARRAY, CHANNELS, MessageType, Qos, TYPES
from dz_ros.recording.sequence import TopicCounter
from dz_ros.recording.summary import Summary

CHUNK_BYTES = 128 * 1024
CHUNK_SECONDS = 0.5
_RECORD_BYTES = 31
"""MCAP's frame around a message."""


@dataclass
class _Topic:
    """One registered topic: its MCAP channel, its line in metadata.yaml, its counts."""

    channel_id: int
    bag: BagTopic
    counter: TopicCounter


class RunWriter:
    """Writes one run; a context manager that closes it.

    Not safe for use by several threads: see `dz_ros.recording.queued`.
    """

    def __init__(self, directory: Path, info: Mapping[str, str],
                 configuration: Mapping[str, Any], *,
                 clock: Callable[[], float] = time.monotonic) -> None:
        """Create the directory and store who and with which configuration.

        Args:
            directory: Where the run goes; must not exist.
            info: mode, plant, law, host, seed, started, versions, … as text.
            configuration: Dotted key → value; {} where it is added later.
            clock: Seconds, decides when a chunk is old.

        Raises:
            RunExistsError: The directory exists.
            RecordingError: It cannot be created, or the configuration not be stored.
        """
        self.directory = Path(directory)
        self.path = self.directory / f'{self.directory.name}_0.mcap'
        self._info = {name: str(text) for name, text in info.items()}
        packed = description.pack_configuration(configuration) if configuration else None
        self._clock = clock
        self._topics: dict[str, _Topic] = {}
        self._schemas: dict[str, int] = {}
        self._start_ns: int | None = None
        self._end_ns = 0
        self._open_bytes = 0
        self._opened = 0.0
        self._closed: Summary | None = None
        self._failure: RecordingError | None = None
        self._file = self._create()
        self._safe = self._count()
        try:
            self._begin(packed)
        except RecordingError:
            self.path.unlink()
            self.directory.rmdir()
            raise

    def _create(self) -> BinaryIO:
        """Return the new MCAP file in its new directory."""
        try:
            self.directory.mkdir(parents=True)
            return self.path.open('xb')
        except FileExistsError:
            raise RunExistsError(f'{self.directory} exists already and a run is never overwritten:'
                                 ' choose another name or move it away') from None
        except OSError as error:
            raise RecordingError(f'{self.directory} cannot be created: '
                                 f'{error.strerror or error}') from None

    def _begin(self, configuration: Mapping[str, str] | None) -> None:
        """Write what a cut file must hold already."""
        from dz_ros.version import version
        # Chunks are closed here, by size and age, and never by the library.
        self._mcap = Writer(self._file, chunk_size=2**62, compression=CompressionType.ZSTD,
                            enable_data_crcs=True)
        self._guard(lambda: self._mcap.start('ros2', f'dz_ros {version()}'))
        self.add_metadata(description.INFO, self._info)
        if configuration is not None:
            self.add_metadata(description.CONFIGURATION, configuration)

    def add_topic(self, topic: str, type_name: str, qos: Qos | Sequence[Mapping[str, Any]]
                  | None = None, *, message_type: MessageType | None = None) -> None:
        """Register a topic; once registered, again is nothing.

        Args:
            topic: Absolute name, ``/reference`` or ``/ns/reference``.
            type_name: Message type, ``package/msg/Type``.
            qos: What its publishers offer; default is that of the channel of this name. Profiles
                as rosbag2 writes them are taken as they are.
            message_type: Definition and hash of a type that is not in `channels.TYPES`.

        Raises:
            RecordingError: Not an absolute name, unknown type, or the same topic with another.
        """
        kind = message_type or TYPES.get(type_name)
        if kind is None or not topic.startswith('/') or topic.endswith('/'):
            raise RecordingError(f'topic {topic} of type {type_name} cannot be recorded: '
                                 f'needs an absolute name and one of {", ".join(TYPES)}')
        known = self._topics.get(topic)
        if known is not None:
            if known.bag.type_name != type_name:
                raise RecordingError(f'topic {topic} is recorded as {known.bag.type_name}, '
                                     f'it cannot be {type_name} as well')
            return
        if qos is None:
            channel = CHANNELS.get(topic.rpartition('/')[2])
            qos = channel.qos if channel is not None else Qos()
        profiles = [qos.to_dict()] if isinstance(qos, Qos) else [dict(item) for item in qos]
        if type_name not in self._schemas:
            self._schemas[type_name] = self._mcap.register_schema(
                type_name, kind.encoding, kind.definition.encode())
        channel_id = self._mcap.register_channel(
            topic, 'cdr', self._schemas[type_name],
            {'offered_qos_profiles': to_yaml(profiles).strip(), 'topic_type_hash': kind.type_hash})
        self._topics[topic] = _Topic(channel_id, BagTopic(topic, type_name, profiles,
                                                          kind.type_hash),
                                     TopicCounter(type_name, type_name == ARRAY.name))

    def write(self, topic: str, payload: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Store one message.

        Args:
            topic: A registered topic.
            payload: The message as received, CDR with its encapsulation header.
            log_time_ns: When it was received [ns since the epoch].
            publish_time_ns: When it was published [ns since the epoch].

        Raises:
            RecordingError: Unknown topic, a time that is none, or the file cannot be written.
        """
        known = self._topics.get(topic)
        if known is None:
            raise RecordingError(f'topic {topic} is not registered in {self.directory}')
        if not (0 <= log_time_ns < 2**63 and 0 <= publish_time_ns < 2**63):
            raise RecordingError(f'topic {topic}: {log_time_ns}, {publish_time_ns} are not times '
                                 'in nanoseconds since the epoch')
        self._usable()
        now = self._clock()
        if not self._open_bytes:
            self._opened = now
        elif now - self._opened >= CHUNK_SECONDS:
            self.flush()
            self._opened = now
        counter = known.counter
        self._mcap.add_message(known.channel_id, log_time_ns, payload, publish_time_ns,
                               counter.messages & 0xFFFFFFFF)
        counter.add(payload)
        if self._start_ns is None:
            self._start_ns = self._end_ns = log_time_ns
        elif log_time_ns > self._end_ns:
            self._end_ns = log_time_ns
        elif log_time_ns < self._start_ns:
            self._start_ns = log_time_ns
        self._open_bytes += len(payload) + _RECORD_BYTES
        if self._open_bytes >= CHUNK_BYTES:
            self.flush()

    def add_metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Store texts under a name, on disk at once.

        Records called ``dz_ros.…`` get a checksum; a reader takes the last text of a key.

        Raises:
            RecordingError: The file cannot be written.
        """
        self._usable()
        record = {str(key): description.sendable(str(text)) for key, text in mapping.items()}
        if name.startswith(description.PREFIX):
            record = description.sealed(record)
        self._guard(lambda: self._mcap.add_metadata(name, record))
        self.flush()

    def add_configuration(self, configuration: Mapping[str, Any]) -> None:
        """Store configuration that became known after the start; adds to what is there.

        Raises:
            RecordingError: It cannot be stored, or the file not be written.
        """
        self.add_metadata(description.CONFIGURATION,
                          description.pack_configuration(configuration))

    def flush(self) -> None:
        """Close the chunk being filled and hand everything to the system.

        Raises:
            RecordingError: The file cannot be written.
        """
        self._usable()
        self._open_bytes = 0
        self._guard(self._mcap.flush)
        self._safe = self._count()

    def flush_if_due(self) -> None:
        """Close the chunk being filled if it is old; for whoever waits without writing.

        Raises:
            RecordingError: The file cannot be written.
        """
        if self._open_bytes and self._clock() - self._opened >= CHUNK_SECONDS:
            self.flush()

    def summary(self) -> Summary:
        """Return what was written so far; of a broken file, what it holds at least."""
        if self._failure is not None:
            return self._safe
        return self._closed or self._count()

    def _count(self) -> Summary:
        """Return what was given so far."""
        start = self._start_ns
        return Summary(self.directory, {name: topic.counter.summary()
                                        for name, topic in self._topics.items()},
                       self.path.stat().st_size, start,
                       0.0 if start is None else (self._end_ns - start) * 1e-9, complete=False)

    def close(self) -> Summary:
        """Finish the file, write metadata.yaml and return what was written; again is nothing.

        Raises:
            RecordingError: The file cannot be written; it stays as one that was cut off.
        """
        if self._closed is not None:
            return self._closed
        self._usable()
        self.flush()
        found = self.summary()
        self.add_metadata(description.SUMMARY, {
            'messages': str(found.messages), 'missing': str(found.missing),
            'duration': repr(found.duration),
            'topics': json.dumps({name: asdict(topic) for name, topic in found.topics.items()})})
        contents = make_metadata(self.path.name, [(topic.bag, topic.counter.messages)
                                                  for topic in self._topics.values()],
                                 self._start_ns, self._end_ns, self._info)

        self._guard(lambda: self._mcap.add_metadata(
            'rosbag2', {'serialized_metadata': to_yaml(contents).strip()}))
        self._guard(self._mcap.finish)
        self._guard(self._file.close)
        self._guard(lambda: write_metadata(self.directory, contents))
        self._closed = replace(found, bytes=self.path.stat().st_size, complete=True)
        return self._closed

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._failure is None:
            self.close()

    def _usable(self) -> None:
        """Raise what broke the file before, or that it is closed."""
        if self._failure is not None:
            raise self._failure
        if self._closed is not None:
            raise RecordingError(f'{self.directory} is closed')

    def _guard(self, action: Callable[[], Any]) -> None:
        """Run an action that writes; a failure closes the file and is final."""
        try:
            action()
        except (OSError, McapError) as error:
            reason = getattr(error, 'strerror', None) or error
            self._failure = RecordingError(
                f'{self.path} cannot be written: {reason}; what it holds is kept: '
                f'dz bag recover {self.directory}')
            with suppress(OSError):       # closing tries to write what failed once more
                self._file.close()
            raise self._failure from None

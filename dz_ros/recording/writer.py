# SPDX-License-Identifier: Apache-2.0
"""Writing a run: a directory that rosbag2, rosbags, PlotJuggler and Foxglove open as it is.

    NAME/NAME_0.mcap      profile ros2, messages as cdr, definitions as ros2msg, zstd chunks
    NAME/metadata.yaml    rosbag2's description, written when the run is closed

A chunk is closed after `CHUNK_BYTES` or `CHUNK_SECONDS`, whichever comes first, and handed to the
system at once: what a killed process loses is the chunk it was filling. Every chunk, and in a
closed file the whole of it, carries a CRC-32.

Over 300 lines: chunks, counts and metadata are of one file and must agree at every flush.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
import json
from pathlib import Path
import time
from typing import Any

from mcap.records import Attachment
from mcap.writer import CompressionType, Writer

from dz_ros.errors import RecordingError
from dz_ros.recording import run_description as description
from dz_ros.recording.bag_metadata import (
    BagTopic,
    FILE_NAME,
    make_metadata,
    to_yaml,
    write_metadata,
)
from dz_ros.recording.channels import ARRAY, CHANNELS, MessageType, Qos, TYPES
from dz_ros.recording.chunk_indices import pack_indices
from dz_ros.recording.output_file import OutputFile
from dz_ros.recording.summary import Summary
from dz_ros.recording.topic_counts import TopicCounter

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

    Not safe for use by several threads: see `dz_ros.recording.writer_thread`.

    Attributes:
        file: The MCAP file: where it is, what the disk refuses.
    """

    def __init__(self, directory: Path, info: Mapping[str, str],
                 configuration: Mapping[str, Any], *, backlog: int = 0,
                 clock: Callable[[], float] = time.monotonic) -> None:
        """Create the directory and store description and configuration.

        Args:
            directory: Where the run goes; must not exist.
            info: mode, plant, law, host, seed, started, versions, … as text.
            configuration: Dotted key → value; {} where it is added later.
            backlog: Bytes that wait in memory where the disk refuses them; what comes beyond is
                refused. 0: nothing waits, the first refusal of the disk is final.
            clock: Seconds, decides when a chunk is old.

        Raises:
            RunExistsError: The directory exists.
            RecordingError: It cannot be created, or the configuration not be stored.
        """
        self._info = {name: str(text) for name, text in info.items()}
        packed = description.pack_configuration(configuration) if configuration else None
        self._clock = clock
        self._topics: dict[str, _Topic] = {}
        self._schemas: dict[MessageType, int] = {}
        self._start_ns: int | None = None
        self._end_ns = self._open_bytes = 0
        self._opened = self._tried = 0.0
        self._closed: Summary | None = None
        self.file = OutputFile.in_new_directory(Path(directory))
        self._chunked = self.file.stored
        try:
            self._begin(packed)
        except RecordingError:
            self.file.discard()
            raise
        self.file.backlog = backlog     # what does not fit at the start is refused

    @property
    def directory(self) -> Path:
        """The run, where it is now."""
        return self.file.directory

    @property
    def path(self) -> Path:
        """The MCAP file, where it is now."""
        return self.file.path

    def _begin(self, configuration: Mapping[str, str] | None) -> None:
        """Write what a cut file must hold already."""
        from dz_ros.version import version
        # Chunks are closed here, by size and age, and never by the library.
        self._mcap = Writer(self.file, chunk_size=2**62,      # type: ignore[arg-type]
                            compression=CompressionType.ZSTD, enable_data_crcs=True)
        pack_indices(self._mcap)
        self._mcap.start('ros2', f'dz_ros {version()}')
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
        if kind not in self._schemas:
            self._schemas[kind] = self._mcap.register_schema(
                type_name, kind.encoding, kind.definition.encode(errors='surrogateescape'))
        channel_id = self._mcap.register_channel(
            topic, 'cdr', self._schemas[kind],
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
        if self.file.full:
            self.flush_if_due()
            if self.file.full:
                raise self.file.refuse()
        if not self._open_bytes:
            self._opened = now
        elif now - self._opened >= CHUNK_SECONDS:
            self.flush()
            self._opened = now
        self._mcap.add_message(known.channel_id, log_time_ns, payload, publish_time_ns,
                               known.counter.messages & 0xFFFFFFFF)
        known.counter.add(payload)
        self._start_ns = log_time_ns if self._start_ns is None else min(self._start_ns,
                                                                        log_time_ns)
        self._end_ns = max(self._end_ns, log_time_ns)
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
        self._mcap.add_metadata(name, record)
        self._store()

    def add_attachment(self, item: Attachment) -> None:
        """Store an attachment as it is; errors as of `add_metadata`."""
        self._usable()
        self._mcap.add_attachment(item.create_time, item.log_time, item.name, item.media_type,
                                  item.data)
        self._store()

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
        self._mcap.flush()      # type: ignore[no-untyped-call]
        self._chunked = self._count()
        self._store()

    def flush_if_due(self) -> None:
        """Close the chunk being filled if it is old, although nothing is written.

        Raises:
            RecordingError: The file cannot be written.
        """
        now = self._clock()
        old = self._open_bytes and now - self._opened >= CHUNK_SECONDS
        if old or (self.file.waiting and now - self._tried >= CHUNK_SECONDS):
            self.flush()

    def _store(self) -> None:
        """Hand what is complete to the system; without a backlog, a refusal is final."""
        self._tried = self._clock()
        self.file.store(self._chunked)

    def summary(self) -> Summary:
        """Return what was written so far; of a broken file, what it holds at least."""
        return self.file.stored if self.file.failure else self._closed or self._count()

    def _count(self) -> Summary:
        """Return what was given so far."""
        topics = {name: topic.counter.summary() for name, topic in self._topics.items()}
        start = self._start_ns
        return Summary(self.directory, topics, self.file.tell(), start,
                       0.0 if start is None else (self._end_ns - start) * 1e-9, complete=False)

    def close(self) -> Summary:
        """Finish the file, write metadata.yaml and return what was written; again is nothing.

        Raises:
            RecordingError: The file cannot be written; it stays as one that was cut off.
        """
        if self._closed is not None:
            return self._closed
        self._usable()
        self.file.check_place()
        self.flush()
        self.file.backlog = 0   # nothing will be written later
        found = self.summary()
        self.add_metadata(description.SUMMARY, {
            'messages': str(found.messages), 'missing': str(found.missing),
            'duration': repr(found.duration),
            'topics': json.dumps({name: asdict(topic) for name, topic in found.topics.items()})})
        topics = [(topic.bag, topic.counter.messages) for topic in self._topics.values()]
        contents = make_metadata(self.path.name, topics, self._start_ns, self._end_ns, self._info)
        self._mcap.add_metadata('rosbag2', {'serialized_metadata': to_yaml(contents).strip()})
        self._mcap.finish()     # type: ignore[no-untyped-call]
        self._store()
        self.file.close()
        try:
            write_metadata(self.directory, contents)
        except OSError as error:
            raise self.file.fail(
                f'{self.directory / FILE_NAME} cannot be written: {error.strerror or error}; the '
                f'messages are whole in {self.path}: dz bag recover {self.directory}') from None
        self._closed = replace(found, bytes=self.file.size, complete=True)
        return self._closed

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, *exception: object) -> None:
        if self.file.failure is None:
            self.close()

    def _usable(self) -> None:
        """Raise what broke the file before, or that it is closed."""
        if self.file.failure is not None:
            raise self.file.failure
        if self._closed is not None:
            raise RecordingError(f'{self.directory} is closed')

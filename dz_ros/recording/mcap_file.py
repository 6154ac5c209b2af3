"""Reading one MCAP file front to back, however it ends.

    magic, Header, {Chunk | Message | Schema | Channel | Metadata}, DataEnd, summary, Footer, magic

A file is *cut* where its writer was stopped: it ends before its Footer and its closing magic.
Everything before the cut is good. It is *damaged* where something else is wrong: a checksum, a
record that cannot be, an end where the closing magic says there is more. The index in the summary
is not used, so that whole and cut files are read the same way, except to get past damage.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
import struct
from typing import BinaryIO, NamedTuple
import zlib

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
import zstandard

from dz_ros.errors import DamagedRunError, RecordingError
from dz_ros.recording.mcap_index import HEAD, Index, read_index

MAGIC = b'\x89MCAP0\r\n'
_MESSAGE = struct.Struct('<HIqq')
_LAST_TIME = struct.Struct('<8xQ')
_NO_CRC = bytes(4)
_PRIVATE = 0x80
"""Record kinds from here on belong to applications and are passed over."""
_DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)
_LARGEST_CHUNK = 2**30
_LOOSE = 1000
"""Messages outside chunks that are handed on together."""
_BROKEN = (McapError, zstandard.ZstdError, struct.error, ValueError, KeyError, RuntimeError,
           EOFError, MemoryError)
"""What decoding of damaged bytes may raise."""


class Message(NamedTuple):
    """One message: topic, payload as received, log and publish time [ns since the epoch]."""

    topic: str
    payload: bytes
    log_time: int
    publish_time: int


@dataclass(frozen=True)
class Topic:
    """One topic of a file.

    Attributes:
        name: Absolute topic name.
        type_name: Message type.
        encoding: Encoding of its messages, ``cdr``.
        definition: Text of the message definition.
        definition_encoding: How that is written, ``ros2msg``.
        qos: Offered QoS profiles, rosbag2's YAML text; empty if unknown.
        type_hash: RIHS01 hash; empty if unknown.
    """

    name: str
    type_name: str
    encoding: str = 'cdr'
    definition: str = ''
    definition_encoding: str = 'ros2msg'
    qos: str = ''
    type_hash: str = ''


class McapFile:
    """One file; `batches` reads it once, the attributes fill up as it goes.

    Attributes:
        path: The file.
        topics: Topic name → topic, those met so far.
        metadata: (name, record) of the metadata records met so far.
        cut: Where the file was cut off; empty while reading and if it is whole.
        damage: What was left out, in words.
    """

    def __init__(self, path: Path, skip_damage: bool = False, since: int = 0) -> None:
        """Prepare to read.

        Args:
            path: The file.
            skip_damage: Leave out what is damaged and go on, instead of raising.
            since: Leave out the chunks before the first one with a message as late as this, if
                the file is whole [ns since the epoch]; not all that is left is as late.
        """
        self.path = path
        self.topics: dict[str, Topic] = {}
        self.metadata: list[tuple[str, Mapping[str, str]]] = []
        self.cut = ''
        self.damage: list[str] = []
        self._skip_damage = skip_damage
        self._since = since
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, str] = {}
        self._first: int | None = None
        self._last = 0

    def batches(self) -> Iterator[list[Message]]:
        """Yield all messages in file order, a chunk at a time.

        Raises:
            RecordingError: Not an MCAP file, or it cannot be opened.
            DamagedRunError: A checksum or record is wrong.
        """
        try:
            with self.path.open('rb') as file:
                size = file.seek(0, 2)
                file.seek(max(size - len(MAGIC), 0))
                closed = file.read() == MAGIC and size > len(MAGIC)
                file.seek(0)
                if file.read(len(MAGIC)) != MAGIC:
                    raise RecordingError(f'{self.path} is not an MCAP file'
                                         f'{"" if size else ": it is empty"}')
                yield from self._scan(file, size, closed)
                if not closed and not self.cut:
                    self.cut = 'cut off behind its last message'
        except OSError as error:
            raise RecordingError(f'{self.path} cannot be read: '
                                 f'{error.strerror or error}') from None

    def _scan(self, file: BinaryIO, size: int, closed: bool) -> Iterator[list[Message]]:
        """Yield the messages of the records behind the magic, up to the footer or the cut."""
        position = len(MAGIC)
        crc: int | None = zlib.crc32(MAGIC)
        loose: list[Message] = []
        index = read_index(file) if self._skip_damage or self._since else Index()
        before = bool(self._since and index.definitions)
        for opcode, body in index.definitions:
            self._define(opcode, ReadDataStream(BytesIO(body)))
        file.seek(position)
        while True:
            head = file.read(HEAD.size)
            opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, size)
            end = position + HEAD.size + length
            if end > size and not closed:
                self.cut = f'cut off at byte {position}; {size - position} more are incomplete'
                break
            if end > size or not (0 < opcode <= Opcode.DATA_END or opcode >= _PRIVATE):
                self._damaged(position, 'a record that cannot be')
                position = next((start for start in index.chunks if start > position), 0)
                if not position:
                    break
                file.seek(position)
                crc = None
                continue
            body = file.read(length)
            if opcode == Opcode.FOOTER:
                self._check(position, crc, head + body)
                break
            if opcode == Opcode.DATA_END:
                self._check(position, crc, body[:4])
            elif opcode == Opcode.CHUNK:
                before = (before and length >= _LAST_TIME.size
                          and _LAST_TIME.unpack_from(body)[0] < self._since)
                found = [] if before else self._read(position, self._chunk, body)
                if found:
                    yield found
            elif opcode == Opcode.MESSAGE:
                loose += self._read(position, self._contents, head + body)
                if len(loose) >= _LOOSE:
                    yield loose
                    loose = []
            elif opcode in _DEFINITIONS:
                self._read(position, self._contents, head + body)
            if opcode == Opcode.DATA_END:
                crc = 0                     # that of the summary begins
            elif crc is not None:
                crc = zlib.crc32(body, zlib.crc32(head, crc))
            position = end
        if loose:
            yield loose

    def _check(self, position: int, crc: int | None, data: bytes) -> None:
        """Compare the checksum of what came before, and of this data, with its last 4 bytes."""
        stored = data[-4:]
        if crc is not None and stored not in (_NO_CRC, struct.pack('<I', zlib.crc32(data[:-4],
                                                                                    crc))):
            self._damaged(position, 'the checksum of everything before does not fit')

    def _read(self, position: int, decode: Callable[[bytes], list[Message]],
              data: bytes) -> list[Message]:
        """Return the messages of one record; none if it is damaged and that is to be skipped."""
        try:
            found = decode(data)
        except _BROKEN as error:
            self._damaged(position, str(error) or type(error).__name__)
            return []
        if found:
            if self._first is None:
                self._first = found[0].log_time
            self._last = found[-1].log_time
        return found

    def _chunk(self, body: bytes) -> list[Message]:
        """Return the messages of a chunk, checked."""
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        if chunk.uncompressed_size > _LARGEST_CHUNK:
            raise ValueError(f'a chunk of {chunk.uncompressed_size} bytes')
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        if size != chunk.uncompressed_size:
            raise ValueError(f'a chunk of {size} bytes that says {chunk.uncompressed_size}')
        return self._contents(stream.read(size))

    def _contents(self, data: bytes) -> list[Message]:
        """Return the messages among these records; take in what the others define."""
        found = []
        channels = self._channels
        position, end = 0, len(data)
        while position < end:
            opcode, length = HEAD.unpack_from(data, position)
            body = position + HEAD.size
            position = body + length
            if position > end:
                raise ValueError('a record longer than what holds it')
            if opcode == Opcode.MESSAGE:
                channel, _, log_time, publish_time = _MESSAGE.unpack_from(data, body)
                found.append(Message(channels[channel], data[body + _MESSAGE.size:position],
                                     log_time, publish_time))
            else:
                self._define(opcode, ReadDataStream(BytesIO(data[body:position])))
        return found

    def _define(self, opcode: int, stream: ReadDataStream) -> None:
        """Take in a schema, channel or metadata record; the first definition of an id counts."""
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(stream)
            self.metadata.append((metadata.name, metadata.metadata))
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            kind = self._schemas.get(channel.schema_id) or Schema(0, b'', '', '')
            self._channels.setdefault(channel.id, channel.topic)
            self.topics.setdefault(channel.topic, Topic(
                channel.topic, kind.name, channel.message_encoding, kind.data.decode(),
                kind.encoding, channel.metadata.get('offered_qos_profiles', ''),
                channel.metadata.get('topic_type_hash', '')))

    def _damaged(self, position: int, reason: str) -> None:
        """Note damage, or raise it.

        Raises:
            DamagedRunError: Damage is not to be skipped.
        """
        seconds = 0.0 if self._first is None else (self._last - self._first) * 1e-9
        where = f'at byte {position}, {seconds:.3f} s into the run: {reason}'
        if not self._skip_damage:
            raise DamagedRunError(f'{self.path} is damaged {where}; keep what is readable with '
                                  f'dz bag recover {self.path}')
        self.damage.append(f'damaged {where}')

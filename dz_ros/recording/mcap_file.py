# SPDX-License-Identifier: Apache-2.0
"""Reading one MCAP file front to back, however it ends.

    magic, Header, {Chunk | Message | Schema | Channel | Metadata}, DataEnd, summary, Footer, magic

A file is *cut* where its writer was stopped: it ends before its Footer and its closing magic.
Everything before the cut is good. It is *damaged* where something else is wrong: a checksum, a
record that cannot be, an end before the one that the closing magic announces. The index in the
summary is not used, so that whole and cut files are read the same way, except to get past damage.

What a length field claims is believed as far as the file is long, and what a chunk claims to
become as far as `dz_ros.recording.decompression` allows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
import struct
from typing import BinaryIO
import zlib

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment

from dz_ros.errors import DamagedRunError, RecordingError
from dz_ros.recording.decompression import Allowance, BROKEN, expanded, LARGEST
from dz_ros.recording.mcap_definitions import Definitions, KINDS, MOST_TEXT
from dz_ros.recording.mcap_index import HEAD, Index, read_index
from dz_ros.recording.messages import Message, Topic

MAGIC = b'\x89MCAP0\r\n'
_MESSAGE = struct.Struct('<HIqq')
_LAST_TIME = struct.Struct('<8xQ')
_NO_CRC = bytes(4)
_PRIVATE = 0x80
"""Record kinds from here on belong to applications and are passed over."""
_TAKEN = (*KINDS, Opcode.CHUNK, Opcode.MESSAGE, Opcode.DATA_END, Opcode.FOOTER)
_CHUNK = struct.Struct('<QQQII')
_LOOSE = 1000
"""Messages outside chunks that are handed on together."""
_STEP = 2**20
_MOST_MESSAGES = 2**20
"""Messages in one chunk; each costs ten times its 31 bytes once it is taken out."""
_BROKEN = (*BROKEN, McapError, struct.error, KeyError)
"""What decoding of damaged bytes may raise."""


class McapFile:
    """One file; `batches` reads it once, the attributes fill up as it goes.

    Attributes:
        path: The file.
        topics: Topic name → topic, those met so far.
        metadata: (name, record) of the metadata records met so far.
        attachments: Those met so far; only if damage is to be skipped, as in a copy.
        cut: Where the file was cut off; empty while reading and if it is whole.
        damage: What was left out, as text.
    """

    def __init__(self, path: Path, skip_damage: bool = False, since: int = 0,
                 topics: dict[str, Topic] | None = None) -> None:
        """Prepare to read.

        Args:
            path: The file.
            skip_damage: Leave out what is damaged and go on, instead of raising.
            since: Leave out the chunks before the first one with a message as late as this, if
                the file is whole [ns since the epoch]; not all that is left is as late.
            topics: Those of the files before, which are added to.
        """
        self.path = path
        self._definitions = Definitions({} if topics is None else topics)
        self.topics = self._definitions.topics
        self.metadata = self._definitions.metadata
        self.attachments: list[Attachment] = []
        self.cut = ''
        self.damage: list[str] = []
        self._skip_damage = skip_damage
        self._since = since
        self._attached = MOST_TEXT
        self._private = 0
        self._allowance = Allowance(0)
        self._first: int | None = None
        self._last = 0

    def outline(self) -> None:
        """Fill in the topics alone, from the index if there is one, else by reading the file.

        Raises:
            RecordingError: As `batches`.
        """
        try:
            with self.path.open('rb') as file:
                definitions = read_index(file).definitions
        except OSError:
            definitions = ()        # reported by what reads it
        for opcode, body in definitions:
            self._read(0, self._contents, HEAD.pack(opcode, len(body)) + body)
        if not definitions:
            for _ in self.batches():
                pass

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
                self._allowance = Allowance(size)
                file.seek(0)
                if file.read(len(MAGIC)) != MAGIC:
                    hint = '' if size else ': it is empty'
                    if self.path.suffix.lower() == '.csv':
                        hint += '; a table becomes a run by dz bag import'
                    raise RecordingError(f'{self.path} is not an MCAP file{hint}')
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
            self._read(size, self._contents, HEAD.pack(opcode, len(body)) + body)
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
            if crc is not None and opcode != Opcode.DATA_END:
                crc = zlib.crc32(head, crc)
            if opcode not in _TAKEN or length > LARGEST:
                crc = self._pass(file, position, opcode, length, crc)
                position = end
                continue
            body = file.read(length)
            if opcode == Opcode.FOOTER:
                self._check(position, crc, body)
                break
            if opcode == Opcode.DATA_END:
                self._check(position, crc, body[:4])
                crc = 0                     # that of the summary begins
                position = end
                continue
            if crc is not None:
                crc = zlib.crc32(body, crc)
            if opcode == Opcode.CHUNK:
                before = (before and length >= _LAST_TIME.size
                          and _LAST_TIME.unpack_from(body)[0] < self._since)
                found = [] if before else self._read(position, self._chunk, body)
                if found:
                    yield found
            elif opcode == Opcode.MESSAGE:
                loose += self._read(position, self._contents, head + body)
                if len(loose) >= _LOOSE or length > _STEP:
                    yield loose
                    loose = []
            else:
                self._read(position, self._contents, head + body)
            position = end
        if loose:
            yield loose
        if self._private:
            self.damage.append(f'{self._private} records of private kinds are passed over')

    def _pass(self, file: BinaryIO, position: int, opcode: int, length: int,
              crc: int | None) -> int | None:
        """Pass over a record piece by piece; keep an attachment that a copy needs."""
        if opcode in _TAKEN:
            self._damaged(position, f'a record of {length} bytes, at most {LARGEST} are read')
        kept = self._skip_damage and opcode == Opcode.ATTACHMENT and length <= self._attached
        self._private += self._skip_damage and opcode >= _PRIVATE
        body, left = b'', length
        while left > 0:
            piece = file.read(min(left, length if kept else _STEP))
            if not piece:
                break
            left -= len(piece)
            crc = None if crc is None else zlib.crc32(piece, crc)
            body = piece if kept else b''
        if kept:
            self._attached -= length
            self._read(position, self._attach, body)
        elif self._skip_damage and opcode == Opcode.ATTACHMENT:
            self.damage.append(f'an attachment of {length} bytes at byte {position} is left out: '
                               f'at most {MOST_TEXT} of them are kept')
        return crc

    def _attach(self, body: bytes) -> list[Message]:
        """Take in an attachment, checked; it holds no message."""
        stored, = struct.unpack('<I', body[-4:])
        if stored not in (0, zlib.crc32(body[:-4])):
            raise ValueError('the checksum of an attachment does not fit')
        self.attachments.append(Attachment.read(ReadDataStream(BytesIO(body))))
        return []

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
        _, _, size, crc, length = _CHUNK.unpack_from(body)
        start = _CHUNK.size + length + 8
        compression = body[_CHUNK.size:start - 8].decode()
        stored = int.from_bytes(body[start - 8:start], 'little')
        if start + stored > len(body):
            raise ValueError('a chunk whose records are longer than itself')
        data = body[start:start + stored]
        if compression:
            data = expanded(data, compression, self._allowance, size)
        if len(data) != size:
            raise ValueError(f'a chunk of {len(data)} bytes, announced were {size}')
        if crc and zlib.crc32(data) != crc:
            raise ValueError('the checksum of a chunk does not fit')
        return self._contents(data)

    def _contents(self, data: bytes) -> list[Message]:
        """Return the messages among these records; take in what the others define."""
        found: list[Message] = []
        channels = self._definitions.channels
        position, end = 0, len(data)
        while position < end:
            opcode, length = HEAD.unpack_from(data, position)
            body = position + HEAD.size
            position = body + length
            if position > end:
                raise ValueError('a record longer than what holds it')
            if opcode == Opcode.MESSAGE:
                channel, _, log_time, publish_time = _MESSAGE.unpack_from(data, body)
                if (log_time | publish_time) < 0:
                    reason = f'{channels[channel]}: log or publish times of 2^63 ns, no times'
                    if not self._skip_damage:
                        raise ValueError(reason)
                    if reason not in self.damage:
                        self.damage.append(reason)
                    continue
                if len(found) == _MOST_MESSAGES:
                    raise ValueError(f'more than {_MOST_MESSAGES} messages in one chunk')
                found.append(Message(channels[channel], data[body + _MESSAGE.size:position],
                                     log_time, publish_time))
            elif opcode in KINDS:
                self._definitions.take(opcode, data[body:position])
        return found

    def _damaged(self, position: int, reason: str) -> None:
        """Note damage, or raise it."""
        seconds = 0.0 if self._first is None else (self._last - self._first) * 1e-9
        where = f'at byte {position}, {seconds:.3f} s into the run: {reason}'
        if not self._skip_damage:
            raise DamagedRunError(f'{self.path} is damaged {where}; keep what is readable with '
                                  f'dz bag recover {self.path}')
        self.damage.append(f'damaged {where}')

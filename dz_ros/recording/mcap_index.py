# SPDX-License-Identifier: Apache-2.0
"""The summary at the end of a whole MCAP file, where it can be trusted.

    Schema*, Channel*, Statistics, ChunkIndex*, MetadataIndex*, SummaryOffset*, Footer, magic

Every field of it is behind one checksum, that of the footer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
import struct
from typing import BinaryIO
import zlib

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import ChunkIndex

HEAD = struct.Struct('<BQ')
"""What every record begins with: its kind and the bytes that follow."""
_LARGEST = 2**28
"""Largest summary that is read [bytes]."""
_END = struct.Struct('<BQQQI8s')


@dataclass(frozen=True)
class Index:
    """What helps to read a damaged file.

    Attributes:
        definitions: (opcode, body) of its schemas and channels.
        chunks: Where its chunks begin [bytes], ascending.
    """

    definitions: tuple[tuple[int, bytes], ...] = ()
    chunks: tuple[int, ...] = ()


def read_index(file: BinaryIO) -> Index:
    """Return the index of a file, or an empty one if it has none or a wrong checksum."""
    size = file.seek(0, 2)
    if size < _END.size:
        return Index()
    file.seek(size - _END.size)
    opcode, _, start, _, crc, _ = _END.unpack(file.read(_END.size))
    if opcode != Opcode.FOOTER or not max(0, size - _LARGEST) < start < size:
        return Index()
    file.seek(start)
    data = file.read(size - start - 12)         # up to the checksum and the magic
    if zlib.crc32(data) != crc:
        return Index()
    definitions, chunks = [], []
    try:
        for kind, body in _records(data):
            if kind in (Opcode.SCHEMA, Opcode.CHANNEL):
                definitions.append((kind, body))
            elif kind == Opcode.CHUNK_INDEX:
                chunks.append(ChunkIndex.read(ReadDataStream(BytesIO(body))).chunk_start_offset)
    except (McapError, struct.error, ValueError):
        return Index()
    return Index(tuple(definitions), tuple(sorted(chunks)))


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (opcode, body) of records whose checksum was right."""
    position = 0
    while position + HEAD.size < len(data):
        opcode, length = HEAD.unpack_from(data, position)
        position += HEAD.size
        yield opcode, data[position:position + length]
        position += length

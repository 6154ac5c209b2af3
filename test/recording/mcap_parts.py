# SPDX-License-Identifier: Apache-2.0
"""MCAP records composed byte by byte, as other writers and attackers make them."""

from __future__ import annotations

import struct
import zlib

MAGIC = b'\x89MCAP0\r\n'


def text(value: str) -> bytes:
    data = value.encode()
    return struct.pack('<I', len(data)) + data


def record(opcode: int, body: bytes, length: int | None = None) -> bytes:
    return bytes([opcode]) + struct.pack('<Q', len(body) if length is None else length) + body


HEAD = MAGIC + record(1, text('ros2') + text('composed'))
TAIL = record(15, bytes(4)) + record(2, bytes(20)) + MAGIC


def schema(number: int, name: str, data: bytes, encoding: str = 'ros2msg') -> bytes:
    return record(3, struct.pack('<H', number) + text(name) + text(encoding)
                  + struct.pack('<I', len(data)) + data)


def channel(number: int, kind: int, topic: str, encoding: str = 'cdr', qos: str = '') -> bytes:
    pairs = text('offered_qos_profiles') + text(qos) if qos else b''
    return record(4, struct.pack('<HH', number, kind) + text(topic) + text(encoding)
                  + struct.pack('<I', len(pairs)) + pairs)


def message(number: int, time: int, payload: bytes) -> bytes:
    return record(5, struct.pack('<HIQQ', number, 0, time % 2**64, time % 2**64) + payload)


def chunk(data: bytes, stored: bytes | None = None, compression: str = '',
          size: int | None = None, length: int | None = None) -> bytes:
    stored = data if stored is None else stored
    return record(6, struct.pack('<QQQI', 0, 0, len(data) if size is None else size,
                                 zlib.crc32(data) if size is None else 0) + text(compression)
                  + struct.pack('<Q', len(stored) if length is None else length) + stored)


def attachment(name: str, data: bytes, time: int) -> bytes:
    body = (struct.pack('<QQ', time, time) + text(name) + text('application/json')
            + struct.pack('<Q', len(data)) + data)
    return record(9, body + struct.pack('<I', zlib.crc32(body)))


def metadata(name: str, pairs: dict[str, str]) -> bytes:
    body = b''.join(text(key) + text(value) for key, value in pairs.items())
    return record(12, text(name) + struct.pack('<I', len(body)) + body)

# SPDX-License-Identifier: Apache-2.0
"""Frames of the serial driver: published vectors, and what no stream of bytes may bring about."""

import zlib

from hypothesis import example, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.drivers.serial import framing
from dz_ros.drivers.serial.framing import (
    CHECKSUM,
    cobs_decode,
    cobs_encode,
    LONG,
    NO_CODE,
    pack,
    Receiver,
    SHORT,
)

FULL = bytes(range(1, 255))         # 01 … FE
# Pairs that the literature on COBS gives; the long ones are about blocks of 254.
PAIRS = [
    (b'', b'\x01'),
    (b'\0', b'\x01\x01'),
    (b'\0\0', b'\x01\x01\x01'),
    (b'\0\x11\0', b'\x01\x02\x11\x01'),
    (b'\x11\x22\0\x33', b'\x03\x11\x22\x02\x33'),
    (b'\x11\x22\x33\x44', b'\x05\x11\x22\x33\x44'),
    (b'\x11\0\0\0', b'\x02\x11\x01\x01\x01'),
    (FULL, b'\xff' + FULL),
    (b'\0' + FULL, b'\x01\xff' + FULL),
    (FULL + b'\xff', b'\xff' + FULL + b'\x02\xff'),
    (FULL[1:] + b'\xff\0', b'\xff' + FULL[1:] + b'\xff\x01\x01'),
    (FULL[2:] + b'\xff\0\x01', b'\xfe' + FULL[2:] + b'\xff\x02\x01'),
]


def by_the_definition(data):
    """Return COBS of data: runs that end in an imagined zero, cut at 254 bytes."""
    if len(data) and 0 not in data and len(data) % 254 == 0:
        return b''.join(b'\xff' + data[i:i + 254] for i in range(0, len(data), 254))
    out = b''
    runs = data.split(b'\0')
    for number, run in enumerate(runs):
        while len(run) >= 254 and (len(run) > 254 or number < len(runs) - 1):
            out, run = out + b'\xff' + run[:254], run[254:]
        out += bytes([len(run) + 1]) + run
    return out


@pytest.mark.parametrize(('data', 'line'), PAIRS)
def test_cobs_of_the_literature(data, line):
    assert cobs_encode(data) == line
    assert cobs_decode(line) == data


@given(st.binary(max_size=1100) | st.integers(0, 1100).map(lambda n: b'\x07' * n))
def test_cobs_is_its_definition_and_comes_back(data):
    line = cobs_encode(data)
    assert line == by_the_definition(data)
    assert 0 not in line
    assert len(line) <= len(data) + 1 + len(data) // 254
    assert cobs_decode(line) == data


@given(st.binary(max_size=600))
def test_no_line_decodes_to_more_than_it_has_or_raises(line):
    data = cobs_decode(line)
    assert data is None or len(data) < max(len(line), 1)


def test_crc_is_the_one_the_document_names():
    # The check value of CRC-32/ISO-HDLC, and the polynomial bit by bit.
    assert zlib.crc32(b'123456789') == 0xCBF43926
    crc = 0xFFFFFFFF
    for byte in b'123456789':
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
    assert crc ^ 0xFFFFFFFF == 0xCBF43926
    assert int(f'{0x04C11DB7:032b}'[::-1], 2) == 0xEDB88320


def test_a_frame_byte_by_byte():
    body = b'\x01\x02'
    crc = zlib.crc32(body)
    assert pack(body) == cobs_encode(body + crc.to_bytes(4, 'little')) + b'\0'


def chunks(data, sizes):
    """Return data cut into pieces of these sizes, the rest in one."""
    at, found = 0, []
    for size in sizes:
        found.append(data[at:at + size])
        at += size
    return [*found, data[at:]]


BODIES = st.lists(st.binary(min_size=1, max_size=framing.MAX_BODY), max_size=8)


@given(BODIES, st.lists(st.integers(0, 40), max_size=20))
def test_frames_come_over_however_the_stream_is_cut(bodies, sizes):
    receiver = Receiver()
    stream = b''.join(map(pack, bodies))
    found = [body for piece in chunks(stream, sizes) for body in receiver.feed(piece)]
    assert found == bodies
    assert not any(receiver.refused.counts.values())


@given(st.binary(max_size=400), BODIES)
@example(b'\x01' * 399, [b'\x05'])
def test_after_garbage_the_second_frame_comes_over(garbage, bodies):
    receiver = Receiver()
    passed = list(receiver.feed(garbage))
    assert passed == []             # of 2^32 pieces of garbage one passes
    found = list(receiver.feed(b''.join(map(pack, [b'lost with the garbage', *bodies]))))
    assert found[-len(bodies):] == bodies if bodies else len(found) <= 1


@settings(max_examples=4 * settings.default.max_examples)
@given(st.binary(min_size=1, max_size=framing.MAX_BODY), st.data())
def test_damage_never_changes_a_body(body, data):
    frame = bytearray(pack(body))
    kind = data.draw(st.sampled_from(('bits', 'cut', 'double', 'insert')))
    at = data.draw(st.integers(0, len(frame) - 1))
    if kind == 'bits':
        for place in data.draw(st.sets(st.integers(0, 8 * len(frame) - 1), min_size=1,
                                       max_size=40)):
            frame[place // 8] ^= 1 << place % 8
    elif kind == 'cut':
        del frame[at:at + data.draw(st.integers(1, len(frame)))]
    elif kind == 'double':
        frame[at:at] = frame[at:]
    else:
        frame[at:at] = data.draw(st.binary(min_size=1, max_size=20))
    receiver = Receiver()
    other = b'the next one'
    found = list(receiver.feed(bytes(frame) + b'\0' + pack(other)))
    assert found[-1] == other
    assert set(found[:-1]) <= {body}


def test_every_wrong_bit_is_found():
    body = bytes(range(29))
    data = body + zlib.crc32(body).to_bytes(4, 'little')
    for first in range(8 * len(data)):
        for second in range(first, 8 * len(data)):
            wrong = bytearray(data)
            for place in {first, second}:
                wrong[place // 8] ^= 1 << place % 8
            receiver = Receiver()
            assert not list(receiver.feed(cobs_encode(bytes(wrong)) + b'\0'))
            assert receiver.refused.counts[CHECKSUM] == 1


@pytest.mark.slow
def test_up_to_four_wrong_bits_of_the_longest_body_are_found():
    # What a wrong bit does to the CRC does not depend on the data. That of one or two bits is
    # never that of one or two others, so no one to four of them cancel.
    size = framing.MAX_BODY + framing.CRC_SIZE
    clean, single = zlib.crc32(bytes(size)), []
    for place in range(8 * size):       # the bits of the CRC as well: over both it is a constant
        body = bytearray(size)
        body[place // 8] ^= 1 << place % 8
        single.append(zlib.crc32(bytes(body)) ^ clean)
    bits = np.array(single, np.uint32)
    first, second = np.triu_indices(len(bits), 1)
    syndromes = np.concatenate([bits, bits[first] ^ bits[second]])
    assert np.all(syndromes)
    assert len(np.unique(syndromes)) == len(syndromes)


def test_a_stream_without_end_takes_no_memory():
    receiver = Receiver()
    for _ in range(1000):
        assert not list(receiver.feed(b'\x07' * 1000))
        assert len(receiver._line) <= framing.MAX_LINE
    assert receiver.refused.counts[LONG] == 1
    assert list(receiver.feed(b'\0' + pack(b'again'))) == [b'again']


def test_what_is_thrown_away_is_counted_by_reason():
    receiver = Receiver()
    assert list(receiver.feed(b'\0\0\0')) == []
    assert not any(receiver.refused.counts.values())
    list(receiver.feed(b'\x09\x01\0'))
    list(receiver.feed(cobs_encode(b'abc') + b'\0'))
    list(receiver.feed(cobs_encode(b'abcdef') + b'\0'))
    list(receiver.feed(b'\x01' * (framing.MAX_LINE + 1) + b'\0'))
    assert receiver.refused.counts == dict.fromkeys((NO_CODE, SHORT, CHECKSUM, LONG), 1)

# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import contextlib
import math
import struct

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.errors import MessageError
from dz_ros.recording.axes_cdr import AxesCodec, decode_axes
from dz_ros.recording.cdr import (
    ArrayCodec,
    Body,
    decode_array,
    decode_string,
    encode_clock,
    encode_string,
)

ARRAY = 'std_msgs/msg/Float64MultiArray'
NAMES = st.text(st.characters(exclude_categories=['Cs'], exclude_characters=',\0'), min_size=1,
                max_size=12)
LABELS = st.lists(NAMES, min_size=1, max_size=20, unique=True).map(tuple)
NUMBERS = st.floats()
MESSAGES = LABELS.flatmap(lambda labels: st.tuples(
    st.just(labels), st.lists(NUMBERS, min_size=len(labels), max_size=len(labels))))


def bits(values) -> bytes:
    """Return the bytes of doubles: equal only if −0.0, NaN and all are equal."""
    return struct.pack(f'<{len(values)}d', *values)


@pytest.fixture(scope='module')
def rosbags():
    typesys = pytest.importorskip('rosbags.typesys')
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY)


def build(store, labels, values, **layout):
    """Return a Float64MultiArray made by another library."""
    types = store.types
    dims = layout.get('dims', [(','.join(labels), len(labels), len(labels))])
    return types[ARRAY](
        types['std_msgs/msg/MultiArrayLayout'](
            [types['std_msgs/msg/MultiArrayDimension'](*item) for item in dims],
            layout.get('offset', 0)), np.array(values, dtype=float))


@given(MESSAGES)
def test_round_trip_keeps_every_bit(message):
    labels, values = message
    codec = ArrayCodec(labels)
    payload = codec.encode(values)
    assert codec.matches(payload)
    assert bits(codec.decode(payload)) == bits(values)
    found, numbers = decode_array(payload)
    assert found == labels
    assert bits(numbers) == bits(values)
    assert codec.decode_many([payload, payload]).tobytes() == bits(values) * 2


@given(MESSAGES)
def test_another_library_reads_what_we_write(rosbags, message):
    labels, values = message
    found = rosbags.deserialize_cdr(ArrayCodec(labels).encode(values), ARRAY)
    dimension, = found.layout.dim
    assert dimension.label == ','.join(labels)
    assert (dimension.size, dimension.stride, found.layout.data_offset) == (
        len(labels), len(labels), 0)
    assert found.data.tobytes() == bits(values)


@given(MESSAGES, st.booleans())
def test_we_read_what_another_library_writes(rosbags, message, little):
    labels, values = message
    payload = bytes(rosbags.serialize_cdr(build(rosbags, labels, values), ARRAY,
                                          little_endian=little))
    codec = ArrayCodec(labels)
    assert codec.matches(payload) is little
    assert bits(codec.decode(payload)) == bits(values)


@given(MESSAGES, st.binary(min_size=16, max_size=16))
def test_pad_bytes_and_options_may_hold_anything(message, noise):
    labels, values = message
    codec = ArrayCodec(labels)
    payload = bytearray(codec.encode(values))
    label = len(','.join(labels).encode()) + 1
    after_label = 4 + 8 + label
    pads = [2, 3, *range(after_label, 4 + -(-(8 + label) // 4) * 4)]
    after_count = 4 + -(-(8 + label) // 4) * 4 + 16
    pads += range(after_count, codec.data_start)
    for index, place in enumerate(pads):
        payload[place] = noise[index % len(noise)]
    assert bits(codec.decode(bytes(payload))) == bits(values)
    payload[2:4] = b'\0\0'
    assert codec.matches(bytes(payload))
    assert codec.decode_many([bytes(payload)]).tobytes() == bits(values)


@given(MESSAGES, st.data())
def test_cut_messages_are_refused(message, data):
    labels, values = message
    codec = ArrayCodec(labels)
    payload = codec.encode(values)
    short = payload[:data.draw(st.integers(0, len(payload) - 1))]
    with pytest.raises(MessageError):
        codec.decode(short)
    assert codec.decode_many([payload, short]) is None


@given(st.binary(max_size=200), st.booleans())
def test_garbage_is_refused_or_read_but_never_breaks(noise, header):
    payload = b'\x00\x01\x00\x00' + noise if header else noise
    for decode in (decode_array, decode_string, ArrayCodec(('seq', 'stamp', 'v')).decode):
        with contextlib.suppress(MessageError):
            decode(payload)


def test_wrong_labels_name_both():
    payload = ArrayCodec(('seq', 'stamp', 'w')).encode([1, 2, 3])
    with pytest.raises(MessageError, match='carries seq, stamp, w; expected seq, stamp, v') as got:
        ArrayCodec(('seq', 'stamp', 'v')).decode(payload)
    assert got.value.expected == ('seq', 'stamp', 'v')
    assert got.value.got == ('seq', 'stamp', 'w')


def test_same_length_other_labels_do_not_pass_the_fast_path():
    assert not ArrayCodec(('a', 'b')).matches(ArrayCodec(('a', 'c')).encode([1, 2]))


@pytest.mark.parametrize('values', [[1.0], [1.0, 2.0, 3.0], ['x', 2.0], [None, 1.0],
                                    [10**400, 1.0]])
def test_encode_refuses(values):
    with pytest.raises(MessageError, match='must be 2 numbers'):
        ArrayCodec(('a', 'b')).encode(values)


@pytest.mark.parametrize('labels', [(), ('a', 'a'), ('a,b',), ('',), ('a\0',)])
def test_labels_must_be_names(labels):
    with pytest.raises(MessageError):
        ArrayCodec(labels)


@pytest.mark.parametrize(('dims', 'offset', 'labels'), [
    ([], 0, ()),                                        # bare numbers
    ([('a,b,c', 3, 3)], 0, ('a', 'b', 'c')),
    ([('a,b,c', 3, 1)], 0, ('a', 'b', 'c')),            # many tools set no stride
    ([('a,b,c', 3, 3)], 1, ()),                         # the first numbers are padding
    ([('a,b', 3, 3)], 0, ()),
    ([('a,b,c', 2, 2)], 0, ()),
    ([('rows', 3, 3), ('columns', 1, 1)], 0, ()),
    ([('', 3, 3)], 0, ()),
])
def test_layouts_of_other_tools(rosbags, dims, offset, labels):
    for little in (True, False):
        payload = bytes(rosbags.serialize_cdr(
            build(rosbags, (), [1.0, 2.0, 3.0], dims=dims, offset=offset), ARRAY,
            little_endian=little))
        assert decode_array(payload) == (labels, (1.0, 2.0, 3.0))


def test_array_without_numbers(rosbags):
    payload = bytes(rosbags.serialize_cdr(build(rosbags, (), [], dims=[]), ARRAY))
    assert decode_array(payload) == ((), ())


def test_trailing_bytes():
    payload = ArrayCodec(('a',)).encode([1.0])
    assert decode_array(payload + bytes(3)) == (('a',), (1.0,))
    with pytest.raises(MessageError, match='4 bytes follow'):
        decode_array(payload + bytes(4))


def test_huge_counts_do_not_allocate():
    for count in (2**31, 2**32 - 1):
        with pytest.raises(MessageError):
            decode_array(struct.pack('<4sIII', b'\x00\x01\x00\x00', 0, 0, count))
        with pytest.raises(MessageError):
            decode_array(struct.pack('<4sI', b'\x00\x01\x00\x00', count))


@given(st.text(st.characters(exclude_categories=['Cs'], exclude_characters='\0')))
def test_strings_round_trip_through_another_library(rosbags, text):
    kind = 'std_msgs/msg/String'
    assert decode_string(encode_string(text)) == text
    assert rosbags.deserialize_cdr(encode_string(text), kind).data == text
    for little in (True, False):
        assert decode_string(bytes(rosbags.serialize_cdr(rosbags.types[kind](text), kind,
                                                         little_endian=little))) == text


@pytest.mark.parametrize('text', ['a\0b', '\ud800'])
def test_strings_that_cannot_be_sent(text):
    with pytest.raises(MessageError, match='cannot be sent'):
        encode_string(text)


def test_text_that_is_not_utf8():
    with pytest.raises(MessageError, match='UTF-8'):
        decode_string(b'\x00\x01\x00\x00\x02\x00\x00\x00\xff\x00')


@given(MESSAGES)
def test_rclpy_reads_what_we_write_and_the_reverse(message):
    serialization = pytest.importorskip('rclpy.serialization', reason='rclpy is not installed')
    messages = pytest.importorskip('std_msgs.msg')
    labels, values = message
    codec = ArrayCodec(labels)
    found = serialization.deserialize_message(codec.encode(values), messages.Float64MultiArray)
    dimension, = found.layout.dim
    assert dimension.label == ','.join(labels)
    assert bits(found.data) == bits(values)
    theirs = bytes(serialization.serialize_message(found))
    assert codec.matches(theirs)
    assert bits(codec.decode(theirs)) == bits(values)


def test_rclpy_strings():
    serialization = pytest.importorskip('rclpy.serialization', reason='rclpy is not installed')
    messages = pytest.importorskip('std_msgs.msg')
    for text in ('', 'a', 'ab', 'abc', 'abcd', 'θ̂ → φ̂', 'x' * 10_000):
        found = serialization.deserialize_message(encode_string(text), messages.String)
        assert found.data == text
        assert decode_string(bytes(serialization.serialize_message(found))) == text


@pytest.mark.parametrize('stamp_ns', [0, 5_000_000, 999_999_999, 10**9, 2**31 * 10**9 - 1])
def test_rclpy_reads_the_time(stamp_ns):
    serialization = pytest.importorskip('rclpy.serialization', reason='rclpy is not installed')
    messages = pytest.importorskip('rosgraph_msgs.msg')
    found = serialization.deserialize_message(encode_clock(stamp_ns), messages.Clock)
    assert found.clock.sec * 10**9 + found.clock.nanosec == stamp_ns
    assert bytes(serialization.serialize_message(found)) == encode_clock(stamp_ns)


def test_rclpy_bare_array():
    serialization = pytest.importorskip('rclpy.serialization', reason='rclpy is not installed')
    messages = pytest.importorskip('std_msgs.msg')
    for values in ([], [1.5], [1.5, -0.0, math.inf]):
        theirs = bytes(serialization.serialize_message(messages.Float64MultiArray(data=values)))
        labels, found = decode_array(theirs)
        assert labels == ()
        assert bits(found) == bits(values)


@pytest.mark.parametrize('decode', [decode_array, decode_axes, ArrayCodec(('seq', 'v')).decode,
                                    AxesCodec(('seq', 'v'), ('x', 'y')).decode])
def test_dimensions_without_end_are_refused_before_they_are_read(decode, monkeypatch):
    """The ends of a loop decode in its thread: what they read does not grow with the message."""
    payload = (b'\0\1\0\0' + struct.pack('<I', 60_000)
               + struct.pack('<I4sII', 1, b'', 0, 0) * 60_000 + struct.pack('<II', 0, 0))
    read = []
    monkeypatch.setattr(Body, 'text', lambda _self: read.append(1) or '')
    with pytest.raises(MessageError, match='an array of 60000 dimensions, at most 8 are read'):
        decode(payload)
    assert not read

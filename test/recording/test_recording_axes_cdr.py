# SPDX-License-Identifier: Apache-2.0
"""Messages of several axes: bytes as another library writes them, and what is refused, why."""

from __future__ import annotations

import contextlib
import math
import struct

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core.axes import MAX_AXES
from dz_ros.core.records import Command, State
from dz_ros.errors import MessageError
from dz_ros.recording.axes_cdr import (
    ANOTHER_ORDER,
    AxesCodec,
    AXIS_TWICE,
    codec_for,
    decode_axes,
    OTHER_AXES,
    ROW_MISSING,
    UNEVEN_ROWS,
)
from dz_ros.recording.cdr import ANOTHER_NUMBER, ArrayCodec, decode_array

ARRAY = 'std_msgs/msg/Float64MultiArray'
AXES = ('surge', 'sway', 'yaw')
LABELS = Command.labels()
ROWS = [float(item) for row in range(3) for item in (7, 0.035, row + 0.5, 7, 0.035, 0)]
NAMES = st.lists(st.from_regex(r'[A-Za-z][A-Za-z0-9_]{0,9}', fullmatch=True), min_size=2,
                 max_size=12, unique=True).map(tuple)


@pytest.fixture(scope='module')
def rosbags():
    typesys = pytest.importorskip('rosbags.typesys')
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY)


def written(store, dims, values, offset=0) -> bytes:
    """Return the payload that another library writes of a layout and its numbers."""
    types = store.types
    made = types[ARRAY](types['std_msgs/msg/MultiArrayLayout'](
        [types['std_msgs/msg/MultiArrayDimension'](*item) for item in dims], offset),
        np.array(values, dtype=float))
    return bytes(store.serialize_cdr(made, ARRAY))


def dims(axes=AXES, labels=LABELS, rows=None, fields=None):
    """Return the two dimensions of a message."""
    rows = len(axes) if rows is None else rows
    fields = len(labels) if fields is None else fields
    return [(','.join(axes), rows, rows * fields), (','.join(labels), fields, fields)]


@given(NAMES, st.integers(0, 2 ** 40), st.floats(-1e9, 1e9), st.data())
def test_round_trip_keeps_every_bit(axes, seq, stamp, data):
    labels = State.labels(2)
    rows = [[seq, stamp, *data.draw(st.lists(st.floats(), min_size=2, max_size=2)), 3, 0.5, 0.0]
            for _ in axes]
    flat = [float(item) for row in rows for item in row]
    codec = AxesCodec(labels, axes)
    payload = codec.encode(flat)
    assert len(payload) == codec.size
    assert codec.matches(payload)
    assert struct.pack(f'{len(flat)}d', *codec.decode(payload)) == struct.pack(
        f'{len(flat)}d', *flat)
    assert decode_axes(payload)[:2] == (axes, labels)
    table = codec.decode_many([payload, payload])
    assert table.shape == (2, len(flat))
    assert table[1].tobytes() == np.array(flat).tobytes()


def test_bytes_are_those_of_another_library(rosbags):
    payload = AxesCodec(LABELS, AXES).encode(ROWS)
    assert payload == written(rosbags, dims(), ROWS)
    found = rosbags.deserialize_cdr(payload, ARRAY)
    assert [(item.label, item.size, item.stride) for item in found.layout.dim] == dims()
    assert found.data.tolist() == ROWS


def test_one_axis_is_the_message_of_one_dimension():
    row = ROWS[:6]
    for axes in ((), ('surge',)):
        codec = codec_for(LABELS, axes)
        assert type(codec) is ArrayCodec
        assert codec.encode(row) == ArrayCodec(LABELS).encode(row)
    assert decode_axes(ArrayCodec(LABELS).encode(row)) == ((), LABELS, tuple(row))


@pytest.mark.parametrize(('layout', 'values', 'cause'), [
    (dims(rows=3), ROWS[:12], ROW_MISSING),
    (dims(axes=AXES[:2], rows=3), ROWS, ROW_MISSING),
    (dims(axes=('sway', 'surge', 'yaw')), ROWS, ANOTHER_ORDER),
    (dims(axes=('surge', 'sway', 'heave')), ROWS, OTHER_AXES),
    (dims(axes=AXES[:2]), ROWS[:12], ANOTHER_NUMBER),
    (dims()[1:], ROWS[:6], ANOTHER_NUMBER),
    (dims(axes=('surge', 'surge', 'yaw')), ROWS, AXIS_TWICE),
    (dims(), [*ROWS[:6], 8.0, *ROWS[7:]], UNEVEN_ROWS),
    (dims(), [*ROWS[:7], 0.04, *ROWS[8:]], UNEVEN_ROWS),
    (dims(), [*ROWS[:9], 6.0, *ROWS[10:]], UNEVEN_ROWS),
])
def test_each_fault_of_a_message_has_its_cause(rosbags, layout, values, cause):
    payload = written(rosbags, layout, values)
    with pytest.raises(MessageError) as refused:
        AxesCodec(LABELS, AXES).decode(payload)
    assert refused.value.cause == cause
    assert '\n' not in str(refused.value)


def test_other_fields_are_named(rosbags):
    payload = written(rosbags, dims(labels=('seq', 'stamp', 'w', 'a', 'b', 'c')), ROWS)
    with pytest.raises(MessageError, match='seq, stamp, w') as refused:
        AxesCodec(LABELS, AXES).decode(payload)
    assert refused.value.got == ('seq', 'stamp', 'w', 'a', 'b', 'c')
    assert not refused.value.cause


def test_a_loop_of_one_axis_refuses_several(rosbags):
    with pytest.raises(MessageError, match='of one axis') as refused:
        ArrayCodec(LABELS).decode(written(rosbags, dims(), ROWS))
    assert refused.value.cause == ANOTHER_NUMBER


def test_nan_in_a_row_is_decoded_and_left_to_the_guards():
    values = [*ROWS[:8], math.nan, *ROWS[9:]]
    found = AxesCodec(LABELS, AXES).decode(AxesCodec(LABELS, AXES).encode(values))
    assert math.isnan(found[8])
    assert found[:8] == tuple(values[:8])


def test_many_are_refused_together_where_one_is():
    codec = AxesCodec(LABELS, AXES)
    good, bad = codec.encode(ROWS), codec.encode([*ROWS[:6], 8.0, *ROWS[7:]])
    assert codec.decode_many([good, bad]) is None
    assert codec.decode_many([good, good[:-8]]) is None
    assert codec.decode_many([good, AxesCodec(LABELS, ('surge', 'sway', 'jaw')).encode(
        ROWS)]) is None


@pytest.mark.parametrize('axes', [('a', 'a'), ('', 'b'), ('a,b', 'c'), ('1a', 'b'),
                                  tuple(f'a{i}' for i in range(MAX_AXES + 1))])
def test_names_that_are_none_make_no_codec(axes):
    with pytest.raises(MessageError):
        AxesCodec(LABELS, axes)


def test_wrong_number_of_numbers_is_refused():
    with pytest.raises(MessageError, match='3 rows of 6'):
        AxesCodec(LABELS, AXES).encode(ROWS[:-1])


@given(st.binary(max_size=400))
def test_any_bytes_are_read_or_refused(data):
    for payload in (data, b'\0\1\0\0' + data):
        for decode in (decode_axes, AxesCodec(LABELS, AXES).decode):
            with contextlib.suppress(MessageError):
                decode(payload)


@given(st.integers(0, 300), st.integers(0, 255))
def test_a_changed_byte_is_read_or_refused(place, value):
    payload = bytearray(AxesCodec(LABELS, AXES).encode(ROWS))
    payload[place % len(payload)] = value
    try:
        axes, labels, numbers = decode_axes(bytes(payload))
        assert not labels or len(numbers) == max(1, len(axes)) * len(labels)
    except MessageError:
        pass
    with contextlib.suppress(MessageError):
        decode_array(bytes(payload))

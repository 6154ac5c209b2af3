# SPDX-License-Identifier: Apache-2.0
"""The messages of the loop, packed and unpacked without ROS: arrays of doubles, text and the time.

CDR (OMG DDS-XTypes 7.4, classic encoding "version 1") as ROS 2 serialises ``std_msgs``. A payload
is a 4-byte encapsulation header (kind of encoding, options) and a body; inside the body a number
of k bytes starts at a multiple of k, counted from the body's first byte. Text is its length with
the closing NUL (uint32), the UTF-8 bytes, the NUL. A sequence is its length (uint32) and its
elements.

    std_msgs/Float64MultiArray     layout.dim[]: label, size, stride;  layout.data_offset;  data[]
    std_msgs/String                data
    rosgraph_msgs/Clock            sec (int32), nanosec (uint32)

Every array of a loop of one axis has one dimension whose label is the comma-separated names of its
numbers; those of several axes: ``recording/axes_cdr.py``. Pad bytes written here are zero; those
of other writers may hold anything and are never compared.
"""

from __future__ import annotations

from collections.abc import Sequence
import struct

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.text import LONGEST, printable
from dz_ros.errors import MessageError

LITTLE_ENDIAN = b'\x00\x01\x00\x00'
"""Encapsulation header of plain CDR, little endian, no options."""

HEADER = len(LITTLE_ENDIAN)
LARGEST_ARRAY = 2**20
"""Larger arrays are none of ours [bytes]."""
_pack_time = struct.Struct(f'<{HEADER}siI').pack
MAX_DIMENSIONS = 8
"""Dimensions of an array that is read, whatever it holds."""
MAX_LABELS, MAX_LABEL = 4096, 128
"""Numbers of a message that have names, and characters of a name, at most."""
ANOTHER_NUMBER = 'another number of axes'
"""Cause by which messages are counted that are those of a loop of several axes, or of one."""
_MAX_TRAILING = 3
"""Bytes that a transport may append to fill the last word."""


class ArrayCodec:
    """Packs and unpacks the arrays of one topic, whose labels are known.

    Attributes:
        labels: Names of the numbers.
        axes: Names of the axes; empty: one, which is not named.
        size: Bytes of a payload.
        data_start: Place of the first double in a payload.
    """

    axes: tuple[str, ...] = ()

    def __init__(self, labels: tuple[str, ...]) -> None:
        """Prepare the bytes that all messages with these labels share.

        Raises:
            MessageError: No label, an empty or repeated one, or one with a comma or NUL in it.
        """
        if not labels or len(set(labels)) < len(labels) or any(
                not name or ',' in name or '\0' in name for name in labels):
            raise MessageError(f'labels {labels!r}: must be different names without commas',
                               got=labels)
        self.labels = labels
        count = len(labels)
        self._lay_out([(','.join(labels), count, count)], count)

    def _lay_out(self, dimensions: Sequence[tuple[str, int, int]], count: int) -> None:
        """Prepare the bytes before `count` numbers of dimensions (label, size, stride)."""
        self._fixed: list[tuple[int, bytes]] = []
        prefix = LITTLE_ENDIAN
        parts = [struct.pack('<I', len(dimensions))]
        for label, *numbers in dimensions:
            text = label.encode() + b'\0'
            parts += [struct.pack('<I', len(text)) + text, struct.pack('<II', *numbers)]
        for part in (*parts, struct.pack('<II', 0, count)):
            start = HEADER + aligned(len(prefix) - HEADER, 4)
            prefix = prefix.ljust(start, b'\0') + part
            self._fixed.append((start, part))
        self.data_start = HEADER + aligned(len(prefix) - HEADER, 8)
        self.size = self.data_start + 8 * count
        self._prefix = prefix.ljust(self.data_start, b'\0')
        self._pack = struct.Struct(f'<{len(self._prefix)}s{count}d').pack
        self._unpack_from = struct.Struct(f'<{count}d').unpack_from

    def encode(self, values: Sequence[float]) -> bytes:
        """Return the payload of these numbers, one for each label.

        Raises:
            MessageError: Another count, or something that is not a number.
        """
        try:
            return self._pack(self._prefix, *values)
        except (struct.error, OverflowError):
            raise MessageError(f'{list(values)!r}: must be {len(self.labels)} numbers '
                               f'({", ".join(self.labels)})', self.labels) from None

    def matches(self, payload: bytes) -> bool:
        """Return whether the payload has the layout that `encode` writes, pad bytes aside."""
        return (len(payload) == self.size and payload.startswith(LITTLE_ENDIAN)
                and all(payload.startswith(part, start) for start, part in self._fixed))

    def decode(self, payload: bytes) -> tuple[float, ...]:
        """Return the numbers of a payload, shape (len(labels),).

        Raises:
            MessageError: Other labels, another length, or not such a message at all.
        """
        if (payload.startswith(self._prefix) and len(payload) == self.size) or (
                self.matches(payload)):
            return self._unpack_from(payload, self.data_start)
        try:
            labels, values = decode_array(payload)
        except MessageError as error:
            raise MessageError(f'{error} (expected {", ".join(self.labels)})',
                               self.labels) from None
        if labels != self.labels:
            found = (printable(', '.join(labels), LONGEST) if labels
                     else f'{len(values)} numbers without names')
            several = not labels and Body(payload).number() == 2
            raise MessageError(f'message carries {found}; expected {", ".join(self.labels)}'
                               + (', of one axis' if several else ''),
                               self.labels, labels, ANOTHER_NUMBER if several else '')
        return values

    def decode_many(self, payloads: Sequence[bytes]) -> NDArray[np.float64] | None:
        """Return the numbers of many payloads, shape (N, len(labels)).

        Returns:
            None where some payload is not laid out as `encode` does: decode them one by one.
        """
        table = np.frombuffer(b''.join(payloads), np.uint8)
        if len(table) != len(payloads) * self.size or any(
                len(payload) != self.size for payload in payloads):
            return None
        table = table.reshape(-1, self.size)
        for start, part in ((0, LITTLE_ENDIAN), *self._fixed):
            if (table[:, start:start + len(part)] != np.frombuffer(part, np.uint8)).any():
                return None
        return np.ascontiguousarray(table[:, self.data_start:]).view('<f8').astype(
            np.float64, copy=False)


def encode_clock(stamp_ns: int) -> bytes:
    """Return the payload of a rosgraph_msgs/Clock.

    Args:
        stamp_ns: The time, 0 … 2³¹ s [ns].
    """
    return _pack_time(LITTLE_ENDIAN, *divmod(stamp_ns, 1_000_000_000))


def decode_array(payload: bytes) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Return (labels, numbers) of any std_msgs/Float64MultiArray, either byte order.

    Labels are () where the layout does not name the numbers one by one: no dimension, several,
    a size or a label that is not for as many numbers as there are, more than `MAX_LABELS` or names
    longer than `MAX_LABEL`.

    Raises:
        MessageError: Not such a message, or cut off.
    """
    if len(payload) > LARGEST_ARRAY:
        raise MessageError(f'an array message of {len(payload)} bytes, at most {LARGEST_ARRAY} '
                           'are read')
    body = Body(payload)
    dimensions = dimension_count(body)
    label, size = '', -1
    for _ in range(dimensions):
        label, size, _ = body.text(), body.number(), body.number()     # stride
    offset = body.number()
    values = body.doubles(body.number())
    body.finish()
    if (dimensions == 1 and size == len(values) <= MAX_LABELS
            and len(label) <= MAX_LABELS * MAX_LABEL and not offset):
        labels = tuple(label.split(','))
        if len(labels) == len(values) and all(0 < len(item) <= MAX_LABEL for item in labels):
            return labels, values
    return (), values


def dimension_count(body: Body) -> int:
    """Read how many dimensions an array has.

    Raises:
        MessageError: More than are read: each takes time, however short it is.
    """
    count = body.number()
    if count > MAX_DIMENSIONS:
        raise MessageError(f'an array of {count} dimensions, at most {MAX_DIMENSIONS} are read')
    return count


def encode_string(text: str) -> bytes:
    """Return the std_msgs/String payload of a text.

    Raises:
        MessageError: The text holds a NUL or cannot be UTF-8.
    """
    try:
        data = text.encode()
    except UnicodeEncodeError as error:
        raise MessageError(f'text cannot be sent: {error}') from None
    if b'\0' in data:
        raise MessageError('text cannot be sent: it holds a NUL, where ROS would end it')
    return LITTLE_ENDIAN + struct.pack('<I', len(data) + 1) + data + b'\0'


def decode_string(payload: bytes) -> str:
    """Return the text of a std_msgs/String payload, either byte order.

    Raises:
        MessageError: Not such a message, or cut off.
    """
    body = Body(payload)
    text = body.text()
    body.finish()
    return text


def aligned(position: int, size: int) -> int:
    """Return the first multiple of size from position on."""
    return -(-position // size) * size


class Body:
    """A cursor over the body of a payload; every step raises MessageError where bytes lack."""

    def __init__(self, payload: bytes) -> None:
        kind = bytes(payload[:2])
        if len(payload) < HEADER or kind not in (b'\x00\x00', b'\x00\x01'):
            raise MessageError(f'not a CDR message: it starts with {payload[:HEADER].hex(" ")!r}')
        self._order = '<' if kind == b'\x00\x01' else '>'
        self._data = payload[HEADER:]
        self._position = 0

    def _take(self, size: int, alignment: int) -> int:
        start = aligned(self._position, alignment)
        if start + size > len(self._data):
            raise MessageError(f'message is cut off: {start + size} bytes announced, '
                               f'{len(self._data)} there')
        self._position = start + size
        return start

    def number(self) -> int:
        """Return the next uint32."""
        start = self._take(4, 4)
        return int(struct.unpack_from(f'{self._order}I', self._data, start)[0])

    def text(self) -> str:
        """Return the next string."""
        size = self.number()
        start = self._take(size, 1)
        raw = bytes(self._data[start:start + size])
        try:
            return raw.removesuffix(b'\0').decode()
        except UnicodeDecodeError as error:
            raise MessageError(f'message holds a text that is not UTF-8: {error}') from None

    def doubles(self, count: int) -> tuple[float, ...]:
        """Return the next `count` doubles."""
        if not count:      # some writers align for the element that does not come, some do not
            self._position = min(aligned(self._position, 8), len(self._data))
            return ()
        start = self._take(8 * count, 8)
        return struct.unpack_from(f'{self._order}{count}d', self._data, start)

    def finish(self) -> None:
        """Check that nothing but padding follows."""
        rest = len(self._data) - self._position
        if rest > _MAX_TRAILING:
            raise MessageError(f'not the expected message: {rest} bytes follow its end')

# SPDX-License-Identifier: Apache-2.0
"""Arrays of a loop of several axes, packed and unpacked without ROS: a row an axis.

    layout.dim[0]   label: names of the axes, comma-separated; size n; stride n F
    layout.dim[1]   label: names of the F fields, as of one axis; size = stride = F
    data            row after row; seq, stamp, echo_seq and echo_stamp the same in every row

The layout decides: a message of other axes, another order or another number of rows is refused,
never reordered or filled. A loop of one axis sends the message of one dimension (``cdr.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
import struct

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.axes import check_names, MAX_AXES, SHARED, uneven
from dz_ros.core.text import LONGEST, printable
from dz_ros.errors import ConfigurationError, MessageError
from dz_ros.recording.cdr import (
    ANOTHER_NUMBER,
    ArrayCodec,
    Body,
    dimension_count,
    LARGEST_ARRAY,
    MAX_LABEL,
    MAX_LABELS,
)

ANOTHER_ORDER = 'axes in another order'
OTHER_AXES = 'other axes'
AXIS_TWICE = 'an axis named twice'
ROW_MISSING = 'a row missing'
UNEVEN_ROWS = 'rows of different samples'
"""Causes by which messages of several axes are counted that are not taken (docs/axes.md)."""


class AxesCodec(ArrayCodec):
    """Packs and unpacks the arrays of one topic of a loop of several axes.

    Numbers are flat, row after row, n F of them.

    Attributes:
        labels: Names of the fields, the same in each row.
        axes: Names of the axes, in the order of the rows.
    """

    def __init__(self, labels: tuple[str, ...], axes: tuple[str, ...]) -> None:
        """Prepare the bytes that all messages share.

        Raises:
            MessageError: Labels as of `ArrayCodec`, axes that are none.
        """
        super().__init__(labels)
        try:
            self.axes = check_names(axes)
        except ConfigurationError as error:
            raise MessageError(str(error)) from None
        rows, fields = len(axes), len(labels)
        self._lay_out([(','.join(axes), rows, rows * fields), (','.join(labels), fields, fields)],
                      rows * fields)
        self._shared = [labels.index(name) for name in SHARED if name in labels]

    def encode(self, values: Sequence[float]) -> bytes:
        """Return the payload of these numbers, row after row.

        Raises:
            MessageError: Another count, or something that is not a number.
        """
        try:
            return self._pack(self._prefix, *values)
        except (struct.error, OverflowError):
            raise MessageError(f'{list(values)!r}: must be {len(self.axes)} rows of '
                               f'{len(self.labels)} numbers', self.labels) from None

    def decode(self, payload: bytes) -> tuple[float, ...]:
        """Return the numbers of a payload, row after row, shape (n F,).

        Raises:
            MessageError: Other labels, axes or rows, or not such a message at all.
        """
        if (payload.startswith(self._prefix) and len(payload) == self.size) or (
                self.matches(payload)):
            values: tuple[float, ...] = self._unpack_from(payload, self.data_start)
        else:
            values = self._decode_other(payload)
        width, rows = len(self.labels), len(self.axes)
        for place in self._shared:
            if values[place::width].count(values[place]) != rows:
                raise MessageError(f'rows of different {self.labels[place]}: '
                                   f'{list(values[place::width])!r}', self.labels, self.labels,
                                   UNEVEN_ROWS)
        return values

    def _decode_other(self, payload: bytes) -> tuple[float, ...]:
        """Return the numbers of a payload that is not laid out as `encode` does.

        Raises:
            MessageError: Its labels, axes or rows are not these.
        """
        wanted = ', '.join(self.axes)
        try:
            axes, labels, values = decode_axes(payload)
        except MessageError as error:
            raise MessageError(f'{error} (expected axes {wanted})', self.labels,
                               cause=error.cause) from None
        if labels != self.labels:
            found = (printable(', '.join(labels), LONGEST) if labels
                     else f'{len(values)} numbers without names')
            raise MessageError(f'message carries {found}; expected axes {wanted} with '
                               f'{", ".join(self.labels)}', self.labels, labels)
        if axes != self.axes:
            cause = (ANOTHER_NUMBER if len(axes) != len(self.axes)
                     else ANOTHER_ORDER if set(axes) == set(self.axes) else OTHER_AXES)
            found = printable(', '.join(axes), LONGEST) or 'one, without a name'
            raise MessageError(f'{cause}: {found}; expected {wanted}', self.labels, labels, cause)
        return values

    def decode_many(self, payloads: Sequence[bytes]) -> NDArray[np.float64] | None:
        """Return the numbers of many payloads, shape (N, n F).

        Returns:
            None where some payload is not laid out as `encode` does, or has rows of different
            samples: decode them one by one.
        """
        values = super().decode_many(payloads)
        if values is None:
            return None
        width = len(self.labels)
        if any((values[:, place::width] != values[:, place, None]).any()
               for place in self._shared):
            return None
        return values


def codec_for(labels: tuple[str, ...], axes: Sequence[str] = ()) -> ArrayCodec:
    """Return the codec of a topic; with fewer than two axes that of one dimension."""
    return AxesCodec(labels, tuple(axes)) if len(axes) > 1 else ArrayCodec(labels)


def decode_axes(payload: bytes) -> tuple[tuple[str, ...], tuple[str, ...], tuple[float, ...]]:
    """Return (axes, labels, numbers) of a std_msgs/Float64MultiArray of one or two dimensions.

    Of one dimension, axes are (). Labels are () where the layout does not name the numbers, as of
    `decode_array`.

    Raises:
        MessageError: Not such a message, cut off; of two dimensions, axes named twice or names
            that are none, or not as many numbers as rows and fields (`MessageError.cause`).
    """
    if len(payload) > LARGEST_ARRAY:
        raise MessageError(f'an array message of {len(payload)} bytes, at most {LARGEST_ARRAY} '
                           'are read')
    body = Body(payload)
    dimensions = [(body.text(), body.number(), body.number())
                  for _ in range(dimension_count(body))]
    offset = body.number()
    values = body.doubles(body.number())
    body.finish()
    if not 1 <= len(dimensions) <= 2 or offset:
        return (), (), values
    label, fields, stride = dimensions[-1]
    labels = tuple(label.split(',')) if len(label) <= MAX_LABELS * MAX_LABEL else ()
    if not 0 < len(labels) == fields <= MAX_LABELS or not all(
            0 < len(name) <= MAX_LABEL for name in labels):
        return (), (), values
    if len(dimensions) == 1:
        return ((), labels, values) if fields == len(values) else ((), (), values)
    names, rows, whole = dimensions[0]
    axes = tuple(names.split(',')) if len(names) <= MAX_LABELS else ()
    if len(set(axes)) < len(axes):
        raise MessageError(f'an axis named twice: {printable(names, LONGEST)}', labels, labels,
                           AXIS_TWICE)
    if len(axes) != rows or len(values) != rows * fields or (whole, stride) != (len(values),
                                                                                fields):
        raise MessageError(f'axes {printable(names, LONGEST)}: {rows} rows announced, '
                           f'{len(values)} numbers of {fields} fields there', labels, labels,
                           ROW_MISSING)
    if not 2 <= len(axes) <= MAX_AXES:
        raise MessageError(f'{len(axes)} axes; of two dimensions a message has 2 to {MAX_AXES}',
                           labels, labels, ANOTHER_NUMBER)
    try:
        check_names(axes)
    except ConfigurationError as error:
        raise MessageError(str(error), labels, labels, OTHER_AXES) from None
    field = uneven(labels, values, rows)
    if field:
        raise MessageError(f'rows of different {field}', labels, labels, UNEVEN_ROWS)
    return axes, labels, values

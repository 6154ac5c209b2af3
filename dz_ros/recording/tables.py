# SPDX-License-Identifier: Apache-2.0
"""Many messages of one topic as one table of numbers.

Messages of one topic have the same labels and so the same size: their bytes, end to end, are an
array whose columns are compared and taken out at once. What does not fit is decoded one by one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dz_ros.core.dataset import Array, Channel, Times
from dz_ros.core.records import SEQ_LIMIT
from dz_ros.errors import MessageError
from dz_ros.recording.axes_cdr import codec_for, decode_axes
from dz_ros.recording.cdr import ArrayCodec

LARGEST_STAMP = 2.0**32
"""No loop runs for 136 years, nor does a clock of ROS [s]."""


class Table:
    """Collects the messages of one topic."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.count = 0
        self._codec: ArrayCodec | None = None
        self._values: list[Array] = []
        self._log: list[Times] = []
        self._publish: list[Times] = []

    def add(self, payloads: Sequence[bytes], log_times: Sequence[int],
            publish_times: Sequence[int]) -> None:
        """Take in some messages.

        Raises:
            MessageError: No records of dz_ros, or labels other than those before.
        """
        if self._codec is None:
            self._codec = self._learn(payloads[0])
        values = self._codec.decode_many(payloads)
        if values is None:
            values = np.array([self._decode(payload, self.count + i)
                               for i, payload in enumerate(payloads)], dtype=float)
        self._values.append(values)
        self._log.append(np.array(log_times, dtype=np.int64))
        self._publish.append(np.array(publish_times, dtype=np.int64))
        self.count += len(payloads)

    def channel(self) -> Channel:
        """Return what was collected, read-only, and forget it; there must have been a message.

        Raises:
            MessageError: A seq is no count, or a stamp no time of a loop.
        """
        assert self._codec is not None
        values = np.concatenate(self._values)
        self._check(values)
        log, publish = np.concatenate(self._log), np.concatenate(self._publish)
        for pieces in (self._values, self._log, self._publish):
            pieces.clear()      # not twice in memory: an hour is 300 MB
        for array in (values, log, publish):
            array.flags.writeable = False
        return Channel(self._codec.labels, values, log, publish, self._codec.axes)

    def _check(self, values: Array) -> None:
        """Check that every message has a count of its own and a place in time."""
        seq, stamp = values[:, 0], values[:, 1]
        for name, column, good, allowed in (
                ('seq', seq, (seq >= 0.0) & (seq < SEQ_LIMIT) & (np.floor(seq) == seq),
                 f'a whole number from 0 to {SEQ_LIMIT - 1}'),
                ('stamp', stamp, np.abs(stamp) < LARGEST_STAMP,
                 f'a number of seconds within ±{LARGEST_STAMP:.0f}')):
            if not good.all():
                place = int(np.argmin(good))
                raise MessageError(f'topic {self.topic}: message {place}: {name} is '
                                   f'{column[place]!s}, must be {allowed}')

    def _learn(self, payload: bytes) -> ArrayCodec:
        """Return the codec for messages like this one."""
        try:
            axes, labels, values = decode_axes(payload)
        except MessageError as error:
            raise MessageError(f'topic {self.topic}: message 0: {error}') from None
        if labels[:2] != ('seq', 'stamp'):
            found = ', '.join(labels) if labels else f'{len(values)} numbers without names'
            raise MessageError(f'topic {self.topic} does not carry records of dz_ros, whose names '
                               f'begin with seq, stamp: it carries {found}', got=labels)
        return codec_for(labels, axes)

    def _decode(self, payload: bytes, index: int) -> tuple[float, ...]:
        """Return the numbers of one message."""
        assert self._codec is not None
        try:
            return self._codec.decode(payload)
        except MessageError as error:
            raise MessageError(f'topic {self.topic}: message {index}: {error}',
                               error.expected, error.got) from None

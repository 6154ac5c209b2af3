# SPDX-License-Identifier: Apache-2.0
"""Many messages of one topic as one table of numbers.

Messages of one topic have the same labels and so the same size: their bytes, end to end, are an
array whose columns are compared and taken out at once. What does not fit is decoded one by one.

A recorder stores what it receives, also what another program publishes on the loop's topics. The
layout of most messages is the topic's own; messages of any other are left out and counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dz_ros.core.dataset import Array, Channel, Times
from dz_ros.core.records import SEQ_LIMIT
from dz_ros.errors import MessageError
from dz_ros.recording.axes_cdr import codec_for, decode_axes
from dz_ros.recording.cdr import ArrayCodec

LARGEST_STAMP = 2.0**32
"""No loop runs for 136 years, nor does a clock of ROS [s]."""
MOST_LAYOUTS = 16
"""Messages of further layouts are left out without being decoded."""


@dataclass
class _Layout:
    """The messages of one layout.

    Attributes:
        codec: Decodes them.
        first: Place of the first one among all messages of the topic.
        values: Their numbers, in pieces of shape (N, F).
        log: When they were received, in pieces of shape (N,) [ns since the epoch].
        publish: When they were published, likewise.
    """

    codec: ArrayCodec
    first: int
    values: list[Array] = field(default_factory=list)
    log: list[Times] = field(default_factory=list)
    publish: list[Times] = field(default_factory=list)

    def add(self, values: Array, log_times: Sequence[int], publish_times: Sequence[int]) -> None:
        self.values.append(values)
        self.log.append(np.array(log_times, dtype=np.int64))
        self.publish.append(np.array(publish_times, dtype=np.int64))

    @property
    def count(self) -> int:
        return sum(map(len, self.values))


class Table:
    """Collects the messages of one topic.

    Attributes:
        topic: Its name.
        count: Number of messages taken in.
        notes: What was left out, as text; complete after `channel`.
    """

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.count = 0
        self.notes: list[str] = []
        self._layouts: dict[tuple[tuple[str, ...], tuple[str, ...]], _Layout] = {}
        self._newest: _Layout | None = None
        self._refused = 0
        self._reason: MessageError | None = None

    def add(self, payloads: Sequence[bytes], log_times: Sequence[int],
            publish_times: Sequence[int]) -> None:
        """Take in some messages."""
        values = None if self._newest is None else self._newest.codec.decode_many(payloads)
        if self._newest is not None and values is not None:
            self._newest.add(values, log_times, publish_times)
        else:
            for i, payload in enumerate(payloads):
                self._add_one(payload, self.count + i, log_times[i], publish_times[i])
        self.count += len(payloads)

    def _add_one(self, payload: bytes, place: int, log_time: int, publish_time: int) -> None:
        """Take in one message, of whatever layout."""
        try:
            layout, values = self._decode(payload, place)
        except MessageError as error:
            self._refused += 1
            self._reason = self._reason or error
            return
        self._newest = layout
        layout.add(np.array([values]), [log_time], [publish_time])

    def _decode(self, payload: bytes, place: int) -> tuple[_Layout, tuple[float, ...]]:
        """Return the layout and the numbers of a message.

        Raises:
            MessageError: No record of dz_ros, or one layout too many.
        """
        try:
            if self._newest is not None:
                return self._newest, self._newest.codec.decode(payload)
        except MessageError:
            pass        # of another layout, or none
        try:
            axes, labels, values = decode_axes(payload)
        except MessageError as error:
            raise MessageError(f'topic {self.topic}: message {place}: {error}') from None
        if labels[:2] != ('seq', 'stamp'):
            found = ', '.join(labels) if labels else f'{len(values)} numbers without names'
            raise MessageError(f'topic {self.topic} does not carry records of dz_ros, whose names '
                               f'begin with seq, stamp: it carries {found}', got=labels)
        layout = self._layouts.get((axes, labels))
        if layout is None:
            if len(self._layouts) >= MOST_LAYOUTS:
                raise MessageError(f'topic {self.topic}: message {place}: more than '
                                   f'{MOST_LAYOUTS} layouts')
            layout = self._layouts[axes, labels] = _Layout(codec_for(labels, axes), place)
        return layout, values

    def channel(self) -> Channel:
        """Return the messages of the topic's layout, read-only, and forget all.

        The layout is that of most messages, of equally many the first.

        Raises:
            MessageError: No message is a record of dz_ros, has a count as its seq and a time of
                a loop as its stamp.
        """
        if not self._layouts:
            assert self._reason is not None     # there was a message
            raise self._reason
        chosen = max(self._layouts.values(), key=lambda layout: layout.count)
        if self._refused:
            self.notes.append(f'{_messages(self._refused)} left out: {self._reason}')
        for layout in self._layouts.values():
            if layout is not chosen:
                self.notes.append(
                    f'topic {self.topic}: {_messages(layout.count)} of another layout left out, '
                    f'the first is message {layout.first}: {_difference(layout, chosen)}')
        codec = chosen.codec
        values, log, publish = (np.concatenate(chosen.values), np.concatenate(chosen.log),
                                np.concatenate(chosen.publish))
        del chosen
        self._layouts.clear()       # not twice in memory: an hour is 300 MB
        self._newest = None
        good = self._check(values)
        if not good.all():
            values, log, publish = values[good], log[good], publish[good]
        for array in (values, log, publish):
            array.flags.writeable = False
        return Channel(codec.labels, values, log, publish, codec.axes)

    def _check(self, values: Array) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return which messages have a count of their own and a place in time, shape (N,)."""
        seq, stamp = values[:, 0], values[:, 1]
        usable = np.ones(len(values), dtype=bool)
        for name, column, good, allowed in (
                ('seq', seq, (seq >= 0.0) & (seq < SEQ_LIMIT) & (np.floor(seq) == seq),
                 f'a whole number from 0 to {SEQ_LIMIT - 1}'),
                ('stamp', stamp, np.abs(stamp) < LARGEST_STAMP,
                 f'a number of seconds within ±{LARGEST_STAMP:.0f}')):
            if not good.all():
                place = int(np.argmin(good))
                reason = (f'topic {self.topic}: message {place}: {name} is {column[place]!s}, '
                          f'must be {allowed}')
                usable &= good
                if not usable.any():
                    raise MessageError(reason)
                self.notes.append(f'{_messages(int(np.count_nonzero(~good)))} left out: '
                                  f'{reason}')
        return usable


def _messages(count: int) -> str:
    return f'{count} message' if count == 1 else f'{count} messages'


def _difference(layout: _Layout, chosen: _Layout) -> str:
    """Return in what two layouts differ, as text of limited length."""
    try:
        chosen.codec.decode(layout.codec.encode(layout.values[0][0].tolist()))
    except MessageError as error:
        return str(error)
    raise AssertionError('two layouts of one codec')

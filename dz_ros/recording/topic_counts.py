# SPDX-License-Identifier: Apache-2.0
"""Counts of one topic: messages, bytes, and their seq (`dz_ros.runs.sequence`)."""

from __future__ import annotations

import struct

from dz_ros.errors import MessageError
from dz_ros.recording.axes_cdr import codec_for, decode_axes
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.summary import TopicSummary
from dz_ros.runs.sequence import SequenceCounter

_first_double = struct.Struct('<d').unpack_from


class TopicCounter:
    """Counts the messages of one topic; reads their seq where the topic's labels begin with it.

    Attributes:
        axes: Names of the axes in its messages; empty: one, without a name.
    """

    def __init__(self, type_name: str, counts_seq: bool) -> None:
        """Start at nothing.

        Args:
            type_name: Message type.
            counts_seq: Whether the messages are arrays, which may carry a seq.
        """
        self.type_name = type_name
        self.messages = self.bytes = 0
        self._sequence = SequenceCounter()
        self._counts_seq = counts_seq
        self._codec: ArrayCodec | None = None
        self.axes: tuple[str, ...] = ()

    def add(self, payload: bytes) -> None:
        """Count one message."""
        self.messages += 1
        self.bytes += len(payload)
        if self._counts_seq:
            codec = self._codec
            if codec is not None and codec.matches(payload):
                self._sequence.add(_first_double(payload, codec.data_start)[0])
            else:
                self._add_unknown(payload)

    def _add_unknown(self, payload: bytes) -> None:
        """Count a message of another layout than the one before."""
        try:
            axes, labels, values = decode_axes(payload)
            if labels[:1] == ('seq',):
                self.axes = axes
                self._codec = codec_for(labels, axes)
                self._sequence.add(values[0])
        except MessageError:      # a foreign message has no seq
            pass

    def summary(self) -> TopicSummary:
        """Return the counts so far."""
        found = self._sequence.count()
        return TopicSummary(self.type_name, self.messages, self.bytes, found.missing,
                            found.repeated, found.reordered, found.restarts)

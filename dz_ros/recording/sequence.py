"""What arrived of a topic: messages, and holes, repeats and restarts in their seq.

A publisher counts its messages, seq = 0, 1, 2, …; what a recording lacks shows as a hole. A number
that comes late into its hole is out of order and not missing; one seen before is a duplicate;
0 after others is a publisher that started again.
"""

from __future__ import annotations

import struct

from dz_ros.errors import MessageError
from dz_ros.recording.cdr import ArrayCodec, decode_array
from dz_ros.recording.summary import TopicSummary

_REMEMBERED = 10_000
"""Holes kept in mind for late messages; older ones stay missing."""

_first_double = struct.Struct('<d').unpack_from


class SequenceCounter:
    """Watches the seq of one topic, one message at a time."""

    def __init__(self) -> None:
        self.missing = self.duplicates = self.reordered = self.restarts = 0
        self._expected: int | None = None
        self._holes: set[int] = set()

    def add(self, seq: float) -> None:
        """Count one message; a seq that is not a whole number is left out."""
        if seq == self._expected:
            self._expected += 1
        elif seq.is_integer():
            self._irregular(int(seq))

    def _irregular(self, seq: int) -> None:
        """Count a message that is not the next one."""
        expected = self._expected
        if expected is None:
            self._expected = seq + 1
        elif seq > expected:
            self.missing += seq - expected
            room = _REMEMBERED - len(self._holes)
            self._holes.update(range(max(expected, seq - room), seq))
            self._expected = seq + 1
        elif seq in self._holes:
            self._holes.discard(seq)
            self.missing -= 1
            self.reordered += 1
        elif seq == 0 and expected > 1:
            self.restarts += 1
            self._expected = 1
            self._holes.clear()
        else:
            self.duplicates += 1


class TopicCounter:
    """Counts the messages of one topic; reads their seq where the topic's labels begin with it."""

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
            labels, values = decode_array(payload)
            if labels[:1] == ('seq',):
                self._codec = ArrayCodec(labels)
                self._sequence.add(values[0])
        except MessageError:      # a foreign message has no seq
            pass

    def summary(self) -> TopicSummary:
        """Return the counts so far."""
        counts = self._sequence
        return TopicSummary(self.type_name, self.messages, self.bytes, counts.missing,
                            counts.duplicates, counts.reordered, counts.restarts)

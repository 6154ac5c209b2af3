# SPDX-License-Identifier: Apache-2.0
"""Numbers of messages and bytes of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class TopicSummary:
    """What a run holds of one topic.

    Attributes:
        type_name: Message type.
        messages: Number of messages.
        bytes: Sum of their sizes, before compression.
        missing: seq between the first and the last that no message carries.
        duplicates: Messages whose seq came before.
        reordered: Messages out of order.
        restarts: Number of restarts of the publisher.
    """

    type_name: str
    messages: int = 0
    bytes: int = 0
    missing: int = 0
    duplicates: int = 0
    reordered: int = 0
    restarts: int = 0


@dataclass(frozen=True)
class Summary:
    """What was written.

    Attributes:
        directory: The run.
        topics: Topic name → what it holds.
        bytes: Size of the MCAP file.
        start_ns: Log time of the first message [ns since the epoch]; None = no message.
        duration: From the first to the last message [s].
        complete: Whether the run was closed properly.
        lost: Messages that were given but could not be written.
        notes: What a recovery had to leave out, as text.
    """

    directory: Path
    topics: Mapping[str, TopicSummary]
    bytes: int
    start_ns: int | None
    duration: float
    complete: bool = True
    lost: int = 0
    notes: tuple[str, ...] = ()

    @property
    def messages(self) -> int:
        """Number of messages in all topics."""
        return sum(topic.messages for topic in self.topics.values())

    @property
    def missing(self) -> int:
        """Number of messages missing by their seq, in all topics."""
        return sum(topic.missing for topic in self.topics.values())

# SPDX-License-Identifier: Apache-2.0
"""Messages and topics as every kind of storage gives them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from dz_ros.recording.channels import CHANNELS


class Message(NamedTuple):
    """One message: topic, payload as received, log and publish time [ns since the epoch].

    The topic is its key among the topics of the run: the name, or, where that is another topic's,
    name and type (`add_topic`).
    """

    topic: str
    payload: bytes
    log_time: int
    publish_time: int


@dataclass(frozen=True)
class Topic:
    """One topic of a run.

    Attributes:
        name: Absolute topic name.
        type_name: Message type.
        encoding: Encoding of its messages, ``cdr``.
        definition: Text of the message definition; of a binary one, every byte that is no UTF-8
            as a surrogate (PEP 383).
        definition_encoding: How that is written, ``ros2msg``.
        qos: Offered QoS profiles, rosbag2's YAML text; empty if unknown.
        type_hash: RIHS01 hash; empty if unknown.
    """

    name: str
    type_name: str
    encoding: str = 'cdr'
    definition: str = ''
    definition_encoding: str = 'ros2msg'
    qos: str = ''
    type_hash: str = ''

    def is_channel(self, name: str | None = None) -> bool:
        """Return whether it is the channel of a loop called so; None = by the end of its name."""
        channel = CHANNELS.get(self.name.rpartition('/')[2] if name is None else name)
        return (channel is not None and self.type_name == channel.type.name
                and self.encoding == 'cdr')


def add_topic(topics: dict[str, Topic], topic: Topic) -> str:
    """Add a topic to those of a run and return its key.

    One name may be declared with several types or encodings. The name alone then means a loop's
    channel, whatever else was declared before it; without one, what was declared first.
    """
    if topic.is_channel() or topic.name.rpartition('/')[2] not in CHANNELS:
        known = topics.setdefault(topic.name, topic)
        if (known.type_name, known.encoding) == (topic.type_name, topic.encoding):
            return topic.name
    encoding = '' if topic.encoding == 'cdr' else f', {topic.encoding or "no encoding"}'
    key = f'{topic.name} ({topic.type_name or "no type"}{encoding})'
    topics.setdefault(key, topic)
    return key

# SPDX-License-Identifier: Apache-2.0
"""Schemas, channels and metadata records of an MCAP file."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from dz_ros.recording.messages import add_topic, Topic

KINDS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)
"""Records that are taken in here."""
MOST_TEXT = 2**26
"""Bytes of definitions and metadata kept of one file."""


class Definitions:
    """What one file has defined so far; an id is defined once.

    Attributes:
        topics: Key → topic (`dz_ros.recording.messages.add_topic`).
        channels: Id of a channel → key of its topic.
        metadata: (name, record) of the metadata records.
    """

    def __init__(self, topics: dict[str, Topic]) -> None:
        self.topics = topics
        self.channels: dict[int, str] = {}
        self.metadata: list[tuple[str, Mapping[str, str]]] = []
        self._schemas: dict[int, Schema] = {}
        self._defined: dict[int, Channel] = {}
        self._room = MOST_TEXT

    def take(self, opcode: int, body: bytes) -> None:
        """Take in a schema, channel or metadata record.

        Raises:
            ValueError: An id is defined again as something else, or there is too much of it.
            McapError, struct.error: No such record.
        """
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            if schema.id not in self._schemas:
                self._keep(body)
            if self._schemas.setdefault(schema.id, schema) != schema:
                raise ValueError(f'schema {schema.id} is defined twice, and not alike')
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(stream)
            self._keep(body)
            self.metadata.append((metadata.name, metadata.metadata))
        elif opcode == Opcode.CHANNEL:
            self._channel(Channel.read(stream), body)

    def _channel(self, channel: Channel, body: bytes) -> None:
        """Take in a channel."""
        if self._defined.setdefault(channel.id, channel) != channel:
            raise ValueError(f'channel {channel.id} is defined twice, and not alike')
        if channel.id in self.channels:
            return
        self._keep(body)
        kind = self._schemas.get(channel.schema_id) or Schema(0, b'', '', '')
        self.channels[channel.id] = add_topic(self.topics, Topic(
            channel.topic, kind.name, channel.message_encoding,
            kind.data.decode(errors='surrogateescape'), kind.encoding,
            channel.metadata.get('offered_qos_profiles', ''),
            channel.metadata.get('topic_type_hash', '')))

    def _keep(self, body: bytes) -> None:
        """Count text that is kept."""
        self._room -= len(body)
        if self._room < 0:
            raise ValueError(f'more than {MOST_TEXT} bytes of definitions and metadata')

# SPDX-License-Identifier: Apache-2.0
"""Channels of a run, their message types and their quality of service, defined once.

A channel is the encoding of a record (`dz_ros.core.records`) on a topic and in a file. Type
names, definitions and hashes are those ROS 2 Jazzy gives the two message types; they are kept
here so that a run can be written where no ROS is installed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class MessageType:
    """A ROS message type.

    Attributes:
        name: Full name, ``package/msg/Type``.
        definition: Its .msg text followed by those it uses.
        type_hash: RIHS01 hash [REP 2011].
        encoding: How the definition is written, MCAP's name for it.
    """

    name: str
    definition: str
    type_hash: str
    encoding: str = 'ros2msg'


@dataclass(frozen=True)
class Qos:
    """Quality of service that a topic's publisher offers.

    Attributes:
        depth: Messages kept for a slow reliable reader.
        durability: ``volatile``, or ``transient_local``: late readers get the last `depth`.
        reliability: ``reliable`` or ``best_effort``.
        history: ``keep_last`` or ``keep_all``.
    """

    depth: int = 1000
    durability: str = 'volatile'
    reliability: str = 'reliable'
    history: str = 'keep_last'

    def to_dict(self) -> dict[str, Any]:
        """Return the profile as rosbag2 writes it into metadata.yaml (no deadline, no lease)."""
        infinite = {'sec': 9223372036, 'nsec': 854775807}
        return {'history': self.history, 'depth': self.depth, 'reliability': self.reliability,
                'durability': self.durability, 'deadline': dict(infinite),
                'lifespan': dict(infinite), 'liveliness': 'automatic',
                'liveliness_lease_duration': dict(infinite),
                'avoid_ros_namespace_conventions': False}


@dataclass(frozen=True)
class RecordChannel:
    """One channel of a run.

    Attributes:
        name: Topic name without namespace, and key of `RunData.channels`.
        type: Its message type.
        qos: What its publisher offers.
        description: What it carries, from which node to which.
    """

    name: str
    type: MessageType
    qos: Qos
    description: str


_RULE = '=' * 80

ARRAY = MessageType(
    'std_msgs/msg/Float64MultiArray',
    f'std_msgs/MultiArrayLayout layout\nfloat64[] data\n{_RULE}\n'
    f'MSG: std_msgs/MultiArrayLayout\nstd_msgs/MultiArrayDimension[] dim\nuint32 data_offset\n'
    f'{_RULE}\nMSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride\n',
    'RIHS01_1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f')

TEXT = MessageType(
    'std_msgs/msg/String', 'string data\n',
    'RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18')

TYPES: Mapping[str, MessageType] = {item.name: item for item in (ARRAY, TEXT)}
"""Message types a run may hold, by name."""

CHANNELS: Mapping[str, RecordChannel] = {item.name: item for item in (
    RecordChannel('reference', ARRAY, Qos(), 'desired motion, trajectory → controller'),
    RecordChannel('state', ARRAY, Qos(), 'measured state, plant or driver → controller'),
    RecordChannel('command', ARRAY, Qos(), 'command, controller → plant or driver'),
    RecordChannel('terms', ARRAY, Qos(), 'every term of the law, controller → any subscriber'),
    RecordChannel('truth', ARRAY, Qos(), 'known of a simulated plant alone, to any subscriber'),
    RecordChannel('events', TEXT, Qos(depth=200, durability='transient_local'),
                  'what happened, as JSON text, every node → any subscriber'),
)}
"""The channels of a run by name."""

EVENTS = 'events'
"""Name of the only channel that carries text."""

# SPDX-License-Identifier: Apache-2.0
"""The loop's topics as ROS sees them; names, types and what is offered: recording/channels.py.

Publishers offer RELIABLE with a history of 1000 samples (5 s at 200 Hz), so that a subscriber can
have every sample. The loop's own subscriptions take the newest sample only (BEST_EFFORT, depth 1):
an old state or command is worth nothing once a newer one is there. A recorder takes everything.
`events` is kept for late joiners (TRANSIENT_LOCAL).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray, String

from dz_ros.recording.channels import CHANNELS, TEXT

NEWEST = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1,
                    reliability=ReliabilityPolicy.BEST_EFFORT,
                    durability=DurabilityPolicy.VOLATILE)
"""QoS requested by the loop's own subscriptions."""

TYPES: Mapping[str, Any] = {
    name: String if channel.type is TEXT else Float64MultiArray
    for name, channel in CHANNELS.items()} | {'pace': Float64MultiArray}
"""Topic → message class."""


LOCKSTEP = QoSProfile(history=HistoryPolicy.KEEP_ALL, depth=0,
                      reliability=ReliabilityPolicy.RELIABLE,
                      durability=DurabilityPolicy.VOLATILE)
"""QoS of both sides in lockstep: nothing is lost, slow readers slow the loop."""


def offered(topic: str, lockstep: bool = False) -> QoSProfile:
    """Return the QoS that the publisher of a topic offers."""
    if lockstep:
        return LOCKSTEP
    qos = CHANNELS[topic].qos
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=qos.depth,
                      reliability=ReliabilityPolicy[qos.reliability.upper()],
                      durability=DurabilityPolicy[qos.durability.upper()])


def everything(topic: str, lockstep: bool = False) -> QoSProfile:
    """Return the QoS a recorder requests: the same, with room for twice as many."""
    if lockstep and topic != 'events':
        return LOCKSTEP
    qos = offered(topic)
    qos.depth *= 2
    return qos


_LISTENERS = {'reference': ('controller_node', 'recorder_node'),
              'state': ('controller_node', 'trajectory_node', 'recorder_node'),
              'command': ('plant_node', 'recorder_node'),
              'terms': ('recorder_node',),
              'truth': ('recorder_node',)}
PACE = ('seq', 'stamp')
"""Labels of `pace`, by which the trajectory knows in lockstep how far the loop is."""
_IN_LOCKSTEP = {'state': ('controller_node', 'recorder_node'), 'pace': ('trajectory_node',)}


def listeners(topic: str, lockstep: bool = False) -> tuple[str, ...]:
    """Return the nodes a publisher waits for before the first sample, if they are peers."""
    found = _IN_LOCKSTEP.get(topic) if lockstep else None
    return found or _LISTENERS.get(topic, ())


PUBLISHED_BY = {'state': 'plant_node', 'command': 'controller_node',
                'reference': 'trajectory_node'}
"""Topic → the place in the loop of the node that publishes it, whatever its name."""
STANDS_FOR = {'actuator_node': 'plant_node'}
"""Node → the one whose place it takes in `listeners` and in `loop.peers`."""

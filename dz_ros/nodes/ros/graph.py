# SPDX-License-Identifier: Apache-2.0
"""Queries of the ROS graph, by the names that a loop's topics have after remapping.

rclpy remaps a name where it makes an entity and in `get_publishers_info_by_topic` and its like,
but not in `count_publishers`. A name must be remapped exactly once: two rules may form a chain. So
a resolved name goes to the functions that do not remap, the name of the loop to those that do.

A node is known by its name or, where it was renamed, by the topic that only a node in its place
publishes.
"""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.node import Node

from dz_ros.nodes.ros.topics import PUBLISHED_BY, STANDS_FOR

PLACES = (*PUBLISHED_BY.values(), 'recorder_node')
"""Names by which `loop.peers` means a place in the loop, whatever the node in it is called."""


def publisher_count(node: Node, topic: str) -> int:
    """Return the number of publishers of a topic of the loop."""
    return int(node.count_publishers(node.resolve_topic_name(topic)))


def publishers(node: Node, topic: str) -> list[str]:
    """Return the fully qualified names of the nodes that publish a topic of the loop."""
    return sorted({f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                   for info in node.get_publishers_info_by_topic(topic)})


def subscribers(node: Node, topic: str) -> set[str]:
    """Return the names of the nodes that subscribe a topic of the loop, without namespace."""
    return {info.node_name for info in node.get_subscriptions_info_by_topic(topic)}


def places(node: Node) -> dict[str, str]:
    """Return the name of a node → its place, for nodes of another name."""
    found = dict(STANDS_FOR)
    for topic, place in PUBLISHED_BY.items():
        found.update({info.node_name: place for info in node.get_publishers_info_by_topic(topic)
                      if info.node_name not in PLACES})
    return found


def not_subscribing(node: Node, topic: str, names: Sequence[str]) -> list[str]:
    """Return which nodes in these places do not subscribe a topic of the loop yet.

    A place `recorder_node` may hold several nodes, by their own names.
    """
    known = places(node)
    there = {known.get(name, name) for name in subscribers(node, topic)} | subscribers(node, topic)
    return [name for name in names if name not in there]

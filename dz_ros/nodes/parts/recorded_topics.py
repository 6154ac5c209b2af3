# SPDX-License-Identifier: Apache-2.0
"""Topics of a recording as ROS sees them: their message classes, and what was offered on them."""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from dz_ros.recording.bag_metadata import read_qos

INTERFACES = Path('share/ament_index/resource_index/rosidl_interfaces')
"""Where a prefix of ROS lists the packages with message types."""
DEFAULT_DEPTH = 1000
"""History offered where a recording has none."""


def message_class(type_name: str) -> Any:
    """Return the class of ``package/msg/Type``; None where that package is not installed.

    The name comes from a recording, so nothing is imported but what the ament index knows to be a
    package of interfaces.
    """
    package, _, name = type_name.replace('/msg/', '/').partition('/')
    if not package.isidentifier() or not _is_interface_package(package):
        return None
    try:
        found = getattr(importlib.import_module(f'{package}.msg'), name, None)
    except ImportError:
        return None
    return found if hasattr(found, 'get_fields_and_field_types') else None


def _is_interface_package(package: str) -> bool:
    """Return whether a module lies in a prefix whose ament index lists it among the interfaces."""
    try:
        spec = importlib.util.find_spec(package)    # of a name without dots it imports nothing
    except (ImportError, ValueError):
        return False
    if spec is None or not spec.origin:
        return False
    return any((prefix / INTERFACES / package).is_file() for prefix in Path(spec.origin).parents)


def offered_as_recorded(text: str) -> QoSProfile:
    """Return what to offer on a topic, from the profiles of its publishers as rosbag2 writes them.

    Where publishers differed, the strongest of their offers is made, which suits every
    subscription that suited one of them.
    """
    known = read_qos(text)
    reliabilities = {item['reliability'] for item in known}
    durabilities = {item['durability'] for item in known}
    histories = {item['history'] for item in known}
    depths = [item['depth'] for item in known
              if item['history'] == 'keep_last' and type(item.get('depth')) is int]
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if 'keep_all' in histories else HistoryPolicy.KEEP_LAST,
        depth=min(max([*depths, 0]), 2 ** 31 - 1) or DEFAULT_DEPTH,
        reliability=(ReliabilityPolicy.BEST_EFFORT if reliabilities == {'best_effort'}
                     else ReliabilityPolicy.RELIABLE),
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if 'transient_local' in durabilities
                    else DurabilityPolicy.VOLATILE))

"""Topics of a recording as ROS sees them: their message classes, and what was offered on them."""

from __future__ import annotations

from collections.abc import Mapping
import importlib
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
import yaml

DEPTH = 1000
"""History offered where a recording does not say."""

# What rosbag2 wrote before metadata version 9: the numbers of rmw/types.h.
_NUMBERS = {'history': {1: 'keep_last', 2: 'keep_all'},
            'reliability': {1: 'reliable', 2: 'best_effort'},
            'durability': {1: 'transient_local', 2: 'volatile'}}


def message_class(type_name: str) -> Any:
    """Return the class of ``package/msg/Type``; None where that package is not installed."""
    package, _, name = type_name.replace('/msg/', '/').partition('/')
    if not package.isidentifier():
        return None
    try:
        return getattr(importlib.import_module(f'{package}.msg'), name, None)
    except ImportError:
        return None


def offered_as_recorded(text: str) -> QoSProfile:
    """Return what to offer on a topic, from the profiles of its publishers as rosbag2 writes them.

    Where publishers differed, the strongest of their offers is made, which suits every
    subscription that suited one of them.
    """
    try:
        profiles = yaml.safe_load(text)
    except yaml.YAMLError:
        profiles = None
    known = [item for item in profiles if isinstance(item, dict)] if isinstance(
        profiles, list) else []
    reliabilities = {_word(item, 'reliability') for item in known}
    durabilities = {_word(item, 'durability') for item in known}
    histories = {_word(item, 'history') for item in known}
    depths = [item['depth'] for item in known
              if _word(item, 'history') == 'keep_last' and type(item.get('depth')) is int]
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if 'keep_all' in histories else HistoryPolicy.KEEP_LAST,
        depth=min(max([*depths, 0]), 2 ** 31 - 1) or DEPTH,
        reliability=(ReliabilityPolicy.BEST_EFFORT if reliabilities == {'best_effort'}
                     else ReliabilityPolicy.RELIABLE),
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if 'transient_local' in durabilities
                    else DurabilityPolicy.VOLATILE))


def _word(profile: Mapping[str, Any], policy: str) -> str:
    """Return a policy in words, '' where it is not told."""
    value = profile.get(policy)
    return _NUMBERS[policy].get(value, '') if type(value) is int else str(value or '')

# SPDX-License-Identifier: Apache-2.0
"""Differences between metadata.yaml and the storage beside it; the storage decides.

What metadata.yaml leaves out, as other versions and tools do, is no difference.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from dz_ros.recording.bag_metadata import read_qos, VERSIONS
from dz_ros.recording.messages import Topic

_POLICIES = ('history', 'depth', 'reliability', 'durability')
_MOST = 20
"""Number of differences that are named."""


def disagreements(bag: Mapping[str, Any], storage: str, packed: bool, topics: Mapping[str, Topic],
                  counts: Mapping[str, int]) -> list[str]:
    """Return where metadata.yaml differs from the storage, as text.

    Args:
        bag: Contents of metadata.yaml.
        storage: What the files are, ``mcap`` or ``sqlite3``.
        packed: Whether messages were compressed one by one.
        topics: Key → topic of the storage.
        counts: Key → messages of it; all of them were read.
    """
    found = list(_all(bag, storage, packed, topics, counts))
    return [*found[:_MOST], *([f'{len(found) - _MOST} more'] if len(found) > _MOST else [])]


def _all(bag: Mapping[str, Any], storage: str, packed: bool, topics: Mapping[str, Topic],
         counts: Mapping[str, int]) -> Iterator[str]:
    total: int = sum(counts.values())
    version, plugin = bag.get('version'), bag.get('storage_identifier')
    if type(version) is not int or version not in VERSIONS:
        yield f'version is {_short(version)}, known are 1 to {VERSIONS[-1]}'
    if plugin != storage:
        yield f'storage_identifier is {_short(plugin)}, the files are {storage}'
    mode = str(bag.get('compression_mode') or 'none')[:20].lower()
    if (mode == 'message') != packed and total:
        yield (f'compression_mode is {_short(bag.get("compression_mode"))}, the messages are '
               f'{"" if packed else "not "}compressed one by one')
    if bag.get('message_count') not in (None, total):
        yield f'message_count is {_short(bag["message_count"])}, stored are {total}'
    yield from _topics(bag.get('topics_with_message_count'), topics, counts)


def _topics(listed: Any, topics: Mapping[str, Topic], counts: Mapping[str, int]) -> Iterator[str]:
    """Yield the differences of topics."""
    if not isinstance(listed, list):
        return
    listed_topics: dict[tuple[str, str], tuple[dict[str, Any], Any]] = {}
    for item in listed:
        stated = item.get('topic_metadata') if isinstance(item, dict) else None
        if not isinstance(stated, dict):
            yield 'topics_with_message_count has an entry without topic_metadata'
            continue
        listed_topics[_short(stated.get('name')), _short(stated.get('type'))] = (
            stated, item.get('message_count'))
    stored = {(_short(topic.name), _short(topic.type_name)): (key, topic)
              for key, topic in topics.items()}
    for (name, kind), (stated, count) in listed_topics.items():
        if (name, kind) not in stored:
            yield f'topic {name} of type {kind} is not stored'
            continue
        key, topic = stored[name, kind]
        if count is not None and count != counts.get(key, 0):
            yield f'{key}: message_count is {_short(count)}, stored are {counts.get(key, 0)}'
        encoding = stated.get('serialization_format')
        if encoding not in (None, topic.encoding):
            yield (f'{key}: serialization_format is {_short(encoding)}, stored is '
                   f'{topic.encoding!r}')
        profiles = stated.get('offered_qos_profiles')
        if isinstance(profiles, str) and profiles.strip() not in ('', '[]') and not read_qos(
                profiles):
            yield f'{key}: offered_qos_profiles cannot be read'
        elif profiles and topic.qos and profiles != topic.qos and (
                _qos(profiles) != _qos(topic.qos)):
            yield f'{key}: offered_qos_profiles are not those stored'
    for (name, kind), (key, _) in stored.items():
        if (name, kind) not in listed_topics and counts.get(key):
            yield f'topic {name} of type {kind} is not named'


def _qos(profiles: Any) -> list[list[str]]:
    """Return profiles in a form that can be compared."""
    return sorted([_short(profile.get(policy)) for policy in _POLICIES]
                  for profile in read_qos(profiles))


def _short(value: Any) -> str:
    """Return a value as it is shown, without what would make a line too long."""
    if isinstance(value, (dict, list, set)):
        return f'a {type(value).__name__}'
    text = value if isinstance(value, str) and value else repr(value)
    return text if len(text) <= 80 else f'{text[:77]}...'

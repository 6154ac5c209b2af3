"""The topics of a run before its messages are read, so that they can be offered in time.

metadata.yaml names them; a file without it is read through once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from dz_ros.recording.bag_metadata import to_yaml
from dz_ros.recording.mcap_file import Topic
from dz_ros.recording.source import Source


def recorded_topics(source: Source) -> dict[str, Topic]:
    """Return topic name → topic; a source that has to be read for it is read to its end.

    Raises:
        RecordingError: It cannot be read.
    """
    if source.topics:
        return dict(source.topics)
    stated = list(_stated(source.bag))
    if stated:
        return {topic.name: topic for topic in stated}
    for _ in source.batches():
        pass
    return dict(source.topics)


def _stated(bag: Mapping[str, Any]) -> Iterator[Topic]:
    """Yield the topics that metadata.yaml names, of any version; none where it cannot be."""
    listed = bag.get('topics_with_message_count')
    for item in listed if isinstance(listed, list) else ():
        stated = item.get('topic_metadata') if isinstance(item, dict) else None
        if not isinstance(stated, dict) or not {'name', 'type'} <= stated.keys():
            return
        qos = stated.get('offered_qos_profiles') or ''
        yield Topic(str(stated['name']), str(stated['type']),
                    str(stated.get('serialization_format', 'cdr')),
                    qos=qos if isinstance(qos, str) else to_yaml(qos))

"""Making a readable run of one that was cut off or damaged, without touching it.

What the file holds before a cut is whole. Damage costs the chunk it is in, half a second; behind a
record whose length is wrong the file's own index shows where to go on, if that is still there.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from dz_ros.errors import RecordingError, RunExistsError
from dz_ros.recording import description
from dz_ros.recording.channels import MessageType
from dz_ros.recording.mcap_file import Topic
from dz_ros.recording.source import open_source
from dz_ros.recording.summary import Summary
from dz_ros.recording.writer import RunWriter

_OURS = (description.INFO, description.CONFIGURATION, description.SUMMARY, 'rosbag2')
"""Metadata records that the new run gets by other ways."""


def recover(source: Path, destination: Path) -> Summary:
    """Copy what can be read of a run into a new one; ``notes`` of the result say what could not.

    Args:
        source: Run directory or .mcap file; not changed.
        destination: The new run; must not exist.

    Raises:
        RunNotFoundError: No source.
        RunExistsError: The destination exists.
        RecordingError: Not one message can be read, or the new run cannot be written.
    """
    destination = Path(destination)
    if destination.exists():
        raise RunExistsError(f'{destination} exists already and a run is never overwritten: '
                             'choose another name or move it away')
    survey = open_source(source, skip_damage=True)
    messages = sum(len(batch) for batch in survey.batches())
    if not messages:
        why = '; '.join([*survey.damage, *filter(None, [survey.cut])]) or 'it is empty'
        raise RecordingError(f'{source}: not one message can be read: {why}')
    info = {**survey.info(), 'recovered_from': Path(source).absolute().name}
    configuration = survey.configuration()
    notes = (*survey.damage, *filter(None, [survey.cut]))
    if notes:
        info['recovered'] = '; '.join(notes)
    with RunWriter(destination, info, configuration) as writer:
        for name, record in survey.metadata:
            if name not in _OURS:
                with suppress(ValueError):
                    writer.add_metadata(name, description.unsealed(record)
                                        if name.startswith(description.PREFIX) else record)
        again = open_source(source, skip_damage=True)
        known: set[str] = set()
        for batch in again.batches():
            for message in batch:
                if message.topic not in known:
                    known.add(message.topic)
                    _register(again.topics[message.topic], writer)
                writer.write(*message)
        return replace(writer.close(), notes=notes)


def _register(topic: Topic, writer: RunWriter) -> None:
    """Register a topic as it was.

    Raises:
        RecordingError: Its messages are no CDR.
    """
    if topic.encoding != 'cdr':
        raise RecordingError(f'topic {topic.name} is encoded as {topic.encoding}: no ROS 2 run')
    writer.add_topic(topic.name, topic.type_name, _qos(topic), message_type=MessageType(
        topic.type_name, topic.definition, topic.type_hash, topic.definition_encoding))


def _qos(topic: Topic) -> list[Any] | None:
    """Return the profiles stored with a topic; None where they cannot be read."""
    try:
        profiles = yaml.safe_load(topic.qos)
    except yaml.YAMLError:
        return None
    return profiles if isinstance(profiles, list) else None

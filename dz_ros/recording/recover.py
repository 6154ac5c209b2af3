# SPDX-License-Identifier: Apache-2.0
"""Making a readable run of one that was cut off or damaged, without touching it.

What the file holds before a cut is whole. Damage costs the chunk it is in, half a second; behind a
record whose length is wrong the file's own index shows where to go on, if that is still there.
Foreign topics, metadata and attachments are copied as they are. What a ROS 2 bag cannot hold
beside the rest (other encodings than CDR, a second type on one name) is left out and named.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from dz_ros.errors import RecordingError, RunExistsError
from dz_ros.recording import run_description as description
from dz_ros.recording.bag_metadata import read_qos
from dz_ros.recording.channels import MessageType
from dz_ros.recording.messages import Topic
from dz_ros.recording.run_source import open_source, Source
from dz_ros.recording.summary import Summary
from dz_ros.recording.writer import RunWriter

_OURS = (description.INFO, description.CONFIGURATION, description.SUMMARY, 'rosbag2')
"""Metadata records that the new run gets by other ways."""


def recover(source: Path, destination: Path) -> Summary:
    """Copy what can be read of a run into a new one; ``notes`` of the result name the rest.

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
    counts: Counter[str] = Counter()
    for batch in survey.batches():
        counts.update(message.topic for message in batch)
    if not counts:
        why = '; '.join([*survey.damage, *filter(None, [survey.cut])]) or 'it is empty'
        raise RecordingError(f'{source}: not one message can be read: {why}')
    left_out = _left_out(survey, counts)
    info = {**survey.info(), 'recovered_from': Path(source).absolute().name}
    configuration = survey.configuration()
    kept = [(name, record) for name, text in survey.metadata if name not in _OURS
            if (record := _unsealed(survey, name, text)) is not None]
    notes = (*survey.damage, *filter(None, [survey.cut]), *left_out.values(), *survey.notes)
    if survey.damage or survey.cut or left_out:
        info['recovered'] = '; '.join(notes)
    with RunWriter(destination, info, configuration) as writer:
        for name, record in kept:
            writer.add_metadata(name, record)
        for attachment in survey.attachments:
            writer.add_attachment(attachment)
        again = open_source(source, skip_damage=True)
        known: set[str] = set()
        for batch in again.batches():
            for message in batch:
                if message.topic in left_out:
                    continue
                if message.topic not in known:
                    known.add(message.topic)
                    _register(again.topics[message.topic], writer)
                writer.write(again.topics[message.topic].name, *message[1:])
        return replace(writer.close(), notes=notes)


def _left_out(survey: Source, counts: Mapping[str, int]) -> dict[str, str]:
    """Return key → why its messages are not copied, as text."""
    found = {}
    for key, topic in survey.topics.items():
        why = ''
        if topic.encoding != 'cdr':
            why = f'encoded as {topic.encoding or "nothing that is named"}, no ROS 2 run'
        elif not topic.name.startswith('/') or topic.name.endswith('/'):
            why = 'its name is none of ROS'
        elif key != topic.name and (topic.name in survey.topics or any(
                other.name == topic.name for name, other in survey.topics.items()
                if name not in found and name < key)):
            why = 'its name is that of a topic of another type'
        if why and counts.get(key):
            found[key] = f'{key} is left out, {counts[key]} messages: {why}'
    if all(key in found for key in counts):
        raise RecordingError(f'{survey.path}: {"; ".join(found.values())}')
    return found


def _unsealed(survey: Source, name: str, record: Mapping[str, str]) -> Mapping[str, str] | None:
    """Return a metadata record as it is stored again; None, and noted, where it is damaged."""
    if not name.startswith(description.PREFIX):
        return record
    try:
        return description.unsealed(record)
    except ValueError as error:
        survey.damage.append(f'{name}: {error}')
        return None


def _register(topic: Topic, writer: RunWriter) -> None:
    """Register a topic as it was."""
    writer.add_topic(topic.name, topic.type_name, read_qos(topic.qos) or None,
                     message_type=MessageType(topic.type_name, topic.definition, topic.type_hash,
                                              topic.definition_encoding))

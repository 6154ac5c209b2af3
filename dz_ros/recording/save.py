# SPDX-License-Identifier: Apache-2.0
"""Writing a run that is in memory, such as a simulated one, as the recorder would have."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
import heapq
from pathlib import Path

from dz_ros.core.axes_keys import section_of
from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.events import ConfigurationEvent
from dz_ros.errors import RecordingError
from dz_ros.recording.axes_cdr import codec_for
from dz_ros.recording.cdr import encode_string
from dz_ros.recording.channels import ARRAY, CHANNELS, EVENTS, TEXT
from dz_ros.recording.run_description import configuration_info, default_info
from dz_ros.recording.summary import Summary
from dz_ros.recording.writer import RunWriter
from dz_ros.version import version

_Item = tuple[int, int, str, bytes, int]
SIMULATION = '/simulation'
"""Name under which a simulated run states its configuration; no node has it."""


def save_run(data: RunData, directory: Path) -> Summary:
    """Write a run, its messages by log time; at the same time reference, state, command, ….

    Args:
        data: The run. What `default_info` knows and `data.info` lacks is added.
        directory: Where it goes; must not exist.

    Raises:
        RunExistsError: The directory exists.
        RecordingError: A channel that no run has, or it cannot be written.
    """
    unknown = [name for name in data.channels if name not in CHANNELS or name == EVENTS]
    if unknown:
        raise RecordingError(f'{directory}: no run has a channel {unknown[0]}')
    info = {**default_info(), **configuration_info(data.configuration), **data.info}
    root = '/' + info.get('namespace', '').strip('/')
    topics = {name: f'{root.rstrip("/")}/{name}' for name in CHANNELS}
    order = {name: place for place, name in enumerate(CHANNELS)}
    streams = [_rows(order[name], topics[name], channel)
               for name, channel in data.channels.items()]
    streams.append((time, order[EVENTS], topics[EVENTS], encode_string(text), time)
                   for time, _, text in data.events)
    with RunWriter(directory, info, data.configuration) as writer:
        for name in data.channels:
            writer.add_topic(topics[name], ARRAY.name)
        if data.events:
            writer.add_topic(topics[EVENTS], TEXT.name)
        for time, _, topic, payload, publish_time in heapq.merge(
                *streams, key=lambda item: item[:2]):
            writer.write(topic, payload, time, publish_time)
        return writer.close()


def state_configuration(data: RunData, memory: Sequence[float]) -> RunData:
    """Return a simulated run with the event by which the nodes of a loop state theirs.

    A tool that converts a recording keeps its topics and may drop the metadata; with the event,
    what is left can still be audited.

    Args:
        data: The run, with its configuration.
        memory: The law's memory before the first command; of several axes one after the other.
    """
    sections = sorted({section_of(key) for key in data.configuration})
    text = ConfigurationEvent(SIMULATION, dict(data.configuration), owns=tuple(sections),
                              memory=tuple(memory), version=version()).to_json()
    begin = min(int(channel.log_time[0]) for channel in data.channels.values())
    return replace(data, events=((begin, SIMULATION, text), *data.events))


def _rows(place: int, topic: str, channel: Channel) -> Iterator[_Item]:
    """Yield the messages of a channel in its order."""
    codec = codec_for(channel.labels, channel.axes)
    for values, log_time, publish_time in zip(channel.values.tolist(), channel.log_time.tolist(),
                                              channel.publish_time.tolist(), strict=True):
        yield log_time, place, topic, codec.encode(values), publish_time

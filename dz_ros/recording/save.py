"""Writing a run that is in memory, such as a simulated one, as the recorder would have."""

from __future__ import annotations

from collections.abc import Iterator
import heapq
from pathlib import Path

from dz_ros.core.dataset import Channel, RunData
from dz_ros.errors import RecordingError
from dz_ros.recording.cdr import ArrayCodec, encode_string
from dz_ros.recording.channels import ARRAY, CHANNELS, EVENTS, TEXT
from dz_ros.recording.description import configuration_info, default_info
from dz_ros.recording.summary import Summary
from dz_ros.recording.writer import RunWriter

_Item = tuple[int, int, str, bytes, int]


def save_run(data: RunData, directory: Path) -> Summary:
    """Write a run, its messages by log time; at the same time reference, state, command, ….

    Args:
        data: The run. What `default_info` knows and `data.info` does not say is added.
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


def _rows(place: int, topic: str, channel: Channel) -> Iterator[_Item]:
    """Yield the messages of a channel in its order."""
    codec = ArrayCodec(channel.labels)
    for values, log_time, publish_time in zip(channel.values.tolist(), channel.log_time.tolist(),
                                              channel.publish_time.tolist(), strict=True):
        yield log_time, place, topic, codec.encode(values), publish_time

# SPDX-License-Identifier: Apache-2.0
"""Reading a run, of ours or of rosbag2, whole or cut off, into arrays; and its description.

A topic is one of the run's channels by the last part of its name and its type: ``/arm/state`` is
the state of the namespace ``/arm``. What was recorded without metadata of ours (``ros2 bag
record``) still has its configuration if the events are in it: every node states its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dz_ros.core.dataset import RunData
from dz_ros.core.events import EventError, parse
from dz_ros.errors import MessageError, RecordingError
from dz_ros.recording.cdr import decode_string
from dz_ros.recording.channels import ARRAY, CHANNELS, EVENTS
from dz_ros.recording.messages import Message
from dz_ros.recording.run_description import configuration_info, renamed_topics
from dz_ros.recording.run_source import open_source, Source
from dz_ros.recording.summary import TopicSummary
from dz_ros.recording.tables import Table
from dz_ros.recording.topic_counts import TopicCounter
from dz_ros.runs.history import RunHistory

Event = tuple[int, str, str]

MOST_EVENT_BYTES = 2**28
"""Events are all kept in memory; a loop has some hundred."""
_EVENT_BYTES = 250
"""What one costs besides its text."""


@dataclass(frozen=True)
class RunInfo:
    """What a run holds, without its numbers.

    Attributes:
        path: The run.
        storage: ``mcap`` or ``sqlite3``.
        files: Names of its files.
        size: Their bytes.
        topics: Topic name → messages, bytes, holes in seq.
        start_ns: Log time of the first message [ns since the epoch]; None = no message.
        duration: From the first to the last message [s].
        info: mode, plant, law, host, seed, versions, …, as far as they are recorded.
        cut: Where it was cut off; empty for a whole run.
        notes: Where metadata.yaml differs from the files, and other remarks.
        axes: Topic name → names of the axes in its messages, of topics of several.
    """

    path: Path
    storage: str
    files: tuple[str, ...]
    size: int
    topics: Mapping[str, TopicSummary]
    start_ns: int | None
    duration: float
    info: Mapping[str, str]
    cut: str = ''
    notes: tuple[str, ...] = ()
    axes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def complete(self) -> bool:
        """Whether the run was closed properly."""
        return not self.cut

    @property
    def messages(self) -> int:
        """Number of messages in all topics."""
        return sum(topic.messages for topic in self.topics.values())


def read_run(path: Path, namespace: str | None = None) -> RunData:
    """Return a run as arrays.

    ``info['cut']`` names the place where a run was cut off; everything before the cut is read.

    Args:
        path: Run directory, rosbag2 directory, .mcap or .db3 file.
        namespace: Whose topics to read where the run holds several loops; None = the only one.

    Raises:
        RunNotFoundError: Nothing there.
        DamagedRunError: A checksum or record is wrong.
        RecordingError: Not a run of dz_ros, or several loops are in it.
    """
    source = open_source(path)
    plain = _PlainNames(source)
    wanted = None if namespace is None else '/' + namespace.strip('/')
    tables: dict[str, Table] = {}
    events: dict[str, list[Event]] = {}
    room = MOST_EVENT_BYTES
    for batch in source.batches():
        for name, messages in _by_topic(batch).items():
            place, channel = plain[name]
            if not source.topics[name].is_channel(channel) or wanted not in (None, place):
                continue
            if channel == EVENTS:
                room = _take_events(source, messages, room)
                events.setdefault(place, []).extend(_event(item) for item in messages)
                continue
            _, payloads, log_times, publish_times = zip(*messages, strict=True)
            tables.setdefault(name, Table(name)).add(payloads, log_times, publish_times)
    chosen = _choose(source, wanted, {plain[name][0] for name in tables} or set(events))
    found = events.get(chosen, [])
    configuration = source.configuration() or _stated(found)
    info = {**configuration_info(configuration), **source.info()}
    if source.cut:
        info['cut'] = source.cut
    chosen_tables = {plain[name][1]: table for name, table in tables.items()
                     if plain[name][0] == chosen}
    try:
        channels = {name: chosen_tables[name].channel() for name in CHANNELS
                    if name in chosen_tables}
    except MessageError as error:
        raise RecordingError(f'{path}: {error}') from None
    notes = [*source.notes, *(note for table in chosen_tables.values() for note in table.notes)]
    if notes:
        info['notes'] = '; '.join(notes)
    return RunData(channels, configuration, info, tuple(found))


def run_info(path: Path) -> RunInfo:
    """Return what a run holds; any rosbag2 bag will do.

    Raises:
        RunNotFoundError: Nothing there.
        DamagedRunError: A checksum or record is wrong.
        RecordingError: Not a recording.
    """
    source = open_source(path)
    plain = _PlainNames(source)
    counters: dict[str, TopicCounter] = {}
    first: int | None = None
    last = 0
    texts: list[Event] = []
    room = MOST_EVENT_BYTES
    for batch in source.batches():
        for name, messages in _by_topic(batch).items():
            topic = source.topics[name]
            counter = counters.get(name)
            if counter is None:
                counter = counters[name] = TopicCounter(topic.type_name,
                                                        topic.type_name == ARRAY.name)
            for message in messages:
                counter.add(message.payload)
            if plain[name][1] == EVENTS and topic.is_channel(EVENTS):
                room = _take_events(source, messages, room)
                texts += [_event(message) for message in messages]
        times = [message.log_time for message in batch]
        first = min(times) if first is None else min(first, *times)
        last = max(last, *times)
    info = {**configuration_info(source.configuration() or _stated(texts)), **source.info()}
    topics = {name: counters[name].summary() if name in counters else TopicSummary(
        topic.type_name) for name, topic in source.topics.items()}
    return RunInfo(Path(path), source.storage, tuple(file.name for file in source.files),
                   source.size, topics, first, 0.0 if first is None else (last - first) * 1e-9,
                   info, source.cut, tuple(source.notes),
                   {name: counter.axes for name, counter in counters.items() if counter.axes})


def _by_topic(batch: Iterable[Message]) -> dict[str, list[Message]]:
    """Return the messages of each topic, in order."""
    found: dict[str, list[Message]] = {}
    for message in batch:
        found.setdefault(message.topic, []).append(message)
    return found


def _split(topic: str) -> tuple[str, str]:
    """Return (namespace, channel name) of a topic: ('/arm', 'state'), ('/', 'state')."""
    place, _, name = topic.rpartition('/')
    return place or '/', name


class _PlainNames(dict[str, tuple[str, str]]):
    """Topic → (namespace, channel name); of a remapped one those it had without."""

    def __init__(self, source: Source) -> None:
        super().__init__()
        self._source = source

    def __missing__(self, topic: str) -> tuple[str, str]:
        """Look in the info, which is read with the first messages."""
        self[topic] = _split(renamed_topics(self._source.info()).get(topic, topic))
        return self[topic]


def _choose(source: Source, wanted: str | None, there: set[str]) -> str:
    """Return the namespace to read."""
    if wanted is not None and wanted in there:
        return wanted
    if wanted is None and len(there) == 1:
        return there.pop()
    if there:
        raise RecordingError(f'{source.path} holds several loops: {", ".join(sorted(there))}; '
                             'choose one by its namespace')
    plain = _PlainNames(source)
    known = sorted({plain[name][0] for name, topic in source.topics.items()
                    if topic.is_channel(plain[name][1])})
    if wanted is not None and known:
        raise RecordingError(f'{source.path} holds no messages of {wanted}; it has '
                             f'{", ".join(known)}')
    if known:
        raise RecordingError(f'{source.path} holds no messages'
                             + (f': {source.cut}' if source.cut else ''))
    topics = ', '.join(sorted(source.topics)) or 'none at all'
    raise RecordingError(f'{source.path} is not a run of dz_ros: none of its topics is '
                         f'{", ".join(CHANNELS)}; it has {topics}')


def _event(message: Message) -> Event:
    """Return (log time, node, text) of an event; node is empty where the text names none."""
    try:
        text = decode_string(message.payload)
    except MessageError as error:
        raise RecordingError(f'topic {message.topic}: {error}') from None
    try:
        return message.log_time, parse(text).node, text
    except EventError:
        return message.log_time, '', text


def _take_events(source: Source, messages: Iterable[Message], room: int) -> int:
    """Return the bytes left for events after these."""
    room -= sum(len(message.payload) + _EVENT_BYTES for message in messages)
    if room < 0:
        raise RecordingError(f'{source.path} holds more than {MOST_EVENT_BYTES} bytes of events')
    return room


def _stated(events: Sequence[Event]) -> dict[str, Any]:
    """Return the configuration with which the nodes began, by their own events."""
    return RunHistory.of(RunData({}, events=tuple(events))).began

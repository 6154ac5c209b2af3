"""Reading a run, of ours or of rosbag2, whole or cut off, into arrays; and what it says of itself.

A topic is one of the run's channels by the last part of its name and its type: ``/arm/state`` is
the state of the namespace ``/arm``. What was recorded without metadata of ours (``ros2 bag
record``) still tells its configuration if the events are in it: every node states its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

from dz_ros.core.dataset import RunData
from dz_ros.errors import MessageError, RecordingError
from dz_ros.recording.cdr import decode_string
from dz_ros.recording.channels import ARRAY, CHANNELS, EVENTS
from dz_ros.recording.description import configuration_info
from dz_ros.recording.mcap_file import Message, Topic
from dz_ros.recording.sequence import TopicCounter
from dz_ros.recording.source import open_source, Source
from dz_ros.recording.summary import TopicSummary
from dz_ros.recording.tables import Table

Event = tuple[int, str, str]


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
        info: mode, plant, law, host, seed, versions, …, as far as the run says.
        cut: Where it was cut off; empty for a whole run.
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

    ``info['cut']`` says where a run was cut off; everything before the cut is read.

    Args:
        path: Run directory, rosbag2 directory, .mcap or .db3 file.
        namespace: Whose topics to read where the run holds several loops; None = the only one.

    Raises:
        RunNotFoundError: Nothing there.
        DamagedRunError: A checksum or record is wrong.
        RecordingError: Not a run of dz_ros, or several loops are in it.
    """
    source = open_source(path)
    wanted = None if namespace is None else '/' + namespace.strip('/')
    tables: dict[str, Table] = {}
    events: dict[str, list[Event]] = {}
    try:
        for batch in source.batches():
            for name, messages in _by_topic(batch).items():
                place, channel = _split(name)
                if not _is_channel(source.topics[name]) or wanted not in (None, place):
                    continue
                if channel == EVENTS:
                    events.setdefault(place, []).extend(_event(item) for item in messages)
                    continue
                _, payloads, log_times, publish_times = zip(*messages, strict=True)
                tables.setdefault(name, Table(name)).add(payloads, log_times, publish_times)
    except MessageError as error:
        raise RecordingError(f'{path}: {error}') from None
    chosen = _choose(source, wanted, {_split(name)[0] for name in tables} or set(events))
    found = events.get(chosen, [])
    configuration = source.configuration() or _stated(found)
    info = {**configuration_info(configuration), **source.info()}
    if source.cut:
        info['cut'] = source.cut
    chosen_tables = {_split(name)[1]: table for name, table in tables.items()
                     if _split(name)[0] == chosen}
    return RunData({name: chosen_tables[name].channel() for name in CHANNELS
                    if name in chosen_tables}, configuration, info, tuple(found))


def run_info(path: Path) -> RunInfo:
    """Return what a run holds; any rosbag2 bag will do.

    Raises:
        RunNotFoundError: Nothing there.
        DamagedRunError: A checksum or record is wrong.
        RecordingError: Not a recording.
    """
    source = open_source(path)
    counters: dict[str, TopicCounter] = {}
    first: int | None = None
    last = 0
    texts: list[Event] = []
    for batch in source.batches():
        for name, messages in _by_topic(batch).items():
            topic = source.topics[name]
            counter = counters.get(name)
            if counter is None:
                counter = counters[name] = TopicCounter(topic.type_name,
                                                        topic.type_name == ARRAY.name)
            for message in messages:
                counter.add(message.payload)
            if _split(name)[1] == EVENTS and _is_channel(topic):
                texts += [_event(message) for message in messages]
        times = [message.log_time for message in batch]
        first = min(times) if first is None else min(first, *times)
        last = max(last, *times)
    info = {**configuration_info(source.configuration() or _stated(texts)), **source.info()}
    topics = {name: counters[name].summary() if name in counters else TopicSummary(
        topic.type_name) for name, topic in source.topics.items()}
    return RunInfo(Path(path), source.storage, tuple(file.name for file in source.files),
                   source.size, topics, first, 0.0 if first is None else (last - first) * 1e-9,
                   info, source.cut)


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


def _is_channel(topic: Topic) -> bool:
    """Return whether the topic is one of a run's channels."""
    channel = CHANNELS.get(_split(topic.name)[1])
    return (channel is not None and topic.type_name == channel.type.name
            and topic.encoding == 'cdr')


def _choose(source: Source, wanted: str | None, there: set[str]) -> str:
    """Return the namespace to read.

    Raises:
        RecordingError: There is none, not this one, or more than one.
    """
    if wanted is not None and wanted in there:
        return wanted
    if wanted is None and len(there) == 1:
        return there.pop()
    if there:
        raise RecordingError(f'{source.path} holds several loops: {", ".join(sorted(there))}; '
                             'choose one by its namespace')
    known = sorted({_split(name)[0] for name, topic in source.topics.items()
                    if _is_channel(topic)})
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
    """Return (log time, node, text) of an event; node is empty where the text names none.

    Raises:
        RecordingError: The message is no text.
    """
    try:
        text = decode_string(message.payload)
    except MessageError as error:
        raise RecordingError(f'topic {message.topic}: {error}') from None
    contents = _json(text)
    return message.log_time, str(contents.get('node', '')), text


def _json(text: str) -> dict[str, Any]:
    """Return the object a JSON text holds; {} where it holds none."""
    try:
        contents = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return contents if isinstance(contents, dict) else {}


def _stated(events: Iterable[Event]) -> dict[str, Any]:
    """Return the configuration that the nodes stated, each its own part, the first time."""
    found: dict[str, Any] = {}
    for _, _, text in events:
        event = _json(text)
        configuration = event.get('configuration')
        if event.get('event') == 'configuration' and isinstance(configuration, dict):
            owns = event.get('owns')
            for key, value in configuration.items():
                if not isinstance(owns, list) or key.partition('.')[0] in owns:
                    found.setdefault(key, value)
    return found

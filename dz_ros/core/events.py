# SPDX-License-Identifier: Apache-2.0
"""What happened in a loop: one frozen class for each kind of event, to JSON text and back.

Nodes publish events as JSON text on the topic `events`; recordings keep them. Texts come from the
network and from files, so `parse` is the only way in: it limits size and depth, checks every
field, and raises `EventError` with one of a few causes, by which refused texts can be counted. A
kind this version does not know becomes `OtherEvent`; fields it does not know are kept in `more`,
so that what newer versions publish passes through. Fields that older versions did not publish have
defaults.

    configuration  what a node runs, from which sample on, and the law's memory before it
    mode           a change of mode at one end of the loop, and why
    started        the loop's clock begins
    stopped        an orderly end by deactivation     finished  … by shutdown or at the last sample
    latency        histogram of a hop
    action         what an operator did on the page
    repeat         begin of a repeat of an identification
    unmeasured     samples for which the device had no measurement

Over 300 lines: one class for each kind, with the units and meaning of its fields.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
import json
import math
import re
from typing import Any, ClassVar, TypeVar

from dz_ros.core.records import SEQ_LIMIT
from dz_ros.core.renamed import ACTIONS, current_keys
from dz_ros.errors import MessageError

MAX_BYTES = 1 << 20
"""Longest text of an event; a configuration with 20 000 way-points fits."""
MAX_DEPTH = 8
"""Objects and arrays within each other."""
MAX_NAME = 256
"""Letters of a node's name or a kind's."""

TOO_LONG, NOT_JSON, TOO_DEEP, NOT_UNICODE, NOT_AN_EVENT, WRONG_TYPE = CAUSES = (
    'longer than allowed', 'not JSON', 'nested too deeply', 'not Unicode', 'not an event',
    'a field of a wrong type')
"""Causes of a refusal."""


class EventError(MessageError):
    """A text that is no event.

    Attributes:
        cause: One of `CAUSES`.
    """

    def __init__(self, cause: str, detail: str = '') -> None:
        super().__init__(f'event refused: {cause}{": " if detail else ""}{detail}', cause=cause)


@dataclass(frozen=True)
class Event:
    """Fields of every event.

    Attributes:
        node: Fully qualified name of the node; empty where the text names none.
        more: Fields that this version does not know.
    """

    name: ClassVar[str] = ''

    node: str = ''
    more: Mapping[str, Any] = field(default_factory=dict, kw_only=True)

    def to_json(self) -> str:
        """Return the event as JSON text."""
        return json.dumps(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Return the event as JSON objects have it; fields that are None are left out."""
        found: dict[str, Any] = {'node': self.node, 'event': self.kind}
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name not in ('node', 'more') and value is not None:
                found[item.name] = value
        return {**found, **self.more}

    @property
    def kind(self) -> str:
        """Name of this kind of event."""
        return self.name


@dataclass(frozen=True)
class ConfigurationEvent(Event):
    """What a node runs.

    Attributes:
        configuration: Dotted key → value.
        owns: Sections in which this node's values are the loop's; None = not given.
        seq: First sample it holds for.
        memory: The law's memory before that sample; None = not given, or not a controller's.
        version: Version of dz_ros.
        rmw: ROS middleware.
        set_aside: Keys that belong to another class of their section.
    """

    name = 'configuration'

    configuration: Mapping[str, Any] = field(default_factory=dict)
    owns: tuple[str, ...] | None = None
    seq: int = 0
    memory: tuple[float, ...] | None = None
    version: str = ''
    rmw: str = ''
    set_aside: tuple[str, ...] = ()

    def to_json_with(self, keys: str) -> str:
        """Return the event as JSON text, with more keys of the configuration.

        Args:
            keys: JSON text of an object without its braces, which is made once where it is long.
        """
        found = self.to_dict()
        own = json.dumps(found.pop('configuration'))[1:-1]
        inner = ', '.join(filter(None, (own, keys)))
        return f'{json.dumps(found)[:-1]}, "configuration": {{{inner}}}}}'


@dataclass(frozen=True)
class ModeEvent(Event):
    """A change of mode.

    Attributes:
        mode: The new mode.
        earlier: The mode before it.
        cause: Event of the table of modes.
        reason: Why, as text.
    """

    name = 'mode'

    mode: str = ''
    earlier: str = ''
    cause: str = ''
    reason: str = ''


@dataclass(frozen=True)
class StartedEvent(Event):
    """The loop's clock begins.

    Attributes:
        stamp: Loop time of the first sample [s].
    """

    name = 'started'

    stamp: float = 0.0


@dataclass(frozen=True)
class StoppedEvent(Event):
    """An orderly end by deactivation.

    Attributes:
        ends: Topics on which nothing follows.
        seq: Newest sample; None = not given.
        ignored, ignored_references: Reason → number of messages not taken; None = not given.
    """

    name = 'stopped'

    ends: tuple[str, ...] = ()
    seq: int | None = None
    ignored: Mapping[str, Any] | None = None
    ignored_references: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class FinishedEvent(StoppedEvent):
    """An orderly end by shutdown, or at the last sample."""

    name = 'finished'


@dataclass(frozen=True)
class LatencyEvent(Event):
    """Histogram of the delays of a hop.

    Attributes:
        hop: From where to where.
        count, late, too_late: Number of delays; of those beyond 1 ms; of those beyond T.
        p50, p99, p999, max: Quantiles and largest [s]; None = unknown.
        up_to: Upper edges of the classes that are not empty [s]; None = no edge.
        in_class: Number of delays in each of them.
    """

    name = 'latency'

    hop: str = ''
    count: int = 0
    late: int = 0
    too_late: int = 0
    p50: float | None = None
    p99: float | None = None
    p999: float | None = None
    max: float | None = None
    up_to: tuple[float | None, ...] = ()
    in_class: tuple[int, ...] = ()


@dataclass(frozen=True)
class ActionEvent(Event):
    """What an operator did on the page.

    Attributes:
        action: What.
        by: Address it came from.
        done: Whether it was done.
        message: What came of it.
        seq: Newest sample then.
        target: Node it was for; None = not one node.
        values: Parameters that were set; None = none.
    """

    name = 'action'

    action: str = ''
    by: str = ''
    done: bool = False
    message: str = ''
    seq: int = -1
    target: str | None = None
    values: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class RepeatEvent(Event):
    """Begin of a repeat of an identification.

    Attributes:
        repeat: Its number; −1 = between repeats.
        seq: Its first sample.
    """

    name = 'repeat'

    repeat: int = -1
    seq: int = 0


@dataclass(frozen=True)
class UnmeasuredEvent(Event):
    """Samples for which the device had no measurement, so that they have no state.

    Attributes:
        ranges: First and last seq of each run of them.
        reason: Why the last one had none, as text.
        samples: Number of samples in the ranges.
    """

    name = 'unmeasured'

    ranges: tuple[tuple[int, ...], ...] = ()
    reason: str = ''
    samples: int = 0


@dataclass(frozen=True)
class OtherEvent(Event):
    """An event of a kind that this version does not know; its fields are in `more`.

    Attributes:
        other: Name of the kind.
    """

    other: str = ''

    @property
    def kind(self) -> str:
        """Name of this kind of event."""
        return self.other

    def to_dict(self) -> dict[str, Any]:
        """Return the event as JSON objects have it."""
        return {'node': self.node, 'event': self.other, **self.more}


KINDS: Mapping[str, type[Event]] = {kind.name: kind for kind in (
    ConfigurationEvent, ModeEvent, StartedEvent, StoppedEvent, FinishedEvent, LatencyEvent,
    ActionEvent, RepeatEvent, UnmeasuredEvent)}
"""Name → class of the events of this version."""

Kind = TypeVar('Kind', bound=Event)


def make(name: str, node: str, details: Mapping[str, Any]) -> Event:
    """Return an event of this process; fields its kind does not have are put in `more`."""
    kind = KINDS.get(name)
    if kind is None:
        return OtherEvent(node, name, more=dict(details))
    own = {item.name for item in fields(kind)} - {'node', 'more'}
    return kind(node, **{key: value for key, value in details.items() if key in own},
                more={key: value for key, value in details.items() if key not in own})


def parse(text: str, limit: int = MAX_BYTES) -> Event:
    """Return the event that a text holds.

    Args:
        text: JSON text, of any origin.
        limit: Longest text taken [characters].

    Raises:
        EventError: The text is no event; `EventError.cause` is the reason.
    """
    if len(text) > limit:
        raise EventError(TOO_LONG, f'{len(text)} characters, {limit} at most')
    try:
        found = json.loads(text)
        if not isinstance(found, dict):
            raise EventError(NOT_AN_EVENT, 'a JSON object expected')
        _check_depth(found)
        if _HALF_CHARACTER.search(text):
            # "\ud800" is read as half a character, which nothing can write again.
            json.dumps(found, ensure_ascii=False).encode()
    except RecursionError:
        raise EventError(TOO_DEEP, f'{MAX_DEPTH} levels at most') from None
    except UnicodeError:
        raise EventError(NOT_UNICODE) from None
    except ValueError as error:
        if isinstance(error, EventError):
            raise
        raise EventError(NOT_JSON) from None
    return _typed(found)


def typed(texts: Iterable[tuple[int, str, str]]) -> Iterator[tuple[int, Event]]:
    """Yield (log time [ns], event) of the texts of a run that hold an event.

    Args:
        texts: (log time [ns], node, text), as in `RunData.events`.
    """
    for time, node, text in texts:
        try:
            event = parse(text)
        except EventError:
            continue
        yield time, event if event.node else _named(event, node)


def of_kind(texts: Iterable[tuple[int, str, str]],
            kind: type[Kind]) -> Iterator[tuple[int, Kind]]:
    """Yield (log time [ns], event) of the events of one kind."""
    for time, event in typed(texts):
        if type(event) is kind:
            yield time, event


_HALF_CHARACTER = re.compile(r'\\[uU][dD][89a-fA-F]')


def _named(event: Event, node: str) -> Event:
    """Return the event as of a node."""
    return replace(event, node=node)


def _check_depth(value: Any) -> None:
    """Raise RecursionError where containers are nested deeper than `MAX_DEPTH`."""
    level = [value]
    for _ in range(MAX_DEPTH):
        level = [item for container in level
                 for item in (container.values() if isinstance(container, dict) else container)
                 if isinstance(item, (dict, list))]
        if not level:
            return
    raise RecursionError


def _typed(found: dict[str, Any]) -> Event:
    """Return a JSON object as the event it is."""
    kind, node = found.pop('event', None), found.pop('node', '')
    for key, value in (('event', kind), ('node', node)):
        if not isinstance(value, str) or len(value) > MAX_NAME:
            raise EventError(NOT_AN_EVENT, f'{key} must be a text of at most {MAX_NAME} letters')
    made = KINDS.get(kind)
    if made is None:
        return OtherEvent(node, kind, more=found)
    known = {}
    for item in fields(made):
        if item.name in found and item.name not in ('node', 'more'):
            value = _check(str(item.type), found.pop(item.name))
            if value is _REFUSED:
                raise EventError(WRONG_TYPE, f'{kind}.{item.name} must be {item.type}')
            known[item.name] = value
    if made is ConfigurationEvent and 'configuration' in known:
        known['configuration'] = current_keys(known['configuration'])
    elif made is ActionEvent:
        known['action'] = ACTIONS.get(known.get('action', ''), known.get('action', ''))
        if known.get('values') is not None:
            known['values'] = current_keys(known['values'])
    return made(node, more=found, **known)


_REFUSED = object()


def _check(wanted: str, value: Any) -> Any:
    """Return a JSON value as the type of a field, `_REFUSED` where it is of another one."""
    kind = wanted.removesuffix(' | None')
    if value is None:
        return None if kind != wanted else _REFUSED
    if kind.startswith('tuple['):
        if not isinstance(value, list):
            return _REFUSED
        item_kind = kind[len('tuple['):].removesuffix(', ...]')
        found = tuple(_check(item_kind, item) for item in value)
        return _REFUSED if any(item is _REFUSED for item in found) else found
    if kind == 'float':
        return _number(value)
    if kind == 'int':
        return (value if isinstance(value, int) and not isinstance(value, bool)
                and -1 <= value < SEQ_LIMIT else _REFUSED)
    return value if isinstance(value, _PLAIN[kind]) else _REFUSED


_PLAIN = {'str': str, 'bool': bool, 'Mapping[str, Any]': dict}


def _number(value: Any) -> Any:
    """Return a JSON number as a float, `_REFUSED` for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return _REFUSED
    try:
        return float(value)
    except OverflowError:
        return math.copysign(math.inf, value)

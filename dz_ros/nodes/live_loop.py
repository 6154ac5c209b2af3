"""What the live page shows of a running loop: rows, events, the state of its nodes."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
import json
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from dz_ros.core.configuration import Configuration
from dz_ros.errors import LoopError, MessageError
from dz_ros.live.clock import clock
from dz_ros.live.columns import Layout
from dz_ros.live.derived import Deriver
from dz_ros.live.describe import facts
from dz_ros.live.history import History
from dz_ros.live.joiner import Joiner
from dz_ros.live.source import Source
from dz_ros.live.stated import brief, labels_of, Stated
from dz_ros.nodes import topics
from dz_ros.nodes.taking import Store, Taker
from dz_ros.recording.cdr import ArrayCodec, decode_array, decode_string
from dz_ros.recording.channels import CHANNELS, EVENTS

GONE = 3.0
"""A node not heard of for so long is not there any more [s]."""
KEPT = 300
"""Events kept for viewers that come later."""
DEPTH = 1000
RECORDER = 'recorder_node'
LISTEN = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=DEPTH,
                    reliability=ReliabilityPolicy.BEST_EFFORT,
                    durability=DurabilityPolicy.VOLATILE)
"""What somebody asks for who only looks: nothing is waited for or sent again."""


class LiveLoop(Source):
    """A loop as it runs.

    Args:
        node: The node that listens.
        minutes: What is kept [min].

    Attributes:
        stamp: Loop time of the newest state [s].
        seq: Its seq; −1 = none yet.
        heard: When it came, by the steady clock [s].
        operator: Does what viewers ask.
    """

    def __init__(self, node: Any, minutes: float) -> None:
        self.stamp, self.seq, self.heard = 0.0, -1, float('-inf')
        self.operator: Any = None
        self._node = node
        self._minutes = minutes
        self._namespace = node.get_namespace().rstrip('/')
        self._said = Stated()
        self._stated: deque[tuple[float, Configuration]] = deque(maxlen=100)
        self._labels: dict[str, tuple[str, ...]] = {}
        self._codecs: dict[str, ArrayCodec] = {}
        self._events: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._news: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._nodes: dict[str, dict[str, Any]] = {}
        self._modes: dict[str, dict[str, Any]] = {}
        self._counted: deque[tuple[float, int]] = deque(maxlen=64)
        self._generation = 0
        self._stale = False
        self._now = 0.0
        self._arrange()
        self._taker = Taker(node)
        for name in CHANNELS:
            self._taker.subscribe(topics.TYPES[name], node.resolve_topic_name(name),
                                  topics.everything(name) if name == EVENTS else LISTEN,
                                  self._taking(name))
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 50)

    @property
    def configuration(self) -> Configuration | None:
        """What the loop runs; None = not known."""
        return self._said.configuration

    @property
    def owners(self) -> dict[str, str]:
        """Section → node whose values are the loop's."""
        return self._said.owners

    def _arrange(self) -> None:
        """Begin the table anew."""
        self.layout = Layout(self._labels)
        self._codecs = {topic: ArrayCodec(labels) for topic, labels in self._labels.items()}
        self._joiner = Joiner(self.layout)
        self._deriver = Deriver(self.layout)
        for time_stated, configuration in self._stated:
            self._deriver.state(time_stated, configuration)
        rate = self.configuration.loop.rate if self.configuration is not None else 200.0
        self.history = History(self.layout.width, int(self._minutes * 60.0 * rate),
                               self._generation)
        self._generation += 1
        self._stale = False

    # What comes in.

    def look(self, now: float) -> bool:
        """Take what has come; return whether the table began anew."""
        self._now = now
        self._taker.take_all(0.0)
        if self._stale or self._joiner.restarted:
            self._arrange()
            self.seq, self.stamp = -1, 0.0
            return True
        rows = self._joiner.take(now)
        if rows:
            self.history.append(self._deriver.complete(np.array(rows)))
        if self._joiner.newest > self.seq:
            self.seq, self.stamp, self.heard = self._joiner.newest, self._joiner.stamp, now
        self._counted.append((now, self.history.head))
        return False

    def _taking(self, topic: str) -> Store:
        """Return what takes a topic's messages."""
        if topic == EVENTS:
            return self._on_event

        def take(payload: bytes, source_ns: int, _received_ns: int) -> None:
            codec = self._codecs.get(topic)
            try:
                if codec is None:
                    raise MessageError('not heard before')
                numbers = codec.decode(payload)
            except MessageError:
                self._learn(topic, payload)
                return
            self._joiner.put(topic, numbers, source_ns * 1e-9, self._now)

        return take

    def _learn(self, topic: str, payload: bytes) -> None:
        """Find out what a topic carries that was not expected."""
        try:
            labels, _ = decode_array(payload)
        except MessageError as error:
            self._node.count(f'{topic}: {error}')
            return
        if labels[:2] != ('seq', 'stamp') or len(set(labels)) < len(labels):
            self._node.count(f'{topic}: a message without the names of its numbers')
        elif self._labels.get(topic) != labels:
            self._labels[topic] = labels
            self._stale = True

    def _on_event(self, payload: bytes, source_ns: int, _received_ns: int) -> None:
        try:
            event = json.loads(decode_string(payload))
            name, node = str(event['event']), str(event['node'])
        except (ValueError, TypeError, KeyError, RecursionError):
            self._node.count('an event that cannot be read')
            return
        when = source_ns * 1e-9
        if name == 'configuration' and isinstance(event.get('configuration'), dict):
            event = {**event, 'changed': self._configure(event, when)}
        elif name == 'mode':
            self._modes[node] = {'mode': str(event.get('mode', '')), 'at': when,
                                 'reason': str(event.get('reason', ''))}
        message = {**brief(event), 'kind': 'event', 'time': when, 'event': name, 'node': node,
                   'stamp': self._stamp_of(when)}
        self._events.append(message)
        self._news.append(message)

    def _configure(self, event: Mapping[str, Any], when: float) -> dict[str, Any]:
        """Take over what a node states; return what changed of it."""
        known = self.configuration is not None
        changed = self._said.hear(event)
        if self._said.problem:
            self._node.count(f'a configuration that cannot be used here: {self._said.problem}')
        c = self.configuration
        if c is None or (known and not self._said.fresh):
            return changed
        self._stated.append((when, c))
        self._deriver.state(when, c)
        labels = labels_of(c)
        if any(self._labels.get(topic) != found for topic, found in labels.items()):
            self._labels.update(labels)
            self._stale = True
        self._news.append({'kind': 'facts', **facts(c)})
        return changed

    def _on_diagnostics(self, message: Any) -> None:
        now = time.monotonic()
        for status in message.status:
            place, _, name = status.name.rpartition('/')
            if place == self._namespace:
                self._nodes[name] = {
                    'level': status.level[0], 'message': status.message, 'heard': now,
                    'values': {item.key: item.value for item in status.values}}

    def _stamp_of(self, when: float) -> float:
        """Return the loop time of an instant [s since the epoch], as near as rows tell."""
        rows = self.history.rows(self.history.begin(1), self.history.head)
        if not len(rows):
            return 0.0
        return max(float(rows[-1, 1] + min(when - rows[-1, 2], 1.0)), 0.0)

    # What goes out.

    def hello(self) -> dict[str, Any]:
        """Return columns, configuration, how long rows are kept."""
        return {'mode': 'live', 'namespace': self._namespace or '/', 'minutes': self._minutes,
                'columns': self.layout.describe(self.configuration),
                'signals': list(self.layout.signals), 'rate': 200.0, **facts(self.configuration)}

    def now(self) -> list[dict[str, Any]]:
        """Return the state of the nodes and the events so far, these in one text."""
        return [self.status(time.monotonic()), {'kind': 'events', 'events': list(self._events)}]

    def news(self) -> list[dict[str, Any]]:
        """Return what has happened since the last time."""
        found = list(self._news)
        self._news.clear()
        return found

    def status(self, now: float) -> dict[str, Any]:
        """Return how old the data is, and how each node is."""
        nodes = []
        for name, node in sorted(self._nodes.items()):
            age = now - node['heard']
            mode = self._modes.get(f'{self._namespace}/{name}', {})
            nodes.append({'name': name, 'age': round(age, 1), 'gone': age > GONE,
                          'level': node['level'], 'message': node['message'],
                          'mode': mode.get('mode', ''), 'reason': mode.get('reason', ''),
                          'values': node['values']})
        recorder = self._nodes.get(RECORDER)
        recording = None
        if recorder is not None and now - recorder['heard'] <= GONE:
            recording = {'level': recorder['level'], 'message': recorder['message'],
                         **recorder['values']}
        return {'kind': 'status', 'time': clock(), 'seq': self.seq, 'stamp': self.stamp,
                'age': round(now - self.heard, 3) if self.seq >= 0 else None,
                'rate': self._rate(), 'lost': self._joiner.lost, 'nodes': nodes,
                'recording': recording,
                'estop': self.operator is not None and self.operator.pressed}

    def _rate(self) -> float:
        """Return rows a second over the last two seconds."""
        if len(self._counted) < 2:
            return 0.0
        (begin, first), (end, last) = self._counted[0], self._counted[-1]
        return round(max(last - first, 0) / (end - begin), 1) if end > begin else 0.0

    # What is asked: the operator does it.

    def estop(self, who: str) -> dict[str, Any]:
        """Stop the loop at once."""
        found: dict[str, Any] = self.operator.estop(who)
        return found

    @property
    def stops(self) -> int:
        """E-stops so far, whoever pressed them."""
        return int(self.operator.stops)

    async def act(self, who: str, request: dict[str, Any], stops: int) -> dict[str, Any]:
        """Do what is asked by the loop's own services."""
        found: dict[str, Any] = await self.operator.act(who, request, stops)
        return found

    async def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """Refuse: everything there is has been sent."""
        raise LoopError(f'{request["do"]}: a running loop sends everything by itself')



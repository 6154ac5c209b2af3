# SPDX-License-Identifier: Apache-2.0
"""A running loop as the live page shows it: rows, events, the state of its nodes.

Over 300 lines: one object that all subscriptions of the page feed.
"""

from __future__ import annotations

from collections import deque
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from dz_ros.core.axes import diagnostic_values
from dz_ros.core.configuration import Configuration
from dz_ros.core.events import ConfigurationEvent, ModeEvent
from dz_ros.core.text import LONGEST, printable
from dz_ros.errors import LoopError, MessageError
from dz_ros.live.backlog import Backlog
from dz_ros.live.clock import clock
from dz_ros.live.columns import Layout, usable
from dz_ros.live.derived import Deriver
from dz_ros.live.describe import facts
from dz_ros.live.history import History
from dz_ros.live.joiner import Joiner
from dz_ros.live.node_configurations import brief, labels_of
from dz_ros.live.source import Source
from dz_ros.nodes.parts.live_commissioning import Commissioning
from dz_ros.nodes.ros import topics
from dz_ros.nodes.ros.base import NOT_READABLE
from dz_ros.nodes.ros.polling import Store
from dz_ros.recording.axes_cdr import codec_for, decode_axes
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.channels import CHANNELS, EVENTS
from dz_ros.runs.history import RunHistory

NODE_TIMEOUT = 3.0
"""A node without diagnostics for this long is not there any more [s]."""
KEPT_EVENTS = 300
"""Events kept for viewers that come later."""
MAX_NODES = 64
"""Nodes that are shown."""
MAX_ARRAY_BYTES = 1 << 17
"""Longest message of numbers that is decoded [bytes]."""
MAX_URGENT_EVENT = 1 << 14
"""Longest event, of another kind than `configuration`, that does not wait for its turn [bytes]."""
ARRANGE_PERIOD = 1.0
"""After a topic's names changed, other names are refused for this long [s]."""
STORED = 'messages stored'
"""Value of the diagnostics that only a recorder has, whatever its name."""
WATCH_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1000,
                       reliability=ReliabilityPolicy.BEST_EFFORT,
                       durability=DurabilityPolicy.VOLATILE)
"""QoS requested by a node that only watches: nothing is waited for or sent again."""


class LiveLoop(Source):
    """A loop as it runs.

    Args:
        node: The node that subscribes.
        minutes: What is kept [min].

    Attributes:
        stamp: Loop time of the newest state [s].
        seq: Its seq; −1 = none yet.
        received: When it came, by the steady clock [s].
        operator: Does what viewers ask.
        commissioning: The steps of a commissioning that is shown; None = there is none.
        axes: Names of the axes, of a loop of several.
        axis: The one that is shown, to all viewers; '' = there is one, without a name.
    """

    def __init__(self, node: Any, minutes: float) -> None:
        self.stamp, self.seq, self.received = 0.0, -1, float('-inf')
        self.operator: Any = None
        self.commissioning: Commissioning | None = None
        self.axes: tuple[str, ...] = ()
        self.axis = ''
        self._node = node
        self._minutes = minutes
        self._namespace = node.get_namespace().rstrip('/')
        self._run_history = RunHistory(keep=0)
        self._configurations = Backlog(self._read_event)
        self._stated: deque[tuple[float, Configuration]] = deque(maxlen=100)
        self._labels: dict[str, tuple[str, ...]] = {}
        self._codecs: dict[str, ArrayCodec] = {}
        self._events: deque[dict[str, Any]] = deque(maxlen=KEPT_EVENTS)
        self._news: deque[dict[str, Any]] = deque(maxlen=KEPT_EVENTS)
        self._nodes: dict[str, dict[str, Any]] = {}
        self._modes: dict[str, dict[str, Any]] = {}
        self._counted: deque[tuple[float, int]] = deque(maxlen=64)
        self._generation = 0
        self._stale = False
        self._stated_labels: frozenset[str] = frozenset()
        self._now = self._arrange_from = 0.0
        self._arrange()
        for name in CHANNELS:
            node.polled.subscribe(topics.TYPES[name], name,
                                  topics.everything(name) if name == EVENTS else WATCH_QOS,
                                  self._store(name))
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 50)

    @property
    def configuration(self) -> Configuration | None:
        """What the axis shown runs; None = not known."""
        return self._of_axis(self._run_history.configuration)

    def _of_axis(self, c: Configuration | None) -> Configuration | None:
        """Return the configuration of the axis shown, from that of the machine."""
        return c.axis(self.axis) if c is not None and self.axis in c.axis_names else c

    @property
    def owners(self) -> dict[str, str]:
        """Section → node whose values are the loop's."""
        return self._run_history.owners

    def mode(self, node: str) -> str:
        """Return the mode a node was in last; empty = not known."""
        return str(self._modes.get(node, {}).get('mode', ''))

    def _arrange(self) -> None:
        """Begin the table again."""
        self.layout = Layout(self._labels)
        self._codecs = {topic: codec_for(labels, self.axes)
                        for topic, labels in self._labels.items()}
        self._joiner = Joiner(self.layout)
        self._deriver = Deriver(self.layout)
        for time_stated, configuration in self._stated:
            self._deriver.state(time_stated, self._of_axis(configuration) or configuration)
        rate = self.configuration.loop.rate if self.configuration is not None else 200.0
        self.history = History(self.layout.width, int(min(self._minutes * 60.0 * rate, 1e9)),
                               self._generation)
        self._generation += 1
        self._stale = False
        self._arrange_from = self._now + ARRANGE_PERIOD

    # What comes in.

    def look(self, now: float) -> bool:
        """Take what has come; return whether the table began again."""
        self._now = now
        self._node.polled.poll(0.0)
        self._configurations.work()
        if self._stale or self._joiner.restarted:
            self._arrange()
            self.seq, self.stamp = -1, 0.0
            return True
        rows = self._joiner.take(now)
        if rows:
            self.history.append(self._deriver.complete(np.array(rows)))
        if self._joiner.newest > self.seq:
            self.seq, self.stamp, self.received = self._joiner.newest, self._joiner.stamp, now
        self._counted.append((now, self.history.head))
        return False

    def _store(self, topic: str) -> Store:
        """Return the function that takes a topic's messages."""
        if topic == EVENTS:
            return self._on_event

        def take(payload: bytes, source_ns: int, _received_ns: int) -> None:
            codec = self._codecs.get(topic)
            try:
                if codec is None:
                    raise MessageError('not received before')
                numbers = codec.decode(payload)
            except MessageError:
                self._learn(topic, payload)
                return
            if codec.axes:
                width = len(codec.labels)
                row = codec.axes.index(self.axis) if self.axis in codec.axes else 0
                numbers = numbers[row * width:(row + 1) * width]
            self._joiner.put(topic, numbers, source_ns * 1e-9, self._now)

        return take

    def _learn(self, topic: str, payload: bytes) -> None:
        """Find out what a topic carries that was not expected."""
        if len(payload) > MAX_ARRAY_BYTES:
            self._node.refuse(topic, f'longer than {MAX_ARRAY_BYTES} bytes')
            return
        try:
            axes, labels, _ = decode_axes(payload)
        except MessageError as error:
            self._node.refuse(topic, error.cause or NOT_READABLE, str(error))
            return
        problem = usable(labels)
        if problem:
            self._node.refuse(topic, problem)
        elif self._labels.get(topic) != labels or axes != self.axes:
            if topic in self._stated_labels:
                self._node.refuse(topic, 'other names than those of the configuration stated')
            elif self._now < self._arrange_from:
                self._node.refuse(topic, 'other names again and again')
            else:
                self._labels[topic] = labels
                self._set_axes(axes)
                self._stale = True

    def _on_event(self, payload: bytes, source_ns: int, _received_ns: int) -> None:
        """Read an event, one that may hold a configuration when its turn comes."""
        plain = b'configuration' not in payload and b'\\' not in payload   # escapes may spell it
        if plain and len(payload) <= MAX_URGENT_EVENT:
            self._read_event(payload, source_ns)
        elif self._configurations.put(payload, source_ns):
            self._node.refuse('events', 'configurations come faster than they are read')

    def _read_event(self, payload: bytes, source_ns: int) -> None:
        event = self._node.parse_event(payload)
        if event is None:
            return
        when = source_ns * 1e-9
        changed = None
        if isinstance(event, ConfigurationEvent):
            changed = self._configure(event, when)
        elif isinstance(event, ModeEvent) and (event.node in self._modes
                                               or len(self._modes) < MAX_NODES):
            self._modes[event.node] = {'mode': printable(event.mode, LONGEST), 'at': when,
                                       'reason': printable(event.reason, LONGEST)}
        message = {**brief(event, changed), 'time': when, 'stamp': self._stamp_of(when)}
        self._events.append(message)
        self._news.append(message)

    def _configure(self, event: ConfigurationEvent, when: float) -> dict[str, Any]:
        """Take over a node's configuration; return what changed of it."""
        known = self.configuration is not None
        changed = self._run_history.add(event)
        if self._run_history.problem:
            self._stated_labels = frozenset()
            self._node.count('a configuration that cannot be used here', self._run_history.problem)
        machine = self._run_history.configuration
        if machine is not None and len(machine.axis_names) != 1:
            self._set_axes(machine.axis_names)
        c = self.configuration
        if machine is None or c is None or (known and not self._run_history.changed):
            return changed
        self._stated.append((when, machine))
        self._deriver.state(when, c)
        labels = labels_of(c)
        if any(usable(found) for found in labels.values()):
            self._node.count('a configuration whose law has too many signals to be shown')
            return changed
        self._stated_labels = frozenset(labels)
        if any(self._labels.get(topic) != found for topic, found in labels.items()):
            self._labels.update(labels)
            self._stale = True
        self._news.append({'kind': 'facts', **facts(c)})
        return changed

    def _set_axes(self, axes: tuple[str, ...]) -> None:
        """Take over the axes of the loop; show the one that was, or the first."""
        if axes != self.axes:
            self.axes = axes
            self.axis = self.axis if self.axis in axes else axes[0] if axes else ''
            self._stale = True

    def _choose(self, axis: Any) -> None:
        """Show another axis to all viewers, from now on.

        Raises:
            LoopError: There is no such axis, or one was chosen just now.
        """
        if axis not in self.axes:
            raise LoopError(f'axis {printable(axis, LONGEST)}: must be one of '
                            f'{", ".join(self.axes) or "none, the loop has one axis"}')
        if self._now < self._arrange_from:
            raise LoopError(f'another axis was chosen less than {ARRANGE_PERIOD:g} s ago')
        if axis != self.axis:
            self.axis = axis
            self._stale = True

    def _on_diagnostics(self, message: Any) -> None:
        now, machine = time.monotonic(), self._run_history.configuration
        most = diagnostic_values(1 if machine is None else len(machine.axis_names))
        for status in message.status:
            place, _, name = status.name.rpartition('/')
            known = place == self._namespace or status.name in self.owners.values()
            if known and (name in self._nodes or len(self._nodes) < MAX_NODES):
                self._nodes[name] = {
                    'node': status.name, 'level': status.level[0],
                    'message': printable(status.message, LONGEST), 'received': now, 'values': {
                        printable(item.key, LONGEST): printable(item.value, LONGEST)
                        for item in status.values[:most]}}

    def _stamp_of(self, when: float) -> float:
        """Return the loop time of an instant [s since the epoch], as near as rows show."""
        rows = self.history.rows(self.history.begin(1), self.history.head)
        if not len(rows):
            return 0.0
        return max(float(rows[-1, 1] + min(when - rows[-1, 2], 1.0)), 0.0)

    # What goes out.

    def hello(self) -> dict[str, Any]:
        """Return columns, configuration, how long rows are kept."""
        found = {'mode': 'live', 'namespace': self._namespace or '/', 'minutes': self._minutes,
                 'columns': self.layout.describe(self.configuration),
                 'axes': list(self.axes), 'axis': self.axis, 'rate': 200.0,
                 **facts(self.configuration)}
        if self.commissioning is not None and self.configuration is None:
            found['title'] = self.commissioning.title
        return found

    def now(self) -> list[dict[str, Any]]:
        """Return the state of the nodes and the events so far, these in one text."""
        found = [self.status(time.monotonic()), {'kind': 'events', 'events': list(self._events)}]
        if self.commissioning is not None and self.commissioning.shown:
            found.append(self.commissioning.shown)
        return found

    def news(self) -> list[dict[str, Any]]:
        """Return what has happened since the last time."""
        found = list(self._news)
        self._news.clear()
        if self.commissioning is not None:
            found += self.commissioning.news()
        return found

    def status(self, now: float) -> dict[str, Any]:
        """Return how old the data is, and how each node is."""
        nodes = []
        for name, node in sorted(self._nodes.items()):
            age = now - node['received']
            mode = self._modes.get(node['node'], {})
            nodes.append({'name': name, 'age': round(age, 1), 'gone': age > NODE_TIMEOUT,
                          'level': node['level'], 'message': node['message'],
                          'mode': mode.get('mode', ''), 'reason': mode.get('reason', ''),
                          'values': node['values']})
        recorder = next((node for node in self._nodes.values() if STORED in node['values']), None)
        recording = None
        if recorder is not None and now - recorder['received'] <= NODE_TIMEOUT:
            recording = {'level': recorder['level'], 'message': recorder['message'],
                         **recorder['values']}
        return {'kind': 'status', 'time': clock(), 'seq': self.seq, 'stamp': self.stamp,
                'age': round(now - self.received, 3) if self.seq >= 0 else None,
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

    def estop(self, viewer: str) -> dict[str, Any]:
        """Stop the loop at once."""
        found: dict[str, Any] = self.operator.estop(viewer)
        return found

    @property
    def stops(self) -> int:
        """E-stops so far, of any publisher."""
        return int(self.operator.stops)

    async def act(self, viewer: str, request: dict[str, Any], stops: int) -> dict[str, Any]:
        """Do what is asked by the loop's own services."""
        found: dict[str, Any] = await self.operator.act(viewer, request, stops)
        return found

    async def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """Show another axis; refuse all else: everything there is has been sent."""
        if request['do'] == 'axis':
            self._choose(request.get('axis'))
            return {'message': f'axis {self.axis}'}
        raise LoopError(f'{request["do"]}: a running loop sends everything by itself')

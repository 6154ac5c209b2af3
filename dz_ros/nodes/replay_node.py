# SPDX-License-Identifier: Apache-2.0
"""A recorded run as a node: publishes what was recorded, paced as it was recorded.

Topics keep their names, taken relative to this node's namespace, their types, their bytes and the
quality of service they were offered with. Services control it as they do rosbag2's player
(docs/replay.md). The ROS-free implementation is ``recording/player.py``.
"""

from __future__ import annotations

from pathlib import Path
import time
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.service import Service
from rosgraph_msgs.msg import Clock

from dz_ros.core.counted_log import CountedLog
from dz_ros.core.lateness import LATE_COUNT
from dz_ros.errors import ConfigurationError, LoopError, RecordingError
from dz_ros.nodes.parts.recorded_topics import message_class, offered_as_recorded
from dz_ros.nodes.parts.replay_services import ReplayServices
from dz_ros.nodes.ros.base import deliver, PEER_WAIT_LOG_PERIOD, quickest_executor, SPIN_LIMIT
from dz_ros.nodes.ros.graph import subscribers
from dz_ros.nodes.ros.services import Callback, NOT_UNDERSTOOD, outliving
from dz_ros.recording.channels import EVENTS
from dz_ros.recording.messages import Message, Topic
from dz_ros.recording.player import Batches, Player
from dz_ros.recording.run_source import open_source, Source
from dz_ros.runtime.claim import claim, ClaimedError, domain_topic
from dz_ros.runtime.deadlines import Deadlines

MAX_UNSERVED_MESSAGES = 50
"""Callbacks are served at least once in this number of messages, also where replay is behind."""
READ_AHEAD_SLACK_NS = 3_000_000
"""The run is read further when the next message is due no sooner than this [ns]."""


class ReplayNode(Node):
    """Player of one run.

    Attributes:
        stopping: True once a signal or the service ``~/stop`` asked the node to end.

    Raises:
        ConfigurationError: No run given, or a parameter that cannot be.
        RecordingError: The run cannot be read, or holds nothing to be played.
        LoopError: Another process publishes one of its topics.
    """

    def __init__(self) -> None:
        super().__init__('replay_node')
        self.stopping = False
        self._refused = CountedLog(self.get_logger().warning)
        self._claims: list[Any] = []
        self._executor = quickest_executor()
        self._executor.add_node(self)
        path = self._given('run', '', 'directory of the run, or its .mcap; any rosbag2 bag')
        if not path:
            raise ConfigurationError('run', path, 'must be the directory of a run')
        self._path = Path(path).expanduser()
        wanted = self._given('topics', [''], 'topics to play; none = all')
        awaited = self._given('wait_for', [''], 'topics that must have a subscriber before '
                              'the first message; TOPIC=NODE: that node')
        self._clock_rate = self._given('clock', 0.0, 'rate at which the time of the recording '
                                       'is published on /clock; 0 = never [Hz]')
        if not 0.0 <= self._clock_rate <= 1000.0:
            raise ConfigurationError('clock', self._clock_rate, 'must be 0 to 1000 Hz')
        self._source: Source = open_source(self._path)
        recorded = self._one_type_each(self._source.recorded_topics())
        self._outputs: dict[str, Publisher] = {
            name: publisher for name in self._chosen(recorded, wanted)
            if (publisher := self._offer(recorded[name])) is not None}
        if not self._outputs:
            raise RecordingError(f'{self._path} holds no topic that could be published')
        self._awaited = [(name, node) for item in awaited if item
                         for topic, _, node in [item.partition('=')]
                         for name in self._chosen(self._outputs, [topic])]
        self._player = Player(
            self._batches, topics=self._outputs,
            rate=self._given('rate', 1.0, 'speed over that of the recording; may be changed '
                             'at any time'),
            start=self._given('start', 0.0, 'where to begin, from the first message on [s]'),
            duration=self._given('duration', 0.0, 'how much to play, in recorded time; 0 = to '
                                 'the end [s]'),
            loop=self._given('loop', False, 'begin again at the end'),
            paused=self._given('paused', False, 'begin paused'))
        ReplayServices(self, self._player, self._publish)
        if self._clock_rate:
            self._clock_publisher = self.create_publisher(Clock, '/clock', 10)

    def create_service(self, srv_type: Any, srv_name: str, callback: Callback,
                       **options: Any) -> Service:
        """Offer a service that no request ends."""
        name = f'{srv_name.rpartition("/")[2]}: {NOT_UNDERSTOOD}'
        return super().create_service(srv_type, srv_name, outliving(
            srv_type, callback, lambda why: self._refused.add(name, why)), **options)

    def _given(self, name: str, default: Any, description: str) -> Any:
        """Return a parameter as given at the start; all but `rate` stay as they are."""
        value = self.declare_parameter(name, default, ParameterDescriptor(
            read_only=name != 'rate', dynamic_typing=isinstance(default, float),
            description=description)).value
        if isinstance(default, float):      # 2 is as good as 2.0
            if type(value) not in (int, float):
                raise ConfigurationError(name, value, 'must be a number')
            return float(value)
        return value

    def _one_type_each(self, recorded: dict[str, Topic]) -> dict[str, Topic]:
        """Return the topics without those on the name of another one, of another type; logged."""
        found: dict[str, Topic] = {}
        for key, topic in sorted(recorded.items(), key=lambda item: item[0] != item[1].name):
            if any(other.name == topic.name for other in found.values()):
                self.get_logger().warning(f'{key} is left out: its name is that of a topic of '
                                          'another type')
            else:
                found[key] = topic
        return {key: topic for key, topic in recorded.items() if key in found}

    def _chosen(self, known: Any, names: list[str]) -> list[str]:
        """Return which topics are meant; names may lack their namespace."""
        found = []
        for name in filter(None, names):
            end = f'/{name.strip("/")}'
            matches = [item for item in known if item.partition(' ')[0] == end] or [
                item for item in known if item.partition(' ')[0].endswith(end)]
            if len(matches) != 1:
                raise ConfigurationError('topic', name, f'{self._path} has {", ".join(known)}')
            found += matches
        return found or list(known)

    def _offer(self, topic: Topic) -> Publisher | None:
        """Return the publisher of a recorded topic; None where there is none, which is logged."""
        kind = message_class(topic.type_name) if topic.encoding == 'cdr' else None
        if kind is None:
            self.get_logger().warning(f'{topic.name} is left out: {topic.type_name} is not '
                                      'installed')
            return None
        if topic.name == '/clock' and self._clock_rate:
            return None
        publisher = self.create_publisher(kind, topic.name.lstrip('/'),
                                          offered_as_recorded(topic.qos))
        if topic.name.rpartition('/')[2] != EVENTS:     # which every node publishes
            try:
                self._claims.append(claim(domain_topic(publisher.topic_name)))
            except ClaimedError as error:
                raise LoopError(
                    f'topic {publisher.topic_name} is published by a loop or another replay on '
                    f'this machine ({error.process}): stop that one, or use another '
                    'namespace or ROS_DOMAIN_ID') from None
        return publisher

    def _batches(self, since: int) -> Batches:
        """Return the run's messages, earlier ones left out where that saves reading them."""
        self._source = open_source(self._path)
        return self._source.batches(since)

    def run(self) -> None:
        """Play until the end, or until it is to end.

        Raises:
            RecordingError: The run cannot be read further.
        """
        self._wait_for_listeners()
        player = self._player
        clock = (Deadlines(1.0 / self._clock_rate, time.monotonic_ns()) if self._clock_rate
                 else None)
        if clock is not None:
            self._tick()
        player.begin()
        unserved = 0
        while not (self.stopping or player.finished):
            if clock is not None and clock.remaining() <= 0.0:
                clock.begin()
                self._tick()
            message = player.take()
            if message is not None:
                self._publish(message)
                unserved += 1
                if unserved < MAX_UNSERVED_MESSAGES:
                    continue
            unserved = 0
            due = player.due_ns
            slack = int(SPIN_LIMIT * 1e9) if due is None else due - time.monotonic_ns()
            if player.low and (due is None or slack > READ_AHEAD_SLACK_NS or message is not None):
                player.read_ahead()
                slack = 0
            if clock is not None:
                slack = min(slack, int(clock.remaining() * 1e9))
            self._executor.spin_once(timeout_sec=min(max(slack * 1e-9, 0.0), SPIN_LIMIT))
        late = (f'{player.late} {LATE_COUNT}, the worst by {player.worst_ns * 1e-6:.1f} ms'
                if player.late else f'none {LATE_COUNT}')
        self.get_logger().info(f'{player.played} messages of {self._path}, {late}')
        if self._source.cut:
            self.get_logger().warning(f'{self._path} was {self._source.cut}')

    def close(self) -> None:
        """Let what was published reach its listeners, then release everything."""
        deliver(*self._outputs.values())
        self._executor.remove_node(self)
        self._executor.shutdown()
        self.destroy_node()
        for held in self._claims:
            held.close()

    def _wait_for_listeners(self) -> None:
        """Wait for subscribers of the topics named by the parameter `wait_for`."""
        logged = time.monotonic()
        while not self.stopping:
            missing = [f'{node or "any node"} to subscribe {self._outputs[name].topic_name}'
                       for name, node in self._awaited if not self._subscribed(name, node)]
            if not missing:
                return
            if time.monotonic() - logged > PEER_WAIT_LOG_PERIOD:
                self.get_logger().info(f'waiting for {", ".join(missing)}')
                logged = time.monotonic()
            self._executor.spin_once(timeout_sec=0.01)

    def _subscribed(self, topic: str, node: str) -> bool:
        """Return whether a recorded topic has a subscriber, or this one."""
        if not node:
            return bool(self._outputs[topic].get_subscription_count() > 0)
        return node in subscribers(self, topic.lstrip('/'))

    def _publish(self, message: Message) -> None:
        self._outputs[message.topic].publish(message.payload)

    def _tick(self) -> None:
        """Publish where the player is on /clock."""
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(self._player.time_ns, 1_000_000_000)
        self._clock_publisher.publish(message)

"""What every node of the loop does: publish records, report events, wait for its peers, spin."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
import json
import time
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher

from dz_ros.core.configuration import Configuration
from dz_ros.errors import LoopError, MessageError
from dz_ros.nodes import topics
from dz_ros.nodes.taking import Taker
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.runtime.claim import claim, ClaimedError, domain_topic
from dz_ros.version import version

SPIN_LIMIT = 0.05
"""Longest wait for anything [s]; a signal is noticed within it."""
DELIVERY = 4.0
"""Longest wait for listeners to have what was published [s]; DDS repairs losses every 3."""
PATIENCE = 5.0
"""A node that waits for its peers says so after each of these [s]."""
SERVE = 0.05
"""In lockstep everything but the loop's topics is looked for after each of these [s] …"""
AT_ONCE = 20
"""… and up to so many callbacks are served then."""


class LoopNode(Node):
    """A node of the loop.

    Args:
        name: Default node name.
        executor: Serves its callbacks; default is the one with the least delay, in lockstep one
            that leaves the loop's topics alone.

    Attributes:
        stopping: True once a signal asked the node to end.
        eager: In lockstep, for how long it looks for messages before it sleeps [s].
    """

    eager = 0.0

    def __init__(self, name: str, executor: Any = None) -> None:
        super().__init__(name)
        self.stopping = False
        self.configuration: Configuration
        self._events = self.create_publisher(topics.TYPES['events'], 'events',
                                             topics.offered('events'))
        self._records: dict[str, tuple[Publisher, ArrayCodec]] = {}
        self._claims: list[Any] = []
        self._listened: list[Any] = []
        self._by_hand: Taker | None = None
        self._serve_at = 0.0
        self._counts: dict[str, int] = {}
        self._executor_given = executor

    def offer(self, topic: str, labels: Sequence[str]) -> Callable[[Sequence[float]], None]:
        """Return the function that publishes a record's numbers on a topic of the loop.

        Raises:
            LoopError: Another process on this machine publishes that topic already.
        """
        publisher = self.create_publisher(topics.TYPES[topic], topic,
                                          topics.offered(topic, self.lockstep))
        try:
            self._claims.append(claim(domain_topic(publisher.topic_name)))
        except ClaimedError as error:
            raise LoopError(
                f'topic {publisher.topic_name} is published by another loop on this machine '
                f'(process {error.pid}): stop that one, or use another namespace or ROS_DOMAIN_ID'
            ) from None
        codec = ArrayCodec(tuple(labels))
        self._records[topic] = (publisher, codec)
        encode, publish = codec.encode, publisher.publish
        if not self.lockstep:
            return lambda numbers: publish(encode(numbers))

        def publish_in_turn(numbers: Sequence[float]) -> None:
            """Publish; wait where a reader that keeps everything is behind."""
            payload = encode(numbers)
            while not self.stopping:
                try:
                    publish(payload)
                    return
                except rclpy_implementation.RCLError:
                    self.count(f'a reader of {publisher.topic_name} is behind, the loop waits')

        return publish_in_turn

    def take(self, topic: str, labels: Sequence[str],
             callback: Callable[[tuple[float, ...]], None]) -> None:
        """Call back with the numbers of each message whose labels are these; count the others."""
        decode = ArrayCodec(tuple(labels)).decode

        def received(payload: bytes) -> None:
            try:
                numbers = decode(payload)
            except MessageError as error:
                self.count(f'{topic}: {error}')
                return
            callback(numbers)

        if self.lockstep:
            self._by_hand = self._by_hand or Taker(self)
            self._by_hand.subscribe(topics.TYPES[topic], topic, topics.LOCKSTEP,
                                    lambda payload, *_: received(payload))
        else:
            self._listened.append(self.create_subscription(topics.TYPES[topic], topic, received,
                                                           topics.NEWEST, raw=True))

    def withdraw(self) -> None:
        """Take back every offer and stop listening to the loop's topics."""
        for publisher, _ in self._records.values():
            self.destroy_publisher(publisher)
        for subscription in self._listened:
            self.destroy_subscription(subscription)
        if self._by_hand is not None:
            self._by_hand.close()
            self._by_hand = None
        for held in self._claims:
            held.close()
        self._records.clear()
        self._listened.clear()
        self._claims.clear()

    @property
    def halted(self) -> bool:
        """Whether the present work is to be left."""
        return self.stopping

    @cached_property
    def _executor(self) -> Any:
        """What serves callbacks; in lockstep one that leaves the loop's topics alone."""
        found = self._executor_given
        if found is None:
            found = SingleThreadedExecutor() if self.lockstep else quickest_executor()
        found.add_node(self)
        return found

    @property
    def lockstep(self) -> bool:
        """Whether steps happen when messages have arrived instead of at deadlines."""
        return self.configuration.loop.timing == 'lockstep'

    def count(self, what: str) -> None:
        """Count a fault; log it the first time and then at each power of ten."""
        number = self._counts[what] = self._counts.get(what, 0) + 1
        if str(number).strip('0') == '1':
            self.get_logger().warning(f'{what} ({number} so far)')

    def event(self, name: str, **details: Any) -> None:
        """Publish something that happened, as JSON, for recorders and late joiners."""
        text = json.dumps({'node': self.get_fully_qualified_name(), 'event': name, **details})
        self._events.publish(topics.TYPES['events'](data=text))

    def announce(self, *owns: str, **details: Any) -> None:
        """Publish the configuration this node runs with.

        Args:
            *owns: Sections in which this node's values are the loop's.
            **details: What else the node has to say of its beginning.
        """
        self.event('configuration', version=version(), owns=owns,
                   rmw=rclpy.get_rmw_implementation_identifier(),
                   configuration=self.stated(),
                   set_aside=self.configuration.set_aside, **details)

    def stated(self) -> dict[str, Any]:
        """Return the dotted keys this node can speak for, with their values."""
        return self.configuration.to_flat()

    def missing(self) -> list[str]:
        """Return which peers do not listen yet to what this node publishes, in words."""
        found = []
        for topic, (publisher, _) in self._records.items():
            wanted = self._peers_among(topics.listeners(topic, self.lockstep))
            if publisher.get_subscription_count() < len(wanted):
                found.append(f'{", ".join(wanted)} to listen to {publisher.topic_name} '
                             '(loop.peers says who is waited for)')
            else:
                found += self.deaf(topic, wanted)
        return found

    def deaf(self, topic: str, names: Sequence[str]) -> list[str]:
        """Return which of these nodes, as far as they are peers, do not listen to a topic yet."""
        topic = self.resolve_topic_name(topic)
        there = {_place(info.node_name) for info in self.get_subscriptions_info_by_topic(topic)}
        return [f'{name} to listen to {topic}' for name in self._peers_among(names)
                if name not in there]

    def _peers_among(self, names: Sequence[str]) -> list[str]:
        """Return those of the names that are peers, this node aside."""
        peers = set(map(_place, self.configuration.loop.peers)) - {_place(self.get_name())}
        return [name for name in names if name in peers]

    def wait_for_peers(self, *more: Callable[[], list[str]]) -> bool:
        """Spin until all peers are there; return False if the node is told to end before.

        Args:
            *more: Further functions that say what is missing.
        """
        said = time.monotonic()
        while not self.halted:
            self.spin_until(time.monotonic() + 0.01)
            missing = self.missing() + [item for function in more for item in function()]
            if not missing:
                return True
            if time.monotonic() - said > PATIENCE:
                self.get_logger().info(f'waiting for {", ".join(missing)}')
                said = time.monotonic()
        return False

    def spin_until(self, deadline: float, done: Callable[[], bool] = lambda: False) -> None:
        """Serve callbacks until a time of the steady clock [s], `done` or the end."""
        while not (self.halted or done()):
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                return
            self.spin(remaining)

    def spin(self, limit: float = SPIN_LIMIT) -> None:
        """Serve a callback, or none for a while [s]; in lockstep also all messages of the loop."""
        if self._by_hand is None:
            self._executor.spin_once(timeout_sec=min(limit, SPIN_LIMIT))
            return
        self._by_hand.take_soon(self.eager, min(limit, SERVE))
        now = time.monotonic()
        if now > self._serve_at:
            self._serve_at = now + SERVE
            self._serve_ready()

    def _serve_ready(self) -> None:
        """Serve the callbacks that are ready; a look for nothing costs as much as a step."""
        for _ in range(AT_ONCE):
            try:
                task, *_ = self._executor.wait_for_ready_callbacks(timeout_sec=0.0)
            except TimeoutException:
                return
            task()
            error = task.exception()
            if error is not None:
                raise error

    def spin_out(self) -> None:
        """Serve what has come already, callbacks and messages."""
        for _ in range(20):
            self._executor.spin_once(timeout_sec=0.0)
        if self._by_hand is not None:
            self._by_hand.take_soon(0.0, 0.0)

    def flush(self) -> None:
        """Wait until what was published has reached its reliable listeners."""
        deliver(self._events, *(publisher for publisher, _ in self._records.values()))

    def run(self) -> None:
        """Do the node's work until told to end; serve callbacks unless overridden."""
        while not self.stopping:
            self.spin()

    def close(self) -> None:
        """Let what was published reach its listeners, then release everything."""
        self.flush()
        self._executor.remove_node(self)
        self.destroy_node()
        for held in self._claims:
            held.close()


def _place(name: str) -> str:
    """Return whose place a node of this name takes."""
    return topics.STANDS_FOR.get(name, name)


def deliver(*publishers: Publisher) -> None:
    """Wait until listeners have everything that was published, but not for ever."""
    give_up = time.monotonic() + DELIVERY
    for publisher in publishers:
        left = max(give_up - time.monotonic(), 0.0)
        publisher.wait_for_all_acked(Duration(seconds=left))


def quickest_executor() -> Any:
    """Return the executor with the least delay that this rclpy has (docs/architecture.md)."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()

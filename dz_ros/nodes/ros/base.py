# SPDX-License-Identifier: Apache-2.0
"""What every node of the loop does: publish records, report events, wait for its peers, spin.

Over 300 lines: what a node publishes, receives, counts and waits for shares its publishers,
subscriptions and executor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
import json
import math
import time
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription
from std_msgs.msg import Float64

from dz_ros.core import events
from dz_ros.core.configuration import Configuration, SECTIONS
from dz_ros.core.counted_log import CountedLog
from dz_ros.core.safety.health import Level, Report
from dz_ros.core.safety.message_guards import Verdict, WORDS
from dz_ros.core.trajectories.base import Trajectory
from dz_ros.errors import LoopError, MessageError
from dz_ros.nodes.ros import graph, topics
from dz_ros.nodes.ros.polling import poll_until, PolledSubscriptions, taker
from dz_ros.nodes.ros.services import Callback, NOT_UNDERSTOOD, outliving
from dz_ros.recording.axes_cdr import codec_for
from dz_ros.recording.cdr import decode_string
from dz_ros.runtime.claim import claim, ClaimedError, domain_topic
from dz_ros.runtime.privileges import usable_cores
from dz_ros.version import version

SPIN_LIMIT = 0.05
"""Longest wait for anything [s]; a signal is noticed within it."""
DELIVERY_TIMEOUT = 4.0
"""Longest wait for subscribers to have what was published [s]; DDS repairs losses every 3."""
PEER_WAIT_UNLOGGED, PEER_WAIT_LOG_PERIOD = 2.0, 5.0
"""A node that waits for its peers logs it after the first, then after each of the second [s]."""
LOCKSTEP_SERVICE_PERIOD = 0.05
"""In lockstep the callbacks of all but the loop's topics are served after each of these [s]."""
MAX_CALLBACKS_AT_ONCE = 20
"""Most callbacks served then."""
URGENT_PERIODS = (0.001, 0.005)
"""Shortest and longest time between two calls of `LoopNode.urgent` [s]."""
NOT_READABLE, OTHER_NAMES = 'without names, or not readable', 'names of other numbers'
"""Cause by which messages are counted whose bytes or labels are not the topic's."""
PAYLOAD_FRAME = 16
"""Bytes of a text message besides its text, at most."""
SCHEDULE_SILENT = 5.0
"""A scheduling variable without a message for this long is worth a warning [s]."""


class LoopNode(Node):
    """A node of the loop.

    Args:
        name: Default node name.
        executor: Serves its callbacks; default is the one with the least delay, in lockstep one
            that leaves the loop's topics alone.

    Attributes:
        stopping: True once a signal asked the node to end.
        polled: The subscriptions that the node polls itself.
        unspun: Subscriptions that no executor serves.
        urgent: Called first in `spin`, at the pace of `URGENT_PERIODS`; None = nothing is urgent.
        eager: In lockstep, for how long it polls for messages before it sleeps [s].
    """

    def __init__(self, name: str, executor: Any = None) -> None:
        self.unspun: list[Subscription] = []        # which the base class asks for
        super().__init__(name)
        self.stopping = False
        self.eager = 0.0
        self.urgent: Callable[[], None] | None = None
        self.configuration: Configuration
        self.polled = PolledSubscriptions(self)
        self._events = self.create_publisher(topics.TYPES['events'], 'events',
                                             topics.offered('events'))
        self._record_publishers: dict[str, Publisher] = {}
        self._claims: list[Any] = []
        self._subscribed: list[Subscription] = []
        self._takers: list[Callable[[], bool]] = []
        self._serve_at = self._urgent_at = 0.0
        self._counted = CountedLog(self.get_logger().warning)
        self._refused: set[str] = set()
        self._trajectory_text: tuple[Trajectory, str] | None = None
        self._executor_given = executor
        self._psi = math.nan, -math.inf        # ψ and when it came [s]

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions that an executor serves."""
        return (item for item in super().subscriptions if item not in self.unspun)

    @property
    def lockstep(self) -> bool:
        """Whether steps happen when messages have arrived instead of at deadlines."""
        return self.configuration.loop.timing == 'lockstep'

    @property
    def halted(self) -> bool:
        """Whether the present work is to be left."""
        return self.stopping

    def polls(self, *choices: str) -> bool:
        """Whether `process.poll` is one of these, and there is a core for each end."""
        return (not self.lockstep and self.configuration.process.poll in choices
                and len(usable_cores()) > 1)

    def given(self, name: str, default: Any, description: str) -> Any:
        """Return the value of a parameter that is fixed once the node runs; declare it."""
        return fixed_parameter(self, name, default, description)

    def create_service(self, srv_type: Any, srv_name: str, callback: Callback,
                       **options: Any) -> Service:
        """Offer a service that no request ends, rclpy's own for parameters among them."""
        name = srv_name.rpartition('/')[2]
        return super().create_service(srv_type, srv_name, outliving(
            srv_type, callback, lambda why: self.refuse(name, NOT_UNDERSTOOD, why)), **options)

    # Topics.

    def _axes_of(self, topic: str) -> tuple[str, ...]:
        """Return the axes whose rows a topic carries; `pace` is the machine's."""
        return () if topic == 'pace' else self.configuration.axis_names

    def offer(self, topic: str, labels: Sequence[str]) -> Callable[[Sequence[float]], None]:
        """Return the function that publishes a record's numbers on a topic of the loop.

        Of several axes these are the numbers of all rows, one after the other.

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
                f'({error.process}): stop that one, or use another namespace or ROS_DOMAIN_ID'
            ) from None
        self._record_publishers[topic] = publisher
        encode = codec_for(tuple(labels), self._axes_of(topic)).encode
        # rclpy's own method asks for the kind of each message, longer than handing it on takes.
        publish = getattr(publisher.handle, 'publish_raw', publisher.publish)
        if not self.lockstep:
            return lambda numbers: publish(encode(numbers))

        def publish_in_turn(numbers: Sequence[float]) -> None:
            payload = encode(numbers)
            while not self.stopping:
                try:
                    publish(payload)
                    return
                except rclpy_implementation.RCLError:
                    self.count(f'a reader of {publisher.topic_name} is behind, the loop waits')

        return publish_in_turn

    @property
    def offering(self) -> bool:
        """Whether the node publishes a topic of the loop now."""
        return bool(self._record_publishers)

    def subscribe(self, topic: str, labels: Sequence[str],
                  callback: Callable[[tuple[float, ...]], None]) -> None:
        """Call back with the numbers of each message whose labels are these; count the others."""
        decode = codec_for(tuple(labels), self._axes_of(topic)).decode

        def received(payload: bytes, *_times: int) -> None:
            try:
                numbers = decode(payload)
            except MessageError as error:
                self.refuse(topic, error.cause or (OTHER_NAMES if error.got else NOT_READABLE),
                            str(error))
                return
            callback(numbers)

        if self.lockstep:
            self.polled.subscribe(topics.TYPES[topic], topic, topics.LOCKSTEP, received)
        else:
            found = self.create_subscription(topics.TYPES[topic], topic, received, topics.NEWEST,
                                             raw=True)
            self._subscribed.append(found)
            self._takers.append(taker(found, received))

    def follow_schedule(self, callback: Callable[[float], None]) -> None:
        """Subscribe the topic of the scheduling variable, where the configuration names one."""
        topic = self.configuration.loop.schedule_topic
        if not topic:
            return

        def received(message: Any) -> None:
            psi = float(message.data)
            if math.isfinite(psi):
                self._psi = psi, time.monotonic()
                callback(psi)
            else:
                self.count('loop.schedule_topic: not finite')

        self._subscribed.append(self.create_subscription(Float64, topic, received, topics.NEWEST))

    def report_schedule(self, report: Report) -> None:
        """Add the scheduling variable of the topic to diagnostics; warn where it is silent."""
        topic = self.configuration.loop.schedule_topic
        if not topic:
            return
        psi, at = self._psi
        age = time.monotonic() - at
        report.put('scheduling variable', None if math.isnan(psi) else psi)
        if math.isnan(psi):
            report.summarize(Level.WARN, f'nothing has come on {topic}: loop.schedule_values hold')
        elif age > SCHEDULE_SILENT:
            report.summarize(Level.WARN, f'{topic} has been silent for {age:.0f} s: {psi:g} holds')

    def withdraw(self) -> None:
        """Publish and receive the loop's topics no more."""
        for publisher in self._record_publishers.values():
            self.destroy_publisher(publisher)
        for subscription in self._subscribed:
            self.destroy_subscription(subscription)
        self.polled.close()
        for held in self._claims:
            held.close()
        self._record_publishers.clear()
        self._subscribed.clear()
        self._takers.clear()
        self._claims.clear()

    # What is counted and logged.

    def count(self, what: str, detail: str = '') -> None:
        """Count a fault; log it the first time and then at each power of ten."""
        self._counted.add(what, detail)

    def refuse(self, topic: str, cause: str, detail: str = '') -> None:
        """Count a message that is not its topic's, by one of a few causes; log its detail."""
        what = f'{topic}: {cause}'
        self._refused.add(what)
        self.count(what, detail)

    def ignored(self, counts: Mapping[str, Mapping[str, int]]) -> dict[str, int]:
        """Return `topic: reason` → number of the messages not taken; log those that are new.

        Args:
            counts: Topic → reason → number, as the guards have them; what could not be decoded
                is added. A repetition is no fault: a node that waits for an answer sends again.
        """
        found = {name: self._counted.counts[name] for name in sorted(self._refused)}
        for topic, reasons in counts.items():
            for reason, number in reasons.items():
                found[f'{topic}: {reason}'] = number
                if reason != WORDS[Verdict.REPEATED]:
                    self._counted.set(f'{topic}: {reason}', number)
        return found

    # Events.

    def event(self, name: str, **details: Any) -> None:
        """Publish an event, as JSON, for recorders and late joiners."""
        made = events.make(name, self.get_fully_qualified_name(), details)
        self._events.publish(topics.TYPES['events'](data=made.to_json()))

    def parse_event(self, payload: bytes, limit: int = events.MAX_BYTES) -> events.Event | None:
        """Return the event of a message of at most `limit` characters; None, counted = none."""
        try:
            if len(payload) > 4 * limit + PAYLOAD_FRAME:    # not even to be decoded
                raise events.EventError(events.TOO_LONG)
            return events.parse(decode_string(payload), limit)
        except events.EventError as error:
            self.refuse('events', error.cause, str(error))
        except MessageError as error:
            self.refuse('events', NOT_READABLE, str(error))
        return None

    def announce(self, *owns: str, **details: Any) -> None:
        """Publish the configuration this node runs with.

        Args:
            *owns: Sections in which this node's values are the loop's.
            **details: Fields of the event: the first sample it holds for, the law's memory.
        """
        trajectory = self.configuration.trajectory
        if self._trajectory_text is None or self._trajectory_text[0] is not trajectory:
            # Its way-points may be thousands: written once for a trajectory.
            self._trajectory_text = trajectory, json.dumps(self.stated('trajectory'))[1:-1]
        event = events.ConfigurationEvent(
            self.get_fully_qualified_name(),
            self.stated(*(name for name in SECTIONS if name != 'trajectory')), owns, **details,
            version=version(), rmw=rclpy.get_rmw_implementation_identifier(),
            set_aside=self.configuration.set_aside)
        self._events.publish(topics.TYPES['events'](
            data=event.to_json_with(self._trajectory_text[1])))

    def stated(self, *sections: str) -> dict[str, Any]:
        """Return the dotted keys whose values this node knows, of some sections; none = all."""
        return self.configuration.to_flat(*sections)

    # Peers.

    def missing(self) -> list[str]:
        """Return as text which peers do not subscribe yet to what this node publishes."""
        found = []
        for topic, publisher in self._record_publishers.items():
            wanted = self._peers_among(topics.listeners(topic, self.lockstep))
            if publisher.get_subscription_count() < len(wanted):
                found.append(f'{", ".join(wanted)} to subscribe {publisher.topic_name} '
                             '(loop.peers names the nodes waited for)')
            else:
                found += self.not_subscribing(topic, wanted)
        return found

    def not_subscribing(self, topic: str, names: Sequence[str]) -> list[str]:
        """Return as text which of these peers do not subscribe to a topic yet."""
        missing = graph.not_subscribing(self, topic, self._peers_among(names))
        return [f'{name} to subscribe {self.resolve_topic_name(topic)}' for name in missing]

    def _peers_among(self, names: Sequence[str]) -> list[str]:
        """Return the peers in these places; one by another name by the topic it publishes."""
        known = graph.places(self)
        places = {known.get(name, name): name for name in self.configuration.loop.peers
                  if name != self.get_name()}
        places.pop(known.get(self.get_name(), self.get_name()), None)
        recorders = [name for name in places if name not in graph.PLACES]
        return [name for name in names if name in places] + (
            recorders if 'recorder_node' in names else [])

    def wait_for_peers(self, *more: Callable[[], list[str]]) -> bool:
        """Spin until all peers are there and nothing `more` is missing; False = it is to end."""
        log_at = time.monotonic() + PEER_WAIT_UNLOGGED
        while not self.halted:
            self.spin_until(time.monotonic() + 0.01)
            missing = self.missing() + [item for function in more for item in function()]
            if not missing:
                return True
            if time.monotonic() > log_at:
                self.get_logger().info(f'waiting for {", ".join(missing)}')
                log_at = time.monotonic() + PEER_WAIT_LOG_PERIOD
        return False

    # Spinning.

    @cached_property
    def _executor(self) -> Any:
        found = self._executor_given
        if found is None:
            found = SingleThreadedExecutor() if self.lockstep else quickest_executor()
        found.add_node(self)
        return found

    def spin_until(self, deadline: float, done: Callable[[], bool] = lambda: False) -> None:
        """Serve callbacks until a time of the steady clock [s], `done` or the end."""
        while not (self.halted or done()):
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                return
            self.spin(remaining)

    def poll_until(self, deadline: float, done: Callable[[], bool]) -> None:
        """Take the loop's messages without sleeping, past the executor, and what is urgent.

        To ask the executor whether there is a message costs more than to take it; what it serves
        besides waits until the deadline.
        """
        poll_until(self._takers, deadline, lambda: self.halted or done(), self._serve_urgent)

    def _serve_urgent(self, now: float) -> None:
        """Serve what is urgent, where it is due."""
        if self.urgent is not None and now >= self._urgent_at:
            self._urgent_at = now + URGENT_PERIODS[0]
            self.urgent()

    def spin(self, limit: float = SPIN_LIMIT) -> None:
        """Serve a callback, or none for a while [s]; in lockstep also all messages of the loop."""
        if self.urgent is not None:
            self._serve_urgent(time.monotonic())
            limit = min(limit, URGENT_PERIODS[1])
        if not self.polled:
            self._executor.spin_once(timeout_sec=min(limit, SPIN_LIMIT))
            return
        self.polled.poll_soon(self.eager, min(limit, LOCKSTEP_SERVICE_PERIOD))
        now = time.monotonic()
        if now > self._serve_at:
            self._serve_at = now + LOCKSTEP_SERVICE_PERIOD
            self._serve_ready()

    def _serve_ready(self) -> None:
        """Serve the callbacks that are ready; to ask for one costs as much as a step."""
        for _ in range(MAX_CALLBACKS_AT_ONCE):
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
        if self.urgent is not None:
            self.urgent()
        for _ in range(MAX_CALLBACKS_AT_ONCE):
            self._executor.spin_once(timeout_sec=0.0)
        if self.polled:
            self.polled.poll_soon(0.0, 0.0)

    def flush(self) -> None:
        """Wait until what was published has reached its reliable subscribers."""
        deliver(self._events, *self._record_publishers.values())

    def run(self) -> None:
        """Do the node's work until it is to end; serve callbacks unless overridden."""
        while not self.stopping:
            self.spin()

    def close(self) -> None:
        """Let what was published reach its subscribers, then release everything."""
        self.flush()
        self._executor.remove_node(self)
        # Its entities end only after this; until then others wait for it to acknowledge.
        self._executor.shutdown()
        self.destroy_node()
        for held in self._claims:
            held.close()


def fixed_parameter(node: Node, name: str, default: Any, description: str) -> Any:
    """Return the value of a parameter that is fixed once the node runs; declare it."""
    return node.declare_parameter(name, default, ParameterDescriptor(
        read_only=True, description=description)).value


def deliver(*publishers: Publisher) -> None:
    """Wait until subscribers have everything that was published, up to `DELIVERY_TIMEOUT`."""
    give_up = time.monotonic() + DELIVERY_TIMEOUT
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

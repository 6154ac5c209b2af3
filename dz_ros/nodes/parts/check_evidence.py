# SPDX-License-Identifier: Apache-2.0
"""What the conformance kit receives of a driver's node: states, and what else it may publish.

Of several axes one is watched: its row of every message. In the commands that go out the other
axes have their safe ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from dz_ros.core.axes import split
from dz_ros.core.configuration import Configuration
from dz_ros.core.events import EventError, ModeEvent, parse
from dz_ros.core.records import Command, State, Truth
from dz_ros.errors import MessageError
from dz_ros.nodes.ros import topics
from dz_ros.nodes.ros.base import LoopNode
from dz_ros.nodes.ros.graph import publishers
from dz_ros.recording.axes_cdr import codec_for
from dz_ros.recording.cdr import ArrayCodec

ANY_QOS = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Matches publishers of either reliability."""
EVENTS_QOS = QoSProfile(depth=200, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SAFE_MODES = ('lost', 'fault', 'estop', 'waiting')
"""Modes in which a host of ours holds the safe command."""
DISCOVERY_TIMEOUT = 5.0
"""Longest wait for a subscriber to be found [s]."""
Send = Callable[[Sequence[str], Sequence[float], Sequence[str]], None]
"""Sends a message of these labels, these numbers of the axis watched, and of these axes."""
_V = Command.labels().index('v')
LIMITED_COUNTS = ('held back by a limit', 'saturated by the device [commands]')
"""Values of the diagnostics that count limited commands."""


class _Rows:
    """The row of one axis in messages of all; of a loop of one axis, all numbers."""

    def __init__(self, configuration: Configuration, axis: str) -> None:
        self.axes = configuration.axis_names
        self._place = self.axes.index(axis) if axis else 0
        self._safe = [item.safety.safe_command for item in configuration.each]

    def codec(self, labels: tuple[str, ...]) -> ArrayCodec:
        """Return the codec of the messages of all axes."""
        return codec_for(labels, self.axes)

    def own(self, numbers: Sequence[float]) -> Sequence[float]:
        """Return the axis' own numbers."""
        return split(numbers, len(self._safe))[self._place]

    def joined(self, command: Sequence[float]) -> tuple[float, ...]:
        """Return the numbers of all axes: the command for this one, the safe one for others."""
        first, after = tuple(command[:_V]), tuple(command[_V + 1:])
        return tuple(number for place, safe in enumerate(self._safe) for number in (
            command if place == self._place else (*first, safe, *after)))


class Evidence:
    """Receives and keeps; sends commands.

    Args:
        node: Of the kit.
        axis: The axis watched, of several; '' = the only one.
        answer: Called with seq and stamp of each new state.

    Attributes:
        states: Every state received.
        arrivals: When each arrived, by the steady clock [s].
        commands: seq → stamp of every command sent.
        taken: seq → how long after the state it answers each was sent [s].
        wrong_labels: Labels of states that are not those of the order; '' = none.
        reports: Whether events or truth of the node show what the actuator does.
    """

    def __init__(self, node: LoopNode, axis: str,
                 answer: Callable[[int, float], None]) -> None:
        self.states: list[State] = []
        self.arrivals: list[float] = []
        self.commands: dict[int, float] = {}
        self.taken: dict[int, float] = {}
        self.wrong_labels = ''
        self.reports = False
        self._longest = 0.0
        self._node = node
        self._answer = answer
        configuration = node.configuration
        self._own = configuration.axis(axis) if axis else configuration
        self._rows = _Rows(configuration, axis)
        self._decode = self._rows.codec(State.labels(self._own.plant.order)).decode
        self._truth = self._rows.codec(Truth.labels()).decode
        self._held: list[tuple[float, float]] = []
        self._since = (0, 0, 0.0)
        self._safe_at: int | None = None
        self._held_back: int | None = None
        self.connect()
        for topic, callback, qos in (('state', self._on_state, ANY_QOS),
                                     ('truth', self._on_truth, ANY_QOS)):
            node.create_subscription(Float64MultiArray, topic, callback, qos, raw=True)
        node.create_subscription(String, 'events', self._on_event, EVENTS_QOS)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)

    def connect(self) -> None:
        """Publish commands."""
        self.commands.clear()
        self._send = self._node.offer('command', Command.labels())

    def disconnect(self) -> None:
        """Publish commands no more."""
        self._node.withdraw()

    def begin(self) -> None:
        """Forget all but the newest state."""
        del self.states[:-1]
        del self.arrivals[:-1]

    def note(self, _what: str) -> None:
        """Note the instant from which `safe_after` counts."""
        self._since = (len(self.states), len(self._held),
                       self.states[-1].stamp if self.states else 0.0)
        self._safe_at = None

    def command(self, command: Command) -> None:
        """Send a good command."""
        self.commands[command.seq] = command.stamp
        self.taken[command.seq] = time.monotonic() - self.arrivals[-1]
        self._send(self._rows.joined(command.numbers()))

    @contextmanager
    def stranger(self) -> Iterator[Send]:
        """Return the function that sends any message, on a publisher of its own.

        It has a subscriber, and is gone when the context ends.
        """
        publisher = self._node.create_publisher(
            Float64MultiArray, 'command', topics.offered('command'))
        self._node.spin_until(time.monotonic() + DISCOVERY_TIMEOUT,
                              publisher.get_subscription_count)
        try:
            yield lambda labels, numbers, axes: publisher.publish(codec_for(
                tuple(labels), axes).encode(self._rows.joined(numbers)[:len(numbers) * max(
                    len(axes), 1)]))
        finally:
            self._node.destroy_publisher(publisher)

    def reset(self, limit: float) -> str:
        """Call the node's reset service if it has one; return why it refused within a time [s]."""
        refused, node = '', self._node
        for name in publishers(node, 'state'):
            client = node.create_client(Trigger, f'{name}/reset')
            node.spin_until(time.monotonic() + 1.0, client.service_is_ready)
            if client.service_is_ready():
                future = client.call_async(Trigger.Request())
                node.spin_until(time.monotonic() + limit, future.done)
                answer = future.result() if future.done() else None
                refused = 'reset does not answer' if answer is None else (
                    '' if answer.success else answer.message)
            node.destroy_client(client)
        return refused

    def begin_silence(self) -> None:
        """Note the instant from which `silence` measures."""
        self._longest = 0.0

    def silence(self) -> float:
        """Return the longest time without a state lately, until now [s]."""
        return max(self._longest, time.monotonic() - self.arrivals[-1])

    def safe_after(self, safe: float) -> int | None:
        """Return after how many samples the actuator held the safe command; None = not seen."""
        first, held, stamp = self._since
        for when, v in self._held[held:]:
            if when >= stamp and math.isclose(v, safe, abs_tol=1e-9):
                return sum(stamp < item.stamp <= when for item in self.states[first:])
        return None if self._safe_at is None else self._safe_at - first

    def largest_held(self) -> float | None:
        """Return the largest |v| the actuator held lately; None = not known."""
        return max((abs(v) for _, v in self._held[-100:]), default=None)

    def held_back(self) -> int | None:
        """Return the number of commands the node reports as limited; None = not known."""
        return self._held_back

    def _on_state(self, payload: bytes) -> None:
        try:
            numbers = self._rows.own(self._decode(payload))
        except MessageError as error:
            self.wrong_labels = self.wrong_labels or ','.join(error.got) or str(error)
            return
        try:
            state = State.from_numbers(numbers)
        except (ValueError, OverflowError):     # seq is no number
            self.wrong_labels = self.wrong_labels or f'seq = {numbers[0]}'
            return
        now = time.monotonic()
        if self.arrivals:
            self._longest = max(self._longest, now - self.arrivals[-1])
        self.states.append(state)
        self.arrivals.append(now)
        self._answer(state.seq, state.stamp)

    def _on_truth(self, payload: bytes) -> None:
        """Take w and d of a simulated actuator: with slope m, w − d = m v."""
        try:
            numbers = self._rows.own(self._truth(payload))
        except MessageError:
            return
        self.reports = True
        zone = self._own.dead_zone
        product = numbers[2] - numbers[3]
        self._held.append((numbers[1], product / (zone.m_r if product > 0.0 else zone.m_l)))

    def _on_event(self, message: Any) -> None:
        try:
            event = parse(message.data)
        except EventError:
            return
        mode = event.mode if isinstance(event, ModeEvent) else ''
        if mode:
            self.reports = True
        if mode in SAFE_MODES and self._safe_at is None:
            self._safe_at = len(self.states)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            found = [int(item.value) for item in status.values
                     if item.key in LIMITED_COUNTS and item.value.isdigit()]
            if found and 'controller' not in status.name:
                self._held_back = sum(found)

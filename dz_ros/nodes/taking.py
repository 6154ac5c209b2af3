"""Taking messages by hand: every message that has come, with its times, in one wake-up.

The executor with the least delay cannot hand over a message's source time-stamp in this version
of rclpy (it raises SystemError for callbacks with two arguments), and the others spend far more on
waking up than a recorder has to do per message. So a recorder waits on its subscriptions itself;
so do the loop's nodes in lockstep, where even one wake-up takes longer than the other's answer.
"""

from __future__ import annotations

from collections.abc import Callable
import os
import sys
import time
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription

Store = Callable[[bytes, int, int], None]
"""Takes a message's bytes, when it was published and when it came [ns since the epoch]; the
middleware took note of both, however late the message is taken."""

MOST = 100
"""Messages of one topic that `take_soon` takes at once: who sends without end must not keep others
from theirs."""


class _ByHand(CallbackGroup):
    """The group of subscriptions that executors leave alone."""

    def can_execute(self, entity: Any) -> bool:
        """Return whether an executor may: not take these messages, but tell of bad QoS."""
        return not isinstance(entity, Subscription)

    def beginning_execution(self, entity: Any) -> bool:
        """Return the same."""
        return self.can_execute(entity)

    def ending_execution(self, entity: Any) -> None:
        """Do nothing."""


class Taker:
    """Subscriptions of a node whose messages are taken by `take_all`.

    Args:
        node: The node; spin it by an executor that honours callback groups.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._group = _ByHand()
        self._subscriptions: list[tuple[Subscription, Store]] = []
        self._wait_set: Any = None

    def subscribe(self, message_type: Any, topic: str, qos: Any, store: Store) -> None:
        """Subscribe a topic, between two calls of `take_all`."""
        subscription = self._node.create_subscription(
            message_type, topic, _never, qos, callback_group=self._group, raw=True)
        self._subscriptions.append((subscription, store))
        self._wait_set = None

    def close(self) -> None:
        """Subscribe to nothing any more."""
        for subscription, _ in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()
        self._wait_set = None

    def take_soon(self, eager: float, timeout: float) -> int:
        """Hand over what has come, up to `MOST` of each topic, as soon as something has.

        Args:
            eager: How long to look for it without sleeping [s]: waking up takes longer than an
                answer that is under way. Who has work to do on this core is let through.
            timeout: Longest wait in all [s].

        Returns:
            The number of messages.
        """
        eager = min(eager, timeout)
        give_up = time.monotonic() + eager
        while not (taken := self._take(MOST)):
            if time.monotonic() >= give_up:
                self._wait(timeout - eager)
                return self._take(MOST)
            os.sched_yield()
        return taken

    def take_all(self, timeout: float) -> int:
        """Wait for messages, hand over all that have come, return their number.

        Args:
            timeout: Longest wait [s].
        """
        self._wait(timeout)
        return self._take(sys.maxsize)

    def _wait(self, timeout: float) -> None:
        """Sleep until there is a message, or for a time [s]."""
        if self._wait_set is None:
            self._wait_set = rclpy_implementation.WaitSet(
                len(self._subscriptions), 0, 0, 0, 0, 0, self._node.context.handle)
        self._wait_set.clear_entities()
        for subscription, _ in self._subscriptions:
            self._wait_set.add_subscription(subscription.handle)
        self._wait_set.wait(int(timeout * 1e9))

    def _take(self, most: int) -> int:
        """Hand over what is there, up to so many messages of each topic; return the number."""
        taken = 0
        for subscription, store in self._subscriptions:
            handle, message_type = subscription.handle, subscription.msg_type
            for _ in range(most):
                found = handle.take_message(message_type, True)
                if found is None:
                    break
                store(found[0], found[1]['source_timestamp'], found[1]['received_timestamp'])
                taken += 1
        return taken


def _never(message: bytes) -> None:
    """Stand in for a callback that is never called."""

# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that a node polls: every message that has come, with its times, in one wake-up.

The executor with the least delay cannot hand over a message's source time-stamp in this version
of rclpy (it raises SystemError for callbacks with two arguments), and the others spend far more on
waking up than a recorder has to do for a message. So a recorder waits on its subscriptions itself;
so do the loop's nodes in lockstep, where even one wake-up takes longer than the other's answer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import os
import time
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription

Store = Callable[[bytes, int, int], None]
"""Takes a message's bytes, when it was published and when it came [ns since the epoch]; the
middleware took note of both, however late the message is polled."""

MAX_MESSAGES_PER_POLL = 100
"""Messages of one topic that `poll_soon` takes: one that comes without end must not keep others
from theirs."""
MAX_MESSAGES_AT_ONCE = 5000
"""Messages of one topic that `poll` takes, more than a subscription keeps: a publisher that is
quicker than this process must not hold it here."""


class _NoExecutor(CallbackGroup):
    """Group of subscriptions whose messages no executor takes; their QoS events it does."""

    def can_execute(self, entity: Any) -> bool:
        """Return whether an executor may serve this entity."""
        return not isinstance(entity, Subscription)

    beginning_execution = can_execute

    def ending_execution(self, entity: Any) -> None:
        """Do nothing."""


class WaitSet:
    """Sleeps until one of some subscriptions of a node has a message."""

    def __init__(self, node: Node, subscriptions: Iterable[Subscription]) -> None:
        self._subscriptions = tuple(subscriptions)
        self._set = rclpy_implementation.WaitSet(
            len(self._subscriptions), 0, 0, 0, 0, 0, node.context.handle)

    def wait(self, timeout: float) -> None:
        """Sleep until there is a message, or for a time [s]."""
        self._set.clear_entities()
        for subscription in self._subscriptions:
            self._set.add_subscription(subscription.handle)
        self._set.wait(int(timeout * 1e9))


class PolledSubscriptions:
    """Subscriptions of a node whose messages are taken by `poll` and `poll_soon`.

    Args:
        node: The node; spin it by an executor that honours callback groups.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._group = _NoExecutor()
        self._subscriptions: list[tuple[Subscription, Store]] = []
        self._wait_set: WaitSet | None = None

    def __len__(self) -> int:
        return len(self._subscriptions)

    def subscribe(self, message_type: Any, topic: str, qos: Any, store: Store) -> None:
        """Subscribe to a topic, between two polls."""
        subscription = self._node.create_subscription(
            message_type, topic, _never, qos, callback_group=self._group, raw=True)
        self._subscriptions.append((subscription, store))
        self._wait_set = None

    def close(self) -> None:
        """Destroy the subscriptions."""
        for subscription, _ in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()
        self._wait_set = None

    def poll_soon(self, eager: float, timeout: float) -> int:
        """Hand over up to `MAX_MESSAGES_PER_POLL` of each topic at the first; return the number.

        Args:
            eager: How long to poll without sleeping [s]: waking up takes longer than an answer
                that is under way. Other processes with work on this core are let through.
            timeout: Longest wait in all [s].
        """
        eager = min(eager, timeout)
        give_up = time.monotonic() + eager
        while not (taken := self._take(MAX_MESSAGES_PER_POLL)):
            if time.monotonic() >= give_up:
                self._wait(timeout - eager)
                return self._take(MAX_MESSAGES_PER_POLL)
            os.sched_yield()
        return taken

    def poll(self, timeout: float) -> int:
        """Wait for messages [s], hand over what has come, return the number."""
        self._wait(timeout)
        return self._take(MAX_MESSAGES_AT_ONCE)

    def _wait(self, timeout: float) -> None:
        if self._wait_set is None:
            self._wait_set = WaitSet(self._node, (item for item, _ in self._subscriptions))
        self._wait_set.wait(timeout)

    def _take(self, most: int) -> int:
        """Hand over up to `most` messages of each topic; return the number."""
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


def taker(subscription: Subscription, received: Callable[[bytes], None]) -> Callable[[], bool]:
    """Return the function that hands over a message that has come; False = there is none.

    An executor that serves the subscription as well finds nothing where this came first.
    """
    take, message_type = subscription.handle.take_message, subscription.msg_type

    def taken() -> bool:
        found = take(message_type, True)
        if found is None:
            return False
        received(found[0])
        return True

    return taken


def poll_until(takers: Sequence[Callable[[], bool]], deadline: float, done: Callable[[], bool],
               urgent: Callable[[float], None]) -> None:
    """Call `takers` (of `taker`) without sleeping; other processes on this core are let through.

    Args:
        takers: In the order in which they are called.
        deadline: End, by the steady clock [s].
        done: Whether it is over before that.
        urgent: Called between two messages with the time [s].
    """
    while not done() and (now := time.monotonic()) < deadline:
        urgent(now)
        for take in takers:
            if take():
                break
        else:
            os.sched_yield()


def _never(message: bytes) -> None:
    """Replace the callback that no executor calls."""

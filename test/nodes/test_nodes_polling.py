# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that a node polls: a topic whose messages never end delays no other."""

import math
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')


def test_messages_that_come_as_fast_as_they_are_taken_do_not_hold_a_poll(monkeypatch):
    from dz_ros.nodes.ros import polling

    times = {'source_timestamp': 1, 'received_timestamp': 2}
    endless = SimpleNamespace(msg_type=None, handle=SimpleNamespace(
        take_message=lambda _type, _raw: (b'', times)))
    monkeypatch.setattr(polling, 'WaitSet', lambda *_: SimpleNamespace(wait=lambda _time: None))
    polled = polling.PolledSubscriptions(
        SimpleNamespace(create_subscription=lambda *_, **_options: endless))
    taken = []
    for topic in ('state', 'command'):
        polled.subscribe(None, topic, 10, lambda *message: taken.append(message))
    assert polled.poll(0.0) == 2 * polling.MAX_MESSAGES_AT_ONCE
    assert polled.poll_soon(0.0, 0.0) == 2 * polling.MAX_MESSAGES_PER_POLL
    assert set(taken) == {(b'', 1, 2)}


def test_polling_takes_each_message_and_serves_what_is_urgent_between_them():
    from dz_ros.nodes.ros.polling import poll_until, taker

    found = iter([None, (b'first', {}), None, (b'second', {}), (b'third', {})])
    subscription = SimpleNamespace(msg_type='type', handle=SimpleNamespace(
        take_message=lambda kind, raw: next(found) if (kind, raw) == ('type', True) else 1 / 0))
    taken, urgent = [], []
    takers = [taker(subscription, taken.append)]
    poll_until(takers, math.inf, lambda: len(taken) == 2, lambda _now: urgent.append(len(taken)))
    assert taken == [b'first', b'second']
    assert urgent == [0, 0, 1, 1]
    poll_until(takers, 0.0, lambda: False, lambda _now: 1 / 0)      # the time is over
    assert next(found) == (b'third', {})

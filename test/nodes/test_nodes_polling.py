# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that a node polls: a topic whose messages never end delays no other."""

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

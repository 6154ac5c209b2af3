# SPDX-License-Identifier: Apache-2.0
"""The live page of a loop of several axes: one is shown, another may be chosen."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed: the live page has no loop')

from dz_ros.core.configuration import Configuration  # noqa: E402
from dz_ros.core.dataset import from_runs  # noqa: E402
from dz_ros.core.events import ConfigurationEvent, parse  # noqa: E402
from dz_ros.core.loop.coupled import simulate_axes  # noqa: E402
from dz_ros.errors import LoopError  # noqa: E402
from dz_ros.nodes.parts.live_loop import ARRANGE_PERIOD, LiveLoop  # noqa: E402
from dz_ros.recording.axes_cdr import codec_for  # noqa: E402
from dz_ros.recording.cdr import decode_string, encode_string  # noqa: E402

FLAT = {'loop.axes': ['surge', 'yaw'], 'loop.duration': 0.3, 'axes.yaw.controller.lambda': 2.0,
        'axes.yaw.plant.x0': [1.0, 0.0]}


class Node:
    """What the loop's subscriptions need of a node: stores are called by the test itself."""

    def __init__(self):
        self.stores, self.refused = {}, []
        self.polled = self

    def subscribe(self, _kind, topic, _qos, store):
        self.stores[topic] = store

    def create_subscription(self, *_):
        pass

    def poll(self, _timeout):
        return 0

    def get_namespace(self):
        return '/'

    def refuse(self, topic, cause, _detail=''):
        self.refused.append((topic, cause))

    def count(self, what, _detail=''):
        self.refused.append(('', what))

    def parse_event(self, payload):
        return parse(decode_string(payload))


@pytest.fixture(scope='module')
def machine():
    return Configuration.from_flat(FLAT)


@pytest.fixture(scope='module')
def runs(machine):
    return simulate_axes(machine)


@pytest.fixture
def shown(machine):
    """A page's loop that has received what the loop's nodes state, and its node."""
    node = Node()
    loop = LiveLoop(node, 1.0)
    event = ConfigurationEvent('/controller_node', machine.to_flat(),
                               owns=('loop', 'plant', 'controller', 'trajectory', 'safety'))
    node.stores['events'](encode_string(event.to_json()), 10**9, 0)
    for now in (0.0, 5.0):
        loop.look(now)
    return loop, node


def feed(node, loop, machine, runs, now):
    """Publish all messages of the runs; take them."""
    data = from_runs(runs, machine)
    for topic, channel in data.channels.items():
        codec = codec_for(channel.labels, channel.axes)
        for values in channel.values.tolist():
            node.stores[topic](codec.encode(values), 10**9, 0)
    loop.look(now)
    loop.look(now + 5.0)
    rows = loop.history.rows(loop.history.begin(1000), loop.history.head)
    return {name: rows[:, place] for place, name in enumerate(loop.layout.names)}


def test_the_first_axis_is_shown_and_another_can_be_chosen(shown, machine, runs):
    loop, node = shown
    hello = loop.hello()
    assert (hello['axes'], hello['axis']) == (['surge', 'yaw'], 'surge')
    columns = feed(node, loop, machine, runs, 10.0)
    assert np.array_equal(columns['v'], runs['surge'].v)
    assert asyncio.run(loop.ask({'do': 'axis', 'axis': 'yaw'})) == {'message': 'axis yaw'}
    assert loop.look(20.0)      # the table begins again
    assert loop.hello()['axis'] == 'yaw'
    values = {item['key']: item['value'] for item in loop.hello()['parameters']}
    assert values['controller.lambda'] == 2.0
    columns = feed(node, loop, machine, runs, 21.0)
    assert np.array_equal(columns['v'], runs['yaw'].v)
    assert np.array_equal(columns['x0'], runs['yaw'].x_measured[:, 0])
    assert not node.refused


def test_what_is_no_axis_or_comes_too_soon_is_refused(shown):
    loop, _ = shown
    for axis in ('jaw', None, 3, ['yaw'], {}):
        with pytest.raises(LoopError, match='must be one of surge, yaw'):
            asyncio.run(loop.ask({'do': 'axis', 'axis': axis}))
    asyncio.run(loop.ask({'do': 'axis', 'axis': 'yaw'}))
    loop.look(30.0)
    with pytest.raises(LoopError, match='chosen less than'):
        asyncio.run(loop.ask({'do': 'axis', 'axis': 'surge'}))
    loop.look(30.0 + 2.0 * ARRANGE_PERIOD)
    assert asyncio.run(loop.ask({'do': 'axis', 'axis': 'surge'})) == {'message': 'axis surge'}


def test_messages_of_other_axes_are_refused_by_cause(shown, runs, machine):
    loop, node = shown
    channel = from_runs(runs, machine).channels['state']
    for axes in (('yaw', 'surge'), ('surge', 'sway')):
        node.stores['state'](codec_for(channel.labels, axes).encode(channel.values[0]), 1, 0)
    assert {topic for topic, _ in node.refused} == {'state'}
    assert loop.axes == ('surge', 'yaw')

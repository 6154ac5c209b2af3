# SPDX-License-Identifier: Apache-2.0
"""The e-stop from outside: every kind of publisher, any moment, held by the one that presses.

Over 300 lines: publishers, ends and presses are those of one topic.
"""

import json
from pathlib import Path
import random
import re
import select
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from dz_ros.core.safety.estop import Presses

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

ROOT = Path(__file__).parents[2]
NODE = ('-m', 'dz_ros.nodes.main')
DZ = ('-m', 'dz_ros')
CONFIG = ROOT / 'config' / 'servo.yaml'
NAMES = ('plant_node', 'controller_node', 'trajectory_node')
PATIENT = ('-p', 'loop.duration:=0.0', '-p', 'safety.fault_after:=4000')
TIME_OUT = 180.0


def qos(kind):
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
    return {'default': QoSProfile(depth=10),
            'sensor data': QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT),
            'latched': QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
            'keep all': QoSProfile(history=HistoryPolicy.KEEP_ALL)}[kind]


KINDS = ('default', 'sensor data', 'latched', 'keep all')


def start(processes, name, *more):
    return processes(*NODE, name, '--ros-args', '--params-file', CONFIG, *PATIENT, *more)


@pytest.fixture
def loop(processes, operator):
    nodes = {name: start(processes, name) for name in NAMES}
    operator.wait_for_mode(plant_node='running', controller_node='running')
    return nodes


@pytest.fixture
def button(operator):
    """Return a function that makes a publisher whose messages both ends have received.

    A publisher knows its subscriptions before they know it: an end that refuses a reset for what
    it holds does.
    """
    def make(kind='default', node=None):
        node = node or operator.node
        made = node.create_publisher(operator.bool, 'estop', qos(kind))

        def press(pressed):
            made.publish(operator.bool(data=pressed))

        def knows(end):
            press(True)
            return node.get_fully_qualified_name() in operator.call(f'{end}/reset').message

        for end in NAMES[:2]:
            operator.wait(lambda end=end: knows(end))
        both_reset(operator, press)
        return press
    return make


def both_stopped(operator):
    operator.wait_for_mode(plant_node='estop', controller_node='estop')


def both_reset(operator, *released):
    """Release these, which may forget what they send, and reset both ends until they run."""
    operator.start_again(release=lambda: [press(False) for press in released])


def test_a_publisher_without_a_node_is_no_end_because_another_publishes_states():
    from dz_ros.nodes.ros.estop_topic import EstopTopic, NAMELESS

    def info(name, gid):
        return SimpleNamespace(node_name=name, node_namespace='', endpoint_gid=[gid] * 16)

    infos = {'estop': [info(NAMELESS, 1), info('plant_node', 2)],
             'state': [info(NAMELESS, 3), info('plant_node', 4)], 'command': []}
    topic = EstopTopic.__new__(EstopTopic)
    topic._node = SimpleNamespace(get_publishers_info_by_topic=infos.get,
                                  get_service_names_and_types=list)
    assert topic.ends() == {bytes([2] * 16)}


def test_a_press_of_any_publisher_stops_both_ends_whatever_follows_at_once(
        loop, operator, button):
    other = button()
    for kind in KINDS:
        press = button(kind)
        press(True)
        press(False)
        other(False)
        both_stopped(operator)
        both_reset(operator, press)


def test_presses_beside_stalls_and_transitions_are_all_received(processes):
    bench = processes(ROOT / 'benchmarks' / 'estop.py', '--presses', '40', '--seed', '7')
    assert bench.wait(600.0) == 0, bench.output
    assert '40 of 40 presses stopped both ends' in bench.output


def test_presses_in_lockstep_and_beside_a_flood_of_releases_are_all_received(processes):
    bench = processes(ROOT / 'benchmarks' / 'estop.py', '--presses', '15', '--seed', '8',
                      '--lockstep', '--flood')
    assert bench.wait(600.0) == 0, bench.output
    assert '15 of 15 presses stopped both ends' in bench.output


def test_a_publisher_holds_what_it_presses_until_it_releases_or_is_gone(loop, operator, button):
    joystick = rclpy.create_node('joystick', context=operator.context)
    joystick.create_service(operator.trigger, '~/estop', lambda _request, answer: answer)
    first, second = button(node=joystick), button()
    first(True)
    both_stopped(operator)
    second(True)
    second(False)
    for node in NAMES[:2]:      # until it has the second one's release as well
        operator.wait(lambda node=node: operator.call(f'{node}/reset').message == (
            'the e-stop is still pressed by /joystick: release it there, or end that node'))
    first(False)
    both_reset(operator)
    first(True)
    both_stopped(operator)
    joystick.destroy_node()         # dies while it presses: stopped until the operator's reset
    received = len(operator.received['state'])
    operator.wait(lambda: len(operator.received['state']) > received + 200)
    both_stopped(operator)
    both_reset(operator)


@pytest.mark.parametrize('transitions', [(4,), (4, 2)])     # inactive, unconfigured
def test_a_press_in_any_lifecycle_state_holds_when_the_node_is_active_again(
        loop, operator, button, transitions):
    press = button()
    for number in transitions:
        assert operator.change('/plant_node', number)
    press(True)
    press(False)
    both_stopped(operator)
    for number in ((1, 3) if len(transitions) > 1 else (3,)):
        assert operator.change('/plant_node', number)
    last = next(event['seq'] for event in reversed(operator.events)
                if event['event'] == 'stopped' and event['node'] == '/plant_node')

    def since():        # not by when it was received: a busy machine has messages wait
        return [message.data for message in operator.received['truth'] if message.data[0] > last]

    operator.wait(lambda: len(since()) > 20)
    assert all(data[2] == data[3] for data in since())
    both_reset(operator)


def test_what_a_latched_publisher_reported_before_the_node_was_there_counts(
        processes, operator):
    publisher = operator.node.create_publisher(operator.bool, 'estop', qos('latched'))
    publisher.publish(operator.bool(data=True))
    start(processes, 'plant_node')
    operator.wait_for_mode(plant_node='estop')


def test_an_end_that_was_frozen_during_a_press_is_stopped_when_it_goes_on(
        loop, operator, button):
    press = button('latched')
    loop['plant_node'].signal(signal.SIGSTOP)
    press(True)
    press(False)
    operator.wait_for_mode(controller_node='estop')
    loop['plant_node'].signal(signal.SIGCONT)
    both_stopped(operator)
    both_reset(operator)


def test_the_command_line_stops_one_end_though_the_other_one_hangs(processes, loop, operator):
    loop['plant_node'].signal(signal.SIGSTOP)
    stop = processes(*DZ, 'estop')
    try:
        assert stop.wait() == 2
        assert 'controller_node: stopped' in stop.output
        assert re.search('plant_node/estop (does not answer )?within 5 s; pressed on /estop, to '
                         r'which \d nodes subscribe', stop.output), stop.output
        operator.wait_for_mode(controller_node='estop')
    finally:
        loop['plant_node'].signal(signal.SIGCONT)
    both_stopped(operator)
    code, output = 2, 'still pressed by'
    while 'still pressed by' in output:     # the command that pressed has ended
        reset = processes(*DZ, 'reset')
        code, output = reset.wait(), reset.output
    assert not re.search('error.*estop', output), output
    if code == 0:       # each node once, and what it is now
        assert output.splitlines() == ['plant_node: reset', 'controller_node: reset']


@pytest.mark.parametrize('kind', KINDS)
def test_the_subscriber_for_a_device_without_a_loop_receives_every_kind(processes, operator, kind):
    subscriber = processes(*NODE, 'operator_node', '--ros-args', '-p', 'task:=receive_estop')
    subscriber.wait_for_line('subscribed')
    publisher = operator.node.create_publisher(operator.bool, 'estop', qos(kind))
    seen = {'sensor data': 1, 'latched': 3}.get(kind, 2)
    operator.wait(lambda: publisher.get_subscription_count() == seen)

    def received():
        publisher.publish(operator.bool(data=True))
        publisher.publish(operator.bool(data=False))
        return kind in ('default', 'keep all') or 'pressed' in subscriber.output

    # What is not kept is sent again: the subscriber may not know a new publisher yet.
    operator.wait(received)
    assert json.loads(subscriber.wait_for_line('pressed')) == {'pressed': True}


@pytest.fixture
def topic(ros_domain):
    """A node of this process with the e-stop, and another one that has no executor either."""
    from dz_ros.nodes.ros.estop_topic import EstopTopic
    context = rclpy.Context()
    context.init()
    node = rclpy.create_node('end', context=context)
    made = EstopTopic(node)
    made.node = node
    made.other = rclpy.create_node('other', context=context)
    yield made
    node.destroy_node()
    made.other.destroy_node()
    context.shutdown()


def received(topic):
    """Return what the next call of `receive` that finds a press returns."""
    while not (found := topic.receive()):
        topic.wait(0.01)
    return found


def publisher_on(topic, kind='keep all'):
    from std_msgs.msg import Bool
    made = topic.other.create_publisher(Bool, 'estop', qos(kind))
    while made.get_subscription_count() < {'sensor data': 1, 'latched': 3}.get(kind, 2):
        topic.wait(0.01)
    return lambda pressed: made.publish(Bool(data=pressed))


BUTTONS = """
import sys
import time
import rclpy
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
rclpy.init()
offered = [QoSProfile(depth=10),
           QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT),
           QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
           QoSProfile(history=HistoryPolicy.KEEP_ALL)]
made = [rclpy.create_node(f'button_{k}').create_publisher(Bool, 'estop', offered[k % 4])
        for k in range(8)]
for line in sys.stdin:
    which, length, releases, other, more = line.split()
    made[int(which)].publish(Bool(data=True))
    time.sleep(float(length))
    for _ in range(int(releases)):
        made[int(which)].publish(Bool(data=False))
    for _ in range(int(more)):
        made[int(other)].publish(Bool(data=False))
    print('done', flush=True)
"""
"""Presses by eight publishers of four kinds, as a line asks for: publisher, length [s], number of
its releases, another publisher, number of releases of that one."""
FORGETS = (1, 2, 5, 6)
"""Those that keep no press behind its release: what the transport drops comes when repeated."""


@pytest.fixture
def two_ends(ros_domain):
    """Yield the e-stops of two nodes, which the test has look when it likes."""
    from dz_ros.nodes.ros.estop_topic import EstopTopic
    context = rclpy.Context()
    context.init()
    nodes = [rclpy.create_node(f'end_{k}', context=context) for k in range(2)]
    made = [EstopTopic(node) for node in nodes]
    for topic, node in zip(made, nodes, strict=True):
        topic.node = node
    yield made
    for node in nodes:
        node.destroy_node()
    context.shutdown()


def test_a_thousand_presses_beside_stalls_are_all_received_at_both_ends(two_ends):
    draw = random.Random(11)
    with subprocess.Popen([sys.executable, '-c', BUTTONS], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, text=True) as process:
        try:
            buttons = Buttons(process, two_ends)
            for which in range(8):      # it knows the ends before they know it
                assert any(buttons.press(which, 0.0, 1, which, 0, (), 1.0) for _ in range(180))
            again = 0
            for number in range(1000):
                which, other = draw.sample(range(8), 2)
                asleep = draw.choice(((), (0,), (1,), (0, 1)))
                time.sleep(draw.choice((0.0, 0.003)) * draw.random())
                length = draw.choice((0.0, 0.001, 0.01)) * draw.random()
                words = (which, length, draw.choice((0, 1, 1, 30)), other,
                         draw.choice((0, 0, 1, 30)), asleep)
                found = buttons.press(*words, 1.0 if which in FORGETS else TIME_OUT)
                again += not found
                assert found or (which in FORGETS and buttons.press(*words, TIME_OUT)), (
                    number, words)
            assert again < 250      # half of those that keep nothing; mostly none
        finally:
            process.kill()


class Buttons:
    """Publishers of another process, and what two ends receive of them."""

    def __init__(self, process, ends):
        self.process, self.ends = process, ends
        self.names = {}

    def gid(self, which):
        """Return the identity of a publisher."""
        give_up = time.monotonic() + TIME_OUT
        while which not in self.names:
            assert time.monotonic() < give_up
            for topic in self.ends:
                for info in topic.node.get_publishers_info_by_topic('estop'):
                    if info.node_name.startswith('button_'):
                        self.names[int(info.node_name[7:])] = bytes(info.endpoint_gid)[:16]
        return self.names[which]

    def press(self, which, length, releases, other, more, asleep, limit):
        """Press; return whether both ends receive it; those asleep look when all is sent."""
        gid, seen = self.gid(which), [set(), set()]
        self.process.stdin.write(f'{which} {length} {releases} {other} {more}\n')
        self.process.stdin.flush()
        give_up = time.monotonic() + TIME_OUT
        while not select.select([self.process.stdout], [], [], 0.0)[0]:
            assert time.monotonic() < give_up
            self.look(seen, set(range(2)) - set(asleep))
        assert self.process.stdout.readline() == 'done\n'
        until = time.monotonic() + limit
        while not all(gid in item for item in seen) and time.monotonic() < until:
            self.look(seen, range(2))
        return all(gid in item for item in seen)

    def look(self, seen, which):
        for end in which:
            seen[end] |= self.ends[end].receive()
        time.sleep(0.0005)


@pytest.mark.parametrize(('before', 'after'), [(4000, 500), (500, 4000), (0, 4900), (4900, 0)])
def test_one_call_finds_a_press_among_the_releases_of_a_stall(monkeypatch, topic, before, after):
    press = publisher_on(topic)
    for pressed in (*[False] * before, True, *[False] * after):
        press(pressed)
    assert topic.held_by() == []        # nothing was taken yet
    # It is acted on before the rest is read.
    taken, acted, receive = [], [], Presses.receive

    def count(presses, publisher, number, pressed):
        taken.append(pressed)
        return receive(presses, publisher, number, pressed)

    monkeypatch.setattr(Presses, 'receive', count)
    assert len(topic.receive(lambda: acted.append(len(taken)))) == 1
    assert acted == [taken.index(True) + 1]
    assert len(taken) > 4000
    assert topic.receive() == set()
    assert topic.held_by() == ([] if after else ['/other'])


def test_a_press_is_held_where_rules_for_names_form_a_chain(ros_domain):
    from std_msgs.msg import Bool

    from dz_ros.nodes.ros.estop_topic import EstopTopic
    context = rclpy.Context()
    context.init()
    node = rclpy.create_node('end', context=context, cli_args=[
        '--ros-args', '-r', 'estop:=/stop_all', '-r', '/stop_all:=/elsewhere'])
    topic = EstopTopic(node)
    other = rclpy.create_node('other', context=context)
    publisher = other.create_publisher(Bool, '/stop_all', qos('keep all'))
    while publisher.get_subscription_count() < 2:
        topic.wait(0.01)
    publisher.publish(Bool(data=True))
    received(topic)
    assert topic.held_by() == ['/other']
    node.destroy_node()
    other.destroy_node()
    context.shutdown()


def test_a_node_does_not_receive_its_own_press(topic):
    topic.publish(True)
    press = publisher_on(topic)
    press(False)
    topic.wait(1.0)
    assert topic.receive() == set()
    assert topic.held_by() == []


def test_without_the_publishers_of_messages_no_release_counts(monkeypatch, ros_domain):
    from dz_ros.nodes.ros import estop_topic
    monkeypatch.setattr(estop_topic, '_Rcl', lambda: (_ for _ in ()).throw(OSError))
    context = rclpy.Context()
    context.init()
    node = rclpy.create_node('end', context=context)
    topic = estop_topic.EstopTopic(node)
    topic.other = rclpy.create_node('other', context=context)
    press = publisher_on(topic, 'latched')
    press(True)
    assert received(topic) == {None}
    press(False)
    topic.wait(1.0)
    topic.receive()
    assert topic.held_by() == ['/other']
    topic.other.destroy_node()
    while topic.held_by():
        topic.wait(0.01)
    node.destroy_node()
    context.shutdown()


def test_the_middleware_of_this_package_names_the_publisher(topic):
    press = publisher_on(topic, 'default')
    press(True)
    publisher, = received(topic)
    infos = topic.other.get_publishers_info_by_topic('estop')
    assert publisher in {bytes(info.endpoint_gid) for info in infos
                         if info.node_name == 'other'}

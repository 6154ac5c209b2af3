# SPDX-License-Identifier: Apache-2.0
"""Replay over real DDS: bytes, order, names, steering, the shadow controller."""

from pathlib import Path
import re
import signal
import time

import pytest

from dz_ros.recording.run_source import open_source

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

DZ = ('-m', 'dz_ros', 'bag', 'replay')
NODE = ('-m', 'dz_ros.nodes.main', 'replay_node', '--ros-args')
TIME_OUT = 180.0
CHANNELS = ('reference', 'state', 'command', 'terms', 'truth')


class Subscriber:
    """A node of the test's own that keeps what it receives."""

    def __init__(self):
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node('subscriber', context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.received, self.clients = {}, {}

    def subscribe(self, topic, message_type=None, raw=True, depth=5000, **qos):
        from std_msgs.msg import Float64MultiArray
        self.received[topic] = []
        self.node.create_subscription(message_type or Float64MultiArray, topic,
                                      self.received[topic].append,
                                      rclpy.qos.QoSProfile(depth=depth, **qos), raw=raw)

    def wait(self, condition):
        deadline = time.monotonic() + TIME_OUT
        while not condition():
            assert time.monotonic() < deadline, 'nothing received in time'
            self.executor.spin_once(timeout_sec=0.1)

    def call(self, name, **options):
        from std_srvs.srv import Trigger
        return self.ask(f'/replay_node/{name}', Trigger, Trigger.Request(), **options)

    def ask(self, service, service_type, request, ended=lambda: False):
        if service not in self.clients:
            self.clients[service] = self.node.create_client(service_type, service)
        assert self.clients[service].wait_for_service(TIME_OUT)
        future = self.clients[service].call_async(request)
        self.wait(lambda: future.done() or ended())
        return future.result() if future.done() else None

    def set_rate(self, value):
        from rcl_interfaces.srv import SetParameters
        request = SetParameters.Request(
            parameters=[rclpy.parameter.Parameter('rate', value=value).to_parameter_msg()])
        return self.ask('/replay_node/set_parameters', SetParameters, request).results[0]

    def publish(self, topic, message):
        publisher = self.node.create_publisher(type(message), f'/replay_node/{topic}', 10)
        self.wait(lambda: publisher.get_subscription_count())
        publisher.publish(message)

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.shutdown()


@pytest.fixture
def subscriber(ros_domain):
    made = Subscriber()
    yield made
    made.close()


def payloads(run, channel):
    return [message.payload for batch in open_source(run).batches() for message in batch
            if message.topic.rpartition('/')[2] == channel]


def test_every_byte_is_published_in_order_on_the_recorded_topics(processes, subscriber, run):
    for name in CHANNELS:
        subscriber.subscribe(f'/{name}')
    replay = processes(*DZ, run, '--rate', '2', '--wait-for', *CHANNELS)
    assert replay.wait() == 0, replay.output
    subscriber.wait(lambda: all(len(subscriber.received[f'/{name}']) == 201 for name in CHANNELS))
    for name in CHANNELS:
        assert subscriber.received[f'/{name}'] == payloads(run, name)
    assert '1006 messages' in replay.output


def test_events_are_offered_to_late_joiners_as_they_were(processes, subscriber, run):
    from std_msgs.msg import String
    replay = processes(*DZ, run, '--topics', 'events', 'state', '--loop', '--duration', '0.5')
    subscriber.subscribe('/state')
    subscriber.wait(lambda: subscriber.received['/state'])
    subscriber.subscribe('/events', String, raw=False,
                         durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL)
    subscriber.wait(lambda: subscriber.received['/events'])
    assert subscriber.received['/events'][0].data == '{"event": "started"}'
    replay.signal(signal.SIGINT)
    assert replay.wait() == 0          # how a loop is meant to end
    assert 'Traceback' not in replay.output


def test_names_follow_namespace_and_remapping(processes, subscriber, run):
    subscriber.subscribe('/again/renamed')
    subscriber.subscribe('/again/command')
    replay = processes(*DZ, run, '--namespace', 'again', '--remap', 'state:=renamed',
                       '--wait-for', 'state', 'command', '--rate', '5')
    assert replay.wait() == 0, replay.output
    subscriber.wait(lambda: len(subscriber.received['/again/renamed']) == 201)
    assert subscriber.received['/again/renamed'] == payloads(run, 'state')


def test_it_is_steered_while_it_plays(processes, subscriber, run):
    from builtin_interfaces.msg import Time
    from std_msgs.msg import Float64, UInt64
    subscriber.subscribe('/state')
    received = subscriber.received['/state']
    states = payloads(run, 'state')
    replay = processes(*NODE, '-p', f'run:={run}', '-p', 'topics:=[state]', '-p', 'paused:=true',
                       '-p', 'wait_for:=[state]')
    answer = subscriber.call('is_paused')
    assert answer.success
    assert answer.message == 'paused at 0.000000 s'
    for count in (1, 2, 3):
        assert subscriber.call('play_next').success
        subscriber.wait(lambda count=count: len(received) == count)
    assert received == states[:3]
    subscriber.publish('burst', UInt64(data=4))
    subscriber.wait(lambda: len(received) == 7)
    subscriber.publish('seek_offset', Float64(data=0.5))
    replay.wait_for_line('seek to 0.500000 s')
    assert subscriber.call('play_next').success
    subscriber.wait(lambda: len(received) == 8)
    assert received[7] == states[100]
    subscriber.publish('seek', Time(sec=10 ** 9, nanosec=250_000_000))
    replay.wait_for_line('seek to 0.250000 s')
    assert subscriber.set_rate(0.001).successful
    refused = subscriber.set_rate(-1.0)
    assert not refused.successful
    assert 'rate = -1.0' in refused.reason
    assert not subscriber.set_rate('fast').successful
    assert subscriber.call('resume').success
    assert not subscriber.call('is_paused').success
    assert not subscriber.call('play_next').success       # it plays
    subscriber.wait(lambda: len(received) == 9)
    assert received[8] == states[50]
    assert subscriber.call('toggle_paused').message.startswith('paused')
    assert subscriber.call('toggle_paused').message.startswith('playing')
    assert subscriber.call('pause').success
    subscriber.publish('burst', UInt64(data=0))              # all that are left
    subscriber.wait(lambda: received[-1] == states[-1])
    assert replay.poll() is None                        # paused: an operator may seek
    # A node that ends does not wait until its answer has arrived.
    answer = subscriber.call('stop', ended=lambda: replay.poll() is not None)
    assert answer is None or answer.success
    assert replay.wait() == 0
    assert 'Traceback' not in replay.output


def test_the_time_of_the_recording_is_published_as_clock(processes, subscriber, run):
    from rosgraph_msgs.msg import Clock
    subscriber.subscribe('/clock', Clock, raw=False)
    subscriber.subscribe('/state')
    replay = processes(*DZ, run, '--clock', '100', '--wait-for', 'state')
    assert replay.wait() == 0, replay.output
    subscriber.wait(lambda: len(subscriber.received['/clock']) > 10)
    times = [message.clock.sec * 10 ** 9 + message.clock.nanosec
             for message in subscriber.received['/clock']]
    assert times == sorted(times)
    assert times[0] >= 10 ** 18
    assert times[-1] < 10 ** 18 + 2 * 10 ** 9


def test_two_replays_on_the_same_topics_are_refused(processes, subscriber, run):
    first = processes(*DZ, run, '--paused')
    assert subscriber.call('is_paused').success
    second = processes(*DZ, run)
    assert second.wait() == 2
    assert 'another replay' in second.output
    assert second.output.count('\n') == 0
    assert first.interrupt() == 130


@pytest.mark.parametrize(('words', 'message'), [
    (('--topics', 'no_such'), '/state'), (('--start', '100'), 'nothing to play'),
    (('--rate', '0'), 'rate = 0.0'), (('--rate', 'nan'), 'rate'), (('--start', '-1'), 'start'),
    (('--clock', '-5'), 'clock'), (('--set', 'controller.k_d=1'), '--into controller only'),
    (('--into', 'controller', '--loop'), '--loop'),
    (('--into', 'controller', '--tolerance', '-1'), '--tolerance'),
    (('--into', 'controller', '--set', 'controller.k_e=1'), 'controller.k_e'),
])
def test_a_users_mistake_is_one_line_and_exit_code_two(processes, run, words, message):
    replay = processes(*DZ, run, *words)
    assert replay.wait() == 2
    assert message in replay.output
    assert replay.output.count('\n') == 0, replay.output


def test_what_is_no_run_is_one_line(processes, tmp_path):
    (tmp_path / 'text.mcap').write_text('no')
    for path in (tmp_path / 'none', tmp_path, tmp_path / 'text.mcap'):
        replay = processes(*DZ, path)
        assert replay.wait() == 2
        assert replay.output.count('\n') == 0, replay.output


@pytest.mark.parametrize(('text', 'expected'), [
    ('', ('KEEP_LAST', 1000, 'RELIABLE', 'VOLATILE')),
    ('- {history: keep_last, depth: 7, reliability: best_effort, durability: volatile}',
     ('KEEP_LAST', 7, 'BEST_EFFORT', 'VOLATILE')),
    ('- {history: 1, depth: 5, reliability: 1, durability: 1}',
     ('KEEP_LAST', 5, 'RELIABLE', 'TRANSIENT_LOCAL')),
    ('- {history: 3, depth: 0, reliability: 2, durability: 2}',
     ('KEEP_LAST', 1000, 'BEST_EFFORT', 'VOLATILE')),
    ('- {history: keep_last, depth: 3, reliability: best_effort, durability: volatile}\n'
     '- {history: keep_last, depth: 9, reliability: reliable, durability: transient_local}',
     ('KEEP_LAST', 9, 'RELIABLE', 'TRANSIENT_LOCAL')),
    ('- {history: keep_all, depth: 0}', ('KEEP_ALL', 1000, 'RELIABLE', 'VOLATILE')),
    ('[[[', ('KEEP_LAST', 1000, 'RELIABLE', 'VOLATILE')),
    ('42', ('KEEP_LAST', 1000, 'RELIABLE', 'VOLATILE')),
])
def test_what_was_offered_is_offered_again(text, expected):
    from dz_ros.nodes.parts.recorded_topics import offered_as_recorded
    qos = offered_as_recorded(text)
    assert (qos.history.name, qos.depth, qos.reliability.name, qos.durability.name) == expected


def test_message_classes_are_found_by_name():
    from std_msgs.msg import String

    from dz_ros.nodes.parts.recorded_topics import message_class
    assert message_class('std_msgs/msg/String') is String
    assert message_class('no_such_package/msg/Text') is None
    assert message_class('std_msgs/msg/NoSuchType') is None
    assert message_class('std_msgs/msg/__name__') is None
    assert message_class('std_msgs/msg/_string') is None
    assert message_class('') is None
    assert message_class('../std_msgs/msg/String') is None


def test_the_example_in_the_document_reports_what_is_printed(processes, tmp_path):
    document = Path(__file__).parents[2] / 'docs' / 'replay.md'
    section = document.read_text(encoding='utf-8').partition('\n## Replay\n')[2]
    (block,) = re.findall(r'^```console\n(.*?)^```', section, re.DOTALL | re.MULTILINE)
    made = processes('-m', 'dz_ros', 'simulate', 'wang2004', '--duration', '5', '--record',
                     'runs/a', cwd=tmp_path, PYTHONPATH=str(Path(__file__).parents[2]))
    assert made.wait() == 0, made.output
    for example in block.split('$ dz ')[1:]:
        command, _, expected = example.partition('\n')
        shown = processes('-m', 'dz_ros', *command.split(), cwd=tmp_path,
                          PYTHONPATH=str(Path(__file__).parents[2]))
        assert shown.wait() in (0, 1), shown.output
        for line in expected.splitlines():      # numbers to three digits: libraries differ
            assert rounded(line) in rounded(shown.output)


def rounded(text):
    """Round numbers to three digits, and forget how wide columns are."""
    return re.sub(r' +', ' ', re.sub(r'\d+\.\d{3,}', lambda found: f'{float(found[0]):.3g}', text))


def test_a_type_name_of_a_recording_imports_interfaces_alone(tmp_path, monkeypatch):
    from dz_ros.nodes.parts.recorded_topics import message_class
    package = tmp_path / 'evil_msgs_not_installed'
    (package / 'msg').mkdir(parents=True)
    for folder in (package, package / 'msg'):
        (folder / '__init__.py').write_text(
            f'open({str(tmp_path / "was_imported")!r}, "w").close()\nclass Thing: pass\n')
    monkeypatch.syspath_prepend(tmp_path)
    assert message_class('evil_msgs_not_installed/msg/Thing') is None
    assert not (tmp_path / 'was_imported').exists()
    assert message_class('std_msgs/msg/String').__name__ == 'String'

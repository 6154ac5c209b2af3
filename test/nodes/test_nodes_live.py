# SPDX-License-Identifier: Apache-2.0
"""The live page's node beside real loops, met by a viewer of the test's own.

Over 300 lines: the viewer, and what it compares with the recording, serve every test.
"""

import asyncio
import json
import math
from pathlib import Path
import sys
import threading
import time

import numpy as np
import pytest

from dz_ros.core.loop.offline import simulate
from dz_ros.files.configurations import load_configuration
from dz_ros.live.history import HEAD
from dz_ros.recording.reader import read_run, run_info
from dz_ros.replay.audit.audit import audit
from dz_ros.replay.whatif import plan

pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
aiohttp = pytest.importorskip('aiohttp', reason='aiohttp is not installed: no page to serve')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

DZ = ('-m', 'dz_ros')
NODE = ('-m', 'dz_ros.nodes.main')
TIME_OUT = 180.0
EXAMPLE = Path(__file__).parents[2] / 'examples' / 'dz_ros_example'


class Viewer:
    """What a browser would be: rows by name, texts by kind."""

    def __init__(self, address, token=True):
        self.base, _, self.token = address.partition('#')
        self.token = self.token if token else ''
        self.rows, self.texts, self.names, self.number = [], [], [], 0

    async def __aenter__(self):
        self.session = aiohttp.ClientSession()
        origin = self.base.rstrip('/')
        self.ws = await self.session.ws_connect(self.base + 'ws', headers={'Origin': origin},
                                                max_msg_size=0)
        await self.ws.send_json({'hello': 1, 'token': self.token, 'seconds': 3600})
        return self

    async def __aexit__(self, *_):
        await self.session.close()

    async def until(self, condition):
        """Take what comes until a condition of it holds; return what it returned."""
        deadline = time.monotonic() + TIME_OUT
        while not (found := condition()):
            assert time.monotonic() < deadline, self.texts[-3:]
            message = await self.ws.receive(TIME_OUT)
            if message.type is aiohttp.WSMsgType.TEXT:
                text = json.loads(message.data)
                self.texts += text['events'] if text['kind'] == 'events' else [text]
                if text['kind'] == 'hello':
                    self.hello, self.rows = text, []
                    self.names = [item['name'] for item in text['columns']]
            else:
                assert message.type is aiohttp.WSMsgType.BINARY, message
                self.rows += np.frombuffer(message.data, '<f8', offset=HEAD.size).reshape(
                    -1, len(self.names)).tolist()
        return found

    async def ask(self, what, **details):
        self.number += 1
        await self.ws.send_json({'do': what, 'id': self.number, 'asked': time.time(),
                                 **details})
        return await self.until(lambda: next((text for text in self.texts if text.get(
            'id') == self.number), None))

    def column(self, name):
        return np.array([row[self.names.index(name)] for row in self.rows])

    def running(self):
        return len(self.rows) > 200 and np.isfinite(self.column('v')[-1])


def start(processes, folder, *more):
    process = processes(*DZ, 'run', 'servo', '--quiet', '--live', '--record', folder, '--set',
                        'safety.fault_after=4000', *more)
    return process, process.wait_for_line('live page:').split()[-1]


def test_a_file_of_a_user_s_package_takes_another_law(processes, tmp_path):
    """Keys of its own law are set aside in every node; the page has those of the law chosen."""
    text = (EXAMPLE / 'config' / 'tank.yaml').read_text(encoding='utf-8')
    for name, path in {'model: tank': 'tank:Tank', 'law: pi': 'pi:Pi',
                       'kind: logistic': 'logistic:Logistic'}.items():
        text = text.replace(name, f'{name.partition(":")[0]}: dz_ros_example.{path}')
    file = tmp_path / 'tank.yaml'
    file.write_text(text, encoding='utf-8')
    process = processes(*DZ, 'run', file, '--quiet', '--live', '--duration', '600', '--set',
                        'controller.law=robust', PYTHONPATH=str(EXAMPLE))
    address = process.wait_for_line('live page:').split()[-1]

    async def look():
        async with Viewer(address) as viewer:
            await viewer.until(viewer.running)
            return [await viewer.ask('set', values={key: 2.0})
                    for key in ('controller.lambda', 'controller.k_p')]

    taken, refused = asyncio.run(look())
    assert taken['ok'], taken
    assert not refused['ok']
    process.interrupt()


def test_a_viewer_gets_what_is_recorded_and_what_it_does_is_recorded(processes, tmp_path):
    process, address = start(processes, tmp_path / 'run', '--duration', '600')

    async def look():
        async with Viewer(address) as viewer:
            await viewer.until(viewer.running)
            assert viewer.hello['may_act']
            answers = {
                'disturbance_pulse': await viewer.ask('disturbance_pulse', acceleration=4.0,
                                                      duration=0.25),
                'zone': await viewer.ask('set', values={'plant.dead_zone.b_r': 0.2}),
                'gain': await viewer.ask('set', values={'controller.k_d': 12.0}),
                'motion': await viewer.ask('set', values={'trajectory.dwell': 0.5}),
                'bad gain': await viewer.ask('set', values={'controller.k_star': 0.01}),
                'fixed': await viewer.ask('set', values={'loop.rate': 100.0}),
                'mixed': await viewer.ask('set', values={'controller.k_d': 1.0,
                                                         'trajectory.dwell': 1.0}),
                'bad pulse': await viewer.ask('disturbance_pulse', acceleration='x', duration=1),
                'huge pulse': await viewer.ask('disturbance_pulse', acceleration=10 ** 400,
                                               duration=1),
                'forbidden': await viewer.ask('activate', node='recorder_node')}
            ok = {name for name, answer in answers.items() if answer['ok']}
            assert ok == {'disturbance_pulse', 'zone', 'gain', 'motion'}, answers
            assert 'loop.rate' in answers['fixed']['message']
            assert 'one section' in answers['mixed']['message']
            for name in ('bad pulse', 'huge pulse'):
                assert 'must be a number' in answers[name]['message']
            stamp = viewer.column('stamp')[-1]
            await viewer.until(lambda: viewer.column('stamp')[-1] > stamp + 1.0)
            pressed = await viewer.ask('estop')
            assert pressed['ok']
            await viewer.until(lambda: viewer.column('seq')[-1] > pressed['seq'] + 60)
            assert (await viewer.ask('reset'))['message'] == 'reset'
            seq = viewer.column('seq')[-1]
            await viewer.until(lambda: viewer.column('seq')[-1] > seq + 200)
            assert (await viewer.ask('deactivate'))['ok']
            status = [text for text in viewer.texts if text['kind'] == 'status'][-1]
            assert {'controller_node', 'plant_node', 'trajectory_node', 'recorder_node'} <= {
                node['name'] for node in status['nodes']}
            assert float(status['recording']['size [MB]']) > 0.0
            return viewer, answers['bad gain']['message'], pressed['seq']

    viewer, refusal, pressed = asyncio.run(look())
    process.interrupt()
    data = read_run(tmp_path / 'run')
    compare(viewer, data)
    events = [json.loads(text) for _, _, text in data.events]
    actions = [event for event in events if event['event'] == 'action']
    assert [item['action'] for item in actions] == [
        'disturbance_pulse', 'set', 'set', 'set', 'set', 'set', 'set', 'disturbance_pulse',
        'disturbance_pulse', 'activate', 'estop', 'reset', 'deactivate']
    assert all(item['node'] == '/live_node' and item['by'] == '127.0.0.1' for item in actions)
    # the controller's own reason
    assert 'design rule (18): k* = 0.01 A does not cover the dead-zone' in refusal
    truth = data.channels['truth']
    after = (truth['seq'] > pressed + 3) & (truth['seq'] < pressed + 60)
    assert after.sum() > 40
    assert (truth['w'][after] == 0.0).all()
    instant = next(item['values']['plant.disturbance_pulse'][0] for item in actions)
    inside = (truth['stamp'] > instant - 1e-6) & (truth['stamp'] < instant + 0.25 - 1e-6)
    disturbed = truth['disturbance'] < -3.0
    assert disturbed.any()         # on a busy machine it may come when it should have begun
    assert not (disturbed & ~inside).any()
    assert audit(data).passed
    planned = plan(data, {})
    assert planned.configuration.plant_settings.disturbance_pulse[1:] == (4.0, 0.25)
    assert any('plant.dead_zone.b_r' in note for note in planned.notes)


def compare(viewer, data):
    """Assert that the rows a viewer got are the messages that were recorded."""
    state, reference = data.channels['state'], data.channels['reference']
    seq = viewer.column('seq')
    assert (np.diff(seq) == 1.0).mean() > 0.99
    for channel, column, key, field in (
            (state, 'x0', 'seq', 'x0'), (state, 'round_trip', 'seq', 'round_trip'),
            (reference, 'xd0', 'seq', 'xd0'), (data.channels['command'], 'v', 'echo_seq', 'v'),
            (data.channels['terms'], 's', 'echo_seq', 's'),
            (data.channels['truth'], 'w', 'seq', 'w')):
        _, first = np.unique(channel[key], return_index=True)
        known = dict(zip(channel[key][first].tolist(), channel[field][first].tolist(),
                         strict=True))
        shown = viewer.column(column)
        pairs = [(value, known[number]) for number, value in zip(seq, shown, strict=True)
                 if np.isfinite(value)]
        there = sum(number in known for number in seq.tolist())
        assert len(pairs) > 0.95 * there > 300, column
        assert all(one == other for one, other in pairs), column
    published = dict(zip(state['seq'].tolist(), state.publish_time.tolist(), strict=True))
    assert all(abs(time_shown * 1e9 - published[number]) < 1e4 for number, time_shown in zip(
        seq[1:], viewer.column('published')[1:], strict=True))


def test_an_estop_is_not_undone_by_a_reset_that_was_asked_for_before_it(processes, tmp_path):
    process, address = start(processes, tmp_path / 'run', '--duration', '600')

    async def look():
        async with Viewer(address) as one, Viewer(address) as other:
            await one.until(one.running)
            await other.until(other.running)
            for stopper in (one, other):        # the viewer that asked for the reset, and another
                assert (await one.ask('estop'))['ok']
                await one.until(lambda: one.texts[-1]['kind'] == 'status')
                one.number += 1
                asked = one.number
                await one.ws.send_json({'do': 'reset', 'id': asked, 'asked': time.time()})
                assert (await stopper.ask('estop'))['ok']
                answer = await one.until(lambda asked=asked: next(
                    (text for text in one.texts if text.get('id') == asked), None))

                def stopped():
                    status = [text for text in one.texts if text['kind'] == 'status'][-1]
                    modes = {node['name']: node['mode'] for node in status['nodes']}
                    return status['estop'] and {modes['plant_node'],
                                                modes['controller_node']} == {'estop'}

                await one.until(stopped)    # a process of a busy machine may be late with it
                seq = one.column('seq')[-1]
                await one.until(lambda seq=seq: one.column('seq')[-1] > seq + 100)
                assert stopped(), answer
                if stopper is one:      # in one burst: it cannot have been done before
                    assert not answer['ok']
                    assert 'cancelled' in answer['message']
                assert (await one.ask('reset'))['message'] == 'reset'

    asyncio.run(look())
    process.interrupt()


def test_nonsense_on_the_topics_does_not_end_the_page(processes, tmp_path):
    import rclpy
    from std_msgs.msg import String

    from dz_ros.nodes.ros import topics

    process, address = start(processes, tmp_path / 'run', '--duration', '600')

    received = threading.Event()

    def publish():
        rclpy.init()
        try:
            node = rclpy.create_node('nonsense')
            publisher = node.create_publisher(String, 'events', topics.everything('events'))
            deadline = time.monotonic() + TIME_OUT
            while not publisher.get_subscription_count():
                assert time.monotonic() < deadline
                rclpy.spin_once(node, timeout_sec=0.05)
            for text in texts:
                publisher.publish(String(data=text))
            received.wait(TIME_OUT)
        finally:
            rclpy.shutdown()

    texts = [
        '{"event": "action", "node": "/x", "values": {"a": NaN, "b": [1e400]}, "z": Infinity}',
        '{"event": "mode", "node": "/x", "mode": "\\ud800", "reason": "\\udfff"}',
        '{"event": "configuration", "node": "/x", "owns": [{}, []], "configuration": '
        '{"plant.disturbance_pulse": NaN}}', '[NaN]', '"\\ud800"',
        '{"event": "last", "node": "/x"}']

    async def look():
        async with Viewer(address) as viewer:
            await viewer.until(viewer.running)
            publishing = asyncio.get_running_loop().run_in_executor(None, publish)
            try:
                await viewer.until(lambda: any(text.get('event') == 'last'
                                               for text in viewer.texts))
            finally:
                received.set()
                await publishing
            odd = next(text for text in viewer.texts if text.get('node') == '/x')
            assert odd['values'] == {'a': None, 'b': [None]}
            seq = viewer.column('seq')[-1]
            await viewer.until(lambda: viewer.column('seq')[-1] > seq + 100)
            async with Viewer(address) as later:
                await later.until(later.running)

    asyncio.run(look())
    process.interrupt()


def test_in_lockstep_the_loop_is_the_same_with_a_page(processes, samples, tmp_path):
    process, address = start(processes, tmp_path / 'run', '--duration', '5', '--lockstep')

    async def look():
        async with Viewer(address) as viewer:
            await viewer.until(lambda: any(text.get('event') == 'finished'
                                           for text in viewer.texts))
            return viewer

    asyncio.run(look())
    assert process.wait() == 0
    data = read_run(tmp_path / 'run')
    run = simulate(load_configuration('servo', ['loop.duration=5', 'safety.fault_after=4000']))
    assert np.array_equal(samples(data.channels['command'])['v'], run.v)


def test_a_page_shows_the_loop_of_its_own_namespace(processes, tmp_path):
    for name, b_r in (('left', 0.25), ('right', 0.35)):
        processes(*DZ, 'run', 'servo', '--quiet', '--duration', '600', '--namespace', f'/{name}',
                  '--set', f'plant.dead_zone.b_r={b_r}')
    page = processes(*NODE, 'live_node', '--ros-args', '-r', '__ns:=/right')
    address = page.wait_for_line('live page:').split()[-1]

    async def look():
        async with Viewer(address) as viewer:
            await viewer.until(viewer.running)
            assert viewer.hello['namespace'] == '/right'
            assert set(viewer.column('zone_high')[-50:]) == {0.35}
            pressed = await viewer.ask('estop')
            assert pressed['ok']
            await viewer.until(lambda: any(text.get('mode') == 'estop' for text in viewer.texts))
            await viewer.until(lambda: viewer.texts[-1]['kind'] == 'status' and len(
                viewer.texts[-1]['nodes']) == 3)
            assert all(text['node'].startswith('/right/') for text in viewer.texts
                       if text['kind'] == 'event')

    asyncio.run(look())


def test_a_press_by_any_publisher_is_shown_until_the_reset(processes, tmp_path, operator):
    process, address = start(processes, tmp_path / 'run', '--duration', '600')
    press = operator.node.create_publisher(operator.bool, 'estop', 10)

    async def look():
        async with Viewer(address) as viewer:
            await viewer.until(viewer.running)
            press.publish(operator.bool(data=True))
            press.publish(operator.bool(data=False))
            await viewer.until(lambda: [text for text in viewer.texts if text['kind'] == 'status'
                                        ][-1]['estop'])
            await viewer.until(lambda: {
                node['name']: node['mode'] for node in [
                    text for text in viewer.texts if text['kind'] == 'status'][-1]['nodes']
                if node['mode'] == 'estop'}.keys() == {'plant_node', 'controller_node'})
            assert (await viewer.ask('reset'))['message'] == 'reset'
            await viewer.until(lambda: not [text for text in viewer.texts
                                            if text['kind'] == 'status'][-1]['estop'])

    operator.wait(lambda: press.get_subscription_count() >= 6)      # both ends and the page
    asyncio.run(look())
    process.interrupt()


BAD_EVENTS = (
    '{"ends": ' + '[' * 10_000, '{"ends": ' + '[' * 100_000, '[' * 100_000,
    '{"event": "stopped", "node": "/x", "ends": 5}',
    '{"event": "stopped", "node": ["x"], "ends": ["state", "command"]}', 'null', '"ends"',
    '{"event": "configuration", "node": "/x", "owns": 3, "configuration": {}}',
    '{"event": "configuration", "node": "/x", "owns": ["plant"], "seq": 1e308}',
    '{"event": "mode", "node": "/x", "mode": {}, "ends": ["state"]}',
    '{"event": "x", "node": "/x", "ends": "' + 'x' * 2_000_000 + '"}')
STATE = ('seq', 'stamp', 'x0', 'x1', 'echo_seq', 'echo_stamp', 'round_trip')
COMMAND = ('seq', 'stamp', 'v', 'echo_seq', 'echo_stamp', 'hold')
REFERENCE = ('seq', 'stamp', 'xd0', 'xd1', 'xd2')
BAD_ARRAYS = (
    ('state', STATE, 3, 4, (0.5, 1e308, -2.0)), ('state', STATE, 3, 0, (1e308, 0.5, -1.0)),
    ('state', STATE, 3, 1, (1e308, math.nan, -1e12)),
    ('command', COMMAND, 3, 3, (0.5, 1e308, math.inf)), ('command', COMMAND, 3, 0, (1e308, 2.5)),
    ('command', COMMAND, 3, 1, (1e308, math.nan)),
    ('reference', REFERENCE, 3, 1, (1e8, 1e308, math.nan)),
    ('terms', ('seq', 'stamp', *(f'n{i}' for i in range(20_000))), 3, 0, (1.0,)),
    ('terms', ('seq', 'stamp', 'a\n\x1b[2K', *('x' * 1000 for _ in range(9))), 3, 0, (1.0,)))
COUNTED = {
    'plant_node': ('events: nested too deeply', 'events: a field of a wrong type',
                   'events: longer than allowed', 'command: echo_seq is no count',
                   'command: seq is no count', 'command: stamp is no loop time'),
    'controller_node': ('events: nested too deeply', 'events: not an event',
                        'state: echo_seq is no count', 'state: seq is no count',
                        'state: stamp is no loop time', 'reference: stamp from the future'),
    'trajectory_node': ('state: echo_seq is no count', 'state: seq is no count',
                        'state: stamp is no loop time'),
    'recorder_node': ('events: nested too deeply', 'events: longer than allowed',
                      'events: a field of a wrong type')}
"""Node → causes by which it counts what it refused."""


def test_messages_made_to_break_end_neither_loop_nor_page_nor_recording(processes, tmp_path):
    import rclpy
    from std_msgs.msg import Float64MultiArray, MultiArrayDimension, String
    process, address = start(processes, tmp_path / 'run', '--duration', '600')
    context = rclpy.Context()
    context.init()
    node = rclpy.create_node('stranger', context=context)
    durable = rclpy.qos.QoSProfile(depth=20, durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL)
    events = node.create_publisher(String, 'events', durable)
    arrays = {topic: node.create_publisher(Float64MultiArray, topic, 10)
              for topic in ('state', 'command', 'reference', 'terms')}
    bad = []
    for topic, labels, value, place, values in BAD_ARRAYS:
        for odd in values:
            made = Float64MultiArray(data=[float(value)] * len(labels))
            made.data[place] = odd
            made.layout.dim.append(MultiArrayDimension(
                label=','.join(labels), size=len(labels), stride=len(labels)))
            bad.append((arrays[topic], made))
    bad += [(events, String(data=text)) for text in BAD_EVENTS]
    turn, missing = 0, []

    async def look():
        async with Viewer(address) as viewer:
            await viewer.until(viewer.running)

            def counted():
                nonlocal turn
                publisher, message = bad[turn % len(bad)]
                publisher.publish(message)
                turn += 1
                status = next((text for text in reversed(viewer.texts)
                               if text['kind'] == 'status'), {'nodes': ()})
                found = {item['name']: item['values'] for item in status['nodes']}
                missing[:] = [(name, cause) for name, causes in COUNTED.items()
                              for cause in causes if f'ignored {cause}' not in found.get(name, ())]
                return not missing

            await viewer.until(counted)
            seq = viewer.column('seq')[-1]
            await viewer.until(lambda: viewer.column('seq')[-1] > seq + 200)
            assert max(map(len, viewer.rows)) < 100
            assert (await viewer.ask('estop'))['ok']
            await viewer.until(lambda: all(item['mode'] == 'estop' for item in [
                text for text in viewer.texts if text['kind'] == 'status'][-1]['nodes']
                if item['name'] in ('plant_node', 'controller_node')))

    try:
        asyncio.run(look())
    finally:
        sys.stdout.write(f'{process.output}\n{missing}\n')      # shown where it fails
        node.destroy_node()
        context.shutdown()
    process.interrupt()
    assert 'Traceback' not in process.output
    assert '\x1b' not in process.output
    assert run_info(tmp_path / 'run').complete

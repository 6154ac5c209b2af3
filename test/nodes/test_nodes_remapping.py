# SPDX-License-Identifier: Apache-2.0
"""A loop whose nodes, namespaces, topics and services all have other names."""

import asyncio
import json
import re
import time

import pytest

from dz_ros.core.records import Command
from dz_ros.recording.reader import read_run, run_info
from dz_ros.replay.audit.audit import audit

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

NODE = ('-m', 'dz_ros.nodes.main')
DZ = ('-m', 'dz_ros')
# `wanted` and `taken` are themselves remapped: a name that is remapped twice is not found.
TOPICS = {'state': '/machine/measured', 'command': 'taken', 'taken': '/elsewhere',
          'reference': '/wanted', '/wanted': '/nowhere', 'terms': 'law/terms', 'truth': 'inside',
          'events': '/machine/log', 'estop': '/stop_all', '/diagnostics': '/health'}
SERVICES = {'plant_node': {'~/reset': '/operate/free_axis', '~/estop': '/operate/stop_axis'},
            'controller_node': {'~/reset': 'free_law', '~/estop': 'stop_law',
                                '~/set_parameters_atomically': 'tune_law'}}
NAMES = {'plant_node': 'axis', 'controller_node': 'law', 'trajectory_node': 'planner',
         'recorder_node': 'logger'}
SPACE = '/cell/left'
SETTINGS = {'loop.duration': '0.0', 'safety.state_hold': '200', 'safety.command_hold': '100',
            'safety.echo_limit': '200', 'safety.fault_after': '2000', 'loop.peers':
            '["axis", "controller_node", "trajectory_node", "logger"]'}


def rules(node, more=()):
    """Return the arguments with which a node gets all its names, by rules for this node alone."""
    name = NAMES[node]
    given = {**TOPICS, **SERVICES.get(node, {})}
    words = ['-r', f'{node}:__node:={name}', '-r', f'__ns:={SPACE}']
    for old, new in given.items():
        words += ['-r', f'{name}:{old}:={new}']
    for key, value in SETTINGS.items():
        words += ['-p', f'{key}:={value}']
    return ['--ros-args', *words, *more]


class Outside:
    """A node of another program: it knows the names that are out there, and no others."""

    def __init__(self):
        from std_msgs.msg import Float64MultiArray, String
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node('outside', context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.kind, self.states, self.events, self.commands = Float64MultiArray, [], [], []
        self.node.create_subscription(self.kind, '/machine/measured', self.states.append, 100)
        self.node.create_subscription(self.kind, f'{SPACE}/taken', self.commands.append, 100)
        self.node.create_subscription(
            String, '/machine/log', lambda text: self.events.append(json.loads(text.data)),
            rclpy.qos.QoSProfile(depth=200,
                                 durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL))

    def wait(self, condition, timeout=60.0):
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, f'not in time: {self.events[-5:]}'
            self.executor.spin_once(timeout_sec=0.1)

    def mode(self, name):
        return next(((item['mode'], item['reason']) for item in reversed(self.events)
                     if item['event'] == 'mode' and item['node'] == f'{SPACE}/{name}'), ('', ''))

    def running(self):
        self.wait(lambda: self.mode('axis')[0] == self.mode('law')[0] == 'running')
        received = len(self.states)
        self.wait(lambda: len(self.states) > received + 20)

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.shutdown()


@pytest.fixture
def outside(ros_domain):
    made = Outside()
    yield made
    made.close()


def operate(processes, verb, *more):
    """Do a verb of `dz` with the rules an operator gives; return its process, ended."""
    given = [('estop', '/stop_all'), ('/diagnostics', '/health'),
             (f'{SPACE}/axis/reset', '/operate/free_axis'), (f'{SPACE}/law/reset', 'free_law'),
             (f'{SPACE}/axis/estop', '/operate/stop_axis'), (f'{SPACE}/law/estop', 'stop_law'),
             ('state', '/machine/measured'),
             ('command', 'taken')]
    words = [word for old, new in given for word in ('--remap', f'{old}:={new}')]
    process = processes(*DZ, verb, *words, *more)
    process.wait()
    return process


def test_a_loop_runs_whatever_its_names_are(processes, outside, tmp_path):
    nodes = {name: processes(*NODE, name, *rules(name, ['-p', f'directory:={tmp_path / "run"}']
                                                 if name == 'recorder_node' else ()))
             for name in ('recorder_node', 'plant_node', 'trajectory_node', 'controller_node')}
    outside.running()
    # What a node has latched comes when its publisher is found, in any order of the nodes.
    outside.wait(lambda: {item['node'] for item in outside.events} >= {
        f'{SPACE}/{name}' for name in ('axis', 'law', 'planner')})

    # A second publisher of commands is seen under the name that the topic really has.
    rival = outside.node.create_publisher(outside.kind, f'{SPACE}/taken', 10)
    sent = iter(range(10 ** 6))

    def rivalled():
        message = outside.kind(data=[float(next(sent)), *outside.states[-1].data[1:2], 3.0,
                                     *outside.states[-1].data[:2], 0.0])
        message.layout.dim = outside.commands[-1].layout.dim
        rival.publish(message)
        return outside.mode('axis')[0] == 'fault'

    assert len(Command.labels()) == 6
    outside.wait(rivalled)
    assert outside.mode('axis')[1] == '2 publishers of commands'
    outside.node.destroy_publisher(rival)

    there = ('--namespace', SPACE)
    done = operate(processes, 'reset', *there)
    assert done.poll() == 0, done.output
    outside.running()
    done = operate(processes, 'estop', *there)
    assert done.poll() == 0, done.output
    outside.wait(lambda: outside.mode('axis')[0] == outside.mode('law')[0] == 'estop')
    done = operate(processes, 'reset', *there)
    assert done.poll() == 0, done.output
    outside.running()
    for _ in range(20):         # it shows what comes in three seconds
        status = operate(processes, 'status', '--once')
        if all(f'{SPACE}/{name}' in status.output for name in NAMES.values()):
            break
    else:
        raise AssertionError(status.output)

    for name in ('plant_node', 'controller_node', 'trajectory_node', 'recorder_node'):
        assert nodes[name].interrupt() == 0, nodes[name].output
    assert set(run_info(tmp_path / 'run').topics) == {
        '/machine/measured', f'{SPACE}/taken', '/wanted', f'{SPACE}/law/terms', f'{SPACE}/inside',
        '/machine/log'}
    data = read_run(tmp_path / 'run')
    assert set(data.channels) == {'state', 'command', 'reference', 'terms', 'truth'}
    assert data.channels['state']['seq'][0] == 0.0
    assert len(data.channels['command']) > 100
    assert {event[1] for event in data.events} >= {f'{SPACE}/axis', f'{SPACE}/law'}
    found = audit(data)      # finds its way to the configuration and recomputes
    assert found.spans
    assert not any(span.problem for span in found.spans)


def test_the_page_acts_on_a_loop_whatever_its_names_are(processes, outside):
    aiohttp = pytest.importorskip('aiohttp', reason='aiohttp is not installed: no page to serve')
    given = {**SETTINGS, 'loop.peers': '["axis", "law", "planner"]'}
    names = ('plant_node', 'trajectory_node', 'controller_node')
    for name in names:
        words = [word for key, value in given.items() for word in ('-p', f'{key}:={value}')]
        processes(*NODE, name, *rules(name, words))
    own = [word for old, new in {
        **TOPICS, f'{SPACE}/axis/reset': '/operate/free_axis', f'{SPACE}/law/reset':
        f'{SPACE}/free_law', f'{SPACE}/law/set_parameters_atomically': f'{SPACE}/tune_law'}.items()
        for word in ('-r', f'{old}:={new}')]
    page = processes(*NODE, 'live_node', '--ros-args', '-r', f'__ns:={SPACE}', *own)
    address = page.wait_for_line('live page:').split()[-1]
    outside.running()

    async def act():
        base, _, token = address.partition('#')
        answers = []
        async with aiohttp.ClientSession() as session, session.ws_connect(
                base + 'ws', headers={'Origin': base.rstrip('/')}, max_msg_size=0) as page:
            await page.send_json({'hello': 1, 'token': token, 'seconds': 60})
            while True:
                message = await page.receive(60.0)
                text = (json.loads(message.data) if message.type is aiohttp.WSMsgType.TEXT
                        else {'kind': 'rows'})
                if text['kind'] == 'rows':
                    break
            number = 0
            for request in ({'do': 'estop'}, {'do': 'reset'},
                            {'do': 'set', 'values': {'controller.lambda': 1.5}}):
                for _ in range(20):
                    number += 1
                    await page.send_json({**request, 'id': number, 'asked': time.time()})
                    answer = {}
                    while answer.get('id') != number:
                        message = await page.receive(60.0)
                        if message.type is aiohttp.WSMsgType.TEXT:
                            answer = json.loads(message.data)
                    # Refused while a machine that stalls keeps the loop, or this page, silent.
                    if answer['ok'] or not re.search(
                            r'no \w+ arrives|it was asked|within|cancelled',
                            answer.get('message', '')):
                        break
                answers.append(answer)
        return answers

    for answer in asyncio.run(act()):
        assert answer['ok'], answer
    outside.running()
    outside.wait(lambda: any(item['event'] == 'configuration' and item['configuration'].get(
        'controller.lambda') == 1.5 and item['node'] == f'{SPACE}/law' for item in outside.events))

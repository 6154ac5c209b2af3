# SPDX-License-Identifier: Apache-2.0
"""Managed nodes as an operator meets them: transitions, e-stop, reset, watchdogs, live gains.

Over 300 lines: all of it operates the same loop by the same services.
"""

from dataclasses import replace
from itertools import pairwise
import math
import os
from pathlib import Path
import re
import signal
import time

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import Command, State, Status, Terms
from dz_ros.files.configurations import load_configuration
from dz_ros.recording.reader import read_run
from dz_ros.replay.audit.audit import audit

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

NODE = ('-m', 'dz_ros.nodes.main')
DZ = ('-m', 'dz_ros')
CONFIG = Path(__file__).parents[2] / 'config' / 'servo.yaml'
NAMES = ('plant_node', 'controller_node', 'trajectory_node')
TIME_OUT, TRIES = 180.0, 5
LONG = ('-p', 'loop.duration:=0.0')


@pytest.fixture
def loop(processes, operator):
    """Return node name → process of a loop that runs."""
    return running_loop(processes, operator)


@pytest.fixture
def patient_loop(processes, operator):
    """Return the same of a loop that a stall of the machine does not stop."""
    return running_loop(processes, operator, *(word for name in (
        'fault_after', 'command_hold', 'state_hold', 'reference_hold', 'echo_limit') for word in (
            '-p', f'safety.{name}:=400')))


def running_loop(processes, operator, *more):
    nodes = {name: start(processes, name, *more) for name in NAMES}
    operator.wait_for_mode(plant_node='running', controller_node='running')
    operator.wait(lambda: len(operator.received['state']) > 50
                  and all(operator.received.values()))
    return nodes


def start(processes, name, *more):
    return processes(*NODE, name, '--ros-args', '--params-file', CONFIG, *LONG, *more)


def held(truth):
    """Return the command the actuator holds, by what the plant reports of its dead-zone, m = 1."""
    return truth.data[2] - truth.data[3]


def test_a_killed_controller_leaves_the_safe_command_within_three_samples(
        processes, loop, operator):
    loop['controller_node'].signal(signal.SIGKILL)
    loop['controller_node'].wait()
    operator.wait_for_mode(plant_node='fault')
    assert operator.modes()['plant_node'] == ('fault', 'no command')
    operator.wait(lambda: held(operator.received['truth'][-1]) == 0.0)
    # Counted in samples: a machine that stalls skips their times, not their numbers.
    echoes = [(message.data[0], message.data[4]) for message in operator.received['state']]
    arrived = next(seq for seq, echo in echoes if echo == max(echo for _, echo in echoes))
    released = next(message.data[0] for message in operator.received['truth']
                    if held(message) == 0.0 and message.data[0] >= arrived)
    assert 0.0 <= released - arrived <= 4.0
    # After a stall the controller may have given the safe command last.
    assert released > arrived or operator.received['command'][-1].data[2] == 0.0
    start(processes, 'controller_node')
    received = len(operator.received['command'])
    operator.wait(lambda: len(operator.received['command']) > received + 20)
    operator.start_again()
    operator.wait(lambda: held(operator.received['truth'][-1]) != 0.0)


def test_estop_by_topic_stops_both_ends_and_only_their_resets_release_it(loop, operator):
    publisher = operator.node.create_publisher(operator.bool, 'estop', rclpy.qos.QoSProfile(
        depth=1, durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL))
    publisher.publish(operator.bool(data=True))
    operator.wait_for_mode(plant_node='estop', controller_node='estop')
    operator.wait(lambda: operator.received['command'][-1].data[2] == 0.0)
    received = len(operator.received['terms'])
    operator.wait(lambda: len(operator.received['terms']) > received + 20)
    terms = [message.data for message in operator.received['terms'][-10:]]
    labels = operator.received['terms'][-1].layout.dim[0].label.split(',')
    assert labels[:12] == list(Terms.labels(())[:12])
    assert {data[labels.index('status')] for data in terms} == {float(Status.INACTIVE)}
    assert len({tuple(data[14:]) for data in terms}) == 1       # estimates stand still
    refused = operator.call('plant_node/reset')
    assert not refused.success
    assert 'still pressed' in refused.message
    publisher.publish(operator.bool(data=False))
    operator.start_again()


def test_ends_that_poll_serve_estop_and_services_all_the_same(processes, operator):
    for name in NAMES:
        start(processes, name, '-p', 'process.poll:=both')
    operator.wait_for_mode(plant_node='running', controller_node='running')
    operator.wait(lambda: len(operator.received['state']) > 50)
    for name in NAMES[:2]:
        assert operator.call(f'{name}/estop').success
    operator.wait_for_mode(plant_node='estop', controller_node='estop')
    operator.wait(lambda: held(operator.received['truth'][-1]) == 0.0)
    operator.start_again()
    operator.wait(lambda: held(operator.received['truth'][-1]) != 0.0)


def test_estop_and_reset_from_the_command_line(processes, loop, operator):
    assert processes(*DZ, 'estop').wait() == 0
    operator.wait_for_mode(plant_node='estop', controller_node='estop')
    status = processes(*DZ, 'status', '--once')
    assert status.wait() == 1, status.output
    for name in NAMES[:2]:
        assert re.search(f'ERROR  /{name}: estop: e-stop by (topic|service)', status.output), (
            status.output)
    for _ in range(5):      # refused while a stalled machine keeps the loop silent
        reset = processes(*DZ, 'reset')
        if reset.wait() == 0:
            break
    assert reset.wait() == 0, reset.output
    operator.wait_for_mode(plant_node='running', controller_node='running')


def test_bad_messages_reach_neither_actuator_nor_estimates(loop, operator):
    publishers = {topic: operator.node.create_publisher(operator.array, topic, 10)
                  for topic in ('command', 'state', 'reference')}
    operator.wait(lambda: all(item.get_subscription_count() for item in publishers.values()))
    for bad in (math.nan, math.inf, -math.inf):
        for topic, labels in (('command', Command.labels()), ('state', State.labels(2)),
                              ('reference', ('seq', 'stamp', 'xd0', 'xd1', 'xd2'))):
            for place in range(len(labels)):
                data = [1e7] * len(labels)
                data[place] = bad
                publishers[topic].publish(message(operator, labels, data))
            publishers[topic].publish(message(operator, labels, [bad]))
            publishers[topic].publish(message(operator, ('nonsense', *labels), [bad] * 9))
            publishers[topic].publish(operator.array(data=[bad]))
    received = len(operator.received['state'])
    operator.wait(lambda: len(operator.received['state']) > received + 100)
    for topic in ('terms', 'truth'):
        for item in operator.received[topic][-100:]:
            assert all(map(math.isfinite, item.data))
    operator.wait_for_mode(plant_node='running', controller_node='running')
    for node in loop.values():
        assert node.poll() is None
        assert 'Traceback' not in node.output


def test_requests_that_rclpy_cannot_read_are_refused_and_end_no_node(loop, operator):
    from rcl_interfaces.msg import Parameter, ParameterValue
    from rcl_interfaces.srv import SetParameters
    parameters = [Parameter(name='controller.k_d', value=ParameterValue(type=77))]
    for node in NAMES:
        for kind, service in ((operator.set_atomically, 'set_parameters_atomically'),
                              (SetParameters, 'set_parameters')):
            answer = operator.call(f'{node}/{service}', kind, kind.Request(parameters=parameters))
            result = getattr(answer, 'result', None) or answer.results[0]
            assert not result.successful
            assert result.reason.startswith('a request that cannot be understood: ValueError: 77')
        assert operator.lifecycle(node) == 'active'
    for node in loop.values():
        assert node.poll() is None
        assert 'Traceback' not in node.output
        assert 'set_parameters: a request that cannot be understood (1 so far)' in node.output


def message(operator, labels, data):
    from std_msgs.msg import MultiArrayDimension
    made = operator.array(data=data)
    made.layout.dim.append(MultiArrayDimension(label=','.join(labels), size=len(data),
                                               stride=len(data)))
    return made


def test_two_controllers_are_a_fault_at_the_actuator(processes, loop, operator):
    publisher = operator.node.create_publisher(operator.array, 'command', 10)
    operator.wait(lambda: publisher.get_subscription_count() > 0)
    labels = Command.labels()
    deadline = time.monotonic() + TIME_OUT
    while operator.modes()['plant_node'][0] != 'fault':
        assert time.monotonic() < deadline
        state = operator.received['state'][-1].data
        publisher.publish(message(operator, labels, [3.0, state[1], 5.0, state[0], state[1], 0.0]))
        operator.executor.spin_once(timeout_sec=0.01)
    assert operator.modes()['plant_node'][1] == '2 publishers of commands'


def test_gains_and_limits_change_while_it_runs_structure_does_not(patient_loop, operator):
    def stated(gain):
        return [event for event in operator.events if event['event'] == 'configuration'
                and event['node'] == '/controller_node'
                and event['configuration']['controller.k_d'] == gain]

    def changed(earlier, gain):
        """Change the gain; return whether the first sample it holds for is one of the law."""
        operator.start_again()      # a long stall may have latched a fault before
        assert operator.set('controller_node', controller__k_d=gain,
                            safety__command_limit=50.0).successful
        operator.wait(lambda: stated(gain))
        event = stated(gain)[0]
        operator.wait(lambda: operator.received['terms'][-1].data[0] > event['seq'] + 20)
        first = None
        for item in operator.received['terms']:
            seq, s, damping = item.data[0], item.data[2], item.data[5]
            if event['seq'] - 20 <= seq < event['seq'] + 20 and item.data[11] == 0.0:
                assert damping == -(gain if seq >= event['seq'] else earlier) * s
            if seq == event['seq']:
                first = item
        # A stall of the machine may have the controller give the safe command just then.
        if first is None or int(first.data[11]) & Status.INACTIVE:
            return False
        names = first.layout.dim[0].label.split(',')
        law = Configuration.from_flat(event['configuration'], driven=False).law
        # Reported again where an update was taken back, as its answer came too late to count.
        reported = [other['memory'] for other in stated(gain) if other['seq'] == event['seq']]
        signals = first.data[names.index('echo_seq') + 1:]
        assert list(law.memory_from_signals(signals)) == reported[-1]
        return True

    operator.wait(lambda: any(event['event'] == 'configuration' for event in operator.events))
    gain = next(event['configuration']['controller.k_d'] for event in operator.events
                if event['event'] == 'configuration' and event['node'] == '/controller_node')
    gains = [gain, *(gain * (2.0 + 0.01 * step) for step in range(5))]
    assert any(changed(*pair) for pair in pairwise(gains)), operator.modes()
    for key, value, words in (('controller__k_d', -1.0, 'k_d'),
                              ('safety__safe_command', 60.0, 'command_limit'),
                              ('controller__theta_0', [0.5] * 10_001, '10001 items: at most'),
                              ('loop__rate', 100.0, 'read-only'),
                              ('controller__law', 'pd', 'read-only')):
        refused = operator.set('controller_node', **{key: value})
        assert not refused.successful
        assert words in refused.reason
    assert operator.set('plant_node', plant__dead_zone__b_r=0.4).successful


def test_standard_transitions_and_bumpless_activation(loop, operator):
    assert operator.lifecycle('/controller_node') == 'active'
    assert operator.change('/controller_node', 4)       # deactivate
    assert operator.lifecycle('/controller_node') == 'inactive'
    operator.wait_for_mode(plant_node='waiting')
    operator.wait(lambda: [item.data[2] for item in operator.received['command'][-5:]] == [
        0.0] * 5)
    assert not operator.change('/controller_node', 1)   # configure: not possible now
    assert loop['controller_node'].poll() is None
    assert operator.set('controller_node', safety__rate_limit=20.0).successful
    received = len(operator.received['command'])
    assert operator.change('/controller_node', 3)       # activate
    operator.wait_for_mode(plant_node='running', controller_node='running')
    operator.wait(lambda: len(operator.received['command']) > received + 100)
    v = [0.0, *(item.data[2] for item in operator.received['command'][received:])]
    stamps = [item.data[1] for item in operator.received['command'][received:]]
    for k in range(len(stamps) - 1):
        if v[k + 2] == 0.0:         # a stalled machine: the safe command comes at once
            continue
        assert abs(v[k + 2] - v[k + 1]) <= 20.0 * (stamps[k + 1] - stamps[k]) + 1e-9
    assert abs(v[1]) <= 20.0 * 0.005 + 1e-9
    assert operator.change('/controller_node', 4)
    assert operator.change('/controller_node', 2)       # cleanup
    assert operator.change('/controller_node', 1)
    assert operator.change('/controller_node', 3)
    operator.wait_for_mode(plant_node='running', controller_node='running')


def test_a_node_that_is_not_to_start_by_itself_waits_for_its_manager(processes, operator):
    node = start(processes, 'controller_node', '-p', 'autostart:=false')
    assert operator.lifecycle('/controller_node') == 'unconfigured'
    assert operator.change('/controller_node', 1)
    assert operator.lifecycle('/controller_node') == 'inactive'
    assert operator.change('/controller_node', 6)       # shutdown while inactive
    assert node.wait() == 0, node.output


def test_a_second_node_of_a_loop_is_refused_in_one_line(processes, loop, operator):
    second = start(processes, 'controller_node')
    assert second.wait() == 2
    assert second.output.startswith('controller_node: error: topic /command is published by')
    assert second.output.count('\n') == 0
    operator.wait_for_mode(plant_node='running', controller_node='running')


def test_a_stopped_trajectory_becomes_a_fault_and_the_loop_goes_on_after_reset(
        processes, loop, operator):
    for _ in range(TRIES):      # a stall of the machine may have the state fail first
        os.kill(loop['trajectory_node'].pid, signal.SIGSTOP)
        operator.wait_for_mode(controller_node='fault')
        if operator.modes()['controller_node'][1] == 'no reference':
            break
        os.kill(loop['trajectory_node'].pid, signal.SIGCONT)
        operator.start_again()
    assert operator.modes()['controller_node'] == ('fault', 'no reference')
    assert not operator.call('controller_node/reset').success
    os.kill(loop['trajectory_node'].pid, signal.SIGCONT)
    operator.start_again()


@pytest.mark.parametrize('limit', ['command_limit=5', 'rate_limit=60', 'ramp=0.5'])
def test_a_limited_run_is_reproduced_bit_for_bit_by_its_audit(processes, tmp_path, limit):
    run = processes(*DZ, 'run', 'wang2004', '--lockstep', '--duration', '2', '--quiet',
                    '--record', tmp_path / 'run', '--set', f'safety.{limit}')
    assert run.wait() == 0, run.output
    data = read_run(tmp_path / 'run')
    found = audit(data)
    assert found.passed, found
    v = data.channels['command']['v']
    free = simulate(load_configuration('wang2004', ['loop.duration=2'])).v
    assert np.abs(v[0]) < np.abs(free[0])
    if limit == 'command_limit=5':
        assert np.abs(v).max() == 5.0
    frozen = data.channels['terms']['status'] == float(Status.SATURATED)
    assert frozen.any()
    assert np.all(data.channels['terms']['dt'][frozen] == 0.0)
    # A command that is not what the command limiter applies is found.
    k = int(np.flatnonzero(frozen)[0])
    values = data.channels['command'].values.copy()
    values[k, 2] += 1e-12
    data.channels['command'] = replace(data.channels['command'], values=values)
    assert not audit(data).passed


def test_diagnostics_report_what_is_wrong(loop, operator):
    from diagnostic_msgs.msg import DiagnosticArray
    reported = {}

    def keep(array):
        for status in array.status:
            reported[status.name] = status

    operator.node.create_subscription(DiagnosticArray, '/diagnostics', keep, 10)
    operator.wait(lambda: set(reported) == {f'/{name}' for name in NAMES})
    values = {item.key: item.value for item in reported['/controller_node'].values}
    assert {'rate [Hz]', 'period p99 [ms]', 'state to command p99 [ms]', 'max |s|/epsilon',
            'variation of v over the expected', 'frozen: saturated [samples]'} <= set(values)
    assert float(values['rate [Hz]']) > 50.0
    assert reported['/plant_node'].hardware_id
    operator.call('plant_node/estop')
    operator.wait(lambda: reported['/controller_node'].level == b'\x02'
                  and 'estop: e-stop by service' in reported['/plant_node'].message)
    assert reported['/plant_node'].level == b'\x02'

# SPDX-License-Identifier: Apache-2.0
"""The host with drivers that fail: faults latched with their words, resets, what is recorded."""

from __future__ import annotations

import json
import os
from pathlib import Path
import signal
import time

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.offline import simulate
from dz_ros.recording.reader import read_run
from dz_ros.replay.audit.audit import audit

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

ROOT = Path(__file__).parents[2]
NODE = ('-m', 'dz_ros.nodes.main')
DZ = ('-m', 'dz_ros')
TIME_OUT = 180.0


class Subscriber:
    """Receives modes, diagnostics and states; calls services."""

    def __init__(self):
        from diagnostic_msgs.msg import DiagnosticArray
        from std_msgs.msg import Float64MultiArray, String
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node('subscriber', context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.events, self.states, self.reported = [], [], {}
        durable = rclpy.qos.QoSProfile(
            depth=200, durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(
            String, 'events', lambda message: self.events.append(json.loads(message.data)),
            durable)
        self.node.create_subscription(Float64MultiArray, 'state', self.states.append, 1000)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._receive, 10)

    def _receive(self, message):
        for status in message.status:
            self.reported[status.name] = status

    def wait(self, condition):
        deadline = time.monotonic() + TIME_OUT
        while not condition():
            assert time.monotonic() < deadline, f'not in time; {self.events[-3:]}'
            self.executor.spin_once(timeout_sec=0.1)

    def mode(self, name='actuator_node'):
        found = [event for event in self.events
                 if event['event'] == 'mode' and event['node'] == f'/{name}']
        return (found[-1]['mode'], found[-1]['reason']) if found else ('', '')

    def values(self, name='/actuator_node'):
        return {item.key: item.value for item in self.reported[name].values}

    def call(self, service, kind=None, request=None):
        from std_srvs.srv import Trigger
        kind = kind or Trigger
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(TIME_OUT)
        future = client.call_async(request or kind.Request())
        self.wait(future.done)
        return future.result()

    def change(self, number):
        from lifecycle_msgs.srv import ChangeState
        request = ChangeState.Request()
        request.transition.id = number
        return self.call('actuator_node/change_state', ChangeState, request).success

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.shutdown()


@pytest.fixture
def subscriber(ros_domain):
    made = Subscriber()
    yield made
    made.close()


@pytest.fixture
def run(processes):
    """Return the function that starts a loop with the mock and its script."""
    def start(*script, options=(), **overrides):
        keys = {'driver.name': 'mock', 'driver.script': list(script), 'loop.duration': 0,
                **{key.replace('__', '.'): value for key, value in overrides.items()}}
        words = [word for key, value in keys.items()
                 for word in ('--set', f'{key}={json.dumps(value)}')]
        return processes(*DZ, 'run', 'servo', '--quiet', *options, *words)
    return start


def test_a_fault_of_the_device_is_latched_in_its_words_until_reset(run, processes, subscriber):
    loop = run('100 fault over-temperature')
    subscriber.wait(lambda: subscriber.mode()[0] == 'fault')
    assert subscriber.mode() == ('fault', 'over-temperature')
    received = len(subscriber.states)
    subscriber.wait(lambda: len(subscriber.states) > received + 50)    # states go on meanwhile
    status = processes(*DZ, 'status', '--once')
    assert status.wait() == 1
    assert 'ERROR  /actuator_node: fault: over-temperature' in status.output
    assert processes(*DZ, 'reset').wait() == 0
    subscriber.wait(lambda: {subscriber.mode()[0], subscriber.mode('controller_node')[0]} == {
        'running'})
    loop.signal(signal.SIGINT)
    assert loop.wait() == 0, loop.output


def test_a_fault_that_lasts_is_why_a_reset_is_refused(run, subscriber):
    run('50- fault bus off')
    subscriber.wait(lambda: subscriber.mode() == ('fault', 'bus off'))
    refused = subscriber.call('actuator_node/reset')
    assert (refused.success, refused.message) == (False, 'bus off')


def test_one_that_refuses_to_recover_reports_it(run, subscriber):
    run('50 fault hot', 'recover wait an hour')
    subscriber.wait(lambda: subscriber.mode()[0] == 'fault')
    refused = subscriber.call('actuator_node/reset')
    assert (refused.success, refused.message) == (False, 'wait an hour')


def test_samples_without_a_measurement_have_no_state_and_too_many_are_a_fault(
        run, subscriber, tmp_path):
    recorded = tmp_path / 'run'
    loop = run('100 none', '150 nan', '200- none', options=('--record', recorded))
    subscriber.wait(lambda: subscriber.mode()[0] == 'fault')
    assert subscriber.mode()[1].startswith('no measurement for ')
    subscriber.wait(lambda: '/actuator_node' in subscriber.reported
                    and int(subscriber.values()['samples without measurement']) > 100)
    assert subscriber.values()['bad measurements'] == '1'
    loop.interrupt()
    sequence = set(map(int, read_run(recorded).channels['state']['seq']))
    assert not {100, 150} & sequence
    assert 150 < max(sequence) < 200


def test_code_that_raises_ends_no_process(run, subscriber):
    loop = run('60-80 raise broken wire')
    subscriber.wait(lambda: subscriber.mode()[0] == 'fault')
    assert 'RuntimeError: broken wire (mock.py, line ' in subscriber.mode()[1]
    received = len(subscriber.states)
    subscriber.wait(lambda: len(subscriber.states) > received + 20)
    assert loop.poll() is None


@pytest.mark.parametrize('what', ['open', 'enable'])
def test_a_device_that_is_not_there_ends_the_run_in_one_line(run, what):
    loop = run(f'{what} no such bus')
    assert loop.wait() == 2
    assert 'actuator_node: error: no such bus' in loop.output
    assert 'Traceback' not in loop.output


def test_a_refused_activation_leaves_the_node_inactive_and_may_be_tried_again(
        processes, subscriber):
    node = processes(*NODE, 'actuator_node', '--ros-args', '-p', 'driver.name:=mock', '-p',
                     "driver.script:=['enable not now']", '-p', 'autostart:=false', '-p',
                     "loop.peers:=['plant_node']")
    assert subscriber.change(1)
    assert not subscriber.change(3)
    from rcl_interfaces.srv import SetParameters
    request = SetParameters.Request(parameters=[rclpy.parameter.Parameter(
        'driver.script', value=['0 none']).to_parameter_msg()])
    assert subscriber.call('actuator_node/set_parameters', SetParameters,
                           request).results[0].successful
    assert subscriber.change(3)
    assert subscriber.change(4)
    assert subscriber.change(2)
    assert subscriber.change(1)
    assert node.interrupt() == 0
    assert 'not now' in node.output


def test_a_device_that_is_stopped_by_itself_is_reset_while_inactive(processes, subscriber,
                                                                    tmp_path):
    (tmp_path / 'stopped.py').write_text(
        'from dz_ros.drivers.simulated import SimulatedActuator\n'
        'from dz_ros.errors import DriverError\n\n\n'
        'class Stopped(SimulatedActuator):\n    name, latched = "stopped", True\n\n'
        '    def fault(self):\n        return "e-stop" if self.latched else ""\n\n'
        '    def enable(self):\n        if self.latched:\n'
        '            raise DriverError("e-stop")\n\n'
        '    def recover(self):\n        self.latched = False\n', encoding='utf-8')
    node = processes(*NODE, 'actuator_node', '--ros-args', '-p', 'driver.name:=stopped:Stopped',
                     '-p', 'autostart:=false', '-p', "loop.peers:=['plant_node']",
                     PYTHONPATH=os.pathsep.join([str(ROOT), str(tmp_path),
                                                 os.environ.get('PYTHONPATH', '')]))
    assert subscriber.call('actuator_node/reset').message == 'nothing is latched'
    assert subscriber.change(1)
    assert not subscriber.change(3)
    answer = subscriber.call('actuator_node/reset')
    assert answer.success, answer.message
    assert subscriber.change(3)
    assert node.interrupt() == 0


def test_saturation_is_counted_and_warned_of(run, subscriber):
    run(driver__limit=0.05)
    subscriber.wait(lambda: '/actuator_node' in subscriber.reported and int(
        subscriber.values()['saturated by the device [commands]']) > 100)
    subscriber.wait(lambda: 'beyond the limit 0.05 of the device'
                    in subscriber.reported['/actuator_node'].message)
    assert subscriber.values()['driver'] == 'mock'


def test_positions_alone_close_the_loop_and_the_rule_is_reported(run, subscriber):
    loop = run(driver__measures=1, driver__observer=5.0, plant__noise=[1e-5, 0.0])
    loop.wait_for_line('design rule observer')
    subscriber.wait(lambda: len(subscriber.states) > 300)
    data = np.array([message.data for message in subscriber.states[-200:]])
    assert data.shape[1] == 7       # seq, stamp, x0, x1, echoes, round trip
    assert np.abs(data[:, 3]).max() > 0.0


def test_in_lockstep_the_mock_repeats_the_loop_offline_bit_for_bit(processes, samples, tmp_path):
    done = processes(*DZ, 'run', 'wang2004', '--lockstep', '--duration', '1', '--quiet',
                     '--set', 'driver.name=mock', '--record', tmp_path / 'run')
    assert done.wait() == 0, done.output
    data = read_run(tmp_path / 'run')
    expected = simulate(Configuration.from_flat({'loop.duration': 1.0}))
    assert np.array_equal(samples(data.channels['state']).values[:, 2:4], expected.x)
    assert 'truth' in data.channels


def test_in_lockstep_a_sample_without_measurement_is_passed_over(processes, tmp_path):
    done = processes(*DZ, 'run', 'wang2004', '--lockstep', '--duration', '1', '--quiet', '--set',
                     'driver.name=mock', '--set', "driver.script=['50 none']", '--record',
                     tmp_path / 'run')
    assert done.wait() == 0, done.output
    sequence = [int(row[0]) for row in read_run(tmp_path / 'run').channels['state'].values]
    assert sorted(set(range(201)) - set(sequence)) == [50]
    found = audit(read_run(tmp_path / 'run'))
    assert found.compared
    assert not found.differences


REAL = ('from dz_ros.drivers.simulated import SimulatedActuator\n\n\n'
        'class Real(SimulatedActuator):\n'
        '    name = "real"\n    summary = "as a real one: no truth"\n    lockstep = False\n')


def test_a_run_is_read_where_its_driver_is_not_installed(processes, tmp_path, patient):
    (tmp_path / 'real_driver.py').write_text(REAL, encoding='utf-8')
    path = os.pathsep.join([str(ROOT), str(tmp_path)])
    run = tmp_path / 'run'
    done = processes(*DZ, 'run', 'servo', *patient, '--duration', '3', '--quiet',
                     '--set', 'driver.name=real_driver:Real', '--record', run, PYTHONPATH=path)
    assert done.wait() == 0, done.output
    (tmp_path / 'real_driver.py').unlink()
    data = read_run(run)
    assert data.configuration['driver.name'] == 'real_driver:Real'
    assert not [key for key in data.configuration if key.startswith('plant.dead_zone')]
    found = audit(data)
    assert found.compared
    assert not found.differences
    for words in (('bag', 'audit', run), ('report', run, '--out', tmp_path / 'report'),
                  ('bag', 'whatif', run, '--config', ROOT / 'config' / 'servo.yaml',
                   '--set', 'controller.lambda=2')):
        read = processes(*DZ, *words, cwd=tmp_path, PYTHONPATH=str(ROOT))
        assert read.wait(300.0) == 0, read.output


def test_the_plant_s_node_does_not_pretend_to_be_another_driver(processes):
    node = processes(*NODE, 'plant_node', '--ros-args', '-p', 'driver.name:=mock')
    assert node.wait() == 2
    assert 'plant_node simulates: start actuator_node' in node.output


def test_a_real_driver_has_no_lockstep(processes, tmp_path):
    (tmp_path / 'real_driver.py').write_text(REAL, encoding='utf-8')
    done = processes(*DZ, 'run', 'servo', '--lockstep', '--set', 'driver.name=real_driver:Real',
                     PYTHONPATH=os.pathsep.join([str(ROOT), str(tmp_path)]))
    assert done.wait() == 2
    assert 'a device keeps time' in done.output


def test_a_controller_needs_no_driver_s_class(processes, subscriber):
    node = processes(*NODE, 'controller_node', '--ros-args', '-p', 'driver.name:=not_here',
                     '-p', 'driver.port:=/dev/null')
    subscriber.wait(lambda: any(event['event'] == 'configuration' for event in subscriber.events))
    assert node.interrupt() == 0, node.output

# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of nodes: a recorded run, a node that hears a loop."""

from dataclasses import replace
import json
from pathlib import Path
import time

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import State
from dz_ros.recording.save import save_run

TIME_OUT = 180.0
PATIENT = ('-p', 'loop.duration:=0.0', '-p', 'safety.state_hold:=200', '-p',
           'safety.command_hold:=100', '-p', 'safety.echo_limit:=200', '-p',
           'safety.fault_after:=2000', '-p', 'driver.fresh:=100.0', '-p',
           'safety.error_limit:=0.0')
"""A machine that others use as well stalls for longer than the defaults allow."""


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    """One second of the loop, simulated; samples 5 ms apart."""
    path = tmp_path_factory.mktemp('replay') / 'run'
    data = from_run(simulate(Configuration.from_flat({'loop.duration': 1.0})), 10 ** 18)
    events = ((10 ** 18 + 7, '/plant_node', '{"event": "started"}'),)
    save_run(replace(data, events=events), path)
    return path


@pytest.fixture
def children():
    """Return ``find(run, count)``: node → process id, once `dz run` has started so many."""
    def find(run, count):
        deadline = time.monotonic() + TIME_OUT
        while True:
            found = {}
            for child in Path(f'/proc/{run.pid}/task/{run.pid}/children').read_text().split():
                words = Path(f'/proc/{child}/cmdline').read_text().split('\0')
                if 'dz_ros.nodes.main' in words:
                    found[words[words.index('dz_ros.nodes.main') + 1]] = int(child)
            if len(found) >= count:
                return found
            assert time.monotonic() < deadline, f'only {found} started'
            time.sleep(0.01)

    return find


class Operator:
    """A node of the test's own that hears everything and calls services."""

    def __init__(self):
        from rcl_interfaces.srv import SetParametersAtomically
        import rclpy
        from std_msgs.msg import Bool, Float64MultiArray, String
        from std_srvs.srv import Trigger
        self.rclpy = rclpy
        self.trigger, self.set_atomically = Trigger, SetParametersAtomically
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node('operator', context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.array, self.bool = Float64MultiArray, Bool
        self.heard = {'state': [], 'command': [], 'terms': [], 'truth': []}
        self.events = []
        for topic, kept in self.heard.items():
            self.node.create_subscription(Float64MultiArray, topic, kept.append, 2000)
        durable = rclpy.qos.QoSProfile(
            depth=200, durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(
            String, 'events', lambda message: self.events.append(json.loads(message.data)),
            durable)

    def wait(self, condition, timeout=TIME_OUT):
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, f'not in time; modes: {self.modes()}'
            self.executor.spin_once(timeout_sec=0.1)

    def modes(self):
        found = {}
        for event in self.events:
            if event['event'] == 'mode':
                found[event['node'].strip('/')] = (event['mode'], event['reason'])
        return found

    def wait_for_mode(self, **wanted):
        self.wait(lambda: all(self.modes().get(name, ('',))[0] == mode
                              for name, mode in wanted.items()))

    def call(self, service, service_type=None, request=None):
        service_type = service_type or self.trigger
        client = self.node.create_client(service_type, service)
        assert client.wait_for_service(TIME_OUT)
        future = client.call_async(request or service_type.Request())
        self.wait(future.done)
        return future.result()

    def set(self, node, **values):
        parameters = [self.rclpy.parameter.Parameter(name.replace('__', '.'), value=value)
                      .to_parameter_msg() for name, value in values.items()]
        return self.call(f'{node}/set_parameters_atomically', self.set_atomically,
                         self.set_atomically.Request(parameters=parameters)).result

    def change(self, node, number):
        from lifecycle_msgs.srv import ChangeState
        request = ChangeState.Request()
        request.transition.id = number
        return self.call(f'{node}/change_state', ChangeState, request).success

    def life(self, node):
        from lifecycle_msgs.srv import GetState
        return self.call(f'{node}/get_state', GetState).current_state.label

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.shutdown()


@pytest.fixture
def operator(ros_domain):
    made = Operator()
    yield made
    made.close()


class Watcher(Operator):
    """An operator of a loop around `actuator_node`, which may fall into fault."""

    patient = PATIENT

    @property
    def states(self):
        return [message.data for message in self.heard['state']]

    def running(self, samples=50):
        self.wait_for_mode(actuator_node='running', controller_node='running')
        heard = len(self.heard['state'])
        self.wait(lambda: len(self.heard['state']) > heard + samples)

    def tracked(self, trajectory, bound, samples=600, row=0):
        """Wait for so many samples in a row whose median error is below a bound, of one axis.

        A busy machine may hold any process for long, so only what lasts is judged.
        """
        width = len(State.labels(2))

        def good():
            recent = [data[row * width:] for data in self.states[-samples:]]
            if len(recent) < samples:
                return False
            if recent[0][1] > 20.0 and 'fault' in {mode for mode, _ in self.modes().values()}:
                self.recovered()
            errors = sorted(abs(data[2] - trajectory(data[1])[0]) for data in recent)
            travel = max(data[2] for data in recent) - min(data[2] for data in recent)
            return errors[samples // 2] < bound and travel > 100.0 * bound

        self.running()
        self.wait(good, 2 * TIME_OUT)

    def recovered(self):
        """Reset the ends in fault, the actuator first; return whether that was accepted."""
        return all(self.call(f'{name}/reset').success
                   for name in ('actuator_node', 'controller_node')
                   if self.modes()[name][0] == 'fault')


@pytest.fixture
def watcher(ros_domain):
    """A node that hears the loop of this test's domain."""
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    made = Watcher()
    yield made
    made.close()


KIT_TIME_OUT = 300.0
LATE = {'rate', 'latency', 'answers at once', 'measurement', 'no fault', 'echo', 'seq'}
"""Checks of the conformance kit that a busy machine may fail."""


@pytest.fixture
def kit(processes):
    """Return the function that has the conformance kit check a driver: check → result."""
    def check(name, *words):
        process = processes('-m', 'dz_ros', 'driver', 'check', name, *words, '--yes', '--json')
        code = process.wait(KIT_TIME_OUT)
        found = {item['name']: item for item in map(json.loads, filter(
            lambda line: line.startswith('{'), process.output.splitlines()))}
        assert {'declaration', 'stale command', 'killed and started again'} <= set(found), \
            process.output
        failed = {key for key, item in found.items() if item['passed'] is False}
        assert failed <= LATE, json.dumps(found, indent=1)
        assert code == bool(failed), process.output
        return found
    return check

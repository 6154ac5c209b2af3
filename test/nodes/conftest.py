# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of nodes: a recorded run, a node that receives a loop.

Over 300 lines: what a test of nodes does from outside, one class for each kind of loop.
"""

from collections.abc import Sequence
from dataclasses import replace
import json
from pathlib import Path
import time

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import State
from dz_ros.recording.save import save_run

TIME_OUT = 180.0
JUDGED_EVERY = 50
"""Samples between two judgements of what was tracked, which cost as much as receiving them."""
ASK_AGAIN = 10.0
"""A service that has not answered is asked again [s]."""
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


@pytest.fixture(scope='session')
def samples():
    """Return ``find(channel)``: the channel of a lockstep run with each message once, by seq.

    A state that gets no answer for a while is sent again, and answered again; neither may differ
    in a bit from what was sent the first time.
    """
    def find(channel):
        seq, first = np.unique(channel.values[:, 0], return_index=True)
        assert np.array_equal(seq, np.arange(len(seq)))
        kept = channel.values[first]
        assert kept[seq.searchsorted(channel.values[:, 0])].tobytes() == channel.values.tobytes()
        return replace(channel, values=kept, log_time=channel.log_time[first],
                       publish_time=channel.publish_time[first])

    return find


@pytest.fixture
def children():
    """Return ``find(run, count)``: node → process id, once `dz run` has started this number."""
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


@pytest.fixture
def none_missing():
    """Return whether a channel has each sample from 0 on, in order, and all but the first once.

    State 0 is sent again until it is answered, and with it references 0 and 1.
    """
    def judge(channel):
        found = list(channel['seq'])
        later = [seq for seq in found if seq > 1.0]
        return {0.0, 1.0} <= {*found} and later == list(range(2, 2 + len(later)))

    return judge


class Operator:
    """A node of the test's own that receives everything and calls services."""

    patient = PATIENT
    ask_again = 0.0

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
        self.received = {'state': [], 'command': [], 'terms': [], 'truth': []}
        self.events = []
        for topic, kept in self.received.items():
            self.node.create_subscription(Float64MultiArray, topic, kept.append, 2000)
        durable = rclpy.qos.QoSProfile(
            depth=200, durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(
            String, 'events', lambda message: self.events.append(json.loads(message.data)),
            durable)

    def reached(self, condition, timeout):
        """Receive until a condition holds; return whether it does in time."""
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.executor.spin_once(timeout_sec=0.1)
        return True

    def wait(self, condition, timeout=TIME_OUT):
        assert self.reached(condition, timeout), f'not in time; modes: {self.modes()}'

    def modes(self):
        found = {}
        for event in self.events:
            if event['event'] == 'mode':
                found[event['node'].strip('/')] = (event['mode'], event['reason'])
        return found

    def wait_for_mode(self, **wanted):
        self.wait(lambda: all(self.modes().get(name, ('',))[0] == mode
                              for name, mode in wanted.items()))

    def start_again(self, actuator='plant_node', release=lambda: None):
        """Reset the ends that are latched, the actuator first, until both run.

        As an operator would: a reset is refused while a stall keeps the loop silent, and the press
        of the other end may come after one.
        """
        ends = (actuator, 'controller_node')

        def running():
            release()
            for name in ends:
                if self.modes()[name][0] in ('estop', 'fault'):
                    self.call(f'{name}/reset')
            return all(self.modes()[name][0] == 'running' for name in ends)

        self.wait(running)

    def call(self, service, service_type=None, request=None):
        answer = self.answer(service, service_type, request)
        assert answer is not None, f'{service} does not answer; modes: {self.modes()}'
        return answer

    def answer(self, service, service_type=None, request=None, timeout=TIME_OUT):
        """Return a service's answer; None where it has none in time."""
        service_type = service_type or self.trigger
        client = self.node.create_client(service_type, service)
        asked = []

        def answered():
            # A server that was killed is known to DDS for a while: it may be the only one that
            # was there when this client asked.
            if client.service_is_ready() and (not asked or time.monotonic() > self.ask_again):
                asked.append(client.call_async(request or service_type.Request()))
                self.ask_again = time.monotonic() + ASK_AGAIN
            return any(future.done() for future in asked)

        self.reached(answered, timeout)
        return next((future.result() for future in asked if future.done()), None)

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

    def lifecycle(self, node):
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


class Rows(Sequence):
    """Numbers of messages that were received, without a copy of all at each look."""

    def __init__(self, messages):
        self._messages = messages

    def __len__(self):
        return len(self._messages)

    def __getitem__(self, place):
        found = self._messages[place]
        return [item.data for item in found] if isinstance(place, slice) else found.data


class Watcher(Operator):
    """An operator of a loop around `actuator_node`, which may fall into fault."""

    @property
    def states(self):
        return Rows(self.received['state'])

    def running(self, samples=50):
        self.wait_for_mode(actuator_node='running', controller_node='running')
        received = len(self.received['state'])
        self.wait(lambda: len(self.received['state']) > received + samples)

    def tracked(self, trajectory, bound, samples=600, row=0):
        """Wait for samples in a row whose median error is below a bound, of one axis.

        A busy machine may hold any process for long, so only what lasts is judged.
        """
        width, judged = len(State.labels(2)), 0

        def good():
            nonlocal judged
            if len(self.states) < max(samples, judged + JUDGED_EVERY):
                return False
            judged = len(self.states)
            recent = [data[row * width:] for data in self.states[-samples:]]
            if recent[0][1] > 20.0 and 'fault' in {mode for mode, _ in self.modes().values()}:
                self.recovered()
            errors = sorted(abs(data[2] - trajectory(data[1])[0]) for data in recent)
            travel = max(data[2] for data in recent) - min(data[2] for data in recent)
            return errors[samples // 2] < bound and travel > 100.0 * bound

        self.running()
        self.wait(good, 2 * TIME_OUT)

    def recovered(self):
        """Reset the ends in fault, the actuator first; return whether that was accepted.

        A node that has ended since does not answer: the test may start it again meanwhile.
        """
        for name in ('actuator_node', 'controller_node'):
            if self.modes()[name][0] == 'fault':
                answer = self.answer(f'{name}/reset', timeout=ASK_AGAIN)
                if answer is None or not answer.success:
                    return False
        return True


@pytest.fixture
def watcher(ros_domain):
    """A node that receives the loop of this test's domain."""
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    made = Watcher()
    yield made
    made.close()


EMULATOR = Path(__file__).with_name('ros2_control_emulator.py')
ROOT = Path(__file__).parents[2]
JOINT = ROOT / 'config' / 'joint.yaml'


class Robot:
    """Words to ros2_control's emulator, what that publishes of its hardware, the loop."""

    def __init__(self, watcher, processes):
        from std_msgs.msg import String
        self._watcher, self._string, self._processes = watcher, String, processes
        self.interface = []     # (controller active, command that the hardware holds)
        watcher.node.create_subscription(String, '/emulator/interface', lambda message:
                                         self.interface.append(json.loads(message.data)), 1000)
        self._do = watcher.node.create_publisher(String, '/emulator/do', 10)

    def do(self, word):
        self._watcher.wait(lambda: self._do.get_subscription_count() > 0)
        self._do.publish(self._string(data=word))

    @property
    def held(self):
        return self.interface[-1][1]

    def emulator(self, kind='forward', active=True, options=(), config=JOINT, path=ROOT):
        """Start the emulator."""
        self._processes(str(EMULATOR), config, kind, *options,
                        PYTHONPATH=str(path)).wait_for_line('controllers are loaded')
        if active:
            self.do('activate')
            self._watcher.wait(lambda: self.interface and self.interface[-1][0])

    def start(self, *more, kind='forward', active=True, options=(), config=JOINT, path=ROOT):
        """Start emulator and loop; return the loop's nodes once they are started."""
        self.emulator(kind, active, options, config, path)
        return {name: self.node(name, *more, config=config, path=path)
                for name in ('actuator_node', 'controller_node', 'trajectory_node')}

    def node(self, name, *more, config=JOINT, path=ROOT):
        """Start a node of the loop."""
        return self._processes('-m', 'dz_ros.nodes.main', name, '--ros-args', '--params-file',
                               config, *self._watcher.patient, *more, PYTHONPATH=str(path))


@pytest.fixture
def robot(watcher, processes):
    """The emulator of ros2_control and the loop around it, not started."""
    return Robot(watcher, processes)


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

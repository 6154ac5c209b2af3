# SPDX-License-Identifier: Apache-2.0
"""The nodes as a ROS user meets them: parameters, names, remapping, messages, signals."""

import json
import math
from pathlib import Path
import signal
import time

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import Command, State, Terms
from dz_ros.files.configurations import write_parameters

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

NODE = ('-m', 'dz_ros.nodes.main')
CONFIG = Path(__file__).parents[2] / 'config' / 'wang2004.yaml'
ARGUMENTS = ('--ros-args', '--params-file', CONFIG)
NAMES = ('plant_node', 'controller_node', 'trajectory_node')
TIME_OUT = 180.0


class Subscriber:
    """A node of the test's own, of plain typed messages, that keeps what it receives."""

    def __init__(self, namespace=''):
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node('subscriber', namespace=namespace, context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.received = {}

    def subscribe(self, topic, message_type, qos=10):
        self.received[topic] = []
        self.node.create_subscription(message_type, topic, self.received[topic].append, qos)

    def wait(self, condition):
        deadline = time.monotonic() + TIME_OUT
        while not condition():
            assert time.monotonic() < deadline, 'nothing received in time'
            self.executor.spin_once(timeout_sec=0.1)

    def call(self, service, service_type, request):
        client = self.node.create_client(service_type, service)
        assert client.wait_for_service(TIME_OUT)
        future = client.call_async(request)
        self.wait(future.done)
        return future.result()

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.shutdown()


@pytest.fixture
def subscriber(ros_domain):
    made = Subscriber()
    yield made
    made.close()


def test_namespaces_remapping_and_labels(processes, subscriber):
    from std_msgs.msg import Float64MultiArray, String
    for topic in ('/left/renamed', '/left/command', '/left/terms'):
        subscriber.subscribe(topic, Float64MultiArray)
    durable = rclpy.qos.QoSProfile(
        depth=200, durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL)
    subscriber.subscribe('/left/events', String, durable)
    nodes = [processes(*NODE, name, *ARGUMENTS, '-r', '__ns:=/left', '-r', 'state:=renamed',
                       '-p', 'loop.duration:=0.0') for name in NAMES]
    subscriber.wait(lambda: all(subscriber.received[topic] for topic in subscriber.received))
    labels = {'/left/renamed': State.labels(2), '/left/command': Command.labels(),
              '/left/terms': Terms.labels(('theta1', 'theta2', 'phi'))}
    for topic, names in labels.items():
        message = subscriber.received[topic][0]
        (dimension,) = message.layout.dim
        assert dimension.label == ','.join(names)
        assert dimension.size == dimension.stride == len(message.data) == len(names)
    subscriber.wait(lambda: {
        json.loads(event.data)['node'] for event in subscriber.received['/left/events']
    } >= {f'/left/{name}' for name in NAMES})
    for node in nodes:
        node.signal(signal.SIGINT)
        node.signal(signal.SIGTERM)
    for node in nodes:
        assert node.wait() == 0
        assert 'Traceback' not in node.output


def test_parameters_carry_description_unit_and_range(processes, subscriber):
    from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
    processes(*NODE, 'controller_node', *ARGUMENTS, '-p', 'controller.k_d:=7')
    listed = subscriber.call('/controller_node/list_parameters', ListParameters,
                             ListParameters.Request()).result.names
    assert {'loop.rate', 'plant.model', 'controller.law', 'controller.lambda',
            'controller.theta_0'} <= set(listed)
    assert not [name for name in listed if name.startswith(('trajectory.', 'plant.dead_zone'))]
    names = ['controller.lambda', 'loop.delay', 'controller.law', 'controller.theta_0']
    described = subscriber.call('/controller_node/describe_parameters', DescribeParameters,
                                DescribeParameters.Request(names=names)).descriptors
    by_name = {item.name: item for item in described}
    assert '[1/s]' in by_name['controller.lambda'].description
    assert not by_name['controller.lambda'].floating_point_range    # it has no upper end
    assert by_name['controller.lambda'].additional_constraints == '> 0'
    assert by_name['loop.delay'].integer_range[0].to_value == 100
    request = GetParameters.Request(names=['controller.k_d', *names])
    values = subscriber.call('/controller_node/get_parameters', GetParameters, request).values
    assert values[0].double_value == 7.0     # given as an integer
    assert list(values[4].double_array_value) == [0.85, 0.85]
    changed = SetParameters.Request(parameters=[
        rclpy.parameter.Parameter('loop.delay', value=3).to_parameter_msg()])
    (result,) = subscriber.call('/controller_node/set_parameters', SetParameters, changed).results
    assert not result.successful


@pytest.mark.parametrize(('name', 'given', 'message'), [
    ('controller_node', 'controller.lambda:=-1.0', 'controller.lambda = -1.0'),
    ('controller_node', 'controller.lamda:=1.0', 'did you mean controller.lambda'),
    ('plant_node', 'plant.x0:=[1.0]', 'plant.x0'),
    ('plant_node', 'plant.model:=none', 'no such plant'),
    ('trajectory_node', 'trajectory.amplitude:=large', 'a finite number'),
    ('recorder_node', 'loop.rate:=200.0', 'directory'),
])
def test_a_bad_parameter_is_one_line_and_exit_code_two(processes, name, given, message):
    node = processes(*NODE, name, '--ros-args', '-p', given)
    assert node.wait() == 2
    assert node.output.startswith(f'{name}: error: ')
    assert message in node.output
    assert node.output.count('\n') == 0


def test_a_missing_parameter_file_is_one_line(processes, tmp_path):
    node = processes(*NODE, 'plant_node', '--ros-args', '--params-file', tmp_path / 'none.yaml')
    assert node.wait() == 2
    assert node.output.startswith('plant_node: error: ')
    assert 'none.yaml' in node.output
    assert node.output.count('\n') == 0


def test_a_plant_without_commands_stays_where_it_is(processes, subscriber):
    from std_msgs.msg import Float64MultiArray
    subscriber.subscribe('/state', Float64MultiArray)
    plant = processes(*NODE, 'plant_node', '--ros-args', '-p', "loop.peers:=['plant_node']")
    publisher = subscriber.node.create_publisher(Float64MultiArray, '/command', 10)
    subscriber.wait(lambda: len(subscriber.received['/state']) >= 3)
    for message in subscriber.received['/state']:
        assert list(message.data)[:4] == [0.0, 0.0, -2.5, 3.5]
    answer = Float64MultiArray(data=[0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    answer.layout.dim.append(rclpy_dimension(','.join(Command.labels()), 6))
    publisher.publish(answer)
    subscriber.wait(lambda: subscriber.received['/state'][-1].data[0] > 3.0)
    assert plant.interrupt() == 0


def test_messages_of_wrong_shape_are_counted_and_ignored(processes, subscriber):
    from std_msgs.msg import Float64MultiArray
    subscriber.subscribe('/state', Float64MultiArray)
    plant = processes(*NODE, 'plant_node', '--ros-args', '-p', "loop.peers:=['plant_node']")
    publisher = subscriber.node.create_publisher(Float64MultiArray, '/command', 10)
    subscriber.wait(lambda: subscriber.received['/state'])
    publisher.publish(Float64MultiArray(data=[1.0]))
    plant.wait_for_line('command: without names, or not readable (1 so far)')
    before = len(subscriber.received['/state'])
    subscriber.wait(lambda: len(subscriber.received['/state']) > before + 1)
    assert subscriber.received['/state'][-1].data[0] == 0.0
    assert plant.interrupt() == 0
    assert 'Traceback' not in plant.output


def test_what_is_ignored_is_in_log_and_diagnostics_whatever_was_wrong(processes, subscriber):
    from diagnostic_msgs.msg import DiagnosticArray
    from std_msgs.msg import Float64MultiArray
    subscriber.subscribe('/state', Float64MultiArray)
    subscriber.subscribe('/diagnostics', DiagnosticArray, 100)
    plant = processes(*NODE, 'plant_node', '--ros-args', '-p', "loop.peers:=['plant_node']")
    publisher = subscriber.node.create_publisher(Float64MultiArray, '/command', 100)
    subscriber.wait(lambda: subscriber.received['/state'])
    labels = 'seq,stamp,v,echo_seq,echo_stamp,hold'
    no_number = Float64MultiArray(data=[math.nan] * 6)
    no_number.layout.dim = [rclpy_dimension(labels, 6)]
    other = Float64MultiArray(data=[0.0])
    other.layout.dim = [rclpy_dimension('sp\x1b[31med', 1)]
    kinds = {'command: not finite': no_number, 'command: names of other numbers': other}

    def counted(name):
        return max((int(item.value) for message in subscriber.received['/diagnostics']
                    for status in message.status for item in status.values
                    if item.key == f'ignored {name}'), default=0)

    # One by one: the loop takes the newest command only, and reports its state after each look.
    while any(counted(name) < 10 for name in kinds):
        for message in kinds.values():
            received = len(subscriber.received['/state'])
            publisher.publish(message)
            subscriber.wait(lambda known=received: len(subscriber.received['/state']) > known)
    for name in kinds:
        plant.wait_for_line(f'{name} (10 so far)')
    assert plant.interrupt() == 0
    for name in kinds:      # the first, the tenth, none between
        assert plant.output.count(f'{name} (') == 2, plant.output
    assert '\x1b[31m' not in plant.output


def test_a_node_states_all_it_runs_with_many_waypoints_included(processes, subscriber, tmp_path):
    from rcl_interfaces.srv import SetParameters
    from std_msgs.msg import String
    c = Configuration.from_flat({
        'trajectory.kind': 'waypoints', 'trajectory.times': [0.1 * k for k in range(3000)],
        'trajectory.positions': [0.1 * (k % 5) for k in range(3000)]}, driven=False)
    write_parameters(c, tmp_path / 'waypoints.yaml')
    latched = rclpy.qos.QoSProfile(depth=20,
                                   durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL)
    subscriber.subscribe('/events', String, latched)
    processes(*NODE, 'controller_node', '--ros-args', '--params-file', tmp_path / 'waypoints.yaml')

    def stated():
        found = [json.loads(message.data) for message in subscriber.received['/events']]
        return [item['configuration'] for item in found if item['event'] == 'configuration']

    subscriber.wait(stated)
    changed = SetParameters.Request(parameters=[
        rclpy.parameter.Parameter('controller.lambda', value=1.1).to_parameter_msg()])
    (result,) = subscriber.call('/controller_node/set_parameters', SetParameters, changed).results
    assert result.successful, result.reason
    subscriber.wait(lambda: len(stated()) == 2)
    assert stated() == [c.to_flat(), c.replace(**{'controller.lambda': 1.1}).to_flat()]


def rclpy_dimension(label, size):
    from std_msgs.msg import MultiArrayDimension
    return MultiArrayDimension(label=label, size=size, stride=size)


def test_a_recorder_the_loop_waits_for_subscribes_after_those_in_a_hurry(
        processes, subscriber, tmp_path):
    from std_msgs.msg import Float64MultiArray
    peers = "['controller_node', 'trajectory_node', 'recorder_node']"
    processes(*NODE, 'recorder_node', *ARGUMENTS, '-p', f'directory:={tmp_path / "run"}', '-p',
              f'loop.peers:={peers}')

    def received_by(topic):
        return {info.node_name for info in
                subscriber.node.get_subscriptions_info_by_topic(f'/{topic}')}

    subscriber.wait(lambda: 'recorder_node' in received_by('terms'))
    assert 'recorder_node' not in received_by('state')
    others = [rclpy.create_node(name, context=subscriber.context)
              for name in ('controller_node', 'trajectory_node')]
    for node in others:
        assert 'recorder_node' not in received_by('state')
        node.create_subscription(Float64MultiArray, 'state', print, 1)
    subscriber.wait(lambda: 'recorder_node' in received_by('state'))
    for node in others:
        node.destroy_node()

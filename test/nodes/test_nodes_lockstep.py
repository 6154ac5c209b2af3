# SPDX-License-Identifier: Apache-2.0
"""The nodes in lockstep: which waits for which, what is served meanwhile; their cores."""

import os
from pathlib import Path
import signal

import pytest

from dz_ros.runtime.privileges import usable_cores

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

NODE = ('-m', 'dz_ros.nodes.main')
CONFIG = Path(__file__).parents[2] / 'config' / 'wang2004.yaml'
ARGUMENTS = ('--ros-args', '--params-file', CONFIG, '-p', 'loop.timing:=lockstep', '-p',
             'loop.duration:=0.0')
NAMES = ('plant_node', 'controller_node', 'trajectory_node')


@pytest.fixture
def loop(processes, operator):
    """The nodes of a loop without end, by name, received to run."""
    nodes = {name: processes(*NODE, name, *ARGUMENTS) for name in NAMES}
    operator.wait(lambda: len(operator.received['state']) > 100)
    return nodes


def stop(nodes):
    """Interrupt the nodes, the plant first; see that each ends in order."""
    for node in nodes.values():
        node.signal(signal.SIGINT)
        assert node.wait() == 0, node.output
        assert 'Traceback' not in node.output


def test_a_node_that_is_gone_ends_the_run_with_its_name(loop):
    loop['trajectory_node'].signal(signal.SIGKILL)
    assert loop['controller_node'].wait() == 2
    assert 'the trajectory is gone' in loop['controller_node'].output
    assert loop['plant_node'].wait() == 2
    assert 'the controller is gone' in loop['plant_node'].output


def test_a_trajectory_that_comes_back_goes_on_where_the_loop_is(loop, processes, operator):
    assert operator.change('/plant_node', 4)    # nothing waits, however long a start takes
    killed = loop.pop('trajectory_node')
    killed.signal(signal.SIGKILL)
    killed.wait()

    def starts():
        return sum(event['node'] == '/trajectory_node' and event['event'] == 'configuration'
                   for event in operator.events)

    before, reached = starts(), operator.received['state'][-1].data[0]
    loop['trajectory_node'] = processes(*NODE, 'trajectory_node', *ARGUMENTS)
    operator.wait(lambda: starts() > before)
    assert operator.change('/plant_node', 3)
    operator.wait(lambda: operator.received['state'][-1].data[0] > reached + 500)
    used = [message.data for message in operator.received['terms']]
    assert all(data[12] == data[13] for data in used)      # the reference of that very state
    stop(loop)


@pytest.mark.parametrize(('name', 'transitions'), [
    ('plant_node', (4, 3)), ('controller_node', (4, 3)), ('controller_node', (4, 2, 1, 3)),
    ('trajectory_node', (4, 3))], ids=['plant', 'controller', 'controller again', 'trajectory'])
def test_a_node_that_was_not_active_for_a_while_goes_on(loop, operator, name, transitions):
    for number in transitions:
        assert operator.change(f'/{name}', number)
    reached = operator.received['state'][-1].data[0]
    operator.wait(lambda: operator.received['state'][-1].data[0] > reached + 500)
    stop(loop)


def test_everything_else_is_served_while_messages_come(loop, operator):
    for gain in range(5, 20):
        assert operator.set('/controller_node', controller__k_d=float(gain)).successful
    assert operator.lifecycle('/plant_node') == 'active'
    press = operator.node.create_publisher(operator.bool, 'estop', rclpy.qos.QoSProfile(
        depth=1, durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL))
    press.publish(operator.bool(data=True))
    operator.wait_for_mode(plant_node='estop', controller_node='estop')
    stop(loop)


def test_the_time_is_published_as_clock(loop, operator):
    from rosgraph_msgs.msg import Clock
    received = []
    operator.node.create_subscription(Clock, '/clock', received.append, 10)
    operator.wait(lambda: len(received) > 100)
    times = [message.clock.sec * 10**9 + message.clock.nanosec for message in received]
    assert all(time_ns % 5_000_000 == 0 for time_ns in times)      # k T, whatever the wall reports
    assert times == sorted(set(times))
    stop(loop)


@pytest.mark.skipif(len(usable_cores()) < 2, reason='one core: nothing to share out')
@pytest.mark.parametrize('timing', ['lockstep', 'realtime'])
def test_the_two_that_take_turns_share_no_core(processes, operator, timing):
    words = [f'loop.timing:={timing}' if item == 'loop.timing:=lockstep' else item
             for item in ARGUMENTS]
    loop = {name: processes(*NODE, name, *words) for name in NAMES}
    operator.wait(lambda: len(operator.received['state']) > 100)
    cores = {name: os.sched_getaffinity(node.pid) for name, node in loop.items()}
    assert not cores['plant_node'] & cores['controller_node']
    assert cores['plant_node'] | cores['controller_node'] == cores['trajectory_node']
    stop(loop)


def test_cores_that_are_configured_are_taken(processes):
    core = usable_cores()[0]
    node = processes(*NODE, 'controller_node', *ARGUMENTS, '-p', f"process.cores:='{core}'")
    node.wait_for_line('design rule')      # the process was set up before
    assert os.sched_getaffinity(node.pid) == {core}

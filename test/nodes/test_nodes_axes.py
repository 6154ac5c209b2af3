# SPDX-License-Identifier: Apache-2.0
"""Nodes with several axes: lockstep is offline, faults name their axis and stop all.

Over 300 lines: all of it needs the same nodes of six axes and what is received of them.
"""

import copy
import math
from pathlib import Path
import re
import signal
import time

import numpy as np
import pytest

from dz_ros.cli.offline import simulate_machine
from dz_ros.core.axes import diagnostic_values, MAX_AXES
from dz_ros.core.dataset import from_runs
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.records import Command, Reference, State, Status, Terms
from dz_ros.files.configurations import load_configuration
from dz_ros.recording.reader import read_run
from dz_ros.replay.audit.audit import audit
from dz_ros.replay.whatif import answer_axes, plan_axes
from dz_ros.runs.axes import each_axis
from dz_ros.runs.history import RunHistory

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

NODE = ('-m', 'dz_ros.nodes.main')
CONFIG = Path(__file__).parents[2] / 'config' / 'six_axes.yaml'
AXES = ('base', 'shoulder', 'elbow', 'roll', 'pitch', 'yaw')
ARGUMENTS = ('--ros-args', '--params-file', CONFIG, '-p', 'loop.duration:=0.0')
NAMES = ('trajectory_node', 'controller_node', 'actuator_node')
FAR = 1e6
"""What a message that must not be taken reports of each axis."""


@pytest.mark.parametrize(('name', 'names'), [
    ('six_axes', AXES), ('two_link_arm', ('shoulder', 'elbow')),
    ('rov_planar', ('surge', 'sway', 'yaw'))])
def test_lockstep_over_dds_is_offline_and_audited_bit_for_bit(processes, samples, tmp_path, name,
                                                              names):
    out = tmp_path / 'run'
    run = processes('-m', 'dz_ros', 'run', name, '--lockstep', '--duration', '1', '--quiet',
                    '--record', out)
    assert run.wait() == 0, run.output
    recorded = read_run(out)
    assert recorded.axes == names
    c = RunHistory.of(recorded).configuration
    offline = from_runs(simulate_axes(c), c)
    for topic, channel in offline.channels.items():
        found = samples(recorded.channels[topic]).values[:len(channel)]
        assert np.array_equal(found, channel.values), topic
    runs = each_axis(recorded)
    for axis, of_axis in runs.items():
        others = [item for other, item in runs.items() if other != axis]
        assert audit(of_axis, others=others).passed, axis
    planned = plan_axes(recorded, {})
    again = answer_axes(planned, simulate_machine(planned.configuration, planned.memories), 'a', 0)
    for topic, channel in again.channels.items():
        assert np.array_equal(channel.values, offline.channels[topic].values), topic


@pytest.fixture
def start(processes, operator):
    """Return ``start(*arguments)``: the nodes of a loop without end, by name, that runs."""
    def begin(*arguments):
        nodes = {name: processes(*NODE, name, *ARGUMENTS, *arguments) for name in NAMES}
        operator.wait(lambda: len(operator.received['state']) > 50 and operator.received['command']
                      and operator.received['terms'])
        return nodes

    return begin


def stop(nodes):
    """Interrupt the nodes, the actuator's first; see that each ends in order."""
    for node in reversed(nodes.values()):
        node.signal(signal.SIGINT)
        assert node.wait() == 0, node.output
        assert 'Traceback' not in node.output


def held(truth):
    """Return the command that each axis' actuator holds; 0 where it holds none."""
    rows = np.reshape(truth.data, (len(AXES), -1))
    return rows[:, 2] - rows[:, 3]


def test_a_driver_that_dies_is_named_and_stops_every_axis(start, operator):
    nodes = start(*operator.patient, '-p', 'driver.name:=mock', '-p',
                  'axes.roll.driver.script:=["300- fault burnt"]')
    operator.wait_for_mode(actuator_node='fault')
    assert operator.modes()['actuator_node'][1].startswith('axis roll: burnt')
    seen = len(operator.received['state'])
    operator.wait(lambda: len(operator.received['state']) > seen + 20)
    operator.wait(lambda: not any(held(operator.received['truth'][-1])))
    assert operator.lifecycle('/actuator_node') == 'active'
    stop(nodes)


def test_a_limit_of_one_axis_is_a_fault_of_all_until_the_reset(start, operator):
    nodes = start(*operator.patient)
    assert not operator.set('/controller_node', controller__lambda=2.0).successful
    assert operator.set('/controller_node', axes__yaw__controller__lambda=8.0).successful
    assert operator.set('/controller_node', axes__pitch__safety__error_limit=1e-9).successful
    operator.wait_for_mode(controller_node='fault')
    assert operator.modes()['controller_node'][1].startswith('axis pitch: error ')
    width = len(Command.labels())
    operator.wait(lambda: not any(operator.received['command'][-1].data[2::width]))
    assert len(operator.received['command'][-1].data) == width * len(AXES)
    assert operator.set('/controller_node', axes__pitch__safety__error_limit=0.0).successful
    operator.wait(lambda: operator.call('/controller_node/reset').success)
    operator.wait_for_mode(controller_node='running')
    stop(nodes)


def renamed(message, names):
    """Return the message with other names of axes before the same rows."""
    message.layout.dim[0].label = ','.join(names)
    return message


def changed(message, row, label, value):
    """Return the message with one number changed."""
    labels = message.layout.dim[1].label.split(',')
    message.data[row * len(labels) + labels.index(label)] = value
    return message


def without_last_row(message, announced):
    """Return the message without its last row, whose axis is announced or not."""
    dimensions, width = message.layout.dim, message.layout.dim[1].size
    message.data = message.data[:-width]
    if not announced:
        renamed(message, AXES[:-1])
        dimensions[0].size -= 1
        dimensions[0].stride -= width
    return message


def of_one_axis(message):
    """Return the message as a loop of one axis sends it."""
    message.layout.dim = message.layout.dim[1:]
    message.data = message.data[:message.layout.dim[0].size]
    return message


FOREIGN = (
    ('a row missing', lambda m: without_last_row(m, announced=True)),
    ('axes in another order', lambda m: renamed(m, AXES[::-1])),
    ('another number of axes', lambda m: without_last_row(m, announced=False)),
    ('another number of axes', of_one_axis),
    ('other axes', lambda m: renamed(m, (*AXES[:-1], 'jaw'))),
    ('other axes', lambda m: renamed(m, (*AXES[:-1], 'y\nw'))),
    ('an axis named twice', lambda m: renamed(m, (*AXES[:-1], 'base'))),
    ('rows of different samples', lambda m: changed(m, 3, 'seq', m.data[0] + 1.0)),
    ('rows of different samples', lambda m: changed(m, 3, 'stamp', m.data[1] + 0.005)),
    *((f'not finite (axis {AXES[row]})', lambda m, row=row, value=value, last=last: changed(
        m, row, m.layout.dim[1].label.split(',')[last], value))
      for row, value, last in ((5, math.nan, 2), (0, math.inf, 2), (3, -math.inf, -1))),
)
"""Cause by which it is counted (docs/axes.md) → what makes such a message of a good one."""


@pytest.fixture
def reported(operator):
    """Node → label → text of its newest diagnostics."""
    from diagnostic_msgs.msg import DiagnosticArray
    found = {}

    def keep(array):
        for status in array.status:
            found[status.name] = {item.key: item.value for item in status.values}

    operator.node.create_subscription(DiagnosticArray, '/diagnostics', keep, 10)
    return found


@pytest.mark.parametrize(('topic', 'labels', 'node'), [
    ('command', Command.labels(), 'actuator_node'), ('state', State.labels(2), 'controller_node'),
    ('reference', Reference.labels(2), 'controller_node')])
def test_what_other_machines_send_is_counted_by_cause_and_moves_no_axis(
        start, operator, reported, topic, labels, node):
    # The loop's readers keep the newest message alone: of one that is sent among good ones the
    # next good one may take the place, so each is sent until it is counted.
    nodes = start(*operator.patient)
    good = []

    def keep(message):
        if max(map(abs, message.data)) < FAR:       # not one of this test's own
            good.append(message)

    operator.node.create_subscription(operator.array, topic, keep, 100)
    publisher = operator.node.create_publisher(operator.array, topic, 10)
    operator.wait(lambda: good and publisher.get_subscription_count() and reported.get(f'/{node}'))

    def count(cause):
        return int(reported[f'/{node}'].get(f'ignored {topic}: {cause}', 0))

    for cause, make in FOREIGN:
        before = count(cause)

        def counted(cause=cause, make=make, before=before):
            message = copy.deepcopy(good[-1])
            for row in range(0, len(message.data), len(labels)):
                message.data[row] += 1.0        # the next seq, which would be taken
                message.data[row + 2] = FAR
            publisher.publish(make(message))
            return count(cause) > before

        operator.wait(counted)
        nodes[node].wait_for_line(f'{topic}: {cause} (')
    operator.wait_for_mode(actuator_node='running', controller_node='running')
    assert 'fault' not in {event.get('mode') for event in operator.events}
    applied = [number for message in operator.received['truth'] for number in message.data[2::5]]
    assert max(map(abs, applied)) < FAR / 10.0
    stop(nodes)


def test_a_stream_of_foreign_messages_is_silence_for_every_axis(start, operator):
    nodes = start()
    last = operator.received['command'][-1]
    nodes['controller_node'].signal(signal.SIGKILL)
    nodes.pop('controller_node').wait()
    publisher = operator.node.create_publisher(operator.array, 'command', 10)

    def given_up():
        publisher.publish(renamed(copy.deepcopy(last), AXES[::-1]))
        return operator.modes().get('actuator_node') == ('fault', 'no command')

    operator.wait(given_up)
    operator.wait(lambda: not any(held(operator.received['truth'][-1])))
    assert 'command: axes in another order (' in nodes['actuator_node'].output
    stop(nodes)


def test_an_axis_at_its_limit_alone_is_held_back_and_its_adaptation_alone_frozen(
        start, operator, reported):
    nodes = start(*operator.patient, '-p', 'axes.yaw.safety.command_limit:=0.2')
    labels, width = operator.received['terms'][-1].layout.dim[1].label.split(','), len(
        Command.labels())
    status = labels.index('status')
    assert status == Terms.labels(()).index('status')

    def saturated():
        """Return for each axis in how many samples it was held back."""
        rows = np.array([item.data[status::len(labels)] for item in operator.received['terms']])
        return np.count_nonzero(rows.astype(int) & Status.SATURATED, axis=0)

    yaw = AXES.index('yaw')
    operator.wait(lambda: saturated()[yaw] > 20)
    assert not saturated()[:yaw].any()

    def largest():
        """Return the largest |v| of each axis so far."""
        return np.abs([item.data[2::width] for item in operator.received['command']]).max(axis=0)

    operator.wait(lambda: largest()[:yaw].min() > 0.2)
    assert largest()[yaw] == 0.2
    operator.wait(lambda: int(reported.get('/controller_node', {}).get(
        'yaw: frozen: saturated [samples]', 0)) > 20)
    for axis in AXES[:-1]:
        assert reported['/controller_node'].get(f'{axis}: frozen: saturated [samples]', '0') == '0'
    operator.wait_for_mode(actuator_node='running', controller_node='running')
    stop(nodes)


STATUS = ('-m', 'dz_ros', 'status', '--once')


def test_status_shows_the_values_of_each_axis_and_names_the_one_in_fault(start, operator,
                                                                         processes):
    def shown(expected, *lines):
        # It waits three seconds for another node; a busy machine may need more than one look,
        # and stand still between running and the look.
        status = processes(*STATUS)
        code = status.wait()
        found = code == expected and all(f'/{line}' in status.output for line in lines)
        return status if found else None

    nodes = start(*operator.patient)
    operator.wait_for_mode(actuator_node='running', controller_node='running')
    looks = []
    operator.wait(lambda: looks.append(
        shown(0, 'controller_node: running', 'actuator_node: running')) or looks[-1])
    status = looks[-1]
    sections = re.split(r'^(?=\w+ +/)', status.output, flags=re.MULTILINE)
    for node, label in (('controller_node', 'max |error|'), ('controller_node', 'max |s|/epsilon'),
                        ('actuator_node', 'applied command')):
        section = next(item for item in sections if f'/{node}: ' in item.partition('\n')[0])
        assert re.findall(rf'^ +(\w+): {re.escape(label)} +\S+$', section, re.MULTILINE) == list(
            AXES), status.output
        assert section.splitlines()[1].split() == ['mode', 'running']   # the machine's, once
    assert operator.set('/controller_node', axes__pitch__safety__error_limit=1e-9).successful
    operator.wait_for_mode(controller_node='fault')
    operator.wait(lambda: looks.append(shown(1, 'controller_node: fault')) or looks[-1])
    status = looks[-1]
    assert re.search('^ERROR  /controller_node: fault: axis pitch: error ', status.output,
                     re.MULTILINE), status.output
    stop(nodes)


def test_status_shows_as_many_values_as_the_most_axes_have(operator, processes):
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    publisher = operator.node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    keys = [f'a{axis}: value {place}' for axis in range(MAX_AXES)
            for place in range(diagnostic_values(MAX_AXES) // MAX_AXES)]
    message = DiagnosticArray(status=[DiagnosticStatus(
        name='/of_many', level=b'\0', message='running', values=[
            KeyValue(key=key, value='1') for key in (*keys, 'one more')])])
    status = processes(*STATUS, '--all')
    deadline = time.monotonic() + 120.0
    while status.poll() is None:
        assert time.monotonic() < deadline
        publisher.publish(message)
        time.sleep(0.2)
    shown = [line.strip().rpartition(' ')[0].strip() for line in status.output.splitlines()
             if line.startswith('   ')]
    assert shown == keys


@pytest.mark.parametrize(('arguments', 'wanted'), [
    (('-p', 'axes.yaw.controller.lamda:=2.0'), 'axes.yaw.controller.lamda'),
    (('-p', 'axes.jaw.controller.lambda:=2.0'), 'not jaw'),
    (('-p', 'axes.yaw.controller.law:=pid'), 'two loops'),
    (('-p', 'loop.axes:=[yaw, yaw]'), 'names yaw twice'),
    (('-p', f'loop.axes:=[{", ".join(f"a{i}" for i in range(MAX_AXES + 1))}]'), 'at most'),
])
def test_axes_that_cannot_be_are_one_line(processes, arguments, wanted):
    node = processes(*NODE, 'controller_node', *ARGUMENTS, *arguments)
    assert node.wait() == 2
    assert wanted in node.output
    assert 'Traceback' not in node.output


def test_the_configuration_is_the_one_of_the_file():
    assert load_configuration(CONFIG).axis_names == AXES

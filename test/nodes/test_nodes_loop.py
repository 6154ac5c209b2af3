# SPDX-License-Identifier: Apache-2.0
"""The loop as real processes over real DDS: started, recorded, interrupted, killed, refused."""

import collections
import os
from pathlib import Path
import signal
import sys
import time

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.laws import LAWS
from dz_ros.core.loop.offline import simulate
from dz_ros.files.configurations import load_configuration
from dz_ros.recording.reader import read_run
from dz_ros.replay.audit.audit import audit

pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

DZ = ('-m', 'dz_ros')
NODE = ('-m', 'dz_ros.nodes.main')
CONFIG = Path(__file__).parents[2] / 'config'


def test_a_real_time_run_is_recorded_whole_and_tracks(processes, tmp_path, patient,
                                                      none_missing):
    run = processes(*DZ, 'run', 'wang2004', *patient, '--duration', '6', '--record',
                    tmp_path / 'run')
    assert run.wait() == 0, run.output
    data = read_run(tmp_path / 'run')
    state, command, terms = (data.channels[name] for name in ('state', 'command', 'terms'))
    # Each publisher counts on its own: nothing got lost on the way, even if the machine stalled.
    for name, channel in data.channels.items():
        assert none_missing(channel), name
    assert np.array_equal(command['echo_seq'], terms['echo_seq'])
    assert tuple(state.values[0, 2:4]) == (-2.5, 3.5)
    assert 6.0 - 1e-6 < state['stamp'][-1] < 7.0     # a stall may skip the last sample's period
    assert np.all(np.diff(np.unique(state['stamp'])) > 0.004)
    # A state echoes the newest command before it: that of the sample before, mostly.
    age = (state['stamp'] - state['echo_stamp'])[state['seq'] > 0.0]
    assert np.all(age > 0.004)
    assert np.median(age) == pytest.approx(0.005)
    measured = state['round_trip'] > 0.0
    assert measured[np.argmax(measured):].all()     # from the first answer on
    assert measured.mean() > 0.5
    # The first answer to a state reports how long it took; a safe command sent after it does not.
    answers = np.unique(command['echo_seq'], return_index=True)[1]
    assert np.all(command['hold'][answers] > 0.0)
    assert terms['theta1'][0] == 0.85
    offline = simulate(Configuration.from_flat({'loop.duration': 6.0}))
    errors = np.abs(state['x0'] - 2.5 * np.sin(state['stamp']))[-200:]
    assert np.median(errors) < abs(offline.x[0, 0]) / 25       # a stall may be among them
    assert data.configuration['controller.k_star'] == 2.5
    assert data.info['mode'] == 'realtime'
    assert 'Traceback' not in run.output


@pytest.mark.parametrize('overrides', [
    ('wang2004', 'plant.substeps=1'),
    *(('wang2004', f'controller.law={law}', 'controller.override_checks=true')
      for law in LAWS.builtin if law != 'wang2004'),
    ('wang2004', 'loop.delay=2', 'plant.noise=[0.001, 0.01]', 'loop.seed=7'),
    ('thruster', 'loop.schedule_times=[0.5, 1.5]', 'controller.law=scheduled',
     'controller.table_points=[14.0, 20.0]', 'controller.m_r_known=[0.86, 1.24]',
     'controller.m_l_known=[0.67, 0.93]', 'controller.b_r_known=[36.0, 28.0]',
     'controller.b_l_known=[-36.0, -28.0]', 'controller.psi_0=20.0'),
    ('servo', 'plant.static_friction=1.5', 'plant.backlash=0.1', 'loop.delay=1',
     'controller.error_band=0.001', 'controller.regressors_at=reference'),
    ('zhang_feng1997',), ('first_order',), ('servo',), ('pendulum',), ('valve_actuator',),
    ('step',)], ids=lambda words: ' '.join(words))
def test_lockstep_equals_the_offline_loop_bit_for_bit(processes, samples, tmp_path, overrides):
    name, *keys = overrides
    words = [word for key in keys for word in ('--set', key)]
    run = processes(*DZ, 'run', name, '--lockstep', '--duration', '2', '--quiet', '--record',
                    tmp_path / 'run', *words)
    assert run.wait() == 0, run.output
    data = read_run(tmp_path / 'run')
    same_as_offline(data, samples, simulate(load_configuration(name, [*keys, 'loop.duration=2'])))


def same_as_offline(data, samples, offline):
    """See that a run in lockstep has every sample of the offline loop, bit for bit."""
    found = {name: samples(channel) for name, channel in data.channels.items()}
    count, order = offline.x.shape
    assert len(found['state']) == len(found['command']) == len(found['terms']) == count
    assert np.array_equal(found['state'].values[:, 2:2 + order], offline.x_measured)
    assert np.array_equal(found['command']['v'], offline.v)
    assert np.array_equal(found['truth'].values[:, 2:], offline.truth)
    for signal_name in offline.configuration.law.signal_names:
        assert np.array_equal(found['terms'][signal_name], offline.column(signal_name))
    assert np.array_equal(found['reference'].values[:count, 2:], offline.x_d)
    assert data.info['mode'] == 'lockstep'


@pytest.mark.parametrize('frozen', ['controller_node', 'trajectory_node'])
def test_what_is_sent_again_in_lockstep_changes_nothing(processes, children, operator, samples,
                                                        tmp_path, frozen):
    from dz_ros.nodes.ros.topics import NEWEST
    run = processes(*DZ, 'run', 'zhang_feng1997', '--lockstep', '--duration', '0', '--record',
                    tmp_path / 'run')
    # The newest one alone: the loop is faster than a node that receives all of them.
    newest = collections.deque([0.0], maxlen=3)
    operator.node.create_subscription(operator.array, 'state', lambda message: newest.append(
        message.data[0]), NEWEST)
    operator.wait(lambda: newest[-1] > 300.0)
    node = children(run, 4)[frozen]
    os.kill(node, signal.SIGSTOP)
    operator.wait(lambda: newest[-1] == newest[0])      # sent once and two times more
    os.kill(node, signal.SIGCONT)
    reached = int(newest[-1])
    operator.wait(lambda: newest[-1] > reached + 300)
    assert run.interrupt() == 0, run.output
    data = read_run(tmp_path / 'run')
    found = {name: samples(data.channels[name]) for name in ('state', 'command')}
    assert len(data.channels['state']) > len(found['state']) > reached + 300
    wanted = simulate(load_configuration('zhang_feng1997', [
        f'loop.duration={(reached + 300) * 0.005}']))
    count = len(wanted.v)
    assert np.array_equal(found['state'].values[:count, 2:4], wanted.x)
    assert np.array_equal(found['command']['v'][:count], wanted.v)
    result = audit(data)
    assert result.passed, result


def test_lockstep_meets_the_reference_run(processes, samples, tmp_path):
    run = processes(*DZ, 'run', 'wang2004', '--lockstep', '--set', 'plant.substeps=1',
                    '--set', 'loop.duration=20', '--record', tmp_path / 'run')
    assert run.wait(120) == 0, run.output
    data = read_run(tmp_path / 'run')
    expected = np.loadtxt(Path(__file__).parents[1] / 'data' / 'wang2004_lambda1_rk4.csv',
                          delimiter=',', skiprows=2)
    assert len(expected) == 4001
    state, command, terms = (samples(data.channels[name])
                             for name in ('state', 'command', 'terms'))
    assert np.abs(state.values[:, 2:4] - expected[:, 2:4]).max() <= 1e-10
    assert np.abs(command['v'] - expected[:, 4]).max() <= 1e-8
    estimates = np.column_stack([terms[name] for name in ('theta1', 'theta2', 'phi')])
    assert np.abs(estimates - expected[:, 5:8]).max() <= 1e-10


def test_ctrl_c_ends_everything_in_order_without_a_traceback(processes, tmp_path, patient):
    run = processes(*DZ, 'run', *patient, '--duration', '600', '--record', tmp_path / 'run')
    run.wait_for_line('v ')
    run.signal(signal.SIGINT)
    run.signal(signal.SIGINT)
    assert run.wait() == 130
    assert 'Traceback' not in run.output
    assert 'none missing' in run.output
    data = read_run(tmp_path / 'run')
    assert len(data.channels['state']) > 1


@pytest.mark.parametrize('line', ['', 'ready'])
def test_ctrl_c_while_the_nodes_are_starting_is_as_orderly(processes, children, tmp_path,
                                                           patient, line):
    run = processes(*DZ, 'run', *patient, '--duration', '600', '--record', tmp_path / 'run')
    nodes = children(run, 1 if line == '' else 4)
    run.signal(signal.SIGINT)
    assert run.wait() == 130, run.output
    assert 'Traceback' not in run.output
    assert 'failed' not in run.output
    assert not [pid for pid in nodes.values() if Path(f'/proc/{pid}').exists()]


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGHUP])
def test_no_node_outlives_dz_run(processes, children, tmp_path, patient, number):
    run = processes(*DZ, 'run', *patient, '--duration', '0', '--record', tmp_path / 'run')
    run.wait_for_line('v ')
    nodes = children(run, 4)
    run.signal(number)
    run.wait()
    deadline = time.monotonic() + 60.0
    while any(Path(f'/proc/{pid}').exists() for pid in nodes.values()):
        assert time.monotonic() < deadline, 'a node goes on without dz run'
        time.sleep(0.05)
    assert read_run(tmp_path / 'run').info.get('cut') is None


@pytest.mark.parametrize('name', ['20261122', 'true', "a: b #it's"])
def test_a_run_is_recorded_under_the_name_given(processes, tmp_path, patient, name):
    run = processes(*DZ, 'run', *patient, '--duration', '0.1', '--quiet', '--record',
                    tmp_path / name)
    assert run.wait() == 0, run.output
    assert [item.name for item in tmp_path.iterdir()] == [name]


def test_a_plant_that_diverges_is_one_line(processes):
    run = processes(*DZ, 'run', 'wang2004', '--set', 'plant.x0=[900, 0]', '--quiet')
    assert run.wait() in (1, 2)
    assert 'Traceback' not in run.output


def test_a_second_loop_is_refused_and_the_first_goes_on(processes, tmp_path, patient):
    first = processes(*DZ, 'run', *patient, '--duration', '0')
    first.wait_for_line('v ')
    second = processes(*DZ, 'run', '--duration', '1', '--record', tmp_path / 'second')
    assert second.wait() == 2
    assert second.output.count('\n') == 0
    assert 'another loop' in second.output
    assert 'ROS_DOMAIN_ID' in second.output
    assert not (tmp_path / 'second').exists()
    beside = processes(*DZ, 'run', *patient, '--duration', '1', '--namespace', '/left')
    assert beside.wait() == 0, beside.output
    assert first.interrupt() == 0, first.output


def test_a_killed_node_is_named_and_the_recording_survives(processes, children, tmp_path, patient):
    run = processes(*DZ, 'run', *patient, '--duration', '600', '--record', tmp_path / 'run')
    run.wait_for_line('v ')
    os.kill(children(run, 4)['controller_node'], signal.SIGKILL)
    assert run.wait() == 1
    assert 'controller_node failed (killed by SIGKILL)' in run.output
    assert len(read_run(tmp_path / 'run').channels['command']) > 1


def test_a_users_mistake_is_one_line_and_exit_code_two(processes, tmp_path):
    run = processes(*DZ, 'run', '--set', 'controller.lamda=2', '--record', tmp_path / 'run')
    assert run.wait() == 2
    assert run.output.startswith('dz: error: ')
    assert run.output.count('\n') == 0
    assert 'did you mean controller.lambda' in run.output
    assert not (tmp_path / 'run').exists()


def test_without_rclpy_it_reports_it_in_one_line(processes, tmp_path):
    hide = "import sys; sys.modules['rclpy'] = None; "
    node = processes(sys.executable, '-c', hide + 'from dz_ros.nodes.main import plant_node; '
                     'sys.exit(plant_node())')
    assert node.wait() == 2
    command = processes(sys.executable, '-c', hide + 'from dz_ros.cli.main import main; '
                        f'sys.exit(main(["run", "--record", {str(tmp_path / "run")!r}]))')
    assert command.wait() == 2
    for process in (node, command):
        assert 'rclpy is not installed here' in process.output
        assert process.output.count('\n') == 0


def test_dz_run_copies_itself_and_each_node_is_a_process_of_its_own(processes, children):
    run = processes(*DZ, 'run', 'wang2004', '--duration', '0', fresh=True)
    found = children(run, 3)
    assert set(found) == {'plant_node', 'controller_node', 'trajectory_node'}
    assert len({os.getsid(pid) for pid in (run.pid, *found.values())}) == 4
    run.wait_for_line('t ')
    assert run.interrupt() == 0, run.output
    assert not any(Path(f'/proc/{pid}').exists() for pid in found.values())

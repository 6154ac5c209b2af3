# SPDX-License-Identifier: Apache-2.0
"""Starting and ending of a node's process: signals at any time, a home that is not there."""

from pathlib import Path
import signal
import sys
import time

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

ROOT = Path(__file__).parents[2]
DZ = ('-m', 'dz_ros')
MAX_SIGNALS = 20_000
"""Signals sent to one process at most."""
READY = {
    'plant_node': ('waiting for', '-p', 'loop.peers:=["absent_node"]'),
    'controller_node': ('design rule',),
    'trajectory_node': ('waiting for', '-p', 'loop.peers:=["controller_node"]'),
    'live_node': ('http://', '-p', 'port:=0'),
}


def bombard(process, number, pause):
    """Send a signal again and again, until the process has ended, or many have been sent."""
    for _ in range(MAX_SIGNALS):
        if process.poll() is not None:
            return
        process.signal(number)
        time.sleep(pause)


@pytest.mark.parametrize(('name', 'number', 'pause'), [
    ('plant_node', signal.SIGINT, 0.0), ('plant_node', signal.SIGTERM, 0.001),
    ('plant_node', signal.SIGHUP, 0.001), ('controller_node', signal.SIGINT, 0.001),
    ('trajectory_node', signal.SIGINT, 0.001), ('live_node', signal.SIGINT, 0.001)])
def test_further_signals_do_not_break_the_end_of_a_node(processes, name, number, pause):
    line, *arguments = READY[name]
    node = processes(sys.executable, '-c', f'import sys; from dz_ros.nodes.main import run_node; '
                     f'sys.exit(run_node({name!r}))', '--ros-args', *arguments)
    node.wait_for_line(line)
    bombard(node, number, pause)
    assert node.wait() == 0, node.output
    assert 'Traceback' not in node.output


def test_before_a_node_takes_signals_it_imports_next_to_nothing(processes):
    script = ('import sys; before = set(sys.modules); import dz_ros.nodes.main; '
              'print(*sorted(set(sys.modules) - before))')
    started = processes(sys.executable, '-S', '-c', script, PYTHONPATH=str(ROOT))
    assert started.wait() == 0, started.output
    loaded = {name for name in started.output.split() if name.partition('.')[0] == 'dz_ros'}
    assert loaded == {'dz_ros', 'dz_ros.nodes', 'dz_ros.nodes.main', 'dz_ros.runtime',
                      'dz_ros.runtime.import_path', 'dz_ros.runtime.os_signals'}
    assert not {'ctypes', 'dataclasses', 'json', 'socket', 'tempfile'} & set(
        started.output.split())


@pytest.mark.parametrize('pause', [0.0, 0.003])
def test_further_signals_do_not_break_the_end_of_a_run(processes, tmp_path, patient, pause):
    run = processes(*DZ, 'run', *patient, '--duration', '0', '--record', tmp_path / 'run')
    run.wait_for_line('t  ')
    bombard(run, signal.SIGINT, pause)
    assert run.wait() == 0, run.output
    assert 'Traceback' not in run.output
    assert 'none missing' in run.output
    assert (tmp_path / 'run/metadata.yaml').exists()


HOMES = [{'HOME': None}, {'HOME': ''}, {'HOME': '/dev/null'}, {'ROS_LOG_DIR': '/dev/null/log'},
         {'ROS_HOME': '/proc/none'}]


@pytest.mark.parametrize('environment', HOMES, ids=str)
def test_without_a_folder_for_log_files_a_node_reports_what_to_set_and_goes_on(processes,
                                                                               environment):
    node = processes('-m', 'dz_ros.nodes.main', 'plant_node', '--ros-args', '-p',
                     'loop.peers:=["absent_node"]', **{'ROS_LOG_DIR': None, **environment})
    node.wait_for_line('waiting for')
    assert node.interrupt() == 0
    assert 'ROS_LOG_DIR' in node.output.splitlines()[0]
    assert node.output.count('ROS_LOG_DIR') == 1
    assert 'Traceback' not in node.output
    assert '>>>' not in node.output


@pytest.mark.parametrize('words', [('run', '--duration', '0.5', '--quiet'), ('estop',),
                                   ('status', '--once')], ids=' '.join)
def test_without_a_home_a_verb_does_its_work_and_reports_it_in_one_line(processes, patient, words):
    verb = processes(*DZ, *words, *(patient if words[0] == 'run' else ()), HOME=None,
                     ROS_LOG_DIR=None)
    code = verb.wait()
    assert (code == 0) == (words[0] == 'run'), verb.output      # the others find no loop
    assert 'pressed on /estop' in verb.output or words[0] != 'estop'
    assert ('waiting for diagnostics: ' in verb.output) == (words[0] == 'status')
    assert verb.output.count('ROS_LOG_DIR') == 1
    assert 'Traceback' not in verb.output

# SPDX-License-Identifier: Apache-2.0
"""Nodes that are copies of dz: exit codes, output, descriptors, names, and when there are none."""

import json
import os
from pathlib import Path
import subprocess
import sys
import textwrap

import pytest

from dz_ros.cli import forked
from dz_ros.cli.processes import start_nodes

pytestmark = pytest.mark.skipif(sys.platform != 'linux', reason='elsewhere no node is a copy')
ROOT = str(Path(__file__).parents[2])


def program(body, **settings):
    """Run a program that may be copied; `node` is what a copy runs, `start` starts one."""
    text = textwrap.dedent("""
        import os, runpy, signal, subprocess, sys, threading
        from dz_ros.cli import forked
        forked.allow(['run', 'servo'])
        def start(node, words=(), inherited=(), output=None, environment=os.environ):
            runpy.run_module = lambda *_, **__: sys.exit(node())
            return forked.Forked('plant_node', words, environment, inherited, output)
        """) + textwrap.dedent(body)
    return subprocess.run([sys.executable, '-c', text], capture_output=True, text=True,
                          timeout=300, check=False, cwd=ROOT, **settings)


def test_exit_code_output_and_what_was_already_written_come_once():
    done = program("""
        print('before')
        node = start(lambda: print('of the node', file=sys.stderr) or 7)
        print(repr(node.stdout.read()), node.wait(), node.poll(), node.returncode)
        """)
    assert (done.stdout, done.stderr) == ("before\n'of the node\\n' 7 7 7\n", '')


def test_a_mistake_in_a_node_is_its_traceback_and_1_and_nothing_of_the_program_goes_on():
    done = program("""
        try:
            node = start(lambda: 1 / 0)
            text = node.stdout.read()
            print('ZeroDivisionError' in text, node.wait())
        finally:
            print('end')
        """)
    assert (done.stdout, done.stderr) == ('True 1\nend\n', '')


def test_signals_and_waiting_are_those_of_a_process():
    done = program("""
        node = start(signal.pause)
        try:
            node.wait(0.05)
        except subprocess.TimeoutExpired:
            print('runs', node.poll())
        node.kill()
        print(node.wait(60.0))
        node.send_signal(signal.SIGINT)     # it has ended
        """)
    assert (done.stdout, done.stderr) == ('runs None\n-9\n', '')


def test_a_copy_has_a_session_an_environment_a_name_and_only_the_descriptors_given():
    done = program("""
        kept, other = os.memfd_create('kept'), os.memfd_create('other')
        def node():
            import json
            listed = os.open('/proc/self/fd', os.O_RDONLY)      # listing opens one itself
            os.close(listed)
            print(json.dumps({
                'session': os.getsid(0) == os.getpid(), 'environment': dict(os.environ),
                'arguments': sys.argv[2:], 'comm': open('/proc/self/comm').read(),
                'command': open('/proc/self/cmdline').read().split('\\0'),
                'input': os.readlink('/proc/self/fd/0'),
                'open': [at for at in range(3, 200) if os.path.exists(f'/proc/self/fd/{at}')],
                'kept': kept}))
            return 0
        print(start(node, ['--a', 'b'], (kept,), None, {'ONLY': 'this'}).stdout.read())
        """, env={**os.environ, 'OTHER': 'that'})
    assert not done.stderr
    found = json.loads(done.stdout)
    assert found['session']
    assert found['environment'] == {'ONLY': 'this'}
    assert found['arguments'] == ['--a', 'b']
    assert found['comm'] == 'plant_node\n'
    assert found['command'][:4] == ['dz_ros.nodes.main', 'plant_node', '--a', 'b']
    assert found['input'] == '/dev/null'
    assert found['open'] == [found['kept']]


def test_output_of_several_nodes_goes_where_it_is_to(tmp_path):
    done = program(f"""
        with open({str(tmp_path / 'out')!r}, 'wb') as file:
            nodes = [start(lambda at=at: print(at) or 0, output=file.fileno()) for at in 'ab']
            print([node.wait() for node in nodes], nodes[0].stdout)
        """)
    assert (done.stdout, done.stderr) == ('[0, 0] None\n', '')
    assert sorted((tmp_path / 'out').read_text().split()) == ['a', 'b']


def test_with_a_second_thread_by_other_verbs_and_in_other_programs_nodes_are_not_copies():
    done = program("""
        print(forked.possible())
        forked._ours.clear()
        for words in ([], ['bag'], ['driver', 'commission'], ['driver', 'run'], ['bag', 'replay']):
            forked.allow(words)
            print(*words, forked.possible())
        end = threading.Event()
        threading.Thread(target=end.wait).start()
        print(forked.possible())
        end.set()
        """)
    assert (done.stdout.splitlines(), done.stderr) == ([
        'True', 'False', 'bag False', 'driver commission False', 'driver run False',
        'bag replay True', 'False'], '')
    assert not forked.possible()        # this process is not dz


@pytest.mark.ros
def test_nodes_that_are_no_copies_are_the_same_nodes(ros_domain):
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    words = ['--ros-args', '-p', 'loop.rate:=-1.0']
    nodes = dict(start_nodes({'controller_node': words, 'trajectory_node': words}))
    for name, node in nodes.items():
        assert isinstance(node, subprocess.Popen)
        text = node.stdout.read()
        assert (node.wait(), text.count('\n')) == (2, 1), text
        assert text.startswith(f'{name}: error: loop.rate')
        node.stdout.close()

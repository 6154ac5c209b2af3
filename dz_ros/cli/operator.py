"""Starting the node that watches, stops and resets running loops, and reading what it says."""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
import os
import signal
import subprocess
import sys

from dz_ros.errors import ConfigurationError, MissingDependencyError, NO_RCLPY


def add_namespace(parser: ArgumentParser) -> None:
    """Declare --namespace."""
    parser.add_argument('--namespace', default='', metavar='NS',
                        help='ROS namespace of the loop, e.g. /left_valve')


@contextmanager
def operator(task: str, namespace: str = '') -> Iterator[subprocess.Popen[str]]:
    """Run the node for a task; yield its process, whose output is JSON lines; end it.

    Raises:
        MissingDependencyError: rclpy is not installed.
        ConfigurationError: Not a namespace.
    """
    if find_spec('rclpy') is None:
        raise MissingDependencyError(NO_RCLPY)
    name = namespace.strip('/')
    if namespace and not all(part.isidentifier() for part in name.split('/')):
        raise ConfigurationError('--namespace', namespace,
                                 'must be names of letters, digits and _ separated by /')
    words = ['--ros-args', '-p', f'task:={task}']
    if name:
        words += ['-r', f'__ns:=/{name}']
    environment = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', **os.environ}
    process = subprocess.Popen(
        [sys.executable, '-m', 'dz_ros.nodes.main', 'operator_node', *words], env=environment,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()


def do_once(task: str, namespace: str) -> int:
    """Do a task that ends by itself, print what each node answered, return the exit code."""
    import json
    with operator(task, namespace) as process:
        assert process.stdout is not None
        for line in process.stdout:
            answer = json.loads(line)
            print(f'{answer["node"]}: {answer["message"]}')
        return process.wait()

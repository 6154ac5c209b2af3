# SPDX-License-Identifier: Apache-2.0
"""``dz estop``, ``dz reset``: the safe command at both ends of a loop, until reset; its release.

Both, and ``dz status``, run operator_node as a process whose output is JSON lines.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
import json
import signal
import subprocess

from dz_ros.cli.options import namespace_name
from dz_ros.cli.output import print_lines
from dz_ros.cli.processes import start_node
from dz_ros.errors import ConfigurationError, MissingDependencyError, NO_RCLPY


def add_namespace(parser: ArgumentParser) -> None:
    """Declare --namespace."""
    parser.add_argument('--namespace', default='', metavar='NS',
                        help='ROS namespace of the loop, e.g. /left_valve')


def add_remapping(parser: ArgumentParser) -> None:
    """Declare --remap."""
    parser.add_argument('--remap', action='append', default=[], metavar='FROM:=TO',
                        help='name that the loop was started with in place of another, as its '
                             'nodes were given it with -r: a topic, or plant_node/reset and the '
                             'like for a service; may be repeated')


@contextmanager
def operator(task: str, namespace: str = '',
             remappings: Sequence[str] = ()) -> Iterator[subprocess.Popen[str]]:
    """Run the node for a task; yield its process, whose output is JSON lines; end it.

    Raises:
        MissingDependencyError: rclpy is not installed.
        ConfigurationError: Not a namespace, or not a remapping.
    """
    for rule in remappings:
        old, sign, new = rule.partition(':=')
        if not (old and sign and new):
            raise ConfigurationError('--remap', rule, 'must be FROM:=TO, e.g. estop:=stop_all')
    if find_spec('rclpy') is None:
        raise MissingDependencyError(NO_RCLPY)
    name = namespace_name(namespace)
    words = ['--ros-args', '-p', f'task:={task}']
    if name:
        words += ['-r', f'__ns:=/{name}']
    for rule in remappings:
        words += ['-r', rule]
    process = start_node('operator_node', words, stdout=subprocess.PIPE, text=True)
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


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments of ``dz estop`` and ``dz reset``."""
    add_namespace(parser)
    add_remapping(parser)


def run(arguments: Namespace) -> int:
    """Do it, print what each node answered; return 0, or 2 where one is not there or refuses."""
    with operator(arguments.words[0], arguments.namespace, arguments.remap) as process:
        assert process.stdout is not None
        for line in process.stdout:
            answer = json.loads(line)
            print_lines(f'{answer["node"]}: {answer["message"]}')
        return process.wait()

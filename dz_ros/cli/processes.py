# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes of a verb: started, waited for, ended in order, each by its own id."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time
from types import TracebackType
from typing import Any

import yaml

from dz_ros.cli import forked
from dz_ros.errors import MissingDependencyError, NO_RCLPY
from dz_ros.runtime.log_folder import log_folder_fault, NO_LOG_FILES
from dz_ros.runtime.os_signals import ENDS, on_ends, restore_handlers
from dz_ros.runtime.process import PARENT

GRACE = 10.0
"""A node that has not ended this long after the request is killed [s]."""
NodeProcess = subprocess.Popen[Any] | forked.Forked
_POLL = 0.02
_DESCRIPTORS = '/dev/fd/'


def check_rclpy() -> None:
    """Find out whether nodes could start at all.

    Raises:
        MissingDependencyError: rclpy is not installed.
    """
    if find_spec('rclpy') is None:
        raise MissingDependencyError(NO_RCLPY)


def python_environment() -> dict[str, str]:
    """Return the environment in which another Python finds this package, and ends with this one.

    The folder in which the user happens to be is none of its Python path.
    """
    home = str(Path(__file__).resolve().parents[2])
    paths = os.environ.get('PYTHONPATH', '').split(os.pathsep)
    if home not in (*sys.path[1:], *paths):
        paths.insert(0, home)
    return {**os.environ, PARENT: str(os.getpid()), 'PYTHONSAFEPATH': '1',
            'PYTHONPATH': os.pathsep.join(path for path in paths if path)}


def start_node(name: str, arguments: Sequence[str], inherited: Sequence[int] = (),
               **streams: Any) -> subprocess.Popen[Any]:
    """Start a node in a session of its own, so that Ctrl-C reaches this process alone.

    Signals wait until the node can take them; the node ends when this process ends, however it
    ends; the folder in which the user happens to be is none of its Python path.

    Args:
        name: Executable of the node.
        arguments: Its command line.
        inherited: File descriptors that it gets besides the parameter files it names.
        **streams: Standard streams and their encoding, as of `subprocess.Popen`.
    """
    arguments, given, environment = _prepared(arguments)
    with _ends_held_back():
        return subprocess.Popen([sys.executable, '-m', forked.PROGRAM, name, *arguments],
                                env=environment, stdin=subprocess.DEVNULL,
                                start_new_session=True, pass_fds=(*given, *inherited), **streams)


def start_nodes(nodes: Mapping[str, Sequence[str]],
                output: int | None = None) -> Iterator[tuple[str, NodeProcess]]:
    """Start several nodes, as `start_node` does one; yield name and process of each.

    Where the system allows it they are copies of this process, which has imported what they need:
    so this process must not start a thread before the last of them is started.

    Args:
        nodes: Executable → command line.
        output: Descriptor that their standard output and error go to, None = a pipe for each, of
            text, to its `stdout`.
    """
    if len(nodes) > 1:
        forked.preload()
    for name, words in nodes.items():
        if len(nodes) == 1 or not forked.possible():
            yield name, start_node(name, words, stdout=output or subprocess.PIPE,
                                   stderr=output or subprocess.STDOUT, text=True,
                                   errors='replace')
            continue
        arguments, given, environment = _prepared(words)
        with _ends_held_back():
            process = forked.Forked(name, arguments, environment, given, output)
        yield name, process


def _prepared(arguments: Sequence[str]) -> tuple[list[str], list[int], dict[str, str]]:
    """Return a node's command line, the descriptors it names, its environment."""
    words = [*arguments, *(['--ros-args', NO_LOG_FILES] if _log_folder_fault() else [])]
    given = [int(word.removeprefix(_DESCRIPTORS)) for word in words
             if word.startswith(_DESCRIPTORS)]
    return words, given, {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', **python_environment()}


@contextmanager
def _ends_held_back() -> Iterator[None]:
    """Start a process whose signals wait until it can take them."""
    held = signal.pthread_sigmask(signal.SIG_BLOCK, ENDS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)


def ask_to_end(process: NodeProcess) -> None:
    """Ask a node to end, also one that is stopped (SIGSTOP)."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGCONT)


def wait_or_kill(process: NodeProcess) -> int:
    """Return a node's exit code; kill it where it does not end in time."""
    try:
        return process.wait(GRACE)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


@cache
def _log_folder_fault() -> str:
    """Return why nodes cannot keep log files, '' where they can; print it once."""
    fault = log_folder_fault()
    if fault:
        print(f'dz: warning: {fault}', file=sys.stderr)
    return fault


class ParameterFiles:
    """Files without a name for the nodes of one verb; a context manager that closes them.

    `start_node` passes them on. They are gone with the last process that has them open, so nothing
    stays behind however a verb ends, and they need no room on a disk.
    """

    def __init__(self) -> None:
        self._descriptors: list[int] = []

    def add(self, text: str) -> str:
        """Return the path, in this process and its nodes, of a new file with this text."""
        if hasattr(os, 'memfd_create'):
            descriptor = os.memfd_create('parameters')
        else:
            with tempfile.TemporaryFile() as file:
                descriptor = os.dup(file.fileno())
        self._descriptors.append(descriptor)
        with os.fdopen(descriptor, 'wb', closefd=False) as whole:   # or an error, never a part
            whole.write(text.encode())
        return f'{_DESCRIPTORS}{descriptor}'

    def add_parameters(self, parameters: Mapping[str, Any]) -> str:
        """Return the path of a file with parameters for every node; text stays text."""
        return self.add(yaml.safe_dump({'/**': {'ros__parameters': dict(parameters)}},
                                       allow_unicode=True))

    def __enter__(self) -> ParameterFiles:
        return self

    def __exit__(self, *exception: object) -> None:
        for descriptor in self._descriptors:
            os.close(descriptor)
        self._descriptors.clear()


class Nodes:
    """The nodes of one verb; a context manager that ends what still runs.

    Ctrl-C and SIGTERM reach this process alone and are passed on in order.

    Attributes:
        interrupted: Whether a signal asked for the end.
    """

    def __init__(self) -> None:
        self.interrupted = False
        self._processes: dict[str, NodeProcess] = {}
        self._previous: Mapping[Any, Any] = {}

    def __enter__(self) -> Nodes:
        self._previous = on_ends(self._interrupt)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        for name in reversed(self._processes):
            self.end(name)
        restore_handlers(self._previous)

    def start(self, nodes: Mapping[str, Sequence[str]]) -> None:
        """Start nodes with their ROS arguments, each in a session of its own."""
        for name, process in start_nodes({name: ['--ros-args', *arguments] for name, arguments in
                                          nodes.items()}, sys.stderr.fileno()):
            self._processes[name] = process

    def wait(self, name: str) -> int:
        """Wait until a node ends and return its exit code.

        Once interrupted, or if another one ends before it with an error, it is ended.
        """
        process = self._processes[name]
        while (code := process.poll()) is None:
            failed = [other for other in self._processes.values() if other.poll()]
            if self.interrupted or failed:
                own = self.end(name)
                return failed[0].wait() if failed else own
            time.sleep(_POLL)
        return code

    def end(self, name: str) -> int:
        """End a node, kill it if it does not, and return its exit code."""
        process = self._processes[name]
        ask_to_end(process)
        return wait_or_kill(process)

    def _interrupt(self, _number: int, _frame: object) -> None:
        self.interrupted = True

"""Nodes as processes of a verb: started, waited for, ended in order, each by its own id."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from types import TracebackType
from typing import Any

import yaml

from dz_ros.errors import MissingDependencyError, NO_RCLPY
from dz_ros.runtime.process import PARENT

ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a verb in order; the last one is a terminal that was closed."""
GRACE = 10.0
"""A node that has not ended this long after being told is killed [s]."""
_POLL = 0.02


def check_rclpy() -> None:
    """Find out whether nodes could start at all.

    Raises:
        MissingDependencyError: rclpy is not installed.
    """
    if find_spec('rclpy') is None:
        raise MissingDependencyError(NO_RCLPY)


def start_node(name: str, arguments: Sequence[str], **streams: Any) -> subprocess.Popen[Any]:
    """Start a node in a session of its own, so that Ctrl-C reaches this process alone.

    Signals wait until the node can take them; the node ends when this process ends, however it
    ends; the folder in which the user happens to be is none of its Python path.

    Args:
        name: Executable of the node.
        arguments: Its command line.
        **streams: Standard streams and their encoding, as of `subprocess.Popen`.
    """
    home = str(Path(__file__).resolve().parents[2])
    paths = os.environ.get('PYTHONPATH', '').split(os.pathsep)
    if home not in (*sys.path[1:], *paths):
        paths.insert(0, home)
    environment = {
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', **os.environ, PARENT: str(os.getpid()),
        'PYTHONSAFEPATH': '1', 'PYTHONPATH': os.pathsep.join(path for path in paths if path)}
    held = signal.pthread_sigmask(signal.SIG_BLOCK, ENDS)
    try:
        return subprocess.Popen([sys.executable, '-m', 'dz_ros.nodes.main', name, *arguments],
                                env=environment, stdin=subprocess.DEVNULL,
                                start_new_session=True, **streams)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)


def write_node_parameters(path: Path, parameters: Mapping[str, Any]) -> None:
    """Write parameters for every node as a file; text keeps its type, whatever it looks like."""
    path.write_text(yaml.safe_dump({'/**': {'ros__parameters': dict(parameters)}},
                                   allow_unicode=True), encoding='utf-8')


class Nodes:
    """The nodes of one verb; a context manager that ends what still runs.

    Ctrl-C and SIGTERM reach this process alone and are passed on in order.

    Attributes:
        interrupted: Whether a signal asked for the end.
    """

    def __init__(self) -> None:
        self.interrupted = False
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> Nodes:
        for number in ENDS:
            self._previous[number] = signal.signal(number, self._interrupt)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        for name in reversed(self._processes):
            self.end(name)
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def start(self, name: str, arguments: Sequence[str]) -> None:
        """Start a node with its ROS arguments, in a session of its own."""
        self._processes[name] = start_node(name, ['--ros-args', *arguments],
                                           stdout=sys.stderr.fileno())

    def wait(self, name: str) -> int:
        """Wait until a node ends and return its exit code.

        Once interrupted, or if another one ends before it with an error, it is ended.
        """
        process = self._processes[name]
        while (code := process.poll()) is None:
            failed = [other for other in self._processes.values() if other.poll()]
            if self.interrupted or failed:
                self.end(name)
                return failed[0].returncode if failed else process.returncode
            time.sleep(_POLL)
        return code

    def end(self, name: str) -> int:
        """Tell a node to end, kill it if it does not, and return its exit code."""
        process = self._processes[name]
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            return process.wait(GRACE)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait()

    def _interrupt(self, _number: int, _frame: object) -> None:
        self.interrupted = True

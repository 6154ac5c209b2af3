# SPDX-License-Identifier: Apache-2.0
"""Nodes as copies of a program that has imported what they need (Linux).

Most of a node's start are imports: Python, NumPy, rclpy and this package. Where a verb starts
several nodes, it imports them once and forks; each node is a process of its own all the same, with
its own session, environment, descriptors and name (`benchmarks/starting.py`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
import ctypes
import gc
import importlib
import io
import os
from pathlib import Path
import runpy
import signal
import subprocess
import sys
import threading
import time
from typing import NoReturn, TextIO
import warnings

from dz_ros.errors import DzRosError

VERBS = (('run',), ('bag', 'replay'))
"""Verbs that start nodes and do nothing else before."""
PROGRAM = 'dz_ros.nodes.main'
"""Module that a node's process runs, with the node's name as its first argument."""
COMMON = ('rclpy', 'rclpy.lifecycle', 'std_msgs.msg', 'std_srvs.srv', 'rcl_interfaces.srv',
          'dz_ros.nodes.plant_node', 'dz_ros.nodes.controller_node',
          'dz_ros.nodes.trajectory_node', 'dz_ros.nodes.recorder_node')
"""Modules that the nodes of a loop need."""
_POLL = 0.01
_ARG_START, _ARG_END = 48 - 3, 49 - 3
"""Places of fields of proc(5)'s stat after the name of the program, counted from its state."""

_ours: list[bool] = []


def allow(words: Sequence[str]) -> None:
    """Allow this process to be copied: it is ``dz`` with a verb that is one of `VERBS`.

    Others may have a participant of DDS when they start nodes, as `dz driver commission` of a
    joint does. Its threads are not copied, what they have locked is, and a node would wait for it
    for ever.

    Args:
        words: Command line of this process, without the program's name.
    """
    if any(tuple(words[:len(verb)]) == verb for verb in VERBS):
        _ours.append(True)


def possible() -> bool:
    """Return whether this process may be copied now: on Linux, allowed, with one thread."""
    return bool(_ours) and sys.platform == 'linux' and threading.active_count() == 1


def preload() -> None:
    """Import what nodes need before they are forked; what is missing is for the node to report."""
    if not possible():
        return
    for name in COMMON:
        with suppress(ImportError, DzRosError):
            importlib.import_module(name)
    gc.collect()
    gc.freeze()     # so that no collection writes to what the copies share


class Forked:
    """A node's process, used as a `subprocess.Popen` is.

    Attributes:
        pid: Its process id.
        stdout: What it writes, also to standard error; None where `output` was given.
        returncode: Its exit code, minus the signal that killed it, None while it runs.
    """

    def __init__(self, name: str, arguments: Sequence[str], environment: Mapping[str, str],
                 inherited: Collection[int], output: int | None = None) -> None:
        """Copy this process; the copy runs the node and ends.

        Args:
            name: Executable of the node.
            arguments: Its command line.
            environment: Its environment variables.
            inherited: File descriptors that it gets besides its standard streams.
            output: Descriptor that both its outputs go to, None = a pipe to `stdout`.

        Raises:
            OSError: No further process, or no further descriptor.
        """
        read, write = os.pipe() if output is None else (None, output)
        for stream in (sys.stdout, sys.stderr):     # or the copy writes what waits in them, too
            with suppress(OSError):
                stream.flush()
        with warnings.catch_warnings():     # NumPy's threads wait, and begin again in the copy
            warnings.simplefilter('ignore', DeprecationWarning)
            pid = os.fork()
        if pid == 0:
            _be(name, arguments, environment, inherited, write)
        self.pid = pid
        self.returncode: int | None = None
        self.stdout: TextIO | None = None
        if read is not None:
            os.close(write)
            self.stdout = os.fdopen(read, errors='replace')

    def poll(self) -> int | None:
        """Return its exit code, None while it runs."""
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Return its exit code once it has ended.

        Args:
            timeout: Longest wait [s], None = as long as it takes.

        Raises:
            subprocess.TimeoutExpired: It still runs.
        """
        give_up = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if give_up is not None and time.monotonic() > give_up:
                raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
            time.sleep(_POLL)
        return code

    def send_signal(self, number: int) -> None:
        """Send it a signal unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


def _be(name: str, arguments: Sequence[str], environment: Mapping[str, str],
        inherited: Collection[int], output: int) -> None:
    """Run a node in this process, a copy, and end it."""
    code = 1
    try:
        detach(environment, inherited, output)
        name_process(name, (PROGRAM, name, *arguments))
        sys.argv = ['', name, *arguments]
        try:
            runpy.run_module(PROGRAM, run_name='__main__', alter_sys=True)
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
        gc.collect()        # what holds a participant of DDS lets it go
    except BaseException:  # noqa: BLE001  nothing of the program that was copied may run on
        sys.excepthook(*sys.exc_info())
    finally:
        leave(code)


def detach(environment: Mapping[str, str], inherited: Collection[int], output: int) -> None:
    """Give this process, a copy, a session, streams, descriptors and an environment of its own.

    Args:
        environment: Its environment variables.
        inherited: File descriptors that it keeps besides its standard streams.
        output: Descriptor that its standard output and error go to.
    """
    os.setsid()
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for descriptor in [int(item.name) for item in Path('/proc/self/fd').iterdir()]:
        if descriptor > 2 and descriptor not in inherited:
            with suppress(OSError):
                os.close(descriptor)
    os.environ.clear()
    os.environ.update(environment)
    # What they knew of the files that they wrote to is of the process that was copied.
    if environment.get('PYTHONUNBUFFERED'):
        sys.stdout = io.TextIOWrapper(os.fdopen(1, 'wb', 0, closefd=False), write_through=True)
    else:
        sys.stdout = os.fdopen(1, 'w', closefd=False)
    sys.stderr = os.fdopen(2, 'w', buffering=1, errors='backslashreplace', closefd=False)


def leave(code: int) -> NoReturn:
    """End this process, a copy, without what the program that was copied does at its end."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(code)


def name_process(name: str, words: Sequence[str]) -> None:
    """Have `ps`, `top` and `pgrep` show a name and, as far as the old ones have room, words."""
    text = b'\0'.join(map(os.fsencode, words))
    try:
        Path('/proc/self/comm').write_text(name, encoding='ascii')
        stat = Path('/proc/self/stat').read_text(encoding='ascii', errors='replace')
    except OSError:
        return
    fields = stat.rpartition(')')[2].split()
    start, end = int(fields[_ARG_START]), int(fields[_ARG_END])
    if end - start > len(name):     # zeros where the system hides them
        ctypes.memmove(start, text[:end - start - 1].ljust(end - start, b'\0'), end - start)

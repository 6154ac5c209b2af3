"""Fixtures: a ROS domain of one's own, processes that end with it, firmware, launch files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import contextlib
import fcntl
import importlib.util
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import types

import pytest

DOMAINS = range(102)
"""ROS_DOMAIN_ID that leave room for DDS's ports on every platform."""

END_TIME_OUT = 30.0
"""A process that has not ended this long after SIGINT is killed [s]."""


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Yield a ROS_DOMAIN_ID no other test of this machine uses meanwhile; set the environment."""
    start = os.getpid() % len(DOMAINS)
    with contextlib.ExitStack() as stack:
        for offset in DOMAINS:
            domain = (start + offset) % len(DOMAINS)
            lock = Path(tempfile.gettempdir()) / f'dz_ros-test-domain-{domain}.lock'
            try:
                file = lock.open('a')
            except OSError:     # another user's
                continue
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                file.close()
                continue
            stack.enter_context(file)
            break
        else:
            pytest.fail('every ROS domain from 0 to 101 is in use by tests of this machine')
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
        monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        monkeypatch.delenv('ROS_LOCALHOST_ONLY', raising=False)
        yield domain


class Process:
    """A program under test, in a session of its own, its output collected line by line.

    Attributes:
        command: What was started.
    """

    def __init__(self, command: Sequence[str], environment: Mapping[str, str],
                 folder: Path | None) -> None:
        self.command = list(command)
        self._process = subprocess.Popen(
            self.command, env=dict(environment), cwd=folder, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors='replace',
            start_new_session=True)
        self._lines: list[str] = []
        self._changed = threading.Condition()
        self._finished = False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._changed:
                self._lines.append(line.rstrip('\n'))
                self._changed.notify_all()
        with self._changed:
            self._finished = True
            self._changed.notify_all()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def output(self) -> str:
        """What it has written so far, standard output and error together."""
        with self._changed:
            return '\n'.join(self._lines)

    def poll(self) -> int | None:
        """Return its exit code, None while it runs."""
        return self._process.poll()

    def wait_for_line(self, part: str, timeout: float = 60.0, nth: int = 1) -> str:
        """Return the nth line that contains a text; fail if it ends or takes too long."""
        deadline = time.monotonic() + timeout
        with self._changed:
            seen = 0
            while True:
                for line in self._lines[seen:]:
                    nth -= part in line
                    if nth == 0:
                        return line
                seen = len(self._lines)
                if self._finished or not self._changed.wait(deadline - time.monotonic()):
                    text = '\n'.join(self._lines)
                    pytest.fail(f'{" ".join(self.command)} never wrote {part!r}:\n{text}')

    def signal(self, number: int) -> None:
        """Send a signal to the process alone, as `kill PID` does."""
        self._process.send_signal(number)

    def wait(self, timeout: float = 60.0) -> int:
        """Return its exit code once it and its output have ended; fail after the time-out."""
        try:
            code = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            pytest.fail(f'{" ".join(self.command)} still runs after {timeout:g} s:\n{self.output}')
        self._reader.join(timeout)
        return code

    def interrupt(self, timeout: float = END_TIME_OUT) -> int:
        """End it as Ctrl-C would and return its exit code."""
        if self.poll() is None:
            self.signal(signal.SIGINT)
        return self.wait(timeout)

    def end(self) -> None:
        """End it by its own id: SIGINT first, SIGKILL if that does not help."""
        if self.poll() is None:
            self.signal(signal.SIGINT)
            try:
                self._process.wait(END_TIME_OUT)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._reader.join(END_TIME_OUT)
        if self._process.stdout is not None and not self._reader.is_alive():
            self._process.stdout.close()


StartProcess = Callable[..., Process]


@pytest.fixture
def processes() -> Iterator[StartProcess]:
    """Yield ``start(*command, cwd=None, **environment) -> Process``; end all when the test ends.

    A command that starts with a word ending in ``.py`` or with ``-m`` runs in this Python.
    Environment variables given as None are removed.
    """
    started: list[Process] = []

    def start(*command: str | os.PathLike[str], cwd: Path | None = None,
              **environment: str | None) -> Process:
        words = [os.fspath(word) for word in command]
        if words[0] == '-m' or words[0].endswith('.py'):
            words.insert(0, sys.executable)
        merged = {**os.environ, 'PYTHONUNBUFFERED': '1', **environment}
        process = Process(words, {key: value for key, value in merged.items()
                                  if value is not None}, cwd)
        started.append(process)
        return process

    try:
        yield start
    finally:
        for process in reversed(started):
            process.end()


FIRMWARE = Path(__file__).parents[1] / 'examples' / 'firmware'
FLAGS = ('-std=c99', '-pedantic', '-O2', '-Wall', '-Wextra', '-Wshadow', '-Wconversion', '-Werror')
SANITIZER = ('-fsanitize=undefined', '-fno-sanitize-recover=all', '-static-libubsan')


def compiled(folder, name, *arguments, sanitized=False):
    """Compile the firmware, skip where there is no compiler; return the file."""
    compiler = shutil.which('cc')
    if compiler is None:
        pytest.skip('no C compiler (cc) on this machine: the firmware is not tested')
    if not FIRMWARE.is_dir():
        pytest.skip('needs the source tree: examples/firmware is not installed')
    target = folder / name

    def compile_with(*flags):
        return subprocess.run([compiler, *FLAGS, *flags, '-o', str(target), *arguments],
                              cwd=FIRMWARE, capture_output=True, text=True, timeout=120,
                              check=False)

    done = compile_with(*SANITIZER) if sanitized else None
    if done is None or done.returncode:     # not every compiler has the sanitizer
        done = compile_with()
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return target


@pytest.fixture(scope='session')
def firmware(tmp_path_factory):
    """Return the reference firmware as a program for this machine."""
    return compiled(tmp_path_factory.mktemp('firmware'), 'firmware', 'dz_device.c', 'line_main.c',
                    '-lm')


@pytest.fixture(scope='session')
def firmware_library(tmp_path_factory):
    """Return the firmware's portable part as a shared library."""
    return compiled(tmp_path_factory.mktemp('firmware'), 'dz_device.so', '-shared', '-fPIC',
                    'dz_device.c', sanitized=True)


@pytest.fixture(params=['emulated', 'firmware'])
def serial_device(request, processes, tmp_path):
    """Return a function that starts a device on a serial line with faults, and its `port`."""
    port = tmp_path / 'port'
    options = ['-o', f'link={port}']
    if request.param == 'firmware':
        options += ['-o', f'program={request.getfixturevalue("firmware")}']

    def start(*faults):
        process = processes('-m', 'dz_ros', 'driver', 'emulate', 'serial', 'serial', *options,
                            *(word for fault in faults for word in ('--fault', fault)))
        process.wait_for_line('serial device on')
        return process

    start.port = port
    return start


class Made:
    """Whatever a launch file makes: what it is made of is kept."""

    def __init__(self, *positional, **named):
        self.positional, self.named = positional, named

    def perform(self, context):
        """Return the value of an argument."""
        return context[self.positional[0]]


LAUNCH = {'launch': ['LaunchDescription'],
          'launch.actions': ['DeclareLaunchArgument', 'EmitEvent', 'OpaqueFunction',
                             'RegisterEventHandler'],
          'launch.event_handlers': ['OnProcessExit'], 'launch.events': ['Shutdown'],
          'launch.substitutions': ['LaunchConfiguration'], 'launch_ros': [],
          'launch_ros.actions': ['Node']}
"""What our launch files use of launch, which has no wheels: module → classes."""


@pytest.fixture
def load_launch_file(monkeypatch):
    """Return ``load(name) -> module`` of launch/NAME.launch.py, with stand-ins for launch."""
    root = Path(__file__).parents[1]

    def load(name):
        for module_name, classes in LAUNCH.items():
            module = types.ModuleType(module_name)
            for kind in classes:
                setattr(module, kind, type(kind, (Made,), {}))
            monkeypatch.setitem(sys.modules, module_name, module)
        index = types.ModuleType('ament_index_python.packages')
        index.get_package_share_directory = lambda package: str(root)
        monkeypatch.setitem(sys.modules, 'ament_index_python.packages', index)
        spec = importlib.util.spec_from_file_location(
            f'{name}_launch', root / 'launch' / f'{name}.launch.py')
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load

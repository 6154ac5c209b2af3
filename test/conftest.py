# SPDX-License-Identifier: Apache-2.0
"""Fixtures: a ROS domain of one's own, processes that end with it, firmware, launches, runs.

Over 300 lines: what several folders share, and pytest finds nowhere else.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable, Iterator, Mapping, Sequence
import contextlib
from dataclasses import replace
import fcntl
import functools
import importlib.util
import json
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
from types import SimpleNamespace
from typing import Any

import hypothesis
import numpy as np
import pytest

from dz_ros.cli import progress
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import Channel, from_run, RunData
from dz_ros.core.loop.controller import Controller
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import Command, Reference, State, Terms
from dz_ros.studies.code_folder import keep_compiled, VARIABLE
from dz_ros.version import version

sys.path.append(str(Path(__file__).parent))
from process_server import can_start, Program, Server  # noqa: E402  of this folder

# A slow machine is no finding, and a test run twice is the same test; `make fuzz` searches on.
hypothesis.settings.register_profile(
    'test', deadline=None, derandomize=True, max_examples=40,
    suppress_health_check=[hypothesis.HealthCheck.too_slow])
hypothesis.settings.register_profile('quick', hypothesis.settings.get_profile('test'),
                                     max_examples=10)
hypothesis.settings.register_profile('thorough', hypothesis.settings.get_profile('test'),
                                     max_examples=400, derandomize=False)
hypothesis.settings.load_profile('test')

DOMAINS = range(102)
"""ROS_DOMAIN_ID that leave room for DDS's ports on every platform."""

# Workers and processes share what they compile, which is of this run.
if 'PYTEST_XDIST_WORKER' not in os.environ:
    CODE = tempfile.mkdtemp(prefix='test-code-')
    os.environ[VARIABLE] = CODE
    atexit.register(shutil.rmtree, CODE, ignore_errors=True)
keep_compiled()

PROCESSES, BROWSER, LONG = 'processes', 'browser', 'long'
"""First part of the name of a group of tests that start processes of ROS or a browser; second part
of the group of those that need a browser, and of groups that take long: these come first."""
WORKERS_WITH_ROLES = 3
"""From this number of workers on the last one only computes."""
LESS = 5
"""Niceness of that one: a third of a loop's weight, where neither would get all it wants."""

END_TIME_OUT = 30.0
"""A process that has not ended this long after SIGINT is killed [s]."""


def pytest_configure() -> None:
    """Take SIGINT, which a job in the background ignores, and its children would with it."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)     # before xdist reads the groups
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Have workers take whole files, which may share fixtures; of what waits, whole functions.

    A browser beside a loop takes more than a core: all that need one are one worker's.
    """
    if not config.pluginmanager.hasplugin('xdist'):
        return
    for item in items:
        file, _, function = item.nodeid.partition('[')[0].partition('::')
        marks = {mark.name for mark in item.iter_markers()}
        group = (f'{PROCESSES} {BROWSER}' if 'live' in marks else
                 f'{PROCESSES} {LONG if "slow" in marks else ""} {file} {function}'
                 if 'ros' in marks else
                 f'{file} {function}' if '/drivers/' in file else file)
        item.add_marker(pytest.mark.xdist_group(group))


@pytest.hookimpl(trylast=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    """Have a worker that only computes do it in the time that loops leave."""
    worker = getattr(session.config, 'workerinput', {})
    count = worker.get('workercount', 0)
    if count < WORKERS_WITH_ROLES or worker['workerid'] != f'gw{count - 1}' or not any(
            starts_processes(item) for item in session.items):
        return
    os.nice(LESS)
    with contextlib.suppress(OSError):      # of a session, where the kernel groups by session
        os.setsid()
        Path('/proc/self/autogroup').write_text(str(LESS), encoding='ascii')


def starts_processes(item: pytest.Item) -> bool:
    """Return whether a test starts processes of ROS or a browser."""
    return any(item.get_closest_marker(mark) for mark in ('ros', 'live'))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Return a scheduler that mixes what waits with what computes."""
    if config.option.dist != 'loadgroup':
        return None
    from xdist.scheduler import LoadGroupScheduling

    class Mixed(LoadGroupScheduling):
        """The last worker takes what starts no processes, all others first what does.

        Tests with ROS processes mostly wait, so some of them at once, each in a domain of its
        own, leave the cores enough for one that computes.
        """

        def _assign_work_unit(self, node: Any) -> None:
            computes = len(self.nodes) > 1 and node.gateway.id == f'gw{len(self.nodes) - 1}'
            wanted = next((scope for part in (BROWSER, LONG, '') for scope in self.workqueue
                           if scope.startswith(f'{PROCESSES} {part}') and not computes),
                          next((scope for scope in self.workqueue
                                if not scope.startswith(PROCESSES)), None))
            if wanted is not None:
                self.workqueue.move_to_end(wanted, last=False)
            elif len(self.nodes) >= WORKERS_WITH_ROLES:
                node.shutdown()
                return
            super()._assign_work_unit(node)

    return Mixed(config, log)


@pytest.fixture(autouse=True)
def patient_stages(monkeypatch):
    """Have a verb that runs in this process show no stage, however long a busy machine takes."""
    monkeypatch.setattr(progress, 'NOTICED', 1e6)


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
                 folder: Path | None, server: Any = None) -> None:
        self.command = list(command)
        self._process = Program(server, self.command, dict(environment), folder) if server else \
            subprocess.Popen(
                self.command, env=dict(environment), cwd=folder, stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors='replace',
                start_new_session=True,
                # A job in the background may ignore it, and its children would with it.
                preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL))
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

    def wait_for_line(self, part: str, timeout: float = 180.0, nth: int = 1) -> str:
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

    def wait(self, timeout: float = 180.0) -> int:
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


@pytest.fixture(scope='session')
def process_server() -> Iterator[Callable[[], Server]]:
    """Yield the function that returns the server of programs, started when first asked for."""
    server = functools.cache(Server)
    yield server
    if server.cache_info().currsize:
        server().close()


@pytest.fixture
def processes(process_server: Callable[[], Server]) -> Iterator[StartProcess]:
    """Yield ``start(*command, cwd=None, fresh=False, **environment) -> Process``; end all at last.

    A command that starts with a word ending in ``.py`` or with ``-m`` runs in this Python; a
    program of this package is copied from one that has imported it, unless it is to be fresh.
    Environment variables given as None are removed.
    """
    started: list[Process] = []

    def start(*command: str | os.PathLike[str], cwd: Path | None = None, fresh: bool = False,
              **environment: str | None) -> Process:
        words = [os.fspath(word) for word in command]
        if words[0] == '-m' or words[0].endswith('.py'):
            words.insert(0, sys.executable)
        merged = {**os.environ, 'PYTHONUNBUFFERED': '1', **environment}
        server = None if fresh or not can_start(words, environment) else process_server()
        process = Process(words, {key: value for key, value in merged.items()
                                  if value is not None}, cwd, server)
        started.append(process)
        return process

    try:
        yield start
    finally:
        for process in reversed(started):
            process.end()


@pytest.fixture
def cluster(processes: StartProcess) -> tuple[str, list[Process]]:
    """Start a dask.distributed scheduler and two workers; return address and workers."""
    pytest.importorskip('distributed', reason='dask.distributed is not installed: no cluster')
    scheduler = processes('-m', 'distributed.cli.dask_scheduler', '--host', '127.0.0.1', '--port',
                          '0', '--no-dashboard')
    line = scheduler.wait_for_line('Scheduler at:')
    address = line.rpartition(' ')[2].strip()
    workers = [processes('-m', 'distributed.cli.dask_worker', address, '--nthreads', '1',
                         '--no-nanny', '--no-dashboard', '--name', f'worker{i}')
               for i in range(2)]
    for worker in workers:
        worker.wait_for_line('Registered to')
    return address, workers


class SmallDisk:
    """A file system of a few kilobytes that only programs started by `enter` see by its path.

    Attributes:
        path: Where they see it.
        outside: The same folder, for this process.
        enter: Words before a command that is to see it.
    """

    def __init__(self, holder: Process, path: Path) -> None:
        self.path = path
        self.outside = Path(f'/proc/{holder.pid}/root{path}')
        self.enter = ('nsenter', '--preserve-credentials', '-U', '-m', f'--wd={Path.cwd()}', '-t',
                      str(holder.pid), '--')

    def fill(self, left: int) -> Path:
        """Fill it but for some bytes; return the file that does, to be removed."""
        filler = self.outside / 'filler'
        with filler.open('wb', buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(4096))
        os.truncate(filler, filler.stat().st_size - left)
        return filler


@pytest.fixture
def small_disk(processes: StartProcess, tmp_path: Path) -> Callable[[str], SmallDisk]:
    """Return ``mount(size) -> SmallDisk``; skip where such a disk cannot be made."""
    def mount(size: str) -> SmallDisk:
        path = tmp_path / 'disk'
        path.mkdir()
        if not all(map(shutil.which, ('unshare', 'nsenter', 'mount'))):
            pytest.skip('a full disk needs unshare, nsenter and mount')
        holder = processes('unshare', '-rm', 'sh', '-c',
                           f'mount -t tmpfs -o size={size} none {path} && echo mounted && '
                           'exec sleep 3600 || echo refused')
        if 'mounted' not in holder.wait_for_line('ed'):
            pytest.skip(f'a disk of its own cannot be mounted here: {holder.output}')
        return SmallDisk(holder, path)

    return mount


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
    """Return ``make(motors, bands)``: the reference firmware as a program for this machine."""
    return functools.cache(lambda motors=1, bands=((0.5, -0.6),): compiled(
        tmp_path_factory.mktemp('firmware'), 'firmware', f'-DDZ_MOTORS={motors}',
        '-DDZ_BANDS=' + ', '.join(f'{{{b_r}, {b_l}}}' for b_r, b_l in bands), 'dz_device.c',
        'line_main.c', '-lm'))


@pytest.fixture(scope='session')
def firmware_library(tmp_path_factory):
    """Return ``make(motors)``: the firmware's portable part as a shared library."""
    return functools.cache(lambda motors: compiled(
        tmp_path_factory.mktemp('firmware'), 'dz_device.so', '-shared', '-fPIC',
        f'-DDZ_MOTORS={motors}', 'dz_device.c', sanitized=True))


SERIAL_AXES = ('pan', 'tilt', 'roll')
"""Axes behind the motors of a serial device."""


@pytest.fixture(params=['emulated', 'firmware'])
def serial_device(request, processes, tmp_path):
    """Return a function that starts a device on a serial line with faults; `port`, `axes`.

    Its motors have dead-zones of their own, `bands` = (b_r, b_l) of each, where they are given;
    they then have no cogging torque, under which the emulated ones creep at rest.
    """
    port = tmp_path / 'port'

    def start(*faults, motors=1, bands=()):
        options = ['-o', f'link={port}']
        if motors > 1:
            options += ['--set', f'loop.axes=[{", ".join(SERIAL_AXES[:motors])}]']
        if bands:
            options += ['--set', 'plant.cogging_torque=0']
        for axis, band in zip(SERIAL_AXES, bands, strict=False):
            for key, value in zip(('b_r', 'b_l'), band, strict=True):
                options += ['--set', f'axes.{axis}.plant.dead_zone.{key}={value}']
        if request.param == 'firmware':
            made = request.getfixturevalue('firmware')
            options += ['-o', f'program={made(motors, bands) if bands else made(motors)}']
        process = processes('-m', 'dz_ros', 'driver', 'emulate', 'serial', 'serial', *options,
                            *(word for fault in faults for word in ('--fault', fault)))
        process.wait_for_line('serial device on')
        return process

    start.port, start.axes = port, SERIAL_AXES
    return start


PATIENT = ('loop.rate=100', 'safety.state_hold=200', 'safety.command_hold=100',
           'safety.echo_limit=300', 'safety.reference_hold=300', 'safety.fault_after=5000')
"""A rate and holds for a machine that is busy with other tests."""


@pytest.fixture
def patient():
    """Return the words by which `dz run` holds as long as a busy machine needs."""
    return tuple(word for text in PATIENT[1:] for word in ('--set', text))


@pytest.fixture
def serial_settings(serial_device):
    """Start a device on a serial line; return the settings of a patient loop with it."""
    pytest.importorskip('serial', reason='pyserial is not installed')
    serial_device()
    return (*PATIENT, 'driver.silence=3.0', 'driver.fresh=4.0', 'driver.watchdog=1.0',
            f'driver.port={serial_device.port}')


@pytest.fixture
def cia402_settings(processes, ros_domain):
    """Start a CiA 402 drive on a bus of its own; return the settings of a patient loop with it."""
    pytest.importorskip('canopen', reason='canopen is not installed')
    can = pytest.importorskip('can', reason='python-can is not installed')
    port = 43400 + ros_domain
    try:
        can.Bus(interface='udp_multicast', channel='239.74.163.2', port=port,
                hop_limit=0).shutdown()
    except can.CanError as error:
        pytest.skip(f'no multicast on this machine: {error}')
    found = (*PATIENT, 'driver.heartbeat_hold=2.0', 'driver.command_hold=2.0',
             'driver.answer_limit=3.0', f'driver.bus_options=[port={port}, hop_limit=0]')
    processes('-m', 'dz_ros', 'driver', 'emulate', 'cia402', 'cia402', *(
        word for text in found for word in ('--set', text))
    ).wait_for_line('simulated drive, node 1 on udp_multicast')
    return found


@pytest.fixture
def joint_settings(processes, ros_domain):
    """Start a joint of ros2_control; return the settings of a patient loop with it."""
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    root = Path(__file__).parents[1]
    processes(str(root / 'test' / 'nodes' / 'ros2_control_emulator.py'),
              str(root / 'config' / 'joint.yaml'), 'effort', 'active=1',
              PYTHONPATH=str(root)).wait_for_line('controllers are loaded')
    return (*PATIENT, 'driver.fresh=4.0')


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
          'launch.logging': ['launch_config'],
          'launch.substitutions': ['LaunchConfiguration'], 'launch_ros': [],
          'launch_ros.actions': ['Node'],
          'launch_ros.parameter_descriptions': ['ParameterValue']}
"""What our launch files use of launch, which has no wheels: module → classes."""


def parameter_value(value, value_type):
    """Return the value that launch must not guess the type of."""
    assert type(value) is value_type
    return value


@pytest.fixture
def load_launch_file(monkeypatch, tmp_path):
    """Return ``load(name) -> module`` of launch/NAME.launch.py, with replacements for launch."""
    root = Path(__file__).parents[1]

    def load(name):
        for module_name, classes in LAUNCH.items():
            module = types.ModuleType(module_name)
            for kind in classes:
                setattr(module, kind, type(kind, (Made,), {}))
            monkeypatch.setitem(sys.modules, module_name, module)
        sys.modules['launch_ros.parameter_descriptions'].ParameterValue = parameter_value
        sys.modules['launch.logging'].launch_config.log_dir = str(tmp_path / 'log')
        index = types.ModuleType('ament_index_python.packages')
        index.get_package_share_directory = lambda package: str(root)
        monkeypatch.setitem(sys.modules, 'ament_index_python.packages', index)
        spec = importlib.util.spec_from_file_location(
            f'{name}_launch', root / 'launch' / f'{name}.launch.py')
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


Simulated = Callable[..., RunData]

EPOCH = 1_700_000_000_000_000_000
LATENCY = 400_000
"""Nanoseconds from publishing a state to publishing its command."""


@functools.cache
def _simulated(items: tuple[tuple[str, Any], ...]) -> RunData:
    return from_run(simulate(Configuration.from_flat(dict(items))))


@pytest.fixture(scope='session')
def simulated() -> Simulated:
    """``simulated({'controller.law': 'pd'})``: an offline run; equal ones are made once."""
    def make(overrides: Mapping[str, Any] | None = None) -> RunData:
        return _simulated(tuple((key, tuple(value) if isinstance(value, list) else value)
                                for key, value in (overrides or {}).items()))
    return make


@pytest.fixture(scope='session')
def over_topics() -> Callable[..., RunData]:
    """``over_topics(run, late={seq: ns})``: the run with the times a real-time loop would have.

    Every topic is published T apart, the command LATENCY after its state, each logged 100 µs
    later; `late` delays the state of a sample, and what follows from it, by this number of ns.
    """
    def dress(run: RunData, late: Mapping[int, int] | None = None) -> RunData:
        count = len(run.channels['state'])
        ticks = EPOCH + np.round(np.arange(count) * 1e9
                                 / run.configuration['loop.rate']).astype(np.int64)
        for seq, delay in (late or {}).items():
            ticks[seq] += delay
        after = {'reference': -1_000_000, 'state': 0, 'truth': 20_000, 'command': LATENCY,
                 'terms': LATENCY + 30_000}
        channels = {}
        for name, channel in run.channels.items():
            values = channel.values.copy()
            if name == 'command':
                values[:, channel.labels.index('hold')] = 0.5e-9 * LATENCY
            if name == 'state':
                values[1:, channel.labels.index('round_trip')] = 1.5e-9 * LATENCY
            published = ticks + after[name]
            channels[name] = Channel(channel.labels, values, published + 100_000, published)
        return replace(run, channels=channels, info={'mode': 'realtime', 'host': 'bench'})
    return dress


@pytest.fixture(scope='session')
def keep() -> Callable[..., RunData]:
    """``keep(run, state=rows, command=rows)``: the run with these rows of these channels only."""
    def cut(run: RunData, **rows: Any) -> RunData:
        channels = dict(run.channels)
        for name, chosen in rows.items():
            old = channels[name]
            channels[name] = Channel(old.labels, old.values[chosen], old.log_time[chosen],
                                     old.publish_time[chosen])
        return replace(run, channels=channels)
    return cut


T = 0.005
BASE = {'loop.duration': 2.0}


class Log:
    """A log written as a recorder would, one message after the other, 100 µs apart."""

    def __init__(self, configuration, mode='realtime'):
        self.configuration, self.mode = configuration, mode
        self.rows = {name: [] for name in ('reference', 'state', 'command', 'terms')}
        self.events, self.now = [], 1_700_000_000_000_000_000

    def put(self, name, numbers):
        self.now += 100_000
        self.rows[name].append((self.now, tuple(map(float, numbers))))

    def announce(self, configuration, seq, memory, reported=None):
        self.now += 100_000
        self.events.append((self.now, '/controller_node', json.dumps({
            'node': '/controller_node', 'event': 'configuration', 'version': reported or version(),
            'owns': ['controller'], 'configuration': configuration.to_flat(), 'set_aside': [],
            'seq': seq, 'memory': list(memory)})))

    def data(self):
        order = self.configuration.plant.order
        labels = {'reference': Reference.labels(order), 'state': State.labels(order),
                  'command': Command.labels(),
                  'terms': Terms.labels(self.configuration.law.signal_names)}
        return RunData({name: Channel(labels[name], np.array([row for _, row in rows]),
                                      *[np.array([time for time, _ in rows])] * 2)
                        for name, rows in self.rows.items() if rows},
                       self.configuration.to_flat(), {'mode': self.mode}, tuple(self.events))


def real_time(samples=300, changes=(), restart=None, plant_restart=None, reported=None, flat=BASE):
    """Return a real-time log with jitter, skipped periods, lost and repeated messages.

    Args:
        samples: States published.
        changes: (seq, overrides): gain changes.
        restart: State at which the controller is started again.
        plant_restart: State at which the plant is started again.
        reported: Version the controller states.
        flat: Configuration.
    """
    generator = np.random.default_rng(7)
    configuration = Configuration.from_flat(flat)
    log, controller, count = Log(configuration), Controller(configuration), 0
    log.announce(configuration, 0, controller.memory, reported)
    x, stamp, seq = list(configuration.x0), 0.0, 0
    changes = dict(changes)
    for k in range(samples):
        if k == restart:
            controller, count = Controller(configuration), 0
            log.announce(configuration, 0, controller.memory, reported)
        if k == plant_restart:
            x, stamp, seq = list(configuration.x0), 0.0, 0
        if count in changes:
            configuration = configuration.replace(**changes.pop(count))
            controller.law = configuration.law
            log.announce(configuration, count, controller.memory, reported)
        sample = round(stamp / T)
        meant = Reference(seq, sample * T, configuration.trajectory(sample * T))
        log.put('reference', meant.numbers())
        if k % 37 != 5 or not controller.has_reference:    # else it arrives too late
            controller.set_reference(meant)
        state = State(seq, stamp, tuple(x), count - 1, 0.0, 0.0)
        for _ in range(2 if k % 50 == 3 else 1):       # sent again: the same answer again
            log.put('state', state.numbers())
            if k % 41 == 11:                            # never reaches the controller
                continue
            command, terms = controller.respond(state)
            count = command.seq + 1
            log.put('command', (*command.numbers()[:-1], generator.uniform(0.0, 1e-3)))
            log.put('terms', terms.numbers())
        if k % 37 == 5:
            controller.set_reference(meant)
        skipped = {60: 1, 120: 2, 180: 5}.get(k, 0)
        stamp += T * (1 + skipped) + generator.normal(0.0, 5e-5)
        x[0] += T * x[1]
        x[1] += T * (command.v - x[0]) + generator.normal(0.0, 0.01)
        seq += 1
    return log.data()


def offline(**overrides):
    return from_run(simulate(Configuration.from_flat({**BASE, **overrides})))


def change(run, name, label, row, value):
    """Return the run with one number changed."""
    channel = run.channels[name]
    values = channel.values.copy()
    values[row, channel.labels.index(label)] = value
    return replace(run, channels={**run.channels, name: replace(channel, values=values)})


def drop(run, name, *rows):
    """Return the run without some messages."""
    channel = run.channels[name]
    keep = np.setdiff1d(np.arange(len(channel)), [row % len(channel) for row in rows])
    return replace(run, channels={**run.channels, name: Channel(
        channel.labels, channel.values[keep], channel.log_time[keep],
        channel.publish_time[keep])})


@pytest.fixture(scope='session')
def logs():
    """Return what makes logs: `real_time`, `offline`; and alters them: `change`, `drop`."""
    return SimpleNamespace(real_time=real_time, offline=offline, change=change, drop=drop)

"""``dz run``: the loop as processes, from start to an orderly end."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import json
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import threading
import time

from dz_ros.cli.options import add_address, add_configuration, read_configuration
from dz_ros.cli.processes import (
    check_rclpy,
    ENDS,
    GRACE,
    start_node,
    write_node_parameters,
)
from dz_ros.core.configuration import Configuration
from dz_ros.errors import ConfigurationError, LoopError, RunExistsError
from dz_ros.files import write_parameters
from dz_ros.runtime.claim import claim, ClaimedError, domain, domain_topic

ORDER = (('plant_node', 'actuator_node'), ('trajectory_node', 'controller_node'),
         ('recorder_node',), ('live_node', 'foxglove_node'))
"""The order in which nodes are ended: whoever drives the loop first, whoever looks at it last."""
LOOKING = {'live_node': 'the live page', 'foxglove_node': 'the server for Foxglove'}
"""Nodes that the loop can do without."""
START_LIMIT = 60.0
"""The loop must have its first sample within this time [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_configuration(parser)
    parser.add_argument('--record', type=Path, metavar='DIR',
                        help='record the run to this directory, which must not exist')
    parser.add_argument('--lockstep', action='store_true',
                        help='step when messages have arrived, as fast as the machine goes; '
                             'the same as --set loop.timing=lockstep')
    parser.add_argument('--namespace', default='', metavar='NS',
                        help='ROS namespace of the loop, e.g. /left_valve')
    parser.add_argument('--quiet', action='store_true', help='no progress')
    parser.add_argument('--live', action='store_true',
                        help='show the loop in the browser: a page whose address is printed')
    add_address(parser)
    parser.add_argument('--foxglove', action='store_true',
                        help='serve the topics to Foxglove or Lichtblick, ws://127.0.0.1:8765')
    parser.add_argument('--read-only', action='store_true',
                        help='the page can be looked at, nobody can act on the loop')


def run(arguments: argparse.Namespace) -> int:
    """Run the loop; return 0, or the code of the node that failed."""
    if arguments.lockstep:
        arguments.overrides.append('loop.timing=lockstep')
    configuration = read_configuration(arguments)
    if arguments.record is not None:
        if arguments.record.exists():
            raise RunExistsError(f'{arguments.record}: exists already; recordings are never '
                                 'overwritten: choose another directory')
        peers = tuple(dict.fromkeys((*configuration.loop.peers, 'recorder_node')))
        configuration = configuration.replace(**{'loop.peers': peers})
    check_rclpy()
    _check_free(arguments.namespace)
    with tempfile.TemporaryDirectory(prefix='dz_ros-') as folder:
        parameters = Path(folder) / 'parameters.yaml'
        write_parameters(configuration, parameters)
        return _Loop(configuration, parameters, arguments).run()


def _check_free(namespace: str) -> None:
    """Find out whether another loop runs on this machine in the same domain and namespace.

    Raises:
        ConfigurationError: Not a namespace.
        LoopError: Another one does, or there is no such domain.
    """
    name = namespace.strip('/')
    if name and not all(part.isidentifier() and part.isascii() for part in name.split('/')):
        raise ConfigurationError('--namespace', namespace,
                                 'must be names of letters, digits and _ separated by /')
    topic = f'/{name}/state' if name else '/state'
    try:
        domain()
    except ValueError as error:
        raise LoopError(str(error)) from None
    try:
        claim(domain_topic(topic)).close()
    except ClaimedError as error:
        raise LoopError(
            f'topic {topic} is published by another loop on this machine (process {error.pid}): '
            'stop that one, or use --namespace or another ROS_DOMAIN_ID') from None


class _Loop:
    """The processes of one run."""

    def __init__(self, configuration: Configuration, parameters: Path,
                 arguments: argparse.Namespace) -> None:
        self._configuration = configuration
        self._quiet = arguments.quiet
        self._terminal = sys.stdout.isatty()
        self._interrupted = False
        self._progress_seen = threading.Event()
        self._show_at = 0.0
        self._line = ''
        self._lock = threading.Lock()
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._failed: dict[str, int] = {}
        self._missed: set[str] = set()
        self._readers: list[threading.Thread] = []
        common = ['--ros-args', '--params-file', str(parameters)]
        if arguments.namespace.strip('/'):
            common += ['-r', f'__ns:=/{arguments.namespace.strip("/")}']
        self._actuator = ('plant_node' if configuration.driver_settings.name == 'simulated'
                          else 'actuator_node')
        self._arguments = {
            self._actuator: common, 'trajectory_node': common,
            'controller_node': [*common, '-p', f'progress_rate:={2.0 if self._quiet else 5.0}']}
        if arguments.record is not None:
            # In a file, because on a command line YAML decides what a name such as 20261122 is.
            directory = parameters.with_name('directory.yaml')
            write_node_parameters(directory, {'directory': str(arguments.record)})
            self._arguments['recorder_node'] = [*common, '--params-file', str(directory)]
        if arguments.live:
            page = parameters.with_name('page.yaml')
            write_node_parameters(page, {'host': arguments.host, 'port': arguments.port,
                                         'read_only': arguments.read_only})
            self._arguments = {'live_node': [*common, '--params-file', str(page)],
                               **self._arguments}
        if arguments.foxglove:
            self._arguments = {'foxglove_node': common, **self._arguments}

    def run(self) -> int:
        """Start everything, wait for the actuator's host, end everything in order."""
        previous = {number: signal.signal(number, self._interrupt)
                    for number in ENDS}
        try:
            for name, arguments in self._arguments.items():
                self._start(name, arguments)
            self._watch()
        finally:
            self._end()
            for number, handler in previous.items():
                signal.signal(number, handler)
        if self._line and self._terminal:
            print()
        for name, code in self._failed.items():
            print(f'dz: error: {name} failed ({_meaning(code)})', file=sys.stderr)
        if self._failed:
            return 2 if 2 in self._failed.values() else 1
        return 130 if self._interrupted and self._configuration.loop.duration else 0

    def _start(self, name: str, arguments: Sequence[str]) -> None:
        """Start one node and read what it says."""
        process = start_node(name, arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                             text=True, errors='replace')
        self._processes[name] = process
        reader = threading.Thread(target=self._read, args=(process,), daemon=True)
        reader.start()
        self._readers.append(reader)

    def _read(self, process: subprocess.Popen[str]) -> None:
        """Pass on what a node says; show its progress."""
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith('{"t"'):
                self._progress_seen.set()
                self._show(json.loads(line))
            else:
                self._say(line.rstrip('\n'))

    def _say(self, text: str) -> None:
        """Print a line above the line of progress."""
        with self._lock:
            if self._terminal and self._line:
                print('\r' + ' ' * len(self._line) + '\r', end='')
            print(text, flush=True)
            if self._terminal and self._line:
                print(self._line, end='', flush=True)

    def _show(self, progress: dict[str, float]) -> None:
        """Show a line of progress: in place on a terminal, once a second elsewhere."""
        now = time.monotonic()
        if self._quiet or (not self._terminal and now < self._show_at):
            return
        self._show_at = now + 1.0
        layer, rate = progress['s_over_epsilon'], progress['rate']
        line = (f't {progress["t"]:7.2f} s   error {progress["error"]:+9.5f}   '
                + ('' if layer is None else f's/ε {layer:+8.2f}   ')
                + f'v {progress["v"]:+8.3f}   '
                + ('' if rate is None else f'{rate:6.1f} Hz   ')
                + ('' if progress['late'] is None else f'late {progress["late"]:.0f}'))
        with self._lock:
            if self._terminal:
                print('\r' + line.ljust(len(self._line)), end='', flush=True)
            else:
                print(line, flush=True)
            self._line = line

    def _interrupt(self, _number: int, _frame: object) -> None:
        self._interrupted = True

    def _watch(self) -> None:
        """Wait until the actuator's host is done, a node fails, or the user ends it."""
        give_up = time.monotonic() + START_LIMIT
        while not self._interrupted:
            for name, process in self._processes.items():
                code = process.poll()
                if code is None or (code == 0 and name == self._actuator):
                    continue
                if name in LOOKING:
                    if name not in self._missed:
                        self._missed.add(name)
                        self._say(f'dz: note: {LOOKING[name]} has ended ({_meaning(code)}); the '
                                  'loop goes on')
                    continue
                self._failed[name] = code
            if self._failed or self._processes[self._actuator].poll() is not None:
                return
            if not self._progress_seen.is_set() and time.monotonic() > give_up:
                self._failed['the loop'] = -1000
                return
            time.sleep(0.02)

    def _end(self) -> None:
        """End the nodes in order, each by its own process id; kill what does not end."""
        for names in ORDER:
            ending = {name: self._processes[name] for name in names if name in self._processes}
            for process in ending.values():
                if process.poll() is None:
                    process.send_signal(signal.SIGINT)
            for name, process in ending.items():
                try:
                    code = process.wait(GRACE)
                except subprocess.TimeoutExpired:
                    process.kill()
                    code = process.wait()
                if code not in (0, -signal.SIGINT) and name not in LOOKING:
                    self._failed.setdefault(name, code)
        for reader in self._readers:
            reader.join(1.0)


def _meaning(code: int) -> str:
    """Return an exit code in words."""
    if code == -1000:
        return f'no sample within {START_LIMIT:g} s'
    if code < 0:
        return f'killed by {signal.Signals(-code).name}'
    return f'exit code {code}' if code else 'ended before the plant'

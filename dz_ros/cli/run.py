# SPDX-License-Identifier: Apache-2.0
"""``dz run``: the loop as processes, from start to an orderly end and a verdict.

Over 300 lines: starting, watching and ending the processes are one thing.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
import json
import os
from pathlib import Path
import re
import signal
import sys
import threading
import time
from typing import Any

from dz_ros.cli.interrupt import INTERRUPTED
from dz_ros.cli.options import (
    add_address,
    add_configuration,
    check_address,
    namespace_name,
    read_machine,
    read_recording,
    refuse_existing,
)
from dz_ros.cli.processes import (
    ask_to_end,
    check_rclpy,
    NodeProcess,
    ParameterFiles,
    start_nodes,
    wait_or_kill,
)
from dz_ros.cli.progress import stage
from dz_ros.core.configuration import Configuration
from dz_ros.core.lateness import fell_behind
from dz_ros.core.text import printable
from dz_ros.errors import DzRosError, LoopError
from dz_ros.files.configurations import format_parameters
from dz_ros.runtime.claim import claim, ClaimedError, domain, domain_topic
from dz_ros.runtime.os_signals import on_ends

ORDER = (('plant_node', 'actuator_node'), ('trajectory_node', 'controller_node'),
         ('recorder_node',), ('live_node', 'foxglove_node'))
"""The order in which nodes are ended: those that drive the loop first, viewers last."""
LOOKING = {'live_node': 'the live page', 'foxglove_node': 'the server for Foxglove'}
"""Nodes that the loop can do without, and that may fail."""
RECORDER = 'recorder_node'
"""Once it runs, the loop can do without it as well; its failure is one of the run."""
START_LIMIT = 60.0
"""The loop must have its first sample within this time [s]."""
_MAY_LACK = ('s_over_epsilon', 'rate', 'late')
_PROGRESS = ('t', 'error', 'v', *_MAY_LACK)
_LATCHED = re.compile(r'\[([\w./]+)\]: (fault: .*); the safe command is out until ')
_RESET = re.compile(r'\[([\w./]+)\]: (?:reset: |estop: )')
_COUNTS = re.compile(r'\[[\w./]+\]: (\d+ samples(?:, | in lockstep).*)')
"""Lines of the nodes' logs that the verdict needs where nothing is recorded."""
_COUNT = re.compile(r'(\d+) (samples|skipped)')
LARGEST = 300e6
"""A recording larger than this is not read for the verdict [bytes]."""
_COLOUR = re.compile(r'\x1b\[[0-9;]*m')
"""Colour codes of a node's log (RCUTILS_COLORIZED_OUTPUT)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_configuration(parser, 'its nodes are started there, and its sections of CONFIG count')
    parser.add_argument('--record', type=Path, metavar='DIR',
                        help='record the run to this directory, which must not exist')
    parser.add_argument('--lockstep', action='store_true',
                        help='step when messages have arrived, as fast as the machine goes; '
                             'the same as --set loop.timing=lockstep')
    parser.add_argument('--quiet', action='store_true', help='no progress')
    parser.add_argument('--live', action='store_true',
                        help='show the loop in the browser: a page whose address is printed')
    add_address(parser)
    parser.add_argument('--foxglove', action='store_true',
                        help='serve the topics to Foxglove or Lichtblick, ws://127.0.0.1:8765')
    parser.add_argument('--read-only', action='store_true',
                        help='the page shows the loop, but cannot act on it')


def run(arguments: argparse.Namespace) -> int:
    """Run the loop; return 0, 1 for a latched fault or lost samples, or a failed node's code."""
    if arguments.lockstep:
        arguments.overrides.append('loop.timing=lockstep')
    check_address(arguments, arguments.live)
    configuration = read_machine(arguments)
    if arguments.record is not None:
        refuse_existing(arguments.record)
        peers = tuple(dict.fromkeys((*configuration.loop.peers, 'recorder_node')))
        configuration = configuration.replace(**{'loop.peers': peers})
    check_rclpy()
    _check_free(arguments.namespace)
    with ParameterFiles() as files:
        return _Loop(configuration, files, arguments).run()


def _check_free(namespace: str) -> None:
    """Find out whether another loop runs on this machine in the same domain and namespace."""
    name = namespace_name(namespace)
    topic = f'/{name}/state' if name else '/state'
    try:
        domain()
    except ValueError as error:
        raise LoopError(str(error)) from None
    try:
        claim(domain_topic(topic)).close()
    except ClaimedError as error:
        raise LoopError(
            f'topic {topic} is published by another loop on this machine ({error.process}): '
            'stop that one, or use --namespace or another ROS_DOMAIN_ID') from None


class _Loop:
    """The processes of one run."""

    def __init__(self, configuration: Configuration, files: ParameterFiles,
                 arguments: argparse.Namespace) -> None:
        self._configuration = configuration
        self._quiet = arguments.quiet
        self._directory = arguments.record
        self._terminal = sys.stdout.isatty()
        self._interrupted = False
        self._printing = True
        self._progress_seen = threading.Event()
        self._show_at = 0.0
        self._line = ''
        self._lock = threading.Lock()
        self._processes: dict[str, NodeProcess] = {}
        self._failed: dict[str, int] = {}
        self._missed: set[str] = set()
        self._readers: list[threading.Thread] = []
        self._latched: dict[str, str] = {}
        self._counts = ''
        common = ['--ros-args', '--params-file', files.add(format_parameters(configuration))]
        if arguments.namespace.strip('/'):
            common += ['-r', f'__ns:=/{arguments.namespace.strip("/")}']
        self._actuator = ('plant_node' if configuration.driver_settings.name == 'simulated'
                          else 'actuator_node')
        self._arguments = {
            self._actuator: common, 'trajectory_node': common,
            'controller_node': [*common, '-p', f'progress_rate:={2.0 if self._quiet else 5.0}']}
        if arguments.record is not None:
            # In a file, because on a command line YAML decides what a name such as 20261122 is.
            self._arguments[RECORDER] = [*common, '--params-file', files.add_parameters(
                {'directory': str(arguments.record)})]
        if arguments.live:
            page = files.add_parameters({'host': arguments.host, 'port': arguments.port,
                                         'read_only': arguments.read_only})
            self._arguments = {'live_node': [*common, '--params-file', page], **self._arguments}
        if arguments.foxglove:
            self._arguments = {'foxglove_node': common, **self._arguments}

    def run(self) -> int:
        """Start everything, wait for the actuator's host, end everything in order."""
        on_ends(self._interrupt)    # for good: a second signal must not break the orderly end
        try:
            for name, process in start_nodes(self._arguments):
                self._processes[name] = process
            for process in self._processes.values():    # no thread before the last is started
                reader = threading.Thread(target=self._read, args=(process,), daemon=True)
                reader.start()
                self._readers.append(reader)
            self._watch()
        finally:
            self._end()
        if self._line and self._terminal:
            self._print()
        for failure in self._failures():
            print(f'dz: error: {failure}', file=sys.stderr)
        failed = self._progress_seen.is_set() and self._verdict()
        if self._failed:
            return 2 if 2 in self._failed.values() else 1
        if failed:
            return 1
        return INTERRUPTED if self._interrupted and self._configuration.loop.duration else 0

    def _verdict(self) -> bool:
        """Print the verdict on the run and what to do next; return whether it failed."""
        if self._directory is not None and RECORDER not in self._failed:
            try:
                size = sum(item.stat().st_size for item in self._directory.iterdir())
                if size <= LARGEST:
                    return self._recorded_verdict(self._directory)
            except (DzRosError, OSError) as error:
                self._print(f'dz: note: {error}')
        failures = [*self._failures(), *_latched_text(self._latched)]
        counts = {word: int(count) for count, word in _COUNT.findall(self._counts)}
        behind = fell_behind(counts.get('samples', 0), counts.get('skipped', 0))
        self._print('verdict: ' + (f'FAILED: {"; ".join(failures)}' if failures else
                                   ', but '.join(filter(None, ('no failure', behind))))
                    + (f'; {self._counts}' if self._counts else ''))
        self._print('next: dz report ' + str(self._directory) if self._directory is not None
                    else 'next: with --record DIR losses and Ω_ε are judged too, for dz report')
        return bool(self._latched)

    def _failures(self) -> list[str]:
        """Return as text which nodes have failed."""
        return [f'{name} failed ({_meaning(code)})' for name, code in self._failed.items()]

    def _recorded_verdict(self, directory: Path) -> bool:
        """Print the verdict on the recording; return whether it failed."""
        from dz_ros.cli.table import five_rows, format_table, window_title
        from dz_ros.report.verdict import judge
        from dz_ros.report.view import View
        from dz_ros.runs.axes import each_axis

        failed = False
        for name, run in each_axis(read_recording(directory)).items():
            with stage('judging the run'):
                view = View.of(run)
                verdict = judge(view)
            verdict = replace(verdict, failures=(*self._failures(), *verdict.failures))
            failed = failed or bool(verdict.failures)
            for line in (*([f'axis {name}'] if name else []), *verdict.lines(),
                         *format_table(window_title(view), five_rows(view))):
                self._print(printable(line))
        self._print(printable(f'next: dz report {directory}'))
        return failed

    def _read(self, process: NodeProcess) -> None:
        """Print a node's log; show its progress."""
        assert process.stdout is not None
        for line in process.stdout:
            progress = progress_of(line)
            if progress is not None:
                self._progress_seen.set()
                self._show(progress)
            else:
                text = printable(_COLOUR.sub('', line.rstrip('\n')))
                self._note(text)
                self._log(text)

    def _note(self, text: str) -> None:
        """Keep what the verdict needs of a line of the log."""
        if found := _LATCHED.search(text):
            self._latched[found[1]] = found[2]
        elif found := _RESET.search(text):
            self._latched.pop(found[1], None)
        elif found := _COUNTS.search(text):
            self._counts = found[1]

    def _log(self, text: str) -> None:
        """Print a line above the line of progress."""
        with self._lock:
            if self._terminal and self._line:
                self._print('\r' + ' ' * len(self._line) + '\r', end='')
            self._print(text)
            if self._terminal and self._line:
                self._print(self._line, end='')

    def _print(self, text: str = '', end: str = '\n') -> None:
        """Print; where the reader has gone, or a disk is full, the loop goes on unread."""
        if self._printing:
            try:
                print(text, end=end, flush=True)
            except OSError:
                self._printing = False
                # What is left in the buffer must not fail again when the interpreter ends.
                with suppress(OSError):
                    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    def _show(self, progress: dict[str, Any]) -> None:
        """Show a line of progress: in place on a terminal, once a second elsewhere."""
        now = time.monotonic()
        if self._quiet or (not self._terminal and now < self._show_at):
            return
        self._show_at = now + 1.0
        layer, rate = progress['s_over_epsilon'], progress['rate']
        axis = f'{progress["axis"]}: ' if 'axis' in progress else ''
        line = (f't {progress["t"]:7.2f} s   {axis}error {progress["error"]:+9.5f}   '
                + ('' if layer is None else f's/ε {layer:+8.2f}   ')
                + f'v {progress["v"]:+8.3f}   '
                + ('' if rate is None else f'{rate:6.1f} Hz   ')
                + ('' if progress['late'] is None else f'late {progress["late"]:.0f}'))
        with self._lock:
            if self._terminal:
                self._print('\r' + line.ljust(len(self._line)), end='')
            else:
                self._print(line)
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
                if name in LOOKING or (name == RECORDER and self._progress_seen.is_set()):
                    self._miss(name, code)
                    continue
                self._failed[name] = code
            if self._failed or self._processes[self._actuator].poll() is not None:
                return
            if not self._progress_seen.is_set() and time.monotonic() > give_up:
                self._failed['the loop'] = -1000
                return
            time.sleep(0.02)

    def _miss(self, name: str, code: int) -> None:
        """Report once that a node has ended without which the loop goes on."""
        if name in self._missed:
            return
        self._missed.add(name)
        if name in LOOKING:
            self._log(f'dz: note: {LOOKING[name]} has ended ({_meaning(code)}); the loop goes on')
        else:
            self._log(f'dz: error: {name} has ended ({_meaning(code)}): nothing more is recorded, '
                      f'the loop goes on; what {self._directory} holds is kept: dz bag recover '
                      f'{self._directory}')

    def _end(self) -> None:
        """End the nodes in order, each by its own process id; kill what does not end."""
        for names in ORDER:
            ending = {name: self._processes[name] for name in names if name in self._processes}
            for process in ending.values():
                ask_to_end(process)
            for name, process in ending.items():
                code = wait_or_kill(process)
                early = name in self._missed or code not in (0, -signal.SIGINT)
                if early and name not in LOOKING:
                    self._failed.setdefault(name, code)
        for reader in self._readers:
            reader.join(1.0)


def progress_of(line: str) -> dict[str, Any] | None:
    """Return a controller's line of progress; None where it is another line."""
    if not line.startswith('{"t"'):
        return None
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    numbers = {name: isinstance(found.get(name), (int, float)) for name in _PROGRESS}
    return found if isinstance(found.get('axis', ''), str) and all(
        numbers[name] or (name in _MAY_LACK and found.get(name) is None)
        for name in _PROGRESS) else None


def _latched_text(latched: Mapping[str, str]) -> list[str]:
    return [f'{node} ended in a latched {reason}' for node, reason in latched.items()]


def _meaning(code: int) -> str:
    """Return an exit code as text."""
    if code == -1000:
        return f'no sample within {START_LIMIT:g} s'
    if code < 0:
        return f'killed by {signal.Signals(-code).name}'
    return f'exit code {code}' if code else 'ended before the plant'

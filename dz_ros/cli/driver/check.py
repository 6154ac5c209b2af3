# SPDX-License-Identifier: Apache-2.0
"""``dz driver check NAME|CONFIG|--topics``: verify a driver's contract; exit code 1 if it fails.

NAME, or the drivers that CONFIG names, is checked in this process
(``drivers/conformance/driver_checks.py``), then as a node: hosted by actuator_node, observed and
commanded through topics, killed and started again. Of several axes each is checked so, in this
process beside the others, which get their safe command, as a node alone; in the end all of them
move together. ``--topics`` checks a running node of any language, axis by axis.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
import json
import math
from pathlib import Path
import subprocess
import sys
from typing import Any

from dz_ros.cli.driver.stop_requests import stop_on_requests
from dz_ros.cli.operator import add_namespace
from dz_ros.cli.output import print_json
from dz_ros.cli.processes import check_rclpy, ParameterFiles, start_node, wait_or_kill
from dz_ros.core.configuration import Configuration
from dz_ros.core.driven import DRIVERS
from dz_ros.drivers.beside import Beside, beside_others
from dz_ros.drivers.conformance.driver_checks import check_contract, check_together
from dz_ros.drivers.conformance.result import Result
from dz_ros.drivers.hosted import HostedDriver
from dz_ros.drivers.hosted_axes import HostedDrivers
from dz_ros.errors import ConfigurationError, DriverError
from dz_ros.files.configurations import (
    format_parameters,
    load_configuration,
    shipped_configurations,
)

FAILED = 1
CONFIG = 'robust_eso'
AMPLITUDE = 0.1
"""Largest command sent unless the driver's limit is smaller [command unit]."""
SHARE = 0.02
"""Largest command sent, as a share of the driver's limit."""
MARKS = {True: 'ok', False: 'FAILED', None: 'unseen'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('name', nargs='?', metavar='NAME',
                        help='driver, see dz driver list, or package.module:Class; or the '
                        'configuration that names it')
    parser.add_argument('--topics', action='store_true',
                        help='check the node that publishes state and takes command now')
    parser.add_argument('--config', metavar='CONFIG',
                        help='configuration: plant, rate, safety, and without NAME the driver '
                        f'(default: {CONFIG})')
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE',
                        dest='overrides',
                        help='change one key of it, e.g. driver.port=/dev/ttyUSB0')
    parser.add_argument('--amplitude', type=float, metavar='V',
                        help='largest command sent, but for --saturate (default: 2 %% of the '
                             "driver's limit, at most 0.1)")
    parser.add_argument('--saturate', action='store_true',
                        help='send twice the limit too: the device moves with all it has')
    parser.add_argument('--yes', action='store_true', help='do not ask before a device moves')
    parser.add_argument('--json', action='store_true', help='one JSON object a line and check')
    parser.add_argument('--axis', metavar='NAME',
                        help='this axis of a configuration of several; the others of its device '
                        'are enabled with it, at their safe command')
    add_namespace(parser)


@dataclass(frozen=True)
class Subject:
    """One axis to check.

    Attributes:
        axis: Its name; '' = the only one, without a name.
        configuration: Of this axis alone.
        hosted: Its driver beside those of the other axes; None = it has no others.
        limit: Largest command [command unit].
        amplitude: Largest command sent but for --saturate [command unit].
    """

    axis: str
    configuration: Configuration
    hosted: Beside | None
    limit: float
    amplitude: float


def run(arguments: argparse.Namespace) -> int:
    """Check; print a line for each check; return 0, or 1 where one failed."""
    machine = _configuration(arguments)
    if arguments.axis is not None and not arguments.topics:
        hosted = beside_others(machine, arguments.axis)
        machine = machine.axis(arguments.axis)
        subjects = [_subject(arguments, '', machine, hosted)]
        if hosted is not None:
            print(hosted.note, file=sys.stderr if arguments.json else sys.stdout, flush=True)
    else:
        names = machine.axis_names or ('',)
        hosts = HostedDrivers(machine) if len(names) > 1 and not arguments.topics else None
        subjects = [_subject(arguments, name, c, Beside(hosts, place) if hosts else None)
                    for place, (name, c) in enumerate(zip(names, machine.each, strict=True))
                    if arguments.axis is None or name in ('', arguments.axis)]
    if arguments.topics:
        check_rclpy()
    _ask(arguments, machine, max(item.amplitude for item in subjects))
    failed = False
    for result in _all(arguments, machine, subjects):
        failed |= result.passed is False
        if arguments.json:
            print_json(asdict(result), None, flush=True)
        else:
            print(line(result), flush=True)
    return FAILED if failed else 0


def _configuration(arguments: argparse.Namespace) -> Configuration:
    """Return the configuration of all axes.

    Raises:
        ConfigurationError: It cannot be used, has no such axis, or it is not clear what to check.
    """
    name, config = arguments.name, arguments.config
    if name is not None and config is None and _is_configuration(name):
        name, config = None, name
    if name is not None if arguments.topics else name is None and config is None:
        raise ConfigurationError('NAME', arguments.name, 'give a driver, a configuration or '
                                 '--topics')
    chosen = [] if name is None else [f'driver.name={json.dumps(name)}']
    machine = load_configuration(
        config or CONFIG, [*arguments.overrides, *chosen], arguments.namespace).replace(
        **{'loop.timing': 'realtime', 'loop.duration': 0.0, 'loop.peers': ['plant_node']})
    if arguments.axis is not None:
        machine.axis(arguments.axis)        # it has such an axis
    return machine


def _is_configuration(name: str) -> bool:
    """Return whether NAME is a configuration and no driver."""
    if ':' in name or name in (*DRIVERS.builtin, *DRIVERS.installed()):
        return False
    return name in shipped_configurations() or Path(name).is_file()


def _subject(arguments: argparse.Namespace, axis: str, c: Configuration,
             hosted: Beside | None) -> Subject:
    """Return what is checked of an axis.

    Raises:
        ConfigurationError: --amplitude is more than it may have.
    """
    limit = math.inf if arguments.topics else (hosted or HostedDriver(c)).limit
    if c.safety.command_limit:
        limit = min(limit, c.safety.command_limit)
    amplitude = arguments.amplitude
    if amplitude is None:
        amplitude = min(AMPLITUDE, SHARE * limit)
    if not (math.isfinite(amplitude) and 0.0 <= amplitude <= limit):
        raise ConfigurationError('--amplitude', amplitude, f'must be from 0 to {limit:g}'
                                 + (f', the limit of axis {axis}' if axis else ''))
    return Subject(axis, c, hosted, limit, amplitude)


def _all(arguments: argparse.Namespace, machine: Configuration,
         subjects: list[Subject]) -> Iterator[Result]:
    """Yield the results of each axis, then of all together, named by axis."""
    for item in subjects:
        prefix = f'{item.axis}: ' if item.axis else ''
        for result in (_of_a_node(arguments, machine, item) if arguments.topics else
                       _results(arguments, item)):
            yield replace(result, name=prefix + result.name)
    if len(subjects) > 1 and not arguments.topics:
        with stop_on_requests(machine.driver_class.lockstep, arguments.namespace) as stopping:
            for result in check_together(machine, [item.amplitude for item in subjects],
                                         lambda: stopping.reason):
                yield replace(result, name=f'all axes: {result.name}')


def line(result: Result) -> str:
    """Return a result as a line: verdict, check, figure, limit, why."""
    why = f'  ({result.words})' if result.words else ''
    return (f'{MARKS[result.passed]:6}  {result.name:24} {result.figure}; must be: '
            f'{result.limit}{why}')


def _ask(arguments: argparse.Namespace, c: Configuration, amplitude: float) -> None:
    """Ask before a real device moves."""
    if arguments.yes or (not arguments.topics and c.driver_class.lockstep):
        return
    most = 'up to its limit' if arguments.saturate else f'up to {amplitude:g}'
    if not sys.stdin.isatty():
        raise ConfigurationError('--yes', False, f'the device will get commands {most}: give '
                                 '--yes without a terminal')
    answer = input(f'The device will get commands {most}, stops and restarts. Go on? [y/N] ')
    if answer.strip().lower() not in ('y', 'yes'):
        raise ConfigurationError('--yes', False, 'nothing was sent')


def _of_a_node(arguments: argparse.Namespace, machine: Configuration,
               subject: Subject) -> Iterator[Result]:
    """Yield every result of an axis of the node that publishes the states now."""
    with ParameterFiles() as files:
        yield from _through_topics(_words(arguments, machine, files),
                                   {**_own(arguments, subject), 'axis': subject.axis})


def _words(arguments: argparse.Namespace, c: Configuration, files: ParameterFiles) -> list[str]:
    """Return the namespace and the parameters of a node, as words of its command line."""
    return ['--ros-args', '-r', f'__ns:=/{arguments.namespace.strip("/")}', '--params-file',
            files.add(format_parameters(c))]


def _own(arguments: argparse.Namespace, subject: Subject) -> dict[str, Any]:
    """Return the parameters of the kit's node alone."""
    limited = arguments.saturate and math.isfinite(subject.limit)
    return {'amplitude': subject.amplitude, 'limit': subject.limit if limited else 0.0}


def _results(arguments: argparse.Namespace, subject: Subject) -> Iterator[Result]:
    """Yield every result of an axis: in this process, then through topics."""
    c, own = subject.configuration, _own(arguments, subject)
    with ParameterFiles() as files:
        words = _words(arguments, c, files)
        opened = True
        with stop_on_requests(c.driver_class.lockstep, arguments.namespace) as stopping:
            for result in check_contract(c, subject.amplitude, arguments.saturate,
                                         lambda: stopping.reason, subject.hosted):
                opened &= result.name != 'opens' or result.passed is not False
                yield result
        if subject.hosted is not None and subject.hosted.driver.device is not None:
            yield Result('as a node', None, 'not tried', 'as in docs/topics.md',
                         'its device is that of other axes too')
        elif find_spec('rclpy') is None:
            yield Result('as a node', None, 'not tried', 'as in docs/topics.md',
                         'rclpy is not installed here')
        elif opened:
            yield from _as_a_node(words, own, Path(files.add('')))


def _as_a_node(words: list[str], own: dict[str, Any], log: Path) -> Iterator[Result]:
    """Host the driver, check it through topics, kill its host and check again."""
    for only in ('', 'killed and started again'):
        with log.open('wb') as out:
            host = start_node('actuator_node', words, stdout=out, stderr=subprocess.STDOUT)
            end = host.terminate if only else host.kill
            try:
                try:
                    yield from _through_topics(words, {**own, 'only': only}, host, log)
                except DriverError as error:
                    end = host.terminate
                    yield Result(only or 'as a node', False, 'not there', 'publishes state',
                                 str(error))
                    return
                if host.poll() is not None:
                    yield Result('host', False, f'exit code {host.returncode}', 'running',
                                 _last_line(log))
                    return
            finally:
                end()
                wait_or_kill(host)


def _through_topics(words: list[str], own: dict[str, Any],
                    host: subprocess.Popen[Any] | None = None,
                    log: Path | None = None) -> Iterator[Result]:
    """Run the kit's node; yield what it finds."""
    more = [item for key, value in own.items() if value != ''
            for item in ('-p', f'{key}:={json.dumps(value)}')]
    node = start_node('check_node', [*words, *more], stdout=subprocess.PIPE,
                      stderr=subprocess.PIPE, text=True)
    try:
        assert node.stdout is not None
        for text in node.stdout:
            if text.startswith('{'):
                yield Result(**json.loads(text))
        lines = node.communicate()[1].strip().splitlines()
        if node.returncode:
            ended = host is not None and host.poll() is not None and log is not None
            raise DriverError(_last_line(log) if ended and log else
                              lines[-1] if lines else f'exit code {node.returncode}')
    finally:
        node.terminate()
        wait_or_kill(node)


def _last_line(log: Path) -> str:
    """Return the last thing a process wrote."""
    lines = log.read_text(encoding='utf-8', errors='replace').strip().splitlines()
    return lines[-1] if lines else 'no output'

"""``dz driver check NAME|--topics``: a driver held to its contract; exit code 1 where it fails.

NAME is checked in this process (``drivers/conformance.py``), then as a node: hosted by
actuator_node, heard and commanded through topics, killed and started again. ``--topics`` checks a
node that is running already, whoever wrote it in whatever language.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict
from importlib.util import find_spec
import json
import math
from pathlib import Path
import subprocess
import sys
import tempfile
from typing import Any

from dz_ros.cli.operator import add_namespace
from dz_ros.cli.processes import check_rclpy, GRACE, start_node
from dz_ros.core.configuration import Configuration
from dz_ros.drivers.conformance import check_contract, Result
from dz_ros.drivers.hosted import HostedDriver
from dz_ros.errors import ConfigurationError, DriverError
from dz_ros.files import load_configuration, write_parameters

FAILED = 1
AMPLITUDE = 0.1
"""Largest command sent unless the driver's limit is smaller [command unit]."""
SHARE = 0.02
"""Largest command sent, as a share of the driver's limit."""
MARKS = {True: 'ok', False: 'FAILED', None: 'unseen'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('name', nargs='?', metavar='NAME',
                        help='driver, see dz driver list, or package.module:Class')
    parser.add_argument('--topics', action='store_true',
                        help='check the node that publishes state and takes command now')
    parser.add_argument('--config', default='robust', metavar='CONFIG',
                        help='configuration: plant, rate, safety (default: %(default)s)')
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
    add_namespace(parser)


def run(arguments: argparse.Namespace) -> int:
    """Check; print a line for each check; return 0, or 1 where one failed."""
    if (arguments.name is None) != arguments.topics:
        raise ConfigurationError('NAME', arguments.name, 'give either a driver or --topics')
    chosen = [] if arguments.name is None else [f'driver.name={json.dumps(arguments.name)}']
    configuration = load_configuration(arguments.config, [*arguments.overrides, *chosen]).replace(
        **{'loop.timing': 'realtime', 'loop.duration': 0.0, 'loop.peers': ['plant_node']})
    limit = math.inf if arguments.topics else HostedDriver(configuration).limit
    if configuration.safety.command_limit:
        limit = min(limit, configuration.safety.command_limit)
    amplitude = arguments.amplitude
    if amplitude is None:
        amplitude = min(AMPLITUDE, SHARE * limit)
    if not (math.isfinite(amplitude) and 0.0 <= amplitude <= limit):
        raise ConfigurationError('--amplitude', amplitude, f'must be from 0 to {limit:g}')
    if arguments.topics:
        check_rclpy()
    _ask(arguments, configuration, amplitude)
    failed = False
    for result in _results(arguments, configuration, amplitude, limit):
        failed |= result.passed is False
        print(json.dumps(asdict(result), ensure_ascii=False) if arguments.json
              else line(result), flush=True)
    return FAILED if failed else 0


def line(result: Result) -> str:
    """Return a result as a line: verdict, check, figure, limit, why."""
    why = f'  ({result.words})' if result.words else ''
    return (f'{MARKS[result.passed]:6}  {result.name:24} {result.figure}; must be: '
            f'{result.limit}{why}')


def _ask(arguments: argparse.Namespace, c: Configuration, amplitude: float) -> None:
    """Ask before a real device moves.

    Raises:
        ConfigurationError: Nobody can be asked, or the answer is no.
    """
    if arguments.yes or (not arguments.topics and c.driver_class.lockstep):
        return
    most = 'up to its limit' if arguments.saturate else f'up to {amplitude:g}'
    if not sys.stdin.isatty():
        raise ConfigurationError('--yes', False, f'the device will get commands {most}: give '
                                 '--yes where nobody can be asked')
    answer = input(f'The device will get commands {most}, stops and restarts. Go on? [y/N] ')
    if answer.strip().lower() not in ('y', 'yes'):
        raise ConfigurationError('--yes', False, 'nothing was sent')


def _results(arguments: argparse.Namespace, c: Configuration, amplitude: float,
             limit: float) -> Iterator[Result]:
    """Yield every result: in this process, then through topics."""
    own: dict[str, Any] = {'amplitude': amplitude,
                           'limit': limit if arguments.saturate and math.isfinite(limit) else 0.0}
    words = ['--ros-args', '-r', f'__ns:=/{arguments.namespace.strip("/")}']
    with tempfile.TemporaryDirectory(prefix='dz_ros-') as folder:
        parameters = Path(folder) / 'parameters.yaml'
        write_parameters(c, parameters)
        words += ['--params-file', str(parameters)]
        if arguments.topics:
            yield from _through_topics(words, own)
            return
        opened = True
        for result in check_contract(c, amplitude, arguments.saturate):
            opened &= result.name != 'opens' or result.passed is not False
            yield result
        if find_spec('rclpy') is None:
            yield Result('as a node', None, 'not tried', 'as docs/topics.md says',
                         'rclpy is not installed here')
        elif opened:
            yield from _as_a_node(words, own, Path(folder) / 'log')


def _as_a_node(words: list[str], own: dict[str, Any], log: Path) -> Iterator[Result]:
    """Host the driver, check it through topics, kill its host and check again."""
    for only in ('', 'killed and started again'):
        with log.open('wb') as out:
            host = start_node('actuator_node', words, stdout=out, stderr=subprocess.STDOUT)
            try:
                try:
                    yield from _through_topics(words, {**own, 'only': only}, host, log)
                except DriverError as error:
                    yield Result(only or 'as a node', False, 'not there', 'publishes state',
                                 str(error))
                    return
                if host.poll() is not None:
                    yield Result('host', False, f'exit code {host.returncode}', 'running',
                                 _last_line(log))
                    return
            finally:
                if only:
                    host.terminate()
                else:
                    host.kill()
                _wait(host)


def _through_topics(words: list[str], own: dict[str, Any],
                    host: subprocess.Popen[Any] | None = None,
                    log: Path | None = None) -> Iterator[Result]:
    """Run the kit's node; yield what it finds.

    Raises:
        DriverError: It cannot hear the driver.
    """
    more = [item for key, value in own.items() if value != ''
            for item in ('-p', f'{key}:={json.dumps(value)}')]
    node = start_node('check_node', [*words, *more], stdout=subprocess.PIPE,
                      stderr=subprocess.PIPE, text=True)
    try:
        assert node.stdout is not None
        for text in node.stdout:
            if text.startswith('{'):
                yield Result(**json.loads(text))
        said = node.communicate()[1].strip().splitlines()
        if node.returncode:
            ended = host is not None and host.poll() is not None and log is not None
            raise DriverError(_last_line(log) if ended and log else
                              said[-1] if said else f'exit code {node.returncode}')
    finally:
        node.terminate()
        _wait(node)


def _last_line(log: Path) -> str:
    """Return the last thing a process wrote."""
    lines = log.read_text(encoding='utf-8', errors='replace').strip().splitlines()
    return lines[-1] if lines else 'it said nothing'


def _wait(process: subprocess.Popen[Any]) -> None:
    """Wait for the end of a process; kill it if it does not end."""
    try:
        process.wait(GRACE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()

# SPDX-License-Identifier: Apache-2.0
"""The shadow controller: yesterday's states and references, today's commands, side by side."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import json
import math
from pathlib import Path
import tempfile
from typing import Any

from dz_ros.cli.interrupt import INTERRUPTED
from dz_ros.cli.options import read_recording, refuse_existing
from dz_ros.cli.output import aligned, note, print_lines
from dz_ros.cli.processes import Nodes, ParameterFiles
from dz_ros.cli.progress import stage
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.errors import ConfigurationError, RecordingError
from dz_ros.files.configurations import flat_parameters, format_parameters
from dz_ros.replay.shadow import compare_answers, Comparison
from dz_ros.runs.history import RunHistory

NAMESPACE = 'shadow'
"""Everything live happens below this namespace: no recorded topic is ever published on."""
PEERS = ('controller_node', 'recorder_node')


def run_shadow(arguments: argparse.Namespace) -> int:
    """Feed, compare, print; return 0 if all commands and terms are within the tolerance, else 1.

    Raises:
        ConfigurationError: The run has no configuration, or not one for this build.
        RunExistsError: The run to be recorded exists.
    """
    if not (math.isfinite(arguments.tolerance) and arguments.tolerance >= 0.0):
        raise ConfigurationError('--tolerance', arguments.tolerance, 'must be a number >= 0')
    refuse_existing(arguments.record)
    recorded = read_recording(arguments.run, arguments.of)
    if recorded.axes:
        raise RecordingError(f'{arguments.run} has axes {", ".join(recorded.axes)}; a shadow '
                             'controller answers a loop of one axis: dz bag audit and whatif do '
                             'it for each')
    live = _configuration(recorded, arguments)
    with tempfile.TemporaryDirectory(prefix='dz_ros-') as folder, ParameterFiles() as files:
        directory = arguments.record or Path(folder) / 'live'
        with stage('feeding the recorded states to a live controller'):
            code = _feed(arguments, recorded, live, files, directory)
        if code:
            return code
        found = compare_answers(recorded, read_recording(directory), arguments.tolerance)
    for text in _notes(recorded):
        note(text)
    if arguments.json:
        print(json.dumps(found.to_dict(), indent=2, allow_nan=False))
    else:
        print_lines(lines(found))
    return 0 if found.same else 1


def _configuration(recorded: RunData, arguments: argparse.Namespace) -> Configuration:
    """Return the live controller's configuration: the run's, with what was asked for changed."""
    began = RunHistory.of(recorded).began
    if not began and arguments.config is None:
        raise ConfigurationError('--config', None, f'{arguments.run} does not hold the '
                                 'configuration it was recorded with: give it')
    overrides = flat_parameters(arguments.config, arguments.overrides,
                                arguments.of or recorded.info.get('namespace', ''))
    # Its commands do not act, so the device moves against them as it likes.
    configuration = Configuration.from_untrusted({**began, 'safety.runaway_time': 0.0}, overrides)
    return configuration.replace(**{
        'loop.timing': 'realtime' if arguments.paced else 'lockstep',
        'loop.peers': PEERS[1:] if arguments.paced else PEERS})


def _feed(arguments: argparse.Namespace, recorded: RunData, live: Configuration,
          files: ParameterFiles, directory: Path) -> int:
    """Run the live controller on the recorded data and record it; return the exit code."""
    namespace = (arguments.namespace or NAMESPACE).strip('/')
    common = ['-r', f'__ns:=/{namespace}', '--params-file', files.add(format_parameters(live))]
    own: dict[str, Any] = {'run': str(arguments.run.absolute())}
    feeder, words = 'feed_node', common
    if arguments.paced:
        place = (arguments.of or recorded.info.get('namespace', '')).strip('/')
        names = {name: f'{place}/{name}'.lstrip('/') for name in ('state', 'reference')}
        own.update({'rate': arguments.rate, 'topics': list(names.values()),
                    'wait_for': [f'{name}={peer}' for name in names.values() for peer in PEERS]})
        feeder = 'replay_node'
        words = [*common[:2], *(word for name, old in names.items() if place
                                for word in ('-r', f'{old}:={name}'))]
    elif arguments.of is not None:
        own['of'] = '/' + arguments.of.strip('/')
    feeding = files.add_parameters(own)
    recording = files.add_parameters({'directory': str(directory.absolute())})
    with Nodes() as nodes:
        nodes.start({'recorder_node': [*common, '--params-file', recording],
                     'controller_node': common, feeder: [*words, '--params-file', feeding]})
        codes = [nodes.wait(feeder), nodes.end('controller_node'), nodes.end('recorder_node')]
        if nodes.interrupted:
            return INTERRUPTED
    failed = [code for code in codes if code]
    return 0 if not failed else 2 if 2 in failed else 1


def lines(found: Comparison) -> Iterator[str]:
    """Yield the comparison as text."""
    yield (f'{found.compared} of {found.recorded} recorded commands compared'
           + (f'; {found.live - found.compared} live ones answer other states'
              if found.live > found.compared else ''))
    worst = found.command
    where = '' if worst.largest_seq is None else f' at seq {worst.largest_seq}'
    yield f'largest |Δv| {worst.largest:.17g}{where}'
    differing = [item for item in (worst, *found.terms) if item.differing]
    if found.first is not None:
        yield (f'first command beyond {found.tolerance:g}: seq {found.first.seq}, '
               f't = {found.first.stamp:g} s: recorded {found.first.recorded!r}, live '
               f'{found.first.live!r}')
    if differing:
        yield from aligned([('term', 'samples', 'first seq', 'largest |Δ|'), *(
            (item.name, str(item.differing), str(item.first_seq), f'{item.largest:.5g}')
            for item in differing)])
    elif found.compared:
        yield (f'every command and every one of {len(found.terms)} terms '
               + ('is the same' if not found.tolerance else f'is within {found.tolerance:g}'))
    if found.not_compared:
        yield f'terms that only one of them has: {", ".join(found.not_compared)}'


def _notes(recorded: RunData) -> Iterator[str]:
    """Yield why a live controller might not meet what the recorded one met."""
    if 'cut' in recorded.info:
        yield f'the run was cut off: {recorded.info["cut"]}'
    command = recorded.channels.get('command')
    if command is not None and len(command) and command['seq'][0] > 0.0:
        yield (f'the recording begins with command {command["seq"][0]:g}: the memory of the '
               'controller before it is not in the run, the live one began without it')
    stated = len(RunHistory.of(recorded).statements('controller'))
    if stated > 1:
        yield (f'the controller of the run stated its configuration {stated} times: the live one '
               'had the first')

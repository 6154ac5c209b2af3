"""The shadow controller: yesterday's states and references, today's commands, side by side."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import json
import math
from pathlib import Path
import sys
import tempfile
from typing import Any

from dz_ros.analysis.shadow import compare_answers, Comparison
from dz_ros.cli.processes import Nodes, write_node_parameters
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.errors import ConfigurationError, RunExistsError
from dz_ros.files import flat_parameters, write_parameters
from dz_ros.recording.reader import read_run

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
    if arguments.record is not None and arguments.record.exists():
        raise RunExistsError(f'{arguments.record}: exists already; recordings are never '
                             'overwritten: choose another directory')
    recorded = read_run(arguments.run, arguments.of)
    live = _configuration(recorded, arguments)
    with tempfile.TemporaryDirectory(prefix='dz_ros-') as folder:
        directory = arguments.record or Path(folder) / 'live'
        code = _feed(arguments, recorded, live, Path(folder), directory)
        if code:
            return code
        found = compare_answers(recorded, read_run(directory), arguments.tolerance)
    for note in _notes(recorded):
        print(f'dz: note: {note}', file=sys.stderr)
    if arguments.json:
        print(json.dumps(found.to_dict(), indent=2, allow_nan=False))
    else:
        print('\n'.join(lines(found)))
    return 0 if found.same else 1


def _configuration(recorded: RunData, arguments: argparse.Namespace) -> Configuration:
    """Return the live controller's configuration: the run's, with what was asked for changed.

    Raises:
        ConfigurationError: There is none, or it cannot be used.
    """
    if not recorded.configuration and arguments.config is None:
        raise ConfigurationError('--config', None, f'{arguments.run} does not hold the '
                                 'configuration it was recorded with: give it')
    overrides = flat_parameters(arguments.config, arguments.overrides)
    configuration = Configuration.from_flat({**recorded.configuration, **overrides},
                                           driven=False)
    return configuration.replace(**{
        'loop.timing': 'realtime' if arguments.paced else 'lockstep',
        'loop.peers': PEERS[1:] if arguments.paced else PEERS})


def _feed(arguments: argparse.Namespace, recorded: RunData, live: Configuration, folder: Path,
          directory: Path) -> int:
    """Run the live controller on the recorded data and record it; return the exit code."""
    namespace = (arguments.namespace or NAMESPACE).strip('/')
    parameters, feeding = folder / 'parameters.yaml', folder / 'feed.yaml'
    write_parameters(live, parameters)
    common = ['-r', f'__ns:=/{namespace}', '--params-file', str(parameters)]
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
    write_node_parameters(feeding, own)
    recording = folder / 'recording.yaml'
    write_node_parameters(recording, {'directory': str(directory.absolute())})
    with Nodes() as nodes:
        nodes.start('recorder_node', [*common, '--params-file', str(recording)])
        nodes.start('controller_node', common)
        nodes.start(feeder, [*words, '--params-file', str(feeding)])
        codes = [nodes.wait(feeder), nodes.end('controller_node'), nodes.end('recorder_node')]
        if nodes.interrupted:
            return 130
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
        width = max(len(item.name) for item in differing)
        yield f'{"term":<{width}}  {"samples":>8}  {"first seq":>9}  {"largest |Δ|":>12}'
        for item in differing:
            yield (f'{item.name:<{width}}  {item.differing:>8}  {item.first_seq:>9}  '
                   f'{item.largest:>12.5g}')
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
               'controller before it is not in the run, the live one began anew')
    stated = 0
    for _, _, text in recorded.events:
        try:
            event = json.loads(text)
        except ValueError:
            continue
        stated += (isinstance(event, dict) and event.get('event') == 'configuration'
                   and 'controller' in (event.get('owns') or ()))
    if stated > 1:
        yield (f'the controller of the run stated its configuration {stated} times: the live one '
               'had the first')

# SPDX-License-Identifier: Apache-2.0
"""``dz bag audit RUN``: recompute every command and estimate of a run, compare bit for bit.

Exit code 0 only if every sample could be checked, every number is equal and no message is missing
(a sample for which the device had no measurement has no state: a note); 1 where anything differs,
is missing or cannot be checked; 2 for a mistake in what was asked for.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import json
from pathlib import Path

from dz_ros.cli.options import add_recording, read_recording
from dz_ros.cli.output import aligned, print_lines
from dz_ros.cli.progress import stage
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration
from dz_ros.replay.audit.audit import audit
from dz_ros.replay.audit.result import AuditResult, FieldResult
from dz_ros.runs.axes import axis_name, each_axis

FAILED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_recording(parser)
    parser.add_argument('--config', metavar='FILE',
                        help='what the controller ran with, for bags without it: a '
                             'configuration file or the name of one that comes with dz_ros')
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE',
                        dest='overrides', help='change one key of that configuration')
    parser.add_argument('--json', action='store_true', help='print everything for programs')
    parser.epilog = ('exit code: 0 all checked, equal and whole; 1 something differs, is missing '
                     'or cannot be checked; 2 a mistake in what was asked for')


def run(arguments: argparse.Namespace) -> int:
    """Audit; print what was found.

    Raises:
        ConfigurationError: --set without --config.
    """
    configuration = None
    if arguments.config is not None:
        configuration = load_configuration(arguments.config, arguments.overrides,
                                           arguments.namespace or '')
    elif arguments.overrides:
        raise ConfigurationError('--set', arguments.overrides[0],
                                 'changes the configuration given by --config, which is missing')
    axes = configuration.axis_names if configuration is not None else ()
    results = {}
    runs = each_axis(read_recording(arguments.run, arguments.namespace))
    if arguments.axis and '' in runs and axis_name(runs['']) == arguments.axis:
        runs = {arguments.axis: runs['']}
    if arguments.axis is not None and arguments.axis not in runs:
        raise ConfigurationError('--axis', arguments.axis,
                                 'the run has one axis, without a name' if '' in runs
                                 else f'must be one of {", ".join(runs)}')
    for name in runs if axes else ():
        if name not in axes and arguments.axis in (None, name):
            raise ConfigurationError('--config', arguments.config, f'is of axes {", ".join(axes)}'
                                     f', the run of {", ".join(runs) or "one axis"}')
    for name, run in runs.items():
        if arguments.axis in (None, name):
            with stage('recomputing samples' + (f' of axis {name}' if name else '')) as step:
                results[name if arguments.axis is None else ''] = audit(
                    run, configuration.axis(name) if configuration is not None and name in axes
                    else configuration, [item for other, item in runs.items() if other != name],
                    step)
    if arguments.json:
        found = {name: result.to_dict() for name, result in results.items()}
        print(json.dumps(found.get('', {'axes': found}), indent=2, allow_nan=False))
    else:
        for name, result in results.items():
            print_lines([f'== axis {name}'] if name else [])
            print_lines(lines(result, arguments.run))
    return 0 if all(result.passed for result in results.values()) else FAILED


def lines(result: AuditResult, run: Path) -> Iterator[str]:
    """Yield what an audit found as text."""
    yield f'{run}: recomputed by dz_ros {result.version}'
    for span in result.spans:
        restart = f'start {span.start + 1} of the controller, ' if span.start else ''
        yield (f'  {restart}from seq {span.first}: law {span.law or "unknown"}, {span.source}'
               + (f', dz_ros {span.version}' if span.version else ''))
    left = result.samples - result.checked
    for label, count, rest in (
            ('samples', result.samples, ''),
            ('checked', result.checked, f'{result.compared} numbers compared'),
            ('not checkable', left, ''),
            ('differences', result.differences, '')):
        yield f'  {label:<14}{count:>8}  {rest}'.rstrip()
    for reason in result.not_checkable:
        yield f'  not checkable: {reason.samples} from seq {reason.first} on: {reason.text}'
    if result.first is not None and result.largest is not None:
        yield f'  first: {result.first.text()}'
        yield f'  largest: {result.largest.text()}'
        yield from _table(result)
    for finding in result.findings:
        yield f'  found: {finding}'
    for note in result.notes:
        yield f'  note: {note}'
    yield _verdict(result)


def _table(result: AuditResult) -> Iterator[str]:
    """Yield one line for each field that differs, under a heading."""
    wrong = {name: item for name, item in result.fields.items() if item.differing}
    yield from aligned([('field', 'compared', 'differ', 'first seq', 'largest'), *(
        (name, f'{item.compared:>8}', f'{item.differing:>8}', _first(item), _largest(item))
        for name, item in wrong.items())], (0, 4), '  ')


def _first(item: FieldResult) -> str:
    return '' if item.first is None else str(item.first.seq)


def _largest(item: FieldResult) -> str:
    return '' if item.largest is None else f'{item.largest.size:.3g} at seq {item.largest.seq}'


def _verdict(result: AuditResult) -> str:
    """Return the conclusion in one line."""
    if result.passed:
        return 'every command and every estimate is reproduced bit for bit'
    reasons = []
    if result.differences:
        reasons.append('the log does not agree with what its law computes')
    if result.checked < result.samples or not result.samples:
        reasons.append('not everything could be checked')
    if result.findings:
        reasons.append('see what was found')
    return 'NOT PASSED: ' + '; '.join(reasons)

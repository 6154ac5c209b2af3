"""``dz bag audit RUN``: recompute every command and estimate of a run, compare bit for bit.

Exit code 0 only if every sample could be checked, every number is equal and no message is missing;
1 where anything differs, is missing or cannot be checked; 2 for a mistake in what was asked for.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import json
from pathlib import Path

from dz_ros.analysis.audit import audit
from dz_ros.analysis.audit_result import AuditResult, FieldResult
from dz_ros.errors import ConfigurationError
from dz_ros.files import load_configuration
from dz_ros.recording.reader import read_run

FAILED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('run', type=Path, metavar='RUN',
                        help='directory of a run or of a rosbag2 bag, or its .mcap or .db3')
    parser.add_argument('--config', metavar='FILE',
                        help='what the controller ran with, for bags that do not say it: a '
                             'configuration file or the name of one that comes with dz_ros')
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE',
                        dest='overrides', help='change one key of that configuration')
    parser.add_argument('--namespace', metavar='NS',
                        help='whose topics to read, where a run holds several loops')
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
        configuration = load_configuration(arguments.config, arguments.overrides)
    elif arguments.overrides:
        raise ConfigurationError('--set', arguments.overrides[0],
                                 'changes the configuration given by --config, which is missing')
    result = audit(read_run(arguments.run, arguments.namespace), configuration)
    if arguments.json:
        print(json.dumps(result.to_dict(), ensure_ascii=False, indent=2, allow_nan=False))
    else:
        print('\n'.join(lines(result, arguments.run)))
    return 0 if result.passed else FAILED


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
    width = max(len(name) for name in wrong)
    yield f'  {"field":<{width}}  {"compared":>8}  {"differ":>8}  {"first seq":>9}  largest'
    for name, item in wrong.items():
        yield (f'  {name:<{width}}  {item.compared:>8}  {item.differing:>8}  '
               f'{_first(item):>9}  {_largest(item)}')


def _first(item: FieldResult) -> str:
    return '' if item.first is None else str(item.first.seq)


def _largest(item: FieldResult) -> str:
    return '' if item.largest is None else f'{item.largest.size:.3g} at seq {item.largest.seq}'


def _verdict(result: AuditResult) -> str:
    """Return the conclusion in one line."""
    if result.passed:
        return 'every command and every estimate is reproduced bit for bit'
    said = []
    if result.differences:
        said.append('the log does not agree with what its law computes')
    if result.checked < result.samples or not result.samples:
        said.append('not everything could be checked')
    if result.findings:
        said.append('see what was found')
    return 'NOT PASSED: ' + '; '.join(said)

# SPDX-License-Identifier: Apache-2.0
"""``dz bag recover RUN [DEST]``: a complete run out of one that was cut off; RUN stays."""

from __future__ import annotations

import argparse
from pathlib import Path

from dz_ros.cli.bag.info import topic_lines
from dz_ros.cli.output import print_lines
from dz_ros.cli.progress import stage
from dz_ros.recording.recover import recover


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('run', type=Path, metavar='RUN',
                        help='directory of the damaged run, or its .mcap; not changed')
    parser.add_argument('destination', nargs='?', type=Path, metavar='DEST',
                        help='directory of the new run, which must not exist '
                             '(default: RUN-recovered)')


def run(arguments: argparse.Namespace) -> int:
    """Recover; print what could be read and what could not."""
    source: Path = arguments.run
    destination = arguments.destination or beside(source, 'recovered')
    with stage(f'reading {source}, writing {destination}'):
        summary = recover(source, destination)
    print_lines(f'{summary.directory}: {summary.messages} messages, {summary.duration:.3f} s')
    print_lines(topic_lines(summary.topics))
    for note in summary.notes:
        print_lines(f'note: {note}')
    return 0


def beside(run: Path, word: str) -> Path:
    """Return a name next to a run's: ``runs/a`` or ``runs/a.mcap`` → ``runs/a-WORD``."""
    run = run.absolute() if run.name in ('', '..') else run
    name = run.stem if run.suffix in ('.mcap', '.db3') else run.name
    return run.with_name(f'{name}-{word}')

# SPDX-License-Identifier: Apache-2.0
"""``dz bag info RUN``: what a recording holds, topic by topic."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

from dz_ros.cli.output import aligned, print_lines
from dz_ros.cli.progress import stage
from dz_ros.core.text import printable
from dz_ros.recording.reader import run_info
from dz_ros.recording.summary import TopicSummary

HEADINGS = ('topic', 'type', 'messages', 'bytes', 'missing', 'repeated', 'out of order',
            'restarts')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('run', type=Path, metavar='RUN', help='directory of a run, or its .mcap')
    parser.epilog = ('lost, repeated, out of order: sample numbers that were never received, '
                     'received again, received after a larger one.')


def run(arguments: argparse.Namespace) -> int:
    """Print it."""
    with stage(f'reading {arguments.run}'):
        info = run_info(arguments.run)
    print_lines(f'{info.path}: {info.storage}, {info.size / 1e6:.3g} MB, '
                f'{"cut off" if info.cut else "complete"}')
    if info.start_ns is not None:
        print_lines(f'{_local(info.start_ns)}, {info.duration:.3f} s, {info.messages} messages')
    for name, value in info.info.items():
        print_lines(f'  {name}: {value}')
    for names in dict.fromkeys(info.axes.values()):
        print_lines(f'  axes: {", ".join(names)}')
    print_lines(topic_lines(info.topics))
    print_lines(f'note: {text}' for text in info.notes)
    if info.cut:
        print_lines(f'note: {info.cut}; dz bag recover {info.path} makes a complete run of it')
    return 0


def _local(time_ns: int) -> str:
    """Return an instant in local time."""
    try:
        start = datetime.fromtimestamp(time_ns * 1e-9).astimezone()
    except (ValueError, OverflowError, OSError):    # years a calendar does not have
        return f'{time_ns} ns after 1970'
    return f'{start:%Y-%m-%d %H:%M:%S %z}'


def topic_lines(topics: Mapping[str, TopicSummary]) -> list[str]:
    """Return a table, one line a topic."""
    rows = [HEADINGS] + [
        (printable(name), printable(topic.type_name), *(str(number) for number in (
            topic.messages, topic.bytes, topic.missing, topic.duplicates, topic.reordered,
            topic.restarts)))
        for name, topic in sorted(topics.items())]
    return aligned(rows, (0, 1))

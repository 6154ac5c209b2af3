"""``dz bag info RUN``: what a recording holds, topic by topic."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

from dz_ros.recording.reader import run_info
from dz_ros.recording.summary import TopicSummary

HEADINGS = ('topic', 'type', 'messages', 'bytes', 'missing', 'twice', 'late', 'restarts')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('run', type=Path, metavar='RUN', help='directory of a run, or its .mcap')
    parser.epilog = ('missing, twice, late: sample numbers that never came, came again, came '
                     'after a later one.')


def run(arguments: argparse.Namespace) -> int:
    """Print it."""
    info = run_info(arguments.run)
    print(f'{info.path}: {info.storage}, {info.size / 1e6:.3g} MB, '
          f'{"cut off" if info.cut else "complete"}')
    if info.start_ns is not None:
        start = datetime.fromtimestamp(info.start_ns * 1e-9).astimezone()
        print(f'{start:%Y-%m-%d %H:%M:%S %z}, {info.duration:.3f} s, {info.messages} messages')
    for name, value in info.info.items():
        print(f'  {name}: {value}')
    print('\n'.join(topic_lines(info.topics)))
    if info.cut:
        print(f'note: {info.cut}; dz bag recover {info.path} makes a complete run of it')
    return 0


def topic_lines(topics: Mapping[str, TopicSummary]) -> list[str]:
    """Return a table, one line a topic."""
    rows = [HEADINGS] + [
        (name, topic.type_name, *(str(number) for number in (
            topic.messages, topic.bytes, topic.missing, topic.duplicates, topic.reordered,
            topic.restarts)))
        for name, topic in sorted(topics.items())]
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADINGS))]
    return ['  '.join(cell.ljust(width) if i < 2 else cell.rjust(width)
                      for i, (cell, width) in enumerate(zip(row, widths, strict=True))).rstrip()
            for row in rows]

"""``dz status``: what the nodes of running loops say of themselves, live."""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from typing import Any

from dz_ros.cli.operator import operator

LEVELS = ('ok', 'WARN', 'ERROR', 'STALE')
GONE = 3.0
"""A node not heard of for so long is shown as stale [s]."""
SHORT = ('mode', 'rate [Hz]', 'period p99 [ms]', 'round trip p99 [ms]',
         'state to command p99 [ms]', 'late by more than 1 ms', 'max |error|', 'max |s|/epsilon',
         'command in force', 'messages waiting', 'messages lost')
"""What is shown without --all."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('--once', action='store_true',
                        help='print what is heard in three seconds and end; exit code 1 where a '
                             'node is in error or none is heard')
    parser.add_argument('--all', action='store_true', help='every value, not the chief ones')


def run(arguments: argparse.Namespace) -> int:
    """Show until interrupted, or once."""
    heard: dict[str, dict[str, Any]] = {}
    first: list[float] = []
    terminal = sys.stdout.isatty()
    with operator('status') as process:
        def read() -> None:
            assert process.stdout is not None
            for line in process.stdout:
                status = json.loads(line)
                heard[status['node']] = {**status, 'at': time.monotonic()}
                first.append(heard[status['node']]['at'])

        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        shown = 0.0
        until = time.monotonic() + 15.0
        while process.poll() is None:
            time.sleep(0.1)
            now = time.monotonic()
            if arguments.once and (now - first[0] > GONE if first else now > until):
                break
            if not arguments.once and now - shown >= 1.0:
                shown = now
                if terminal:
                    print('\x1b[2J\x1b[H', end='')
                print(_table(dict(heard), arguments.all, now), flush=True)
        code = process.poll()
    if code:
        return code
    if arguments.once:
        print(_table(heard, arguments.all, time.monotonic()))
        return 1 if not heard or any(item['level'] > 1 for item in heard.values()) else 0
    return 0


def _table(heard: dict[str, dict[str, Any]], everything: bool, now: float) -> str:
    """Return the nodes, worst word first, their values below them."""
    if not heard:
        return 'no node is heard: is a loop running in this ROS_DOMAIN_ID?'
    lines = []
    for name, status in sorted(heard.items()):
        age = now - status['at']
        level = LEVELS[3] if age > GONE else LEVELS[min(status['level'], 3)]
        said = f'not heard for {age:.0f} s' if age > GONE else status['message']
        lines.append(f'{level:5}  {name}: {said}')
        values = status['values']
        lines += [f'         {key:32} {value:>12}' for key, value in values.items()
                  if everything or key in SHORT or key.startswith('ignored')]
    return '\n'.join(lines)

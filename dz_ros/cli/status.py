# SPDX-License-Identifier: Apache-2.0
"""``dz status``: the diagnostics of the nodes of running loops, live."""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from typing import Any

from dz_ros.cli.operator import add_remapping, operator
from dz_ros.cli.output import print_lines
from dz_ros.cli.progress import stage
from dz_ros.core.lateness import LATE_COUNT

LEVELS = ('ok', 'WARN', 'ERROR', 'STALE')
GONE = 3.0
"""A node without diagnostics for longer is shown as stale [s]."""
MAX_NODES = 64
"""Nodes that are shown; any process may publish diagnostics under any number of names."""
SHORT = ('mode', 'rate [Hz]', 'period p99 [ms]', 'round trip p99 [ms]',
         'state to command p99 [ms]', LATE_COUNT, 'max |error|', 'max |s|/epsilon',
         'applied command', 'messages waiting', 'messages lost')
"""What is shown without --all."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('--once', action='store_true',
                        help='print what is received and end once three seconds bring no other '
                             'node; exit code 1 where a node is in error or there is none')
    add_remapping(parser)
    parser.add_argument('--all', action='store_true', help='every value, not the chief ones')


def run(arguments: argparse.Namespace) -> int:
    """Show until interrupted, or once."""
    received: dict[str, dict[str, Any]] = {}
    newest = 0.0        # when a node appeared last
    terminal = sys.stdout.isatty()
    with operator('status', remappings=arguments.remap) as process:
        def read() -> None:
            nonlocal newest
            assert process.stdout is not None
            for line in process.stdout:
                status = json.loads(line)
                now = time.monotonic()
                if status['node'] not in received:
                    if len(received) >= MAX_NODES:
                        continue
                    newest = now
                received[status['node']] = {**status, 'at': now}

        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        shown = 0.0
        until = time.monotonic() + 15.0
        if arguments.once:
            with stage('waiting for diagnostics'):
                while process.poll() is None and not newest and time.monotonic() < until:
                    time.sleep(0.1)
        while process.poll() is None:
            time.sleep(0.1)
            now = time.monotonic()
            if arguments.once and (now - newest > GONE if newest else now > until):
                break
            if not arguments.once and now - shown >= 1.0:
                shown = now
                if terminal:
                    print('\x1b[2J\x1b[H', end='')
                print_lines(_table(dict(received), arguments.all, now))
                sys.stdout.flush()
        code = process.poll()
    if code:
        return code
    if arguments.once:
        print_lines(_table(received, arguments.all, time.monotonic()))
        return 1 if not received or any(item['level'] > 1 for item in received.values()) else 0
    return 0


def _table(received: dict[str, dict[str, Any]], everything: bool, now: float) -> list[str]:
    """Return the nodes, worst word first, their values below them, a line each."""
    if not received:
        return ['no node publishes diagnostics: is a loop running in this ROS_DOMAIN_ID?']
    lines = [f'only the first {MAX_NODES} nodes are shown'] if len(received) >= MAX_NODES else []
    for name, status in sorted(received.items()):
        age = now - status['at']
        level = LEVELS[3] if age > GONE else LEVELS[min(status['level'], 3)]
        text = f'silent for {age:.0f} s' if age > GONE else status['message']
        lines.append(f'{level:5}  {name}: {text}')
        values = status['values']
        lines += [f'         {key:32} {value:>12}' for key, value in values.items()
                  if everything or plain(key) in SHORT or key.startswith('ignored')]
    return lines


def plain(key: str) -> str:
    """Return the label of a value without the axis that may stand before it."""
    return key.partition(': ')[2] or key

# SPDX-License-Identifier: Apache-2.0
"""``dz doctor``: what this machine permits a loop, and what that would gain, measured.

An absolute-deadline loop of 200 Hz runs once for each set-up, on the machine as it is and beside
one busy process a core, and its ticks are timed. What is refused is not measured.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
import contextlib
from importlib.util import find_spec
import json
from pathlib import Path
import platform
import subprocess
import sys
from typing import Any

from dz_ros.cli.processes import python_environment
from dz_ros.cli.progress import stage
from dz_ros.core.lateness import LATE
from dz_ros.core.percentiles import percentile
from dz_ros.errors import LoopError
from dz_ros.runtime.privileges import ADVICE, usable_cores

SECONDS = 1.5
BUSY = 'import sys, time\nend = time.time() + float(sys.argv[1])\nwhile time.time() < end: pass'
WHOLE = 20.0
"""Longest that one measurement may take [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('--seconds', type=float, default=SECONDS, metavar='S',
                        help=f'length of each measurement (default: {SECONDS:g})')
    parser.add_argument('--json', action='store_true', help='print every number for programs')


def run(arguments: argparse.Namespace) -> int:
    """Look, measure, print; return 0."""
    if not 0.1 <= arguments.seconds <= WHOLE / 2.0:
        raise LoopError(f'--seconds {arguments.seconds:g}: must be from 0.1 to {WHOLE / 2.0:g}')
    last = max(usable_cores())
    setups: dict[str, list[str]] = {
        'as any process': [], 'process.lock_memory: true': ['--lock'],
        f"process.cores: '{last}'": ['--cores', str(last)],
        'process.priority: 50': ['--priority', '50'],
        'all of them': ['--lock', '--cores', str(last), '--priority', '50']}
    with stage('measuring an idle machine'):
        idle = {name: measure(words, arguments.seconds) for name, words in setups.items()}
    with _load(len(setups) * (arguments.seconds + WHOLE)), stage('measuring a busy machine'):
        busy = {name: measure(words, arguments.seconds) for name, words in setups.items()
                if not idle[name]['refused']}
    machine = _machine()
    if arguments.json:
        print(json.dumps({'machine': machine, 'idle': idle, 'busy': busy}, ensure_ascii=False,
                         indent=2))
        return 0
    for name, value in machine.items():
        print(f'{name:18} {value}')
    print('ticks of 200 Hz, late by [µs]       as it is              beside a busy process a core')
    print(_line('', *('p50', 'p99', 'max') * 2))
    for name in setups:
        print(_line(name, *_cells(idle[name]), *_cells(busy.get(name))))
    for line in _advice(idle, busy):
        print(line)
    return 0


def _machine() -> dict[str, str]:
    """Return the properties of the machine that matter, as text."""
    found = {'cores': str(len(usable_cores())),
             'system': f'{platform.system()} {platform.release()}',
             'Python': platform.python_version()}
    version = platform.version()
    found['kernel'] = next((name for name in ('PREEMPT_RT', 'PREEMPT_DYNAMIC', 'PREEMPT')
                            if name in version), 'without preemption')
    governor = Path('/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor')
    with contextlib.suppress(OSError):
        found['frequency'] = f'{governor.read_text().strip()} (performance keeps ticks closest)'
    with contextlib.suppress(OSError, ValueError, IndexError):
        stolen = Path('/proc/stat').read_text().split('\n', 1)[0].split()
        share = int(stolen[8]) / max(sum(map(int, stolen[1:9])), 1)
        if share > 0.0:
            found['virtual'] = (f'a machine within a machine: {100 * share:.2f} % of its time '
                                'was taken away by others since it started')
    found['rclpy'] = 'installed' if find_spec('rclpy') else 'not installed: dz run cannot'
    found['numba'] = ('installed' if find_spec('numba') else
                      "not installed: sweeps are slower; pip install 'dz_ros[numba]'")
    return found


def measure(words: Sequence[str], seconds: float) -> dict[str, Any]:
    """Return the result of one measurement.

    Raises:
        LoopError: It failed.
    """
    done = subprocess.run(      # in a session of its own: Ctrl-C is answered here alone
        [sys.executable, '-m', 'dz_ros.runtime.probe', '--duration', str(seconds), *words],
        env=python_environment(), start_new_session=True,
        capture_output=True, text=True, check=False, timeout=WHOLE + seconds)
    if done.returncode:
        raise LoopError(f'a measurement failed: {done.stderr.strip().splitlines()[-1:]}')
    found = json.loads(done.stdout)
    return {'refused': found['refused'], **summary(found['lateness'])}


def summary(ordered: Sequence[float]) -> dict[str, Any]:
    """Return p50, p99 and the largest of ordered times [s], and the number of late ones."""
    return {'p50': percentile(ordered, 0.5), 'p99': percentile(ordered, 0.99),
            'max': ordered[-1], 'late': sum(item > LATE for item in ordered),
            'ticks': len(ordered)}


@contextlib.contextmanager
def _load(limit: float) -> Iterator[None]:
    """Keep every core busy for at most `limit` [s]."""
    busy = [subprocess.Popen([sys.executable, '-c', BUSY, str(limit)], start_new_session=True)
            for _ in usable_cores()]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def _cells(found: dict[str, Any] | None) -> list[str]:
    """Return p50, p99, max [µs] of a measurement."""
    if found is None or found['refused']:
        return ['refused', '', '']
    return [f'{1e6 * found[key]:.0f}' for key in ('p50', 'p99', 'max')]


def _line(name: str, *cells: str) -> str:
    """Return a line of the table."""
    return f'  {name:26}' + ''.join(f'{cell:>9}' for cell in cells)


def _advice(idle: dict[str, Any], busy: dict[str, Any]) -> Iterator[str]:
    """Yield what to do."""
    refused = [name for name, found in idle.items() if found['refused']]
    if refused:
        yield f'refused: {", ".join(refused)}; {ADVICE}'
    plain = busy['as any process']['p99']
    best = min(busy, key=lambda name: float(busy[name]['p99']))
    if busy[best]['p99'] < 0.7 * plain:
        yield (f'on a busy machine {best} makes the ticks {plain / busy[best]["p99"]:.1f} times '
               'as punctual (p99)')
    elif not refused:
        yield 'none of the set-ups makes the ticks much more punctual here: leave them off'

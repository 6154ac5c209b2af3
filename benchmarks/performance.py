# SPDX-License-Identifier: Apache-2.0
"""Every ratio of speed with its target, in one table; marks what falls short.

    python benchmarks/performance.py                  measure everything, print (half an hour)
    python benchmarks/performance.py --quick          what can be said within a minute
    python benchmarks/performance.py --write          write the table into docs/performance.md too
    python benchmarks/performance.py --only PART …    these parts alone
    python benchmarks/performance.py --keep FILE      add to what the file has of other parts

A figure is a ratio against a peer measured in the same run on the same machine; nothing else may
run meanwhile. Returns 1 if a target is missed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import asdict
import json
import os
from pathlib import Path
import sys
import time

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks import batches, law, lockstep, loop, offline, starting, switching  # noqa: E402
from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit import profile_of_a_node  # noqa: E402
from benchmarks.speed_kit.rows import markdown, Row, say, show  # noqa: E402

PARTS: dict[str, Callable[[bool], list[Row]]] = {
    'latency': lambda quick: loop.measure(quick, ('latency',)),
    'polling': lambda quick: loop.measure(quick, ('polling',)),
    'cpu': lambda quick: loop.measure(quick, ('cpu',)),
    'kilohertz': lambda quick: loop.measure(quick, ('kilohertz',)),
    'rates': lambda quick: loop.measure(quick, ('rates',)),
    'soak': lambda quick: loop.measure(quick, ('soak',)),
    'lockstep': lockstep.measure,
    'law': law.measure,
    'offline': offline.measure,
    'batches': batches.measure,
    'starting': starting.measure,
    'switching': switching.measure,
}
"""Part → what measures it."""
QUICK = ('latency', 'law', 'starting', 'offline')
DOCUMENT = ROOT / 'docs' / 'performance.md'
PACKAGES = ('ros-rclpy', 'ros-rmw-fastrtps-cpp', 'numba', 'numpy', 'scipy', 'control')


def marked(name: str) -> tuple[str, str]:
    """Return the marks around what is written into the document."""
    return (f'<!-- {name}: benchmarks/performance.py writes it -->', f'<!-- end of {name} -->')


def put(name: str, lines: list[str]) -> None:
    """Put lines between the marks of a name.

    Raises:
        ValueError: The document has no such marks.
    """
    begin, end = marked(name)
    head, found, rest = DOCUMENT.read_text(encoding='utf-8').partition(begin)
    _, closed, tail = rest.partition(end)
    if not (found and closed):
        raise ValueError(f'{DOCUMENT.name} has no marks of {name!r}')
    DOCUMENT.write_text('\n'.join([head + begin, '', *lines, '', end]) + tail, encoding='utf-8')


def main() -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--quick', action='store_true')
    parser.add_argument('--write', action='store_true')
    parser.add_argument('--only', nargs='+', choices=(*PARTS, 'profile'), metavar='PART')
    parser.add_argument('--keep', type=Path, metavar='FILE')
    arguments = parser.parse_args()
    load = os.getloadavg()[1]
    print(f'{describe(*PACKAGES)}, load average {load:.1f}', flush=True)
    kept: dict[str, list[Row]] = {}
    if arguments.keep is not None and arguments.keep.exists():
        kept = {part: [Row(**row) for row in rows]
                for part, rows in json.loads(arguments.keep.read_text()).items()}
    for part in arguments.only or (QUICK if arguments.quick else PARTS):
        if part in PARTS:
            begin = time.monotonic()
            kept[part] = PARTS[part](arguments.quick)
            say(f'{part}: {time.monotonic() - begin:.0f} s')
            if arguments.keep is not None:
                arguments.keep.write_text(json.dumps(
                    {name: [asdict(row) for row in found] for name, found in kept.items()},
                    indent=1))
    rows = [row for part in PARTS for row in kept.get(part, [])]
    code = show(rows)
    if arguments.write:
        put('table', [f'Measured on {describe(*PACKAGES)}; load average over five minutes before '
                      f'it began: {load:.1f} (0 = an idle machine).', '', *markdown(rows)])
        if not arguments.only or 'law' in arguments.only:
            put('law steps', law.grids(arguments.quick))
        if not arguments.only or 'profile' in arguments.only:
            put('profile', profile_of_a_node.measure())
    return code


if __name__ == '__main__':
    sys.exit(main())

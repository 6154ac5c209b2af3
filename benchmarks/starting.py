"""How long commands take from start to end, and what an import brings with it.

    python benchmarks/starting.py [--quick]

Processes by the Python that runs this, from the start to the end of the process.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import statistics
import subprocess
import sys
import time

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit.rows import Row, show  # noqa: E402

DZ = ('-c', 'import sys; from dz_ros.cli.main import main; sys.exit(main())')
"""What the console script `dz` does."""
HEAVY = ('numpy', 'matplotlib', 'numba', 'rclpy', 'scipy', 'mcap')


def seconds(words: Sequence[str], times: int) -> list[float]:
    """Return how long a process took, several times, the first (cold) one left out [s]."""
    found = []
    for _ in range(times + 1):
        begin = time.perf_counter()
        subprocess.run([sys.executable, *words], cwd=ROOT, stdout=subprocess.DEVNULL, check=True)
        found.append(time.perf_counter() - begin)
    return found[1:]


def brought() -> list[str]:
    """Return which heavy packages `import dz_ros` loads."""
    code = f'import sys, dz_ros; print(*(n for n in {HEAVY!r} if n in sys.modules))'
    done = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True,
                          check=True)
    return done.stdout.split()


def measure(quick: bool = False) -> list[Row]:
    """Return the lines of the table."""
    times = 3 if quick else 10
    bare = statistics.median(seconds(('-c', 'pass'), times))
    rows = []
    for what, words, target in (('dz --help', ('--help',), 0.15),
                                ('dz simulate wang2004', ('simulate', 'wang2004'), 1.0)):
        found = seconds((*DZ, *words), times)
        rows.append(Row(f'`{what}`, start to end', statistics.median(found), target, 's',
                        detail=f'median of {times}, {min(found):.3f} to {max(found):.3f} s; '
                               f'Python itself {bare:.3f} s'))
    heavy = brought()
    return [*rows, Row('`import dz_ros` loads of numpy, matplotlib, numba, rclpy, …', len(heavy),
                       0.0, 'packages', detail=', '.join(heavy) or 'none of them')]


def main() -> int:
    """Print the table; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--quick', action='store_true', help='fewer repetitions')
    arguments = parser.parse_args()
    print(describe())
    return show(measure(arguments.quick))


if __name__ == '__main__':
    sys.exit(main())

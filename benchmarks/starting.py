# SPDX-License-Identifier: Apache-2.0
"""How long commands take from start to end, `dz run` to its first sample, what an import brings.

    python benchmarks/starting.py [--quick]

Processes by the Python that runs this, from the start to the end of the process. Byte code is
kept, as Python does by itself, whatever PYTHONDONTWRITEBYTECODE is.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib.util import find_spec
import os
from pathlib import Path
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit.rows import Row, show  # noqa: E402

DZ = ('-c', 'import sys; from dz_ros.cli.main import main; sys.exit(main())')
"""What the console script `dz` does."""
ENVIRONMENT = {name: value for name, value in os.environ.items()
               if name != 'PYTHONDONTWRITEBYTECODE'}
HEAVY = ('numpy', 'matplotlib', 'numba', 'rclpy', 'scipy', 'mcap')


def seconds(words: Sequence[str], times: int, cold: bool = False) -> list[float]:
    """Return how long a process took, several times [s]; before them the first, if wanted."""
    found = []
    for _ in range(times + 1):
        begin = time.perf_counter()
        subprocess.run([sys.executable, *words], cwd=ROOT, stdout=subprocess.DEVNULL, check=True,
                       env=ENVIRONMENT)
        found.append(time.perf_counter() - begin)
    return found if cold else found[1:]


def first_sample(*words: str) -> float:
    """Return how long `dz run` takes to its first sample [s]: until a sample at t, less t."""
    begin = time.perf_counter()
    running = subprocess.Popen([sys.executable, *DZ, 'run', 'wang2004', *words], cwd=ROOT,
                               env=ENVIRONMENT, text=True, stdout=subprocess.PIPE)
    assert running.stdout is not None
    for line in running.stdout:
        found = re.match(r't +([\d.]+) s', line)
        if found is not None:
            taken = time.perf_counter() - begin - float(found[1])
            running.send_signal(signal.SIGINT)
            running.communicate(timeout=60.0)
            return taken
    sys.exit('dz run had no sample')


def starts_of_loops(times: int) -> list[Row]:
    """Return how long `dz run` takes to its first sample, recorded and not."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for what, recorded in (('dz run', False), ('dz run --record', True)):
            found = [first_sample(*(('--record', f'{folder}/{place}') if recorded else ()))
                     for place in range(times + 1)][1:]
            rows.append(Row(f'`{what}` to its first sample', statistics.median(found), 2.0, 's',
                            detail=f'median of {times}, {min(found):.2f} to {max(found):.2f} s'))
    return rows


COMPILED = """
import time
import dz_ros as dz
configuration = dz.load('wang2004')
begin = time.perf_counter()
dz.simulate(configuration, compiled=True)
print(time.perf_counter() - begin)
"""


def compiled_calls(times: int) -> list[Row]:
    """Return how long a process's first compiled call takes, nothing kept and kept before."""
    first, later = [], []
    for _ in range(times + 1):
        with tempfile.TemporaryDirectory() as folder:
            for found in (first, later):
                done = subprocess.run([sys.executable, '-c', COMPILED], cwd=ROOT, check=True,
                                      env=ENVIRONMENT | {'DZ_ROS_CACHE': folder}, text=True,
                                      stdout=subprocess.PIPE)
                found.append(float(done.stdout))
    return [Row(what, statistics.median(found[1:]), target, 's',
                detail=f'median of {times}, {min(found[1:]):.2f} to {max(found[1:]):.2f} s')
            for what, found, target in (
                ("`dz.simulate('wang2004', compiled=True)`, nothing compiled before", first, 3.0),
                ('the same in the next process', later, None))]


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
    found = seconds(('-c', "import dz_ros as dz; dz.simulate('wang2004')"), times)
    rows.append(Row('a script: `import dz_ros`, 20 s simulated', statistics.median(found), 0.5,
                    's', detail=f'median of {times}, {min(found):.3f} to {max(found):.3f} s'))
    if find_spec('numba') is not None:
        rows += compiled_calls(3 if quick else 5)
    if find_spec('rclpy') is not None:
        rows += starts_of_loops(times)
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

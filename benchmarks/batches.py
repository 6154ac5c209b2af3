"""Thousands of parameter sets: time against number of runs and of cores, and the memory it takes.

    python benchmarks/batches.py [--quick]

Each run is the paper's example, 20 s at 200 Hz, metrics included, by `dz sweep` in processes of
its own. Compiling takes the same few seconds whatever the number of runs, so the rate is that
between two lengths of a sweep.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit.rows import Row, show  # noqa: E402
from dz_ros.studies.pool import cores  # noqa: E402


def sweep(count: int, jobs: int, folder: Path) -> tuple[float, int]:
    """Return seconds and the largest process [bytes] of a sweep."""
    words = ['-m', 'dz_ros', 'sweep', 'wang2004', '--over',
             f'controller.epsilon=0.01:0.1:{count}', '--jobs', str(jobs), '--out',
             str(folder / f'{count}-{jobs}.csv')]
    begin = time.perf_counter()
    running = subprocess.Popen([sys.executable, *words], cwd=ROOT, stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(running.pid, 0)
    if status:
        sys.exit(f'dz {" ".join(words[2:])} failed')
    return time.perf_counter() - begin, usage.ru_maxrss * 1024


def measure(quick: bool = False) -> list[Row]:
    """Return the lines of the table."""
    counts = (50, 250) if quick else (250, 1000, 4000)
    rows, rates = [], {}
    with tempfile.TemporaryDirectory() as folder:
        for jobs in sorted({1, cores()}):
            found = {count: sweep(count, jobs, Path(folder)) for count in counts}
            few, many = counts[0], counts[-1]
            rates[jobs] = (many - few) / (found[many][0] - found[few][0])
            rows.append(Row(f'batch on {jobs} core{"s" if jobs > 1 else ""}', rates[jobs],
                            unit='runs/s', least=True, detail='; '.join(
                                f'{count} runs {taken:.1f} s, {most / 1e6:.0f} MB'
                                for count, (taken, most) in found.items())))
            rows.append(Row(f'memory of {many} runs over that of {few}, {jobs} at a time',
                            found[many][1] / found[few][1]))
    if len(rates) > 1:
        rows.append(Row(f'{cores()} cores over one', rates[cores()] / rates[1], least=True))
    return rows


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--quick', action='store_true', help='fewer runs')
    arguments = parser.parse_args()
    print(describe('numba', 'numpy'))
    return show(measure(arguments.quick))


if __name__ == '__main__':
    sys.exit(main())

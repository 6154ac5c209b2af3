"""Thousands of parameter sets: time against number of runs and of cores, and the memory it takes.

    python benchmarks/batches.py [--quick]

Each run is the paper's example, 20 s at 200 Hz, metrics included, by `dz sweep` in processes of
its own. Compiling takes the same few seconds whatever the number of runs, so the rate is that
between two lengths of a sweep. Memory is that of the process that hands out runs and writes the
file, and of all processes of the sweep together, each at its own peak (what they share counts in
each).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
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

WATCH = 0.1
"""Between two looks at the memory [s]; the system keeps the peak of a process that lives."""


@dataclass(frozen=True)
class Sweep:
    """What a sweep took: seconds; peak memory of its first process and of all together [MB]."""

    taken: float
    parent: float
    together: float


def sweep(count: int, jobs: int, folder: Path) -> Sweep:
    """Return what a sweep took."""
    words = ['-m', 'dz_ros', 'sweep', 'wang2004', '--over',
             f'controller.epsilon=0.01:0.1:{count}', '--jobs', str(jobs), '--out',
             str(folder / f'{count}-{jobs}.csv')]
    begin = time.perf_counter()
    running = subprocess.Popen([sys.executable, *words], cwd=ROOT, stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL)
    peaks: dict[int, float] = {}
    while True:
        try:
            status = running.wait(WATCH)
            break
        except subprocess.TimeoutExpired:
            for process in family(running.pid):
                peaks[process] = max(peak(process), peaks.get(process, 0.0))
    taken = time.perf_counter() - begin
    if status:
        sys.exit(f'dz {" ".join(words[2:])} failed')
    return Sweep(taken, peaks.get(running.pid, 0.0), sum(peaks.values()))


def family(process: int) -> list[int]:
    """Return a process and all it has started, and what those have."""
    found = [process]
    for parent in found:
        for listed in Path(f'/proc/{parent}/task').glob('*/children'):
            try:
                found += [int(item) for item in listed.read_text().split()]
            except OSError:
                continue
    return found


def peak(process: int) -> float:
    """Return the most memory a process has held [MB]; 0 where it is gone."""
    try:
        lines = Path(f'/proc/{process}/status').read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) * 1024e-6 for line in lines if line.startswith('VmHWM')),
                0.0)


def measure(quick: bool = False) -> list[Row]:
    """Return the lines of the table."""
    counts = (50, 250) if quick else (250, 1000, 4000)
    rows, rates = [], {}
    with tempfile.TemporaryDirectory() as folder:
        for jobs in sorted({1, cores()}):
            found = {count: sweep(count, jobs, Path(folder)) for count in counts}
            few, many = counts[0], counts[-1]
            rates[jobs] = (many - few) / (found[many].taken - found[few].taken)
            rows.append(Row(f'batch on {jobs} core{"s" if jobs > 1 else ""}', rates[jobs],
                            unit='runs/s', least=True, detail='; '.join(
                                f'{count} runs {item.taken:.1f} s, {item.together:.0f} MB in all, '
                                f'{item.parent:.0f} MB the first process'
                                for count, item in found.items())))
            rows += [Row(f'memory of {many} runs over that of {few}, {jobs} at a time, {what}',
                         getattr(found[many], name) / getattr(found[few], name))
                     for name, what in (('together', 'all processes'),
                                        ('parent', 'the first process'))]
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

# SPDX-License-Identifier: Apache-2.0
"""Thousands of parameter sets: a row beside its bare loop, time, memory, and how a batch starts.

    python benchmarks/batches.py [--quick] [--laws NAME …] [--whole] [--inside NAME …]

a row        CPU time of a row of `dz sweep` (configuration, run, metrics, margin) beside that
             of the compiled loop alone, called on arrays that are there; for every law, while
             one of its gains or b is swept; in turns, so that both meet the same machine
a batch      the paper's example, 20 s at 200 Hz, by `dz sweep` in processes of its own.
             Starting takes the same whatever the number of runs, so the rate is that between
             two lengths. Memory is that of the process that hands out runs and writes the
             file, and of all processes together, each at its own peak (what they share counts
             in each)
starting     `dz sweep` and `dz arena` of one run, code compiled before, from start to end
--whole      100 000 runs from the first to the last
--inside     what each part of a row takes, for these laws
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
import statistics
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit.rows import in_turns, Row, show  # noqa: E402
from benchmarks.starting import DZ, seconds  # noqa: E402
from dz_ros.core.configuration import Configuration  # noqa: E402
from dz_ros.core.design.stability import run_is_lost  # noqa: E402
from dz_ros.core.loop.compiled import available, compiled_loop, simulate_fast  # noqa: E402
from dz_ros.core.loop.offline import simulate  # noqa: E402
from dz_ros.studies.code_folder import keep_compiled  # noqa: E402
from dz_ros.studies.entrants import entrants  # noqa: E402
from dz_ros.studies.outcome import chatter_share, measured, rows_of  # noqa: E402
from dz_ros.studies.pool import cores  # noqa: E402
from dz_ros.studies.scenarios import base_configuration  # noqa: E402
from dz_ros.studies.sweep import CHUNK  # noqa: E402

TURNS, RUNS, LOOPS = 11, CHUNK, 10
"""Turns; in each rows as one task of a large sweep, and loops alone."""
WHOLE, WHOLE_LIMIT = 100_000, 180.0
"""Runs of a large sweep, and how long they may take [s]."""
STARTED = 3.0
"""A batch of one run is done after this [s]."""
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


def swept(known: Configuration, count: int) -> list[dict[str, Any]]:
    """Return the changes of a sweep: of K where the law has one, else of b."""
    gains = known.law.gains
    key = next((key for key in ('k_d', 'k') if hasattr(gains, key)), None)
    if key is None:
        return [{'plant.b': b} for b in np.linspace(0.8, 1.2, count).tolist()]
    gain = float(getattr(gains, key))
    return [{f'controller.{key}': item}
            for item in np.linspace(gain, 1.1 * gain + 0.1, count).tolist()]


def bare_seconds(configuration: Configuration, count: int) -> list[float]:
    """Return the CPU time of the compiled loop alone, called on arrays that are there [s]."""
    loop, calls = compiled_loop(configuration), []
    simulate(configuration, lambda *arguments: calls.append(arguments))
    found = []
    for _ in range(count):
        arguments = [item.copy() if isinstance(item, np.ndarray) else item for item in calls[0]]
        begin = time.process_time()
        loop(*arguments)
        found.append(time.process_time() - begin)
    return found


def beside_bare(laws: Sequence[str], turns: int = TURNS) -> list[Row]:
    """Return how quick rows are beside their loops, for each law."""
    keep_compiled()
    rows = []
    for name in laws:
        known = Configuration.from_changed(base_configuration(20.0),
                                           dict(entrants()[name].changes))
        base, changes = known.to_flat(), swept(known, RUNS * (turns + 1))
        bare_seconds(known, 1)
        rows_of(base, changes[:RUNS])           # compiles, imports, warms up
        shares, bare, row = [], [], []
        for turn in range(1, turns + 1):
            bare.append(statistics.fmean(bare_seconds(known, LOOPS)))
            begin = time.process_time()
            rows_of(base, changes[turn * RUNS:(turn + 1) * RUNS])
            row.append((time.process_time() - begin) / RUNS)
            shares.append(bare[-1] / row[-1])
        own, alone = statistics.median(row), statistics.median(bare)
        rows.append(in_turns(
            f'row of a sweep of `{name}`, speed over its bare compiled loop', shares, 0.8,
            least=True, detail=f'{1e3 * own:.2f} ms beside {1e3 * alone:.2f} ms'))
    return rows


def inside(names: Sequence[str]) -> list[str]:
    """Return the CPU time of each part of a row, medians, as lines of a table."""
    keep_compiled()
    lines = ['| law | configuration | margin | arrays and loop | metrics | lost or not '
             '| loop alone |', f'|{"---|" * 7}']
    for name in names:
        known = Configuration.from_changed(base_configuration(20.0),
                                           dict(entrants()[name].changes))
        bare_seconds(known, 1)
        taken: list[list[float]] = []
        for change in swept(known, 4 * CHUNK):
            times = [time.process_time()]
            c = known.replace(**change)
            times.append(time.process_time())
            chatter_share(c)
            times.append(time.process_time())
            run = simulate_fast(c)
            times.append(time.process_time())
            measured(run)
            times.append(time.process_time())
            run_is_lost(run)
            times.append(time.process_time())
            taken.append([after - before for before, after in pairwise(times)])
        parts = [statistics.median(column) for column in zip(*taken, strict=True)]
        alone = statistics.median(bare_seconds(known, 4 * CHUNK))
        lines.append(f'| `{name}` | ' + ' | '.join(f'{1e6 * item:.0f} µs'
                                                   for item in (*parts, alone)) + ' |')
    return lines


def starts(quick: bool) -> list[Row]:
    """Return how long batches of one run take, code compiled before."""
    times, rows = 3 if quick else 5, []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'one.csv'
        for what, words in (
                ('dz sweep', ('sweep', 'wang2004', '--over', 'plant.b=1:1:1', '--quiet',
                              '--out', str(file))),
                ('dz arena', ('arena', '--laws', 'wang2004', '--scenarios', 'nominal',
                              '--duration', '20', '--quiet'))):
            found = []
            for _ in range(times + 1):
                file.unlink(missing_ok=True)
                found += seconds((*DZ, *words), 0, cold=True)
            rows.append(Row(f'`{what}` of one run, start to end',
                        statistics.median(found[1:]), STARTED, 's',
                        detail=f'median of {times}, {min(found[1:]):.2f} to '
                               f'{max(found[1:]):.2f} s; the first {found[0]:.2f} s'))
    return rows


def batches(quick: bool) -> list[Row]:
    """Return rates and memory of sweeps in processes of their own."""
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


def whole() -> list[Row]:
    """Return how long 100 000 runs take, really run."""
    with tempfile.TemporaryDirectory() as folder:
        found = sweep(WHOLE, cores(), Path(folder))
        with (Path(folder) / f'{WHOLE}-{cores()}.csv').open() as file:
            kept = sum(1 for _ in file) - 2
    if kept != WHOLE:
        sys.exit(f'{kept} of {WHOLE} runs were kept')
    return [Row(f'{WHOLE} runs on {cores()} cores', found.taken, WHOLE_LIMIT, 's',
                detail=f'{WHOLE / found.taken:.0f} runs/s, {found.together:.0f} MB in all')]


def measure(quick: bool = False) -> list[Row]:
    """Return the lines of the table."""
    laws = ('wang2004', 'robust_eso') if quick else tuple(entrants())
    rows = beside_bare(laws, 5 if quick else TURNS) if available() else []
    return rows + starts(quick) + batches(quick)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--quick', action='store_true', help='fewer runs')
    parser.add_argument('--laws', nargs='+', choices=tuple(entrants()), metavar='NAME',
                        help='rows beside loops of these alone')
    parser.add_argument('--whole', action='store_true', help='100 000 runs alone')
    parser.add_argument('--inside', nargs='+', choices=tuple(entrants()), metavar='NAME',
                        help='what each part of a row takes')
    arguments = parser.parse_args()
    print(describe('numba', 'numpy'))
    if arguments.inside:
        print(*inside(arguments.inside), sep='\n')
        return 0
    if arguments.whole:
        return show(whole())
    return show(beside_bare(arguments.laws) if arguments.laws else measure(arguments.quick))


if __name__ == '__main__':
    sys.exit(main())

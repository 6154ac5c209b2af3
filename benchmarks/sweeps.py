# SPDX-License-Identifier: Apache-2.0
"""Sweeps for the documents: the study of ε, the boundary of chatter, and how fast sweeps are.

    python benchmarks/sweeps.py            print
    python benchmarks/sweeps.py --write    write docs/sweeps.md and its pictures
    python benchmarks/sweeps.py --whole    run 100 000 loops as well: some ten minutes

The pictures do not hang on the machine, the speed does, and on what else it is doing.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager, ExitStack
from importlib.util import find_spec
import os
from pathlib import Path
import subprocess
import sys
import tempfile
from threading import Thread
import time

from machine import describe

from dz_ros.core.loop.compiled import available
from dz_ros.report.style import Picture
from dz_ros.studies.pool import cores
from dz_ros.studies.scenarios import base_configuration
from dz_ros.studies.sweep import read_sweep, run_sweep
from dz_ros.studies.sweep_pictures import pictures
from dz_ros.studies.sweep_plan import parse_axes, SweepPlan

ROOT = Path(__file__).resolve().parent.parent
STUDIES = {
    'epsilon': ('controller.epsilon=0.005:0.5:60:log',),
    'chatter': ('controller.epsilon=0.005:0.05:40:log', 'plant.b=0.5:2:31'),
}
WHOLE = 100_000
KEPT_CODE = """## What is kept

`dz sweep`, `dz arena`, `dz tune` and `dz.simulate(compiled=True)` keep compiled code in
`$DZ_ROS_CACHE`, else in `dz_ros` in `$XDG_CACHE_HOME` or `~/.cache`, for every combination of law,
plant, trajectory and observer; later processes load it. It is found by a hash of the byte code of
all its functions, of every constant they read, of the processor and of the versions of Python and
numba, so that an edited law is compiled again. At most 300 files are kept, a fifth of a megabyte
each. A folder that another user owns or may write to is not used. `DZ_ROS_CACHE=off` keeps
nothing.
"""


def main() -> int:
    """Run the studies."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--write', action='store_true', help='write documents and pictures')
    parser.add_argument('--runs', type=int, default=2000, help='runs to measure the speed with')
    parser.add_argument('--whole', action='store_true', help='also run 100 000 loops')
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        drawn = {name: study(name, Path(folder)) for name in STUDIES}
        lines = speeds(arguments.runs, Path(folder))
        if arguments.whole:
            lines.append(whole(Path(folder)))
    machine = describe('numba', 'numpy')
    print(machine, f'numba used: {available()}', *lines,
          *(picture.caption for picture in drawn.values()), sep='\n')
    if arguments.write:
        write(machine, lines, drawn)
    return 0


def study(name: str, folder: Path) -> Picture:
    """Return the picture of a study; chatter is looked at with a sample of delay."""
    base = {**base_configuration(20.0), 'loop.delay': int(name == 'chatter')}
    file = folder / f'{name}.csv'
    run_sweep(SweepPlan(base, parse_axes(STUDIES[name])), file)
    return pictures(read_sweep(file))[0]


def throughput(jobs: int, runs: int, folder: Path, cluster: str | None = None) -> float:
    """Return runs per second, compilation left out.

    Several processes are new in each sweep, so it is the time between two lengths of one. A single
    process is this one and the workers of a cluster stay, so the first sweep compiles and the
    second is timed.
    """
    stay = jobs == 1 or cluster is not None
    times = []
    for count in (runs // 10, runs):
        plan = SweepPlan(base_configuration(20.0),
                         parse_axes([f'controller.epsilon=0.01:0.1:{count}']))
        begin = time.perf_counter()
        run_sweep(plan, folder / f'speed-{jobs}-{count}-{bool(cluster)}.csv', jobs, cluster)
        times.append(time.perf_counter() - begin)
    return runs / times[1] if stay else (runs - runs // 10) / (times[1] - times[0])


@contextmanager
def cluster(workers: int) -> Iterator[str]:
    """Start a scheduler and workers as processes; yield the scheduler's address."""
    dask = [sys.executable, '-m', 'distributed.cli.dask_']
    with ExitStack() as stack:

        def start(kind: str, *words: str) -> str:
            process = subprocess.Popen([*dask[:-1], dask[-1] + kind, *words], text=True,
                                       stderr=subprocess.PIPE, cwd=ROOT,
                                       env={**os.environ, 'PYTHONPATH': str(ROOT)})
            stack.callback(process.wait)
            stack.callback(process.terminate)
            assert process.stderr is not None
            for line in process.stderr:
                if 'Scheduler at:' in line or 'Registered to' in line:
                    Thread(target=process.stderr.read, daemon=True).start()
                    return line.rpartition(' ')[2].strip()
            raise SystemExit(f'dask {kind} did not start')

        address = start('scheduler', '--host', '127.0.0.1', '--port', '0', '--no-dashboard')
        for _ in range(workers):
            start('worker', address, '--nthreads', '1', '--no-nanny', '--no-dashboard')
        yield address


def speeds(runs: int, folder: Path) -> list[str]:
    """Return the rows of the table of speeds: processes here, workers of a cluster."""
    found = {}
    for count in sorted({1, cores()}):
        found[f'{count} process{"es" * (count > 1)}'] = throughput(count, runs, folder)
    if find_spec('distributed') is not None:
        for count in sorted({1, cores()}):
            with cluster(count) as address:
                found[f'cluster, {count} worker{"s" * (count > 1)}'] = throughput(
                    count, runs, folder, address)
    return ['| on | runs of 20 s | runs per s | 100 000 runs at this rate |', '|---|---|---|---|',
            *(f'| {name} | {runs} | {rate:.0f} | {WHOLE / rate / 60:.0f} min |'
              for name, rate in found.items())]


def whole(folder: Path) -> str:
    """Return the row of 100 000 runs that have really been run, from the first to the last."""
    plan = SweepPlan(base_configuration(20.0),
                     parse_axes([f'controller.epsilon=0.01:0.1:{WHOLE}']))
    begin = time.perf_counter()
    run_sweep(plan, folder / 'whole.csv', cores())
    passed = time.perf_counter() - begin
    done = len(read_sweep(folder / 'whole.csv'))
    if done != WHOLE:
        raise SystemExit(f'{done} of {WHOLE} runs were kept')
    return f'| {cores()} processes | {WHOLE} | {WHOLE / passed:.0f} | {passed / 60:.1f} min, run |'


def write(machine: str, lines: list[str], drawn: dict[str, Picture]) -> None:
    """Write docs/sweeps.md and its pictures."""
    for name, picture in drawn.items():
        (ROOT / 'docs' / 'images' / f'sweep_{name}.png').write_bytes(picture.png())
    text = ['# Sweeps', '', 'Written by `python benchmarks/sweeps.py --write`.', '',
            '## The width of the boundary layer', '',
            '`dz sweep wang2004 --over controller.epsilon=0.005:0.5:60:log --out epsilon.csv` and '
            '`dz sweep plot epsilon.csv`: the example of the paper, λ = 1, no delay, 20 s.', '',
            f'![{drawn["epsilon"].alt}](images/sweep_epsilon.png)', '',
            drawn['epsilon'].caption, '', '## Where chatter begins', '',
            '`dz sweep wang2004 --set loop.delay=1 --over controller.epsilon=0.005:0.05:40:log '
            '--over plant.b=0.5:2:31 --out chatter.csv`.', '',
            f'![{drawn["chatter"].alt}](images/sweep_chatter.png)', '',
            drawn['chatter'].caption, '', '## How fast', '', *lines, '',
            'Compiled by numba, four RK4 steps a sample, metrics included; compiling, which the '
            f'first sweep of a law does, left out. Measured on {machine}; load average '
            f'{os.getloadavg()[0]:.1f} on {cores()} cores at the end. Scheduler and client of a '
            'cluster take their share of the same cores as its workers. The runs are those of the '
            'batches in [Performance](performance.md), measured at another time: rates differ by '
            'what else the machine was doing.', '', KEPT_CODE]
    (ROOT / 'docs' / 'sweeps.md').write_text('\n'.join(text), encoding='utf-8')


if __name__ == '__main__':
    sys.exit(main())

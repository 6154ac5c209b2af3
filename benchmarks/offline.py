# SPDX-License-Identifier: Apache-2.0
"""The compiled loop beside plain Python, hand-written C, scipy and python-control, with errors.

    python benchmarks/offline.py [--quick]

All compute the paper's example, 20 s at 200 Hz. The error is the largest |x - x_exact| over all
samples, x_exact from test/data/wang2004_lambda1_exact.csv (the plant integrated to 12 digits).
They take turns; a time is the best of its turns.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
import sys
import tempfile
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit import peers  # noqa: E402
from benchmarks.speed_kit.rows import Row, say, show  # noqa: E402
from dz_ros.core.configuration import Configuration  # noqa: E402
from dz_ros.core.loop.compiled import available, simulate_fast  # noqa: E402
from dz_ros.core.loop.offline import simulate  # noqa: E402

REFERENCE = ROOT / 'test' / 'data' / 'wang2004_lambda1_exact.csv'
TARGETS = {'plain Python': 25.0, 'C -O2': 0.8, 'solve_ivp, sample by sample': 100.0,
           'python-control': 100.0}
"""Peer → how many times its speed the compiled loop is to have."""


def best(run: Callable[[], Any], seconds: float, least: int) -> float:
    """Return the shortest of several times [s]."""
    times: list[float] = []
    while len(times) < least or sum(times) < seconds:
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return min(times)


def measure(quick: bool = False) -> list[Row]:
    """Return the table."""
    c = Configuration.from_flat({'loop.duration': 20.0, 'controller.lambda': 1.0})
    example = peers.Example(c)
    exact = np.loadtxt(REFERENCE, delimiter=',', skiprows=2, usecols=(2, 3))
    with tempfile.TemporaryDirectory() as folder:
        runs: dict[str, Callable[[], NDArray[np.float64]]] = {
            'compiled': lambda: simulate_fast(c).x,
            'plain Python': lambda: simulate(c).x}
        try:
            runs['C -O2'] = peers.c_loop(example, Path(folder))
        except FileNotFoundError as error:
            say(f'{error}: no comparison with C')
        runs['solve_ivp, sample by sample'] = lambda: peers.by_solve_ivp(example)
        runs['python-control'] = lambda: peers.by_control(example)
        runs['solve_ivp, law in continuous time'] = lambda: peers.continuous(example)
        states, times = {}, dict.fromkeys(runs, np.inf)
        for name, run in list(runs.items()):
            try:
                states[name] = run()        # compiles, imports, warms up
            except ModuleNotFoundError as error:
                say(f'{error}: no comparison with {name}')
                del runs[name], times[name]
        for _ in range(2 if quick else 5):
            for name, run in runs.items():
                slow = name not in ('compiled', 'C -O2', 'plain Python')
                times[name] = min(times[name], best(run, 0.0 if slow else 0.3, 1))
    errors = {name: float(np.abs(x - exact).max()) for name, x in states.items()}
    if available() and not np.array_equal(states['compiled'], states['plain Python']):
        sys.exit('the compiled loop does not give the bits of the plain one')
    own = times['compiled']
    label = 'compiled loop' if available() else 'plain loop (numba is not installed)'
    return [Row(f'{label}, speed over {name}', times[name] / own, TARGETS.get(name), least=True,
                detail=f'{own * 1e3:.2f} ms (error {errors["compiled"]:.1e}) beside '
                       f'{times[name] * 1e3:.4g} ms (error {errors[name]:.1e})')
            for name in runs if name != 'compiled']


def main() -> int:
    """Print the table; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--quick', action='store_true', help='fewer turns')
    arguments = parser.parse_args()
    print(describe('numba', 'numpy', 'scipy', 'control'))
    return show(measure(arguments.quick))


if __name__ == '__main__':
    sys.exit(main())

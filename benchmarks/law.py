# SPDX-License-Identifier: Apache-2.0
"""What one step of a law costs in Python, records and all terms included.

    python benchmarks/law.py [--quick]

Y(x) is computed outside. The scalar core is `Law.kernel`, which writes v, the next memory and all
terms into buffers; `Law.step` makes records of them.
"""

from __future__ import annotations

import argparse
import gc
from pathlib import Path
import sys
import time

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit.rows import Row, show, spread  # noqa: E402
from dz_ros.core.laws import LAWS  # noqa: E402
from dz_ros.core.laws.base import Law  # noqa: E402
from dz_ros.core.records import Reference, State  # noqa: E402
from dz_ros.core.signals import STATUS  # noqa: E402
from dz_ros.errors import ConfigurationError  # noqa: E402

JUDGED = ('wang2004', 'robust')
TARGET_US = 10.0
ORDERS, REGRESSORS = tuple(range(1, 7)), (1, 2, 5, 10, 20)


def cost(law: Law, steps: int, core: bool = False) -> dict[str, float]:
    """Return the spread of the times of one step [µs], of the scalar core alone or of it all."""
    generator = np.random.default_rng(1)
    x = generator.standard_normal((64, law.order)).tolist()
    x_d = generator.standard_normal((64, law.order + 1)).tolist()
    regressors = generator.standard_normal((64, law.regressor_count)).tolist()
    memory = law.initial_memory()
    constants, times = law.constants, []
    new_memory, buffer = [0.0] * len(memory), [0.0] * (STATUS + 1 + len(law.signal_names))
    clock = time.perf_counter_ns
    gc.disable()
    for k in range(steps):
        at = k % 64
        state = State(k, k * law.period, tuple(x[at]))
        reference = Reference(k, state.stamp, tuple(x_d[at]))
        y = regressors[at]
        if core:
            begin = clock()
            law.kernel(constants, memory, reference.x_d, state.x, y, law.period, new_memory,
                       buffer)
        else:
            begin = clock()
            law.step(memory, reference, state, y, law.period)
        times.append(clock() - begin)
    gc.enable()
    return spread(times[steps // 10:], 1e-3)


def every_law(steps: int) -> dict[str, dict[str, float]]:
    """Return the cost of each law for n = 2, r = 2 [µs]."""
    found = {}
    for name in LAWS.builtin:
        try:
            found[name] = cost(LAWS.load(name)(None, 2, 2), steps)
        except ConfigurationError:
            continue
    return found


def grid(name: str, steps: int) -> list[str]:
    """Return the table of p50 against n and r as lines of Markdown."""
    law = LAWS.load(name)
    lines = [f'| n of `{name}` | ' + ' | '.join(f'r = {r}' for r in REGRESSORS) + ' |',
             '|---' * (len(REGRESSORS) + 1) + '|']
    for n in ORDERS:
        costs = (cost(law(None, n, r), steps) for r in REGRESSORS)
        lines.append(f'| {n} | ' + ' | '.join(f'{item["p50"]:.1f} ({item["p99"]:.1f})'
                                              for item in costs) + ' |')
    return lines


def grids(quick: bool = False) -> list[str]:
    """Return the tables of the laws that are judged."""
    lines: list[str] = []
    for name in JUDGED:
        lines += ['', f'`Law.step` of `{name}`, p50 (p99) [µs]:', '',
                  *grid(name, 2_000 if quick else 20_000)]
    return lines[1:]


def measure(quick: bool = False) -> list[Row]:
    """Return the lines of the table."""
    found = every_law(5_000 if quick else 50_000)
    rows = []
    for name in JUDGED:
        core = cost(LAWS.load(name)(None, 2, 2), 5_000 if quick else 50_000, core=True)
        rows += [Row(f'scalar core of `{name}`, n = 2, r = 2, all terms, p99', core['p99'],
                     TARGET_US, 'µs', detail=f'p50 {core["p50"]:.1f} µs'),
                 Row(f'the same with records (`Law.step` of `{name}`), p99', found[name]['p99'],
                     unit='µs', detail=f'p50 {found[name]["p50"]:.1f} µs')]
    slowest = max(found, key=lambda name: found[name]['p99'])
    return [*rows, Row(f'step of the slowest law (`{slowest}`), p99', found[slowest]['p99'],
                       unit='µs', detail=f'p50 {found[slowest]["p50"]:.1f} µs')]


def main() -> int:
    """Print the tables; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--quick', action='store_true', help='fewer steps')
    arguments = parser.parse_args()
    print(describe())
    code = show(measure(arguments.quick))
    print('', *grids(arguments.quick), sep='\n')
    return code


if __name__ == '__main__':
    sys.exit(main())

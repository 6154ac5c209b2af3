# SPDX-License-Identifier: Apache-2.0
"""Whether the bounds that `dz driver identify` gives hold, and how wide they are.

    python benchmarks/identify.py                 100 seeded devices of each kind
    python benchmarks/identify.py --devices 20    fewer
    python benchmarks/identify.py --repeats 8     shorter experiments

What is drawn, and what "covered" and "drift" mean: benchmarks/seeded_devices.py.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial
import sys

from machine import describe
import numpy as np
from seeded_devices import Device, identified, KINDS

from dz_ros.errors import DzRosError
from dz_ros.identification.estimation.least_squares import ZONE


def attempt(kind: str, repeats: int, seed: int) -> Device | str:
    """Return a device that was identified, or why it was not."""
    try:
        return identified(kind, seed, repeats)
    except DzRosError as error:
        return f'seed {seed}: {error}'


def main() -> int:
    """Identify all devices of each kind; print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--devices', type=int, default=100)
    parser.add_argument('--repeats', type=int, default=16)
    parser.add_argument('-j', '--jobs', type=int, default=None, help='processes')
    arguments = parser.parse_args()
    print(describe('numpy', 'scipy'), flush=True)
    print(f'\n| device | number | all four covered | {" | ".join(ZONE)} | width/drift: median '
          '| largest | beyond 3 | s of loop time |')
    print('|---|---|---|' + '---|' * (len(ZONE) + 4), flush=True)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for kind in KINDS:
            found = list(pool.map(partial(attempt, kind, arguments.repeats),
                                  range(arguments.devices)))
            print(line(kind, [item for item in found if isinstance(item, Device)], len(found)),
                  flush=True)
            for item in found:
                if isinstance(item, str):
                    print(f'  {item}', file=sys.stderr)
                elif not item.covered.all():
                    print(f'  seed {item.seed}: bounds {item.bounds.tolist()}, '
                          f'truth {item.truth.tolist()}', file=sys.stderr)
    return 0


def line(kind: str, done: list[Device], total: int) -> str:
    """Return the row of a kind; a device that was not identified covers nothing."""
    covered = np.array([item.covered for item in done])
    cells = [kind, str(total), str(int(covered.all(axis=1).sum()))]
    cells += [str(int(column.sum())) for column in covered.T]
    drift = np.array([item.drift for item in done])
    width = np.array([item.width for item in done])
    if drift.any():
        ratio = width / drift
        cells += [f'{np.median(ratio):.2f}', f'{ratio.max():.2f}',
                  f'{int((ratio > 3.0).sum())} of {ratio.size}']
    else:
        cells += ['-', '-', '-']
    cells.append(f'{np.median([item.duration for item in done]):.0f}')
    return f'| {" | ".join(cells)} |'


if __name__ == '__main__':
    sys.exit(main())

"""Robustness in one number: random plants and dead-zones inside the stated bounds.

    python benchmarks/robustness.py                10 000 plants for each law, 20 s each
    python benchmarks/robustness.py --plants 500   fewer
    python benchmarks/robustness.py --write        write docs/robustness.md and the worst cases

Drawn, uniformly and from a fixed seed: b_r, b_l, m within the bounds (A4) of the example,
a_i within [0.5, 1.25], b within [0.5, 2] (ours: the paper states bounds of the dead-zone only;
these are as wide as the projection box of 1/(b m), a_i/(b m) allows). The bounds stated to the
controller are those drawn from; neither law computes with b_bounds, so this changes no number. A
plant counts where every state of x̃ stays within Ω_ε of the paper's law in every sample of the last
10 s: |x̃| <= 0.02 and |x̃'| <= 0.04. The worst case of each law, by max|x̃|, is a configuration.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
import time
from typing import Any

from machine import describe
import numpy as np

from dz_ros.core.compiled import available
from dz_ros.core.configuration import Configuration
from dz_ros.files import write_parameters
from dz_ros.studies.outcome import Row, rows_of
from dz_ros.studies.pool import cores, execute
from dz_ros.studies.scenarios import base_configuration, yardstick

ROOT = Path(__file__).resolve().parent.parent
LAWS = ('wang2004', 'robust')
RANGES = {'plant.dead_zone.b_r': (0.1, 0.6), 'plant.dead_zone.b_l': (-0.7, -0.1),
          'm': (0.85, 1.25), 'plant.a1': (0.5, 1.25), 'plant.a2': (0.5, 1.25),
          'plant.a3': (0.5, 1.25), 'plant.b': (0.5, 2.0)}
STATED = {'controller.b_bounds': list(RANGES['plant.b']),
          'controller.m_bounds': list(RANGES['m']),
          'controller.b_r_bounds': list(RANGES['plant.dead_zone.b_r']),
          'controller.b_l_bounds': list(RANGES['plant.dead_zone.b_l'])}
"""What the controller is told of the plants."""
SEED = 2004
SUBSTEPS = 1
"""One RK4 step of 5 ms: max|x̃| within 1e-9 of that with four, at a quarter of the time."""
CHUNK = 100


def draw(count: int) -> list[dict[str, Any]]:
    """Return what changes in each plant."""
    low, high = np.array(list(RANGES.values())).T
    numbers = np.random.default_rng(SEED).uniform(low, high, (count, len(RANGES)))
    plants = [dict(zip(RANGES, (float(item) for item in row), strict=True)) for row in numbers]
    for plant in plants:
        plant['plant.dead_zone.m_r'] = plant['plant.dead_zone.m_l'] = plant.pop('m')
    return plants


def main() -> int:
    """Run all plants under each law."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--plants', type=int, default=10_000)
    parser.add_argument('--duration', type=float, default=20.0, help='of each run [s]')
    parser.add_argument('--write', action='store_true', help='write documents and worst cases')
    parser.add_argument('-j', '--jobs', type=int, default=0, help='processes')
    arguments = parser.parse_args()
    plants = draw(arguments.plants)
    lines = ['| law | plants | within Ω_ε | x̃ alone within it | max x̃, median | 99 % | worst | '
             'lost | runs per s |', f'|{"---|" * 9}']
    print(describe('numba', 'numpy'), f'numba used: {available()}', *lines, sep='\n', flush=True)
    for law in LAWS:
        begin = time.perf_counter()
        rows = run(law, plants, arguments.duration, arguments.jobs)
        rate = len(rows) / (time.perf_counter() - begin)
        lines.append(table_line(law, rows, rate))
        print(lines[-1], flush=True)
        worst = max(range(len(rows)), key=lambda place: error(rows[place]))
        if arguments.write:
            save(law, plants[worst])
    if arguments.write:
        write(lines, arguments)
    return 0


def base_of(law: str, duration: float) -> dict[str, Any]:
    """Return the configuration that the plants change."""
    return {**base_configuration(duration), **STATED, 'controller.law': law,
            'plant.substeps': SUBSTEPS}


def run(law: str, plants: list[dict[str, Any]], duration: float, jobs: int) -> list[Row]:
    """Return the row of each plant under a law."""
    base = base_of(law, duration)
    chunks = [plants[i:i + CHUNK] for i in range(0, len(plants), CHUNK)]
    tasks = [(rows_of, (base, chunk, yardstick())) for chunk in chunks]
    found: dict[int, list[Row]] = {}
    for place, rows in execute(tasks, jobs):
        found[place] = rows
        if len(found) % 20 == 0:
            print(f'{law}: {CHUNK * len(found)} of {len(plants)}', file=sys.stderr, flush=True)
    return [row for place in range(len(chunks)) for row in found[place]]


def error(row: Row) -> float:
    """Return max|x̃|; infinite where the run was lost."""
    return float('inf') if row['lost'] or row['error_max'] is None else float(row['error_max'])


def table_line(law: str, rows: list[Row], rate: float) -> str:
    """Return the table's line of a law."""
    errors = np.array([error(row) for row in rows])
    lost = np.isinf(errors)
    within = float(np.mean([item['omega'] == 1.0 for item in rows] & ~lost))
    alone = float(np.mean(errors <= yardstick()[0]))
    most = np.quantile(errors, 0.99, method='higher')       # errors of lost runs are infinite
    return (f'| `{law}` | {len(rows)} | {100 * within:.2f} % | {100 * alone:.2f} % | '
            f'{np.median(errors):.3g} | {most:.3g} | {errors.max():.3g} | '
            f'{np.count_nonzero(lost)} | {rate:.0f} |')


def save(law: str, plant: dict[str, Any]) -> None:
    """Write a law's worst case as a configuration."""
    path = ROOT / 'benchmarks' / 'worst' / f'{law}.yaml'
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    write_parameters(Configuration.from_flat(
        {**base_of(law, 20.0), **plant}), path)


def write(lines: list[str], arguments: argparse.Namespace) -> None:
    """Write docs/robustness.md."""
    ranges = ', '.join(f'{key.rpartition(".")[2]} in [{low:g}, {high:g}]'
                       for key, (low, high) in RANGES.items())
    bounds, gains = yardstick(), Configuration.from_flat(base_of('robust', 20.0)).law.gains
    largest, jobs = RANGES['plant.b'][1] * RANGES['m'][1], arguments.jobs or cores()
    text = ['# Robustness in one number', '',
            'Written by `python benchmarks/robustness.py --write`: the share of '
            f'{arguments.plants} random plants and dead-zones for which every state stays '
            f"within Ω_ε of the paper's law, |x̃| ≤ {bounds[0]:g} and |x̃'| ≤ {bounds[1]:g}, in "
            f'every sample of the last 10 s of {arguments.duration:g} s; Ω_ε is the same for both '
            'laws. Beside it the share for which x̃ alone does. Drawn uniformly, seed '
            f'{SEED}: {ranges}. One RK4 step a sample. The bounds of the dead-zone are the '
            "paper's, those of the plant ours.", '',
            'The controllers are told the bounds that are drawn from. Neither law computes with '
            'those of b: gains are the shipped ones, also `beta` of `robust`, b_max m_max, which '
            f'is that for b = 1, {gains.beta:g}, where these plants have up to {largest:g}. There '
            'is no delay; with it such a plant may chatter, as `dz check` says of the worst '
            'cases.',
            '', *lines, '', f'Measured on {describe("numba", "numpy")}, '
            f'{jobs} process{"es" * (jobs > 1)}. The rates hang on what else the machine was '
            'doing, the shares do not.', '',
            'The worst plant of each law, to be run by anyone: `dz simulate '
            'benchmarks/worst/wang2004.yaml`, `dz simulate benchmarks/worst/robust.yaml`.', '']
    (ROOT / 'docs' / 'robustness.md').write_text('\n'.join(text), encoding='utf-8')


if __name__ == '__main__':
    sys.exit(main())

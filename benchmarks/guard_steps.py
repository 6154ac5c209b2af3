# SPDX-License-Identifier: Apache-2.0
"""Which loops of `robust_eso` have their gain lowered by the guard on noise alone.

    python benchmarks/guard_steps.py                 10 000 plants a delay (half an hour)
    python benchmarks/guard_steps.py --plants 500    fewer
    python benchmarks/guard_steps.py --write         write the table into docs/robustness.md

The plants and the noise are those of `robustness.py`. A plant counts where its loop inside the
layer is calm with its own b m. It is put by ε over σ_s of that loop, as `dz check` has it at the
bounds of b m. Its guard has stepped where κ_f fell; in the first second the start adds to the
noise, so what fell later is counted by itself.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
import math
import sys

from machine import describe
from robustness import base_of, CONDITIONS, draw, EVERYWHERE, GUARD, NOISE, PAGE

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.guard_noise import LEAST_IN_LOOP
from dz_ros.core.design.linear_loop import noise_of_surface
from dz_ros.core.loop.compiled import simulate_fast

EDGES = (0.0, 1.0, 1.5, 2.0, 2.5, 3.0, math.inf)
"""Limits of the rows, of ε over σ_s."""
DURATION = 20.0
DELAYS = (0, 1, 2)
BEGIN = 1.0
"""Until then the start adds to the noise [s]."""


def judge(flat: dict[str, object]) -> tuple[float, bool, bool] | None:
    """Return ε over σ_s of a plant's loop, whether its guard stepped, and stepped after `BEGIN`.

    None where the loop is not calm.
    """
    c = Configuration.from_flat(flat)
    design, model = c.law.design, c.law.layer_model()
    assert design is not None
    assert model is not None
    sigma = noise_of_surface(model, design.lambda_, c.loop.period, c.plant.b * c.dead_zone.m_r,
                             c.loop.delay, c.noise)
    if sigma == math.inf:
        return None
    run = simulate_fast(c)
    kappa = run.column('kappa_f')
    later = kappa[run.t >= BEGIN]
    return design.epsilon / sigma, bool(kappa.min() < 1.0), bool(later.min() < later[0])


def main() -> int:
    """Simulate; print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--plants', type=int, default=10_000)
    parser.add_argument('--write', action='store_true', help=f'write into {PAGE.name}')
    arguments = parser.parse_args()
    plants = draw(arguments.plants)
    found = {}
    for delay in DELAYS:
        base = {**base_of(EVERYWHERE, DURATION), **CONDITIONS[delay, True]}
        judged = [judge({**base, **plant, 'loop.seed': seed}) for seed, plant in enumerate(plants)]
        found[delay] = [item for item in judged if item is not None]
    lines = ['| ε over σ_s of the loop | ' + ' | '.join(
        f'delay {delay}: loops | guard stepped (later)' for delay in DELAYS) + ' |',
        f'|{"---|" * (1 + 2 * len(DELAYS))}']
    for low, high in pairwise(EDGES):
        cells = []
        for delay in DELAYS:
            rows = [row[1:] for row in found[delay] if low <= row[0] < high]
            shares = [f'{100.0 * sum(steps) / len(rows):.3g} %'
                      for steps in zip(*rows, strict=True)]
            cells += [str(len(rows)), f'{shares[0]} ({shares[1]})' if rows else '']
        name = f'{low:g} and more' if high == math.inf else f'{low:g} to {high:g}'
        lines.append(f'| {name} | {" | ".join(cells)} |')
    machine = describe('numba', 'numpy')
    print(machine, *lines, sep='\n')
    if arguments.write:
        text = [GUARD, '', 'Written by `python benchmarks/guard_steps.py --write`: the same '
                f'{arguments.plants} plants with `{EVERYWHERE}` under the same noise, σ = '
                f"{NOISE[0]:g} on x and {NOISE[1]:g} on x', {DURATION:g} s. Near its limit of b m "
                'a loop amplifies the noise; where that fills the layer, the guard takes it for '
                'oscillation and lowers K. Counted is whether it does so in the run, in brackets '
                f'whether after the first {BEGIN:g} s, in which the start adds to the noise. Each '
                'plant whose loop is calm is put by ε over the '
                'standard deviation σ_s that the noise gives s in its closed loop '
                '(`noise_of_surface` in `dz_ros/core/design/linear_loop.py`). `dz check` computes '
                f'σ_s at the bounds of b m and warns below {LEAST_IN_LOOP:g}.', '', *lines, '',
                f'Computed on {machine}; the numbers do not depend on the machine.', '']
        before = PAGE.read_text(encoding='utf-8').partition(GUARD)[0].rstrip()
        PAGE.write_text('\n'.join([before, '', *text]), encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())

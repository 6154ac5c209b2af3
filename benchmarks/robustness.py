# SPDX-License-Identifier: Apache-2.0
"""Robustness in numbers: random plants and dead-zones inside the stated bounds.

    python benchmarks/robustness.py --state FILE     go on for --seconds, keep what is done in FILE
    python benchmarks/robustness.py --state FILE --seconds 0 --write
                                                     docs/robustness.md and the worst cases

Drawn, uniformly and from a fixed seed: b_r, b_l, m within the bounds (A4) of the example,
a_i within [0.5, 1.25], b within [0.5, 2] (ours: the paper states bounds of the dead-zone only;
these are as wide as the projection box of 1/(b m), a_i/(b m) allows). The bounds stated to the
controller are those drawn from; no law of these computes with b_bounds, so this changes no number.
A plant counts where every state of x̃ stays within Ω_ε of the paper's law in every sample of the
last 10 s: |x̃| <= 0.02 and |x̃'| <= 0.04. It chatters where the total variation of v exceeds
`CHATTER` times what is explained: that of the same plant without delay and noise under the paper's
law, whose smooth command has the variation that the reference and the dead-zone need, and that
which the noise gives v in the linear loop inside the layer (`noise_variation`) of this plant and
delay, at the gain that the guard of the law had left in each sample. Where that loop is not calm,
noise explains nothing. The worst case of each law, by
max|x̃| without delay and noise, is a configuration. Chunks of plants are taken in turn through all
conditions, so that a table can be made of those that are done; it has their number.

Over 300 lines: drawing, judging and writing the table are one measurement.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
import json
import math
from pathlib import Path
import sys
import time
from typing import Any

from machine import describe
import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.linear_loop import LayerModel, noise_variation
from dz_ros.core.design.stability import run_is_lost
from dz_ros.core.laws import Law
from dz_ros.core.laws.robust_eso import RobustEso
from dz_ros.core.loop.compiled import available, simulate_fast
from dz_ros.core.loop.offline import Run
from dz_ros.files.configurations import write_parameters
from dz_ros.runs.metrics import choose_window, variation
from dz_ros.studies.scenarios import base_configuration, yardstick

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / 'docs' / 'robustness.md'
GUARD = '## When noise lowers the gain'
"""What begins here in the page is `guard_steps.py`'s."""
LAWS = ('wang2004', 'robust', 'robust_eso')
NOISE = [1e-3, 1e-2]
"""Standard deviation on x and x' where there is noise: that of the comparison of laws."""
CONDITIONS = {(delay, noise): {'loop.delay': delay, **({'plant.noise': NOISE} if noise else {})}
              for noise in (False, True) for delay in (0, 1, 2)}
EVERYWHERE = 'robust_eso'
"""The law that runs under every condition; the others without delay and noise."""
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
CHUNK = 250
CHATTER = 2.0
"""Total variation over that of the smooth command from which on a plant counts as chattering."""

LOST = [math.inf, math.inf, math.inf, 0.0, 1.0]
"""What `measure` returns of a run that is lost."""

Key = tuple[str, int, bool, int]
"""Law, delay [samples], whether there is noise, number of the chunk."""


def draw(count: int) -> list[dict[str, Any]]:
    """Return what changes in each plant."""
    low, high = np.array(list(RANGES.values())).T
    numbers = np.random.default_rng(SEED).uniform(low, high, (count, len(RANGES)))
    plants = [dict(zip(RANGES, (float(item) for item in row), strict=True)) for row in numbers]
    for plant in plants:
        plant['plant.dead_zone.m_r'] = plant['plant.dead_zone.m_l'] = plant.pop('m')
    return plants


def base_of(law: str, duration: float) -> dict[str, Any]:
    """Return the configuration that the plants change."""
    return {**base_configuration(duration), **STATED, 'controller.law': law,
            'plant.substeps': SUBSTEPS}


def measure(flat: dict[str, Any]) -> list[float]:
    """Return max|x̃|, max|x̃'|, total variation per second of the last 10 s, `explained` of it.

    A lost run has inf, inf, inf and what is explained of it, 0, 1.
    """
    try:
        run = simulate_fast(Configuration.from_flat(flat))
    except (ArithmeticError, ValueError):
        return LOST
    if run_is_lost(run):
        return LOST
    shown = run.t >= choose_window(run.t)[0] - 1e-9
    error = np.abs(run.x - run.x_d[:, :-1])[shown].max(axis=0)
    return [float(error[0]), float(error[1]), float(variation(run.t[shown], run.v[shown]) or 0.0),
            *explained(run, shown)]


def explained(run: Run, shown: Any) -> tuple[float, float]:
    """Return the variation per second that noise explains, and the share of time not calm.

    Both of the linear loop inside the layer, at the gains that the run had in the samples shown.
    """
    c = run.configuration
    guarded = 'kappa_f' in c.law.signal_names
    kappa = run.column('kappa_f')[shown] if guarded else np.ones(np.count_nonzero(shown))
    found = share = 0.0
    for level, count in zip(*np.unique(kappa, return_counts=True), strict=True):
        change = noise_variation(model_at(c.law, float(level)), c.loop.period,
                                 c.plant.b * c.dead_zone.m_r, c.loop.delay, c.noise)
        if math.isfinite(change):
            found += float(count) / len(kappa) * change
        else:
            share += float(count) / len(kappa)
    return found, share


def model_at(law: Law, kappa: float) -> LayerModel:
    """Return the law in its layer with the gains that its guard leaves at κ_f."""
    if isinstance(law, RobustEso):
        g = law.gains
        gains = replace(g, layer_gain=kappa * g.layer_gain,
                        observer_rate=math.sqrt(kappa) * g.observer_rate)
        return RobustEso(gains, law.order, law.regressor_count, law.period).layer_model()
    assert law.design is not None
    model = law.layer_model(kappa * law.design.gain)
    assert model is not None
    return model


def wanted(chunks: int) -> list[Key]:
    """Return everything there is to do, what a short run should have first."""
    return [(law, delay, noise, chunk) for chunk in range(chunks) for delay, noise in CONDITIONS
            for law in LAWS if law == EVERYWHERE or (delay, noise) == (0, False)]


def main() -> int:
    """Run what is not done yet; print and write where all is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--state', type=Path, required=True, metavar='FILE',
                        help='keeps a line of JSON for each finished chunk')
    parser.add_argument('--plants', type=int, default=10_000)
    parser.add_argument('--duration', type=float, default=20.0, help='of each run [s]')
    parser.add_argument('--seconds', type=float, default=math.inf, help='stop after this long')
    parser.add_argument('--write', action='store_true', help='write documents and worst cases')
    arguments = parser.parse_args()
    end = time.monotonic() + arguments.seconds
    plants = draw(arguments.plants)
    todo = wanted(-(-len(plants) // CHUNK))
    done = read(arguments.state)
    for key in todo:
        if key in done:
            continue
        if time.monotonic() > end:
            print(f'{len(done)} of {len(todo)} chunks are done; the same command goes on')
            break
        law, delay, noise, chunk = key
        begin = chunk * CHUNK
        base = {**base_of(law, arguments.duration), **CONDITIONS[delay, noise]}
        rows = [measure({**base, **plant, **({'loop.seed': begin + place} if noise else {})})
                for place, plant in enumerate(plants[begin:begin + CHUNK])]
        with arguments.state.open('a', encoding='utf-8') as file:
            file.write(json.dumps([list(key), rows]) + '\n')
        done[key] = rows
    ready = next((chunk for chunk in range(-(-len(plants) // CHUNK)) if any(
        key not in done for key in todo if key[3] == chunk)), -(-len(plants) // CHUNK))
    if not ready:
        return 1
    found = {(law, delay, noise): np.array([row for chunk in range(ready)
                                            for row in done[law, delay, noise, chunk]])
             for law, delay, noise, _ in todo}
    lines = table(found)
    print(describe('numba', 'numpy'), f'numba used: {available()}', *lines, sep='\n')
    if arguments.write:
        for law in LAWS:    # a worst case of fewer plants replaces none
            if ready * CHUNK >= len(plants) or not worst_case(law).exists():
                save(law, plants[int(found[law, 0, False][:, 0].argmax())])
        write(lines, len(found['wang2004', 0, False]), arguments.duration)
    return 0


def read(path: Path) -> dict[Key, list[list[float]]]:
    """Return the finished chunks of a file; none where there is no file.

    Raises:
        SystemExit: The rows are not those of `measure`, as in files of before.
    """
    if not path.exists():
        return {}
    found = {}
    for line in path.read_text(encoding='utf-8').splitlines():
        (law, delay, noise, chunk), rows = json.loads(line)
        if any(len(row) != len(LOST) for row in rows):
            raise SystemExit(f'{path}: rows of {len(rows[0])} numbers where {len(LOST)} are '
                             'measured; it is of another version, choose another file')
        found[law, delay, noise, chunk] = rows
    return found


def table(found: dict[tuple[str, int, bool], Any]) -> list[str]:
    """Return the table."""
    lines = ['| law | delay | noise | within Ω_ε | x̃ alone within it | max x̃, median | 99 % | '
             'worst | TV per s, median | 99 % | over explained, median | 99 % | worst | '
             'not calm | chatter | lost |', f'|{"---|" * 16}']
    calm = found['wang2004', 0, False][:, 2]
    bounds = yardstick()
    for (law, delay, noise), rows in sorted(
            found.items(), key=lambda item: (LAWS.index(item[0][0]), item[0][2], item[0][1])):
        error, change = rows[:, 0], rows[:, 2]
        within = (error <= bounds[0]) & (rows[:, 1] <= bounds[1])
        ratio = np.full(len(rows), math.inf)    # a lost run varies without bound
        np.divide(change, calm + rows[:, 3], out=ratio, where=np.isfinite(change))
        lines.append(
            f'| `{law}` | {delay} | {"yes" if noise else ""} | {100 * within.mean():.2f} % | '
            f'{100 * np.mean(error <= bounds[0]):.2f} % | {np.median(error):.3g} | '
            f'{np.quantile(error, 0.99, method="higher"):.3g} | {error.max():.3g} | '
            f'{np.median(change):.3g} | {np.quantile(change, 0.99, method="higher"):.3g} | '
            f'{np.median(ratio):.3g} | {np.quantile(ratio, 0.99, method="higher"):.3g} | '
            f'{ratio.max():.3g} | {100 * np.mean(rows[:, 4] > 0.0):.2f} % | '
            f'{100 * np.mean(ratio > CHATTER):.2f} % | '
            f'{np.count_nonzero(~np.isfinite(error))} |')
    return lines


def worst_case(law: str) -> Path:
    """Return the path of a law's worst case."""
    return ROOT / 'benchmarks' / 'worst' / f'{law}.yaml'


def save(law: str, plant: dict[str, Any]) -> None:
    """Write a law's worst case as a configuration."""
    path = worst_case(law)
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    write_parameters(Configuration.from_flat(
        {**base_of(law, 20.0), **plant}), path)


def write(lines: list[str], count: int, duration: float) -> None:
    """Write docs/robustness.md."""
    ranges = ', '.join(f'{key.rpartition(".")[2]} in [{low:g}, {high:g}]'
                       for key, (low, high) in RANGES.items())
    bounds, gains = yardstick(), Configuration.from_flat(base_of('robust', 20.0)).law.gains
    largest = RANGES['plant.b'][1] * RANGES['m'][1]
    text = ['# Robustness in numbers', '',
            'Written by `python benchmarks/robustness.py --state FILE --write`: the share of '
            f'{count} random plants and dead-zones for which every state stays '
            f"within Ω_ε of the paper's law, |x̃| ≤ {bounds[0]:g} and |x̃'| ≤ {bounds[1]:g}, in "
            f'every sample of the last 10 s of {duration:g} s; Ω_ε is the same for all '
            'laws. Beside it the share for which x̃ alone does. Drawn uniformly, seed '
            f'{SEED}: {ranges}. One RK4 step a sample. The bounds of the dead-zone are the '
            "paper's, those of the plant ours. Errors are those of the true state; noise: "
            f"σ = {NOISE[0]:g} on x, {NOISE[1]:g} on x', a seed for each plant.", '',
            'Chatter: the total variation of v in the last 10 s is more than '
            f'{CHATTER:g} times what is explained, the sum of two. The first is that of the '
            "paper's law with the same plant, without delay and noise: what reference and "
            'dead-zone need. The second is what the noise gives v in the linear loop inside the '
            'layer, `noise_variation` in `dz_ros/core/design/linear_loop.py`: the stationary '
            'E|v_k+1 − v_k|/T of white noise for this plant, this delay and the gain that the '
            'guard of the law had left (κ_f) in each sample; without noise it is 0. Where that '
            'loop is not calm, its spectral radius 1 or more, noise explains nothing. The table '
            'has the total variation over what is explained; about 1 means that v varies as '
            'reference, dead-zone and noise make it. *Not calm*: the share of plants for which '
            'that loop was not calm in some sample of the window. An oscillation that is small '
            'beside the noise in v is not seen by this measure, and a calm loop near its limit '
            'that amplifies the noise counts as explained. A plant that chatters without noise '
            'may be calm with it: without noise the oscillation stays inside the layer, where the '
            'guard does not see it; noise carries it to |s| = ε, and the guard lowers the gain. '
            'More plants chatter without noise than were not calm: the loops of the others are '
            'calm near their limit, where an oscillation that a crossing of the dead-zone sets '
            'off takes many samples to fade.',
            '',
            'The controllers have the bounds that are drawn from. No law of these computes with '
            'those of b: gains are the shipped ones, which are made for b m up to '
            f'{gains.beta:g} (`beta` of `robust`), where these plants have up to {largest:g}. '
            'With two samples of delay `robust_eso` as shipped is stable up to b m = 1.10 only '
            '(one sample: 2.08), so that most of these plants are beyond what its gains are made '
            'for: `dz check` warns of it, the guard lowers the gain in the run, and `dz tune` '
            'gives a layer gain for the delay and the bounds.', '',
            *lines, '', f'Computed on {describe("numba", "numpy")}; the numbers do not depend on '
            'the machine.', '',
            'The worst plant found of each law without delay and noise can be run: '
            + ', '.join(f'`dz simulate benchmarks/worst/{law}.yaml`' for law in LAWS) + '.', '']
    _, begin, rest = PAGE.read_text(encoding='utf-8').partition(GUARD)
    PAGE.write_text('\n'.join(text) + (f'\n{begin}{rest}' if begin else ''), encoding='utf-8')


if __name__ == '__main__':
    sys.exit(main())

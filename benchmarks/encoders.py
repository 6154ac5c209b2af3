# SPDX-License-Identifier: Apache-2.0
"""Positions alone: how much lower K must be, and the accuracy of `robust_eso` by encoder.

    python benchmarks/encoders.py            print the tables
    python benchmarks/encoders.py --gains    only that of the gains
    python benchmarks/encoders.py --write    write them into docs/encoders.md

Gains: the servo of `joint`, its bounds and its reference; the K that `dz tune` proposes, with a
measured velocity and with one that is observed, and the largest K without chatter for a delay of 0
and 1 by the spectral radius, each with the other gains that are proposed with it.

Accuracy: the example's plant, its x read as an angle in rad; gains by the rules for encoders
(`dz_ros.core.laws.robust_eso_gains.gains_for_encoder`), the rate of `levant` the best of a list.
Errors are max|x̃| over the last half of 60 s; TV is the total variation of v per second; the
largest b m is that of the loop's matrix, none for `levant`, which is not linear.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
import sys

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.linear_loop import largest_beta
from dz_ros.core.design.observation import linear_observer
from dz_ros.core.laws.robust_eso_gains import gains_for_encoder, OBSERVER_RATE
from dz_ros.core.loop.compiled import simulate_fast
from dz_ros.files.configurations import load_configuration
from dz_ros.studies.tune import tune
from dz_ros.studies.tune_layer import steepest_gain

PAGE = Path(__file__).resolve().parent.parent / 'docs' / 'encoders.md'
BEGIN, END = '<!-- table -->', '<!-- end of table -->'
GAINS, GAINS_END = '<!-- gains -->', '<!-- end of gains -->'
LAWS = ('robust', 'robust_eso', 'wang2004')
RESOLUTIONS = (0.0, 1e-4, 1e-3)
BITS = (17, 16, 14, 12)
CASES = (('nominal', {}), ('b = 0.5', {'plant.b': 0.5}), ('delay 1', {'loop.delay': 1}),
         ('b = 2, delay 1', {'plant.b': 2.0, 'loop.delay': 1}))
RATES = (20.0, 40.0, 60.0, 80.0, 120.0, 160.0, 240.0)


def reach(c: Configuration) -> tuple[float, float]:
    """Return max|x̃| and total variation of v per second; inf where the loop is lost."""
    run = simulate_fast(c)
    half = len(run.t) // 2
    error = float(np.abs(run.x[half:, 0] - run.x_d[half:, 0]).max())
    variation = float(np.abs(np.diff(run.v[half:])).sum() / (run.t[-1] - run.t[half]))
    return (error, variation) if error < 1.0 else (math.inf, math.inf)


def largest_b(c: Configuration) -> str:
    """Return the largest b m that is calm with a sample of delay, by the spectral radius."""
    observer = linear_observer(c, c.make_driver().measured)
    if observer is None:
        return '–'
    return f'{largest_beta(c.law.layer_model(), c.loop.period, 1, observer):.2f}'


def gain_lines() -> list[str]:
    """Return the table of K with a measured velocity and with positions alone."""
    lines = ['| law | step of the encoder | largest K, measured | positions alone '
             '| K of `dz tune`, measured | positions alone | share |', f'|{"---|" * 7}']
    print(*lines, sep='\n', flush=True)
    for law in LAWS:
        base = load_configuration('joint', [f'controller.law={law}', 'loop.duration=8'])
        measured = tune(base).after
        own = steepest_gain(measured)
        for step in RESOLUTIONS:
            alone = base.replace(**{'driver.measured': 1, 'driver.resolution': step,
                                    'plant.resolution': step})
            proposed = tune(alone).after
            found = proposed.law.design
            assert found is not None
            assert measured.law.design is not None
            share = found.gain / measured.law.design.gain
            lines.append(f'| `{law}` | {f"{step:g} rad" if step else "none"} | {own:.0f} '
                         f'| {steepest_gain(proposed):.0f} | {measured.law.design.gain:.0f} '
                         f'| {found.gain:.0f} | {share:.2f} |')
            print(lines[-1], flush=True)
    return lines


def put(lines: list[str], begin: str, end: str) -> None:
    """Put a table between its marks on the page."""
    text = PAGE.read_text(encoding='utf-8')
    PAGE.write_text(f'{text.split(begin)[0]}{begin}\n' + '\n'.join(lines)
                    + f'\n{end}{text.split(end)[1]}', encoding='utf-8')


def main() -> int:
    """Measure all resolutions and observers."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--write', action='store_true', help=f'write the table into {PAGE.name}')
    parser.add_argument('--gains', action='store_true', help='only the table of gains')
    arguments = parser.parse_args()
    lines = gain_lines()
    if arguments.write:
        put(lines, GAINS, GAINS_END)
    if arguments.gains:
        return 0
    titles = [name for name, _ in CASES]
    lines = ['| encoder | K | observer | ω | ' + ' | '.join(titles)
             + ' | TV | calm at delay 1 up to b m |', f'|{"---|" * (6 + len(titles))}']
    for bits in BITS:
        quantum = 2.0 * math.pi / 2 ** bits
        base = load_configuration('robust_eso', ['driver.measured=1', 'loop.duration=60'])
        gains = gains_for_encoder(base.loop.period, quantum / math.sqrt(12.0), 1.25, 1.0, 4.0)
        base = base.replace(**{'plant.resolution': quantum},
                            **{f'controller.{key}': item for key, item in gains.items()})
        for kind in ('tracking', 'luenberger', 'levant'):
            omega = OBSERVER_RATE * gains['layer_gain']
            c = base.replace(**{'driver.observer_kind': kind, 'driver.observer': omega})
            if kind == 'levant':
                c = min((c.replace(**{'driver.observer': rate}) for rate in RATES),
                        key=lambda item: reach(item)[0])
            found = [reach(c.replace(**changes)) for _, changes in CASES]
            numbers = ' | '.join('lost' if math.isinf(item[0]) else f'{item[0]:.2e}'
                                 for item in found)
            lines.append(f'| {bits} bit | {gains["layer_gain"]:.0f} | `{kind}` '
                         f'| {c.driver_settings.observer:.0f} | {numbers} | {found[0][1]:.0f} '
                         f'| {largest_b(c)} |')
            print(lines[-1], flush=True)
    if arguments.write:
        put(lines, BEGIN, END)
    return 0


if __name__ == '__main__':
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""Draw what an imported log and its identified plant show, for docs/real_log.md.

    python benchmarks/real_log.py axis-run axis-found
    python benchmarks/real_log.py axis-run axis-found --halves

RUN is what `dz bag import` wrote, FOUND what `dz driver identify --from RUN` did. Writes
docs/images/real_log_prediction.png and real_log_characteristic.png. With --halves it prints the
mean force of each period instead, and what a plant fitted to one half explains of the other.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
import shutil
import sys

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.loop.integration import make_advance
from dz_ros.core.loop.offline import simulate
from dz_ros.files.configurations import load_configuration
from dz_ros.identification.estimation.pipeline import fit_log
from dz_ros.recording.reader import read_run
from dz_ros.replay.whatif import fitted_keys
from dz_ros.report.style import axis_label, BLUE, GREY, legend, new_figure, RED, styled

IMAGES = Path(__file__).parents[1] / 'docs' / 'images'
Array = NDArray[np.float64]
BEGUN = 3.0
"""A loop has begun after this time [s]: it starts with an observed velocity that is wrong."""
PERIOD = 6.24
"""The trajectory of the log repeats after this time [s]."""


def predicted(run: RunData, c: Configuration, constants: Iterable[float],
              rate: float = 0.0) -> Array:
    """Return the position simulated from the commands of a run alone.

    Args:
        run: The run.
        c: Its plant's model and dead-zone.
        constants: Those of the plant.
        rate: Of an acceleration that grows with the time from the middle of the run on.
    """
    x, v, period = run.channels['state']['x0'], run.channels['command']['v'], c.loop.period
    advance = make_advance(c.plant.regressors, c.plant.disturbance)
    place = [float(x[0]), float(np.polyfit(np.arange(11) * period, x[:11], 2)[1])]
    path, work = [], ([0.0] * c.plant.regressor_count, *([0.0] * 2 for _ in range(4)))
    p, zone = tuple(constants), c.dead_zone.constants
    for k, command in enumerate(v.tolist()):
        path.append(place[0])
        advance(place, command, k * period, period / 4, 4, p, zone, *work,
                rate * (k - 0.5 * len(v)) * period)
    return np.array(path)


def explained(run: RunData, c: Configuration, constants: Iterable[float],
              rate: float = 0.0) -> float:
    """Return the share of the position's variance that is simulated, in %."""
    x = run.channels['state']['x0']
    rest = predicted(run, c, constants, rate) - x
    return float(100.0 * (1.0 - np.mean(rest * rest) / np.var(x)))


def part(run: RunData, begin: int, end: int) -> RunData:
    """Return some samples of a run."""
    return replace(run, channels={
        name: replace(channel, values=channel.values[begin:end],
                      log_time=channel.log_time[begin:end],
                      publish_time=channel.publish_time[begin:end])
        for name, channel in run.channels.items()})


def free_fit(run: RunData, c: Configuration, drifts: bool) -> tuple[list[float], float]:
    """Return the constants, and the rate, with which the simulated position is nearest."""
    start = np.array([c.plant.b, *c.plant.a])
    x, rest = run.channels['state']['x0'], c.plant.constants[len(start):]

    def residual(q: Array) -> Array:
        found = predicted(run, c, [*(start * q[:4]), *rest], q[4] * 1e-3 if drifts else 0.0)
        return (found - x) / float(np.std(x))

    q = least_squares(residual, [1.0] * 4 + [0.0] * drifts, max_nfev=25).x
    return [*(start * q[:4]), *rest], float(q[4]) * 1e-3 if drifts else 0.0


def halves(run: RunData, c: Configuration) -> None:
    """Print what one half says of the other.

    Args:
        run: The whole.
        c: The identified plant.
    """
    count = len(run.channels['state']['x0'])
    x, v, length = run.channels['state']['x0'], run.channels['command']['v'], round(
        PERIOD / c.loop.period)
    print('x repeats: correlation', float(np.corrcoef(x[:-length], x[length:])[0, 1]))
    force = float(c.to_flat()['plant.force_constant'])
    print('mean force of a period, N:', *(
        f'{force * v[begin:begin + length].mean():.2f}'
        for begin in range(0, count - length + 1, length // 2)))
    parts = {'first': part(run, 0, count // 2), 'second': part(run, count // 2, count),
             'whole': run}
    for name, own in parts.items():
        fitted = c.replace(**fitted_keys(fit_log(own, c), c))
        constants = fitted.plant.constants
        print(f'--fit to {name}:', *(f'{other} {explained(data, fitted, constants):.2f}'
                                     for other, data in parts.items()), flush=True)
    middles = {'first': 0.25, 'second': 0.75}
    for drifts in (False, True):
        for name, middle in middles.items():
            p, rate = free_fit(parts[name], c, drifts)
            found = []
            for other, there in middles.items():
                q = list(p)
                # a_3, the constant force, moves on to the middle of the other half.
                q[3] -= rate * (there - middle) * count * c.loop.period
                found.append(f'{other} {explained(parts[other], c, q, rate):.2f}')
            print(f'free fit to {name},', 'drifting:' if drifts else 'constant:', *found,
                  flush=True)


def largest(t: Array, error: Array) -> tuple[str, ...]:
    """Return the largest error as text, and that after the start."""
    found = 1e3 * np.abs(error)
    return (f'{found.max():.2f} mm,', f'{found[t > BEGUN].max():.2f} mm after {BEGUN:g} s;')


def main(run_path: Path, found: Path, by_halves: bool) -> None:
    """Write the two pictures, or print the halves."""
    run, c = read_run(run_path), load_configuration(str(found / 'identified.yaml'), [])
    if by_halves:
        halves(run, c)
        return
    state = run.channels['state']
    t, x = state['stamp'], state['x0']
    path = predicted(run, c, c.plant.constants)
    rest = path - x
    print(f'explained: {100.0 * (1.0 - np.mean(rest ** 2) / np.var(x)):.2f} %, RMS '
          f'{np.sqrt(np.mean(rest ** 2)):.2g}')
    asked = run.channels['reference']
    loops = {}
    for delay in (1, 0):
        loop = simulate(c.replace(**{'loop.delay': delay}))
        error = loop.x[:, 0] - np.interp(loop.t, asked['stamp'], asked['xd0'])
        loops[delay] = loop.t, error
        print(f'proposed loop, delay {delay}: largest error', *largest(loop.t, error),
              f'largest |v| {np.abs(loop.v).max():.2f}')
    recorded = x - asked['xd0']
    print('recorded loop: largest error', *largest(t, recorded),
          f"largest |v| {np.abs(run.channels['command']['v']).max():.2f}")
    with styled():
        figure = new_figure(9.2, 5.6)
        upper, middle, lower = figure.subplots(3, 1, sharex=True)
        upper.plot(t, x, color=GREY, lw=2.5, label='measured')
        upper.plot(t, path, color=BLUE, label='simulated from the commands alone')
        upper.set_ylabel(axis_label('x', 'm'))
        middle.plot(t, 1e3 * rest, color=BLUE, label='simulated − measured')
        middle.set_ylabel(axis_label('difference', 'mm'))
        lower.plot(t, 1e3 * recorded, color=GREY, label='the loop that was recorded')
        for (delay, (at, error)), color in zip(loops.items(), (BLUE, RED), strict=True):
            lower.plot(at, 1e3 * error, color=color,
                       label=f'proposed loop on the identified plant, delay {delay}')
        lower.set_ylabel(axis_label('tracking error', 'mm'))
        lower.set_xlabel(axis_label('time', 's'))
        for ax, columns in ((upper, 2), (middle, 2), (lower, 3)):
            legend(ax, columns)
        figure.savefig(IMAGES / 'real_log_prediction.png', dpi=110)
    shutil.copyfile(found / 'characteristic.png', IMAGES / 'real_log_characteristic.png')


if __name__ == '__main__':
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:] == ['--halves'])

# SPDX-License-Identifier: Apache-2.0
"""`robust` against `robust_eso` on the simulated drives of the device configurations.

    python benchmarks/device_laws.py            print the tables
    python benchmarks/device_laws.py --write    write them into docs/drivers.md

First each configuration of a device as it comes, offline, with the steps in which its driver
measures and commands and the driver's limit: robust_eso, and robust with the gains that these
configurations had before; what that comes to over all of them, and how both take over an error of
0.1 rad. Then the drive of `joint.yaml` with its position and speed measured, or its position alone
by an encoder (both laws with the gains that `dz tune` proposes for it), and loads within and
beyond what the bounds of b and m state, and that in a few numbers. Errors are of the last half of
40 s; TV is the total variation of v per second; the share of chatter is what `dz check` states:
the largest b m over that at which the linear loop is no longer calm.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
import sys
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.rules import check
from dz_ros.core.design.stability import run_is_lost
from dz_ros.core.loop.compiled import simulate_fast
from dz_ros.files.configurations import load_configuration
from dz_ros.studies.tune import tune

PAGE = Path(__file__).resolve().parent.parent / 'docs' / 'drivers.md'
TABLES = ('device configurations', 'both laws on them', 'take-over', 'laws on drives',
          'laws on drives in short')
"""Names of the marks on the page, `<!-- name -->` to `<!-- end of name -->`."""
NAMES = ('joint', 'serial', 'cia402', 'cia402_axes')
ROBUST: dict[str, Any] = {
    'law': 'robust', 'lambda': 5.0, 'k_d': 10.0, 'k_star': 1.45, 'margin': 0.445, 'beta': 1.375,
    'design_delay': 1, 'gain_cap': 120.0, 'integral_divisor': 2.0, 'rho_0': 0.25, 'rho_1': 16.0,
    'k_2': 20.0, 'theta_min': [0.1, 0.1], 'theta_max': [3.0, 3.0], 'phi_min': 0.3, 'phi_max': 2.5}
"""Gains of `robust` by its rules for these bounds and a measured velocity, with f = 0.445: those
that these configurations had before `robust_eso`."""
COMMON = ('b_r_bounds', 'b_l_bounds', 'm_bounds', 'b_bounds', 'override_checks', 'gamma', 'eta',
          'theta_0', 'phi_0', 'v_floor', 'v_max', 'identifier')
"""Keys of the controller that both laws take from the configuration."""
SENSORS: dict[str, dict[str, Any]] = {
    'position, speed': {},
    **{f'{bits} bit': {'driver.measured': 1, 'plant.resolution': 2.0 * math.pi / 2 ** bits}
       for bits in (17, 14, 12)}}
LOADS: dict[str, dict[str, Any]] = {
    'nominal': {}, 'largest b m': {'plant.inertia': 1.0 / 1.1, 'plant.dead_zone.m_r': 1.25,
                                   'plant.dead_zone.m_l': 1.25},
    'half the inertia': {'plant.inertia': 0.5}, 'twice the inertia': {'plant.inertia': 2.0}}
WITHIN = ('nominal', 'largest b m')
"""Loads within the bounds."""
DELAYS = (0, 1, 2)
NEAR = 0.002
"""An error is taken over once it stays within this [rad]."""
FIGURES = {'largest error': 0, 'its root mean square': 1, 'variation of v': 2, 'peak of v': 3}
Reached = tuple[float, float, float, float]
"""max|x̃| and its root mean square [mrad], total variation of v per second, peak of v."""


def drive(c: Configuration) -> Configuration:
    """Return a device's configuration with its drive simulated, as its driver measures it."""
    driver = c.make_driver()
    flat = {key: value for key, value in c.to_flat().items() if not key.startswith('driver.')}
    return Configuration.from_flat({
        **flat, 'loop.duration': 40.0, 'plant.resolution': driver.resolution,
        'plant.derivative_resolution': list(driver.derivative_resolution),
        'plant.command_resolution': driver.command_resolution,
        'plant.command_limit': driver.limit if math.isfinite(driver.limit) else 0.0})


def under_robust(c: Configuration) -> Configuration:
    """Return a configuration under `robust`; bounds, first estimates and limit stay."""
    kept = {key: value for key, value in c.to_flat().items()
            if not key.startswith('controller.') or key.partition('.')[2] in COMMON}
    return Configuration.from_flat({
        **kept, **{f'controller.{key}': value for key, value in ROBUST.items()}})


def laws(sensor: dict[str, Any]) -> dict[str, Configuration]:
    """Return law → the drive of `joint` with a sensor; by an encoder with the gains proposed."""
    c = load_configuration('joint')
    found = {'`robust`': under_robust(drive(c)), '`robust_eso`': drive(c)}
    if sensor:
        c = c.replace(**{'driver.measured': 1, 'driver.resolution': sensor['plant.resolution']})
        for law, own in (('`robust`', under_robust(c)), ('`robust_eso`', c)):
            tuned = {key: value for key, value in tune(own).after.to_flat().items()
                     if not key.startswith('driver.') or key == 'driver.observer'}
            found[law] = Configuration.from_flat({**tuned, 'loop.duration': 40.0, **sensor})
    found['`robust_eso`, identifier'] = found['`robust_eso`'].replace(
        **{'controller.identifier': True})
    return found


def reach(c: Configuration) -> Reached | None:
    """Return what a run reaches; None = it is lost."""
    run = simulate_fast(c)
    if run_is_lost(run):
        return None
    half = len(run.t) // 2
    error = 1e3 * np.abs(run.x[half:, 0] - run.x_d[half:, 0])
    variation = float(np.abs(np.diff(run.v[half:])).sum() / (run.t[-1] - run.t[half]))
    return (float(error.max()), float(np.sqrt(np.square(error).mean())), variation,
            float(np.abs(run.v).max()))


def delayed(c: Configuration) -> list[Reached | None]:
    """Return what a configuration reaches at each delay."""
    return [reach(c.replace(**{'loop.delay': delay})) for delay in DELAYS]


def cell(found: Reached | None, peak: bool) -> str:
    """Return a cell of a table."""
    if found is None:
        return 'lost'
    error, mean, variation, most = found
    return f'{error:.2f}, {mean:.2f} ({variation:.3g}' + (f', {most:.3g})' if peak else ')')


def head(*titles: str) -> list[str]:
    """Return the first two lines of a table."""
    return [f'| {" | ".join(titles)} |', f'|{"---|" * len(titles)}']


def shipped_lines() -> tuple[list[str], list[str]]:
    """Return the table of the configurations as they come, and what both laws come to on them."""
    lines = head('configuration', 'law', *(f'delay {delay}' for delay in DELAYS),
                 'share of chatter, delay 0, 1, 2')
    ratios: list[list[float]] = []
    for name in NAMES:
        whole = load_configuration(name)
        for axis in whole.axis_names or ('',):
            c = drive(whole.axis(axis) if axis else whole)
            both = []
            for own in (under_robust(c), c):
                both.append(delayed(own))
                shares = {item.numbers['delay']: item.numbers['share_high']
                          for item in check(own) if item.rule == 'chatter'}
                cells = [*(cell(item, peak=True) for item in both[-1]),
                         ', '.join(f'{shares[float(delay)]:.2f}' for delay in DELAYS)]
                lines.append(f'| `{name}`{f", {axis}" if axis else ""} | `{own.law.name}` | '
                             + ' | '.join(cells) + ' |')
            ratios += [[old / new for old, new in zip(first, second, strict=True)]
                       for first, second in zip(*both, strict=True)
                       if first is not None and second is not None]
    short = head('`robust` over `robust_eso`', 'least', 'largest')
    for name, place in FIGURES.items():
        values = [item[place] for item in ratios]
        short.append(f'| {name} | {min(values):.2f} | {max(values):.2f} |')
    return lines, short


def take_over_lines() -> list[str]:
    """Return the table of how both laws take over an error of 0.1 rad."""
    eso = drive(load_configuration('joint'))
    runs = [simulate_fast(c) for c in (under_robust(eso), eso)]
    after, push = [], []
    for run in runs:
        outside = np.flatnonzero(np.abs(run.x[:, 0] - run.x_d[:, 0]) > NEAR)
        after.append(f'{run.t[outside[-1] + 1]:.2g} s')
        push.append(f'{np.abs(run.v[run.t < 1.0]).max():.2g} N m')
    return [*head('`joint`, from 0.1 rad', '`robust`', '`robust_eso`'),
            f'| within {1e3 * NEAR:g} mrad after | {" | ".join(after)} |',
            f'| largest \\|v\\| in the first second | {" | ".join(push)} |']


def loaded_lines() -> tuple[list[str], list[str]]:
    """Return the table of sensors and loads, and how the laws compare in it."""
    lines = head('measured', 'load', 'law', *(f'delay {delay}' for delay in DELAYS))
    short = head('measured', 'loads', 'against', 'cells', 'error of `robust` smaller in',
                 'error of `robust` over the other', 'variation of `robust` over the other')
    for sensor, measured in SENSORS.items():
        own, found = laws(measured), {}
        for load, changed in LOADS.items():
            for law, c in own.items():
                found[load, law] = delayed(c.replace(**changed))
                lines.append(f'| {sensor} | {load} | {law} | '
                             + ' | '.join(cell(item, peak=False) for item in found[load, law])
                             + ' |')
        short += compared(sensor, found)
    return lines, short


def compared(sensor: str, found: dict[tuple[str, str], list[Reached | None]]) -> list[str]:
    """Return the lines of one sensor: `robust` against the others, within and beyond bounds."""
    lines = []
    for loads in (WITHIN, *((load,) for load in LOADS if load not in WITHIN)):
        for law in ('`robust_eso`', '`robust_eso`, identifier'):
            pairs = [(first, second) for load in loads for first, second in
                     zip(found[load, '`robust`'], found[load, law], strict=True)]
            both = [(first, second) for first, second in pairs
                    if first is not None and second is not None]
            better = sum(first[0] < second[0] for first, second in both)
            ratios = [[first[i] / second[i] for first, second in both] for i in (0, 2)]
            shown = ' | '.join(f'{min(items):.2g} to {max(items):.2g}' if items else 'lost'
                               for items in ratios)
            title = 'within the bounds' if loads == WITHIN else loads[0]
            lines.append(f'| {sensor} | {title} | {law} | {len(pairs)} | {better} | {shown} |')
    return lines


def main() -> int:
    """Measure both laws."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--write', action='store_true', help=f'write the tables into {PAGE.name}')
    arguments = parser.parse_args()
    tables = dict(zip(TABLES, (*shipped_lines(), take_over_lines(), *loaded_lines()), strict=True))
    for lines in tables.values():
        print(*lines, '', sep='\n')
    if arguments.write:
        text = PAGE.read_text(encoding='utf-8')
        for name, lines in tables.items():
            begin, end = f'<!-- {name} -->', f'<!-- end of {name} -->'
            before, after = text.split(begin)[0], text.split(end)[1]
            text = f'{before}{begin}\n' + '\n'.join(lines) + f'\n{end}{after}'
        PAGE.write_text(text, encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())

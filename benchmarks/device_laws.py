# SPDX-License-Identifier: Apache-2.0
"""`robust` against `robust_eso` on the simulated drives of the device configurations.

    python benchmarks/device_laws.py            print the tables
    python benchmarks/device_laws.py --write    write them into docs/drivers.md

First each configuration of a device as it comes, offline, with the steps in which its driver
measures and commands and the driver's limit: robust_eso, and robust with the gains that these
configurations had before. Then the drive of `joint.yaml` with its position and speed measured, or
its position alone by an encoder (`robust_eso` with the gains that `dz tune` proposes for it), and
loads within and beyond what the bounds of b and m state. Errors are of the last half of 40 s; TV
is the total variation of v per second; the share of chatter is what `dz check` states: the
largest b m over that at which the linear loop is no longer calm.
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
SHIPPED, LOADED = '<!-- device configurations -->', '<!-- laws on drives -->'
ENDS = {SHIPPED: '<!-- end of device configurations -->', LOADED: '<!-- end of laws on drives -->'}
NAMES = ('joint', 'serial', 'cia402', 'cia402_axes')
ROBUST: dict[str, Any] = {
    'law': 'robust', 'lambda': 5.0, 'k_d': 10.0, 'k_star': 1.45, 'margin': 0.445, 'beta': 1.375,
    'design_delay': 1, 'gain_cap': 120.0, 'integral_divisor': 2.0, 'rho_0': 0.25, 'rho_1': 16.0,
    'k_2': 20.0, 'theta_min': [0.1, 0.1], 'theta_max': [3.0, 3.0], 'phi_min': 0.3, 'phi_max': 2.5}
"""Gains of `robust` by its rules for the bounds of these configurations."""
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
DELAYS = (0, 1, 2)


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
    found = {'`robust`': Configuration.from_flat({**under_robust(drive(c)).to_flat(), **sensor})}
    if not sensor:
        found['`robust_eso`'] = drive(c)
    else:
        c = c.replace(**{'driver.measured': 1, 'driver.resolution': sensor['plant.resolution']})
        tuned = {key: value for key, value in tune(c).after.to_flat().items()
                 if not key.startswith('driver.')}
        found['`robust_eso`'] = Configuration.from_flat({**tuned, 'loop.duration': 40.0, **sensor})
    found['`robust_eso`, identifier'] = found['`robust_eso`'].replace(
        **{'controller.identifier': True})
    return found


def reach(c: Configuration) -> tuple[str, ...]:
    """Return max|x̃| and its root mean square [mrad], TV per second and peak of v as text."""
    run = simulate_fast(c)
    if run_is_lost(run):
        return ('lost',)
    half = len(run.t) // 2
    error = 1e3 * np.abs(run.x[half:, 0] - run.x_d[half:, 0])
    variation = float(np.abs(np.diff(run.v[half:])).sum() / (run.t[-1] - run.t[half]))
    return (f'{error.max():.2f}, {np.sqrt(np.square(error).mean()):.2f}', f'{variation:.3g}',
            f'{np.abs(run.v).max():.3g}')


def shipped_lines() -> list[str]:
    """Return the table of the configurations as they come."""
    lines = ['| configuration | law | ' + ' | '.join(f'delay {delay}' for delay in DELAYS)
             + ' | share of chatter, delay 0, 1, 2 |', f'|{"---|" * (3 + len(DELAYS))}']
    for name in NAMES:
        whole = load_configuration(name)
        for axis in whole.axis_names or ('',):
            c = drive(whole.axis(axis) if axis else whole)
            for own in (under_robust(c), c):
                cells = []
                for delay in DELAYS:
                    found = reach(own.replace(**{'loop.delay': delay}))
                    cells.append(f'{found[0]} ({", ".join(found[1:])})')
                shares = {item.numbers['delay']: item.numbers['share_high']
                          for item in check(own) if item.rule == 'chatter'}
                cells.append(', '.join(f'{shares[float(delay)]:.2f}' for delay in DELAYS))
                lines.append(f'| `{name}`{f", {axis}" if axis else ""} | `{own.law.name}` | '
                             + ' | '.join(cells) + ' |')
                print(lines[-1], flush=True)
    return lines


def loaded_lines() -> list[str]:
    """Return the table of sensors and loads."""
    lines = ['| measured | load | law | ' + ' | '.join(f'delay {delay}' for delay in DELAYS)
             + ' |', f'|{"---|" * (3 + len(DELAYS))}']
    for sensor, measured in SENSORS.items():
        own = laws(measured)
        for load, changed in LOADS.items():
            for law, c in own.items():
                cells = []
                for delay in DELAYS:
                    found = reach(c.replace(**changed, **{'loop.delay': delay}))
                    cells.append(f'{found[0]} ({found[1]})' if len(found) > 1 else found[0])
                lines.append(f'| {sensor} | {load} | {law} | ' + ' | '.join(cells) + ' |')
                print(lines[-1], flush=True)
    return lines


def main() -> int:
    """Measure both laws."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--write', action='store_true', help=f'write the tables into {PAGE.name}')
    arguments = parser.parse_args()
    tables = {SHIPPED: shipped_lines(), LOADED: loaded_lines()}
    if arguments.write:
        text = PAGE.read_text(encoding='utf-8')
        for begin, lines in tables.items():
            before, after = text.split(begin)[0], text.split(ENDS[begin])[1]
            text = f'{before}{begin}\n' + '\n'.join(lines) + f'\n{ENDS[begin]}{after}'
        PAGE.write_text(text, encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())

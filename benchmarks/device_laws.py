# SPDX-License-Identifier: Apache-2.0
"""`robust` as shipped against `robust_eso` by rule on the drives of the device configurations.

    python benchmarks/device_laws.py            print the table
    python benchmarks/device_laws.py --write    write it into docs/drivers.md

The drive that `joint.yaml`, `serial.yaml` and `cia402.yaml` describe, friction, cogging and
dead-zone included, is simulated with its position and speed measured, or its position alone by an
encoder, with 0 to 2 samples of delay and with a load that makes b smaller or larger than its
bounds say. `robust_eso` has the gains that `dz tune` proposes for the configuration. Errors are
max|x̃| over the last half of 40 s; TV is the total variation of v per second.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
import sys
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.stability import run_is_lost
from dz_ros.core.loop.compiled import simulate_fast
from dz_ros.files.configurations import load_configuration
from dz_ros.studies.tune import tune

PAGE = Path(__file__).resolve().parent.parent / 'docs' / 'drivers.md'
BEGIN, END = '<!-- laws on drives -->', '<!-- end of laws on drives -->'
SENSORS: dict[str, dict[str, Any]] = {
    'position, speed': {},
    **{f'{bits} bit': {'driver.measured': 1, 'plant.resolution': 2.0 * math.pi / 2 ** bits}
       for bits in (17, 14, 12)}}
LOADS: dict[str, dict[str, Any]] = {
    'nominal': {}, 'half the inertia': {'plant.inertia': 0.5},
    'twice the inertia': {'plant.inertia': 2.0}}
DELAYS = (0, 1, 2)


def base(law: str, sensor: dict[str, Any]) -> Configuration:
    """Return the drive under a law; simulated, because a device's driver is not run here."""
    flat = load_configuration('joint').to_flat()
    flat = {key: value for key, value in flat.items() if not key.startswith('driver.')}
    shipped = Configuration.from_flat({**flat, 'loop.duration': 40.0, **sensor})
    if law == 'robust':
        return shipped
    gains = ('lambda', 'k_d', 'k_star', 'rho_0', 'rho_1', 'k_2', 'margin', 'beta',
             'design_delay', 'gain_cap', 'integral_divisor', 'identifier')
    kept = {key: value for key, value in shipped.to_flat().items()
            if key.partition('.')[2] not in gains}
    return tune(Configuration.from_flat({**kept, 'controller.law': law})).after


def reach(c: Configuration) -> str:
    """Return max|x̃| and total variation of v per second as a cell."""
    run = simulate_fast(c)
    if run_is_lost(run):
        return 'lost'
    half = len(run.t) // 2
    error = float(np.abs(run.x[half:, 0] - run.x_d[half:, 0]).max())
    variation = float(np.abs(np.diff(run.v[half:])).sum() / (run.t[-1] - run.t[half]))
    return f'{error:.2e} ({variation:.3g})'


def main() -> int:
    """Measure both laws."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--write', action='store_true', help=f'write the table into {PAGE.name}')
    arguments = parser.parse_args()
    lines = ['| measured | load | law | ' + ' | '.join(f'delay {delay}' for delay in DELAYS)
             + ' |', f'|{"---|" * (3 + len(DELAYS))}']
    for sensor, measured in SENSORS.items():
        laws = {law: base(law, measured) for law in ('robust', 'robust_eso')}
        for load, changed in LOADS.items():
            for law, c in laws.items():
                cells = [reach(c.replace(**changed, **{'loop.delay': delay})) for delay in DELAYS]
                lines.append(f'| {sensor} | {load} | `{law}` | ' + ' | '.join(cells) + ' |')
                print(lines[-1], flush=True)
    if arguments.write:
        text = PAGE.read_text(encoding='utf-8')
        before, after = text.split(BEGIN)[0], text.split(END)[1]
        PAGE.write_text(f'{before}{BEGIN}\n' + '\n'.join(lines) + f'\n{END}{after}',
                        encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())

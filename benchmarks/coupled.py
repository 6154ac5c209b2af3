# SPDX-License-Identifier: Apache-2.0
"""Machines whose axes are coupled: one law for all axes against an independent loop for each.

    python benchmarks/coupled.py            print the table
    python benchmarks/coupled.py --write    write it into docs/axes.md

The arm, its motion and the gains of `coupled_eso` are those of config/two_link_arm.yaml; the
independent loops are `robust_eso` with its gains by rule, each from the view of its joint. The
vehicle and its independent loops are those of config/rov_planar.yaml. Errors are the largest
max|x̃| of an axis over the last half of 24 s; TV is the total variation of v per second, summed
over the axes. `controller.override_checks` of the independent loops of the arm changes no figure;
why it is set: docs/axes.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
import math
from pathlib import Path
import sys
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.laws.robust_eso_gains import gains_by_rule
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.files.configurations import load_configuration

PAGE = Path(__file__).resolve().parent.parent / 'docs' / 'axes.md'
BEGIN, END = '<!-- coupled: benchmarks/coupled.py writes it -->', '<!-- end of coupled -->'
DURATION = 24.0
K_STAR, K_D, TOLERANCE = 4.0, 10.0, 0.25
SHARES = {'exact': 1.0, '× 0.6': 0.6}


def inertia(weights: tuple[float, ...], elbow: float) -> np.ndarray:
    """Return M at an elbow angle [rad], shape (2, 2)."""
    side = weights[2] + weights[1] * math.cos(elbow)
    return np.array([[weights[0] + 2.0 * weights[1] * math.cos(elbow), side],
                     [side, weights[2]]])


def coupled(c: Configuration, share: float, nominal: float) -> dict[str, Any]:
    """Return gains of `coupled_eso`: weights and M̂ as shares of the truth."""
    weights = np.array(c.plant.weights) / c.plant.parameters.torque_constant
    return {'controller.law': 'coupled_eso', 'controller.theta_0': (share * weights).tolist(),
            'controller.theta_min': (0.1 * weights).tolist(),
            'controller.theta_max': (3.0 * weights).tolist(),
            'controller.inertia': (nominal * inertia(tuple(weights), 0.6)).ravel().tolist()}


def independent(c: Configuration, share: float, wide: bool,
                gain: float = 1.0) -> dict[str, Any]:
    """Return gains of `robust_eso` by rule for each joint.

    Args:
        c: The machine.
        share: Weights as a share of those of the view.
        wide: Bounds of b over all elbow angles, the other joint free or held; else ±25 % of the
            view's.
        gain: Share of the gain by rule.
    """
    found: dict[str, Any] = {'controller.law': 'robust_eso', 'controller.k_star': K_STAR,
                             'controller.override_checks': True}
    weights = c.plant.weights
    angles = np.linspace(*c.axis('elbow').plant_settings.x0[:1] + np.array([-0.7, 0.7]), 50)
    for place, name in enumerate(c.axis_names):
        view = c.axis(name).plant
        bounds = view.b * (1.0 - TOLERANCE), view.b * (1.0 + TOLERANCE)
        if wide:
            free = [np.linalg.inv(inertia(weights, angle))[place, place] for angle in angles]
            held = [1.0 / inertia(weights, angle)[place, place] for angle in angles]
            scale = view.parameters.torque_constant
            bounds = min(*held, *free) * scale, max(*held, *free) * scale
        theta = [share * item / view.b for item in view.a]
        gains = gains_by_rule(c.loop.period, bounds, (1.0, 1.0 / gain), K_STAR, K_D, theta,
                              share / view.b)
        gains.update(theta_0=theta, phi_0=share / view.b)
        found.update({f'axes.{name}.controller.{key}': item for key, item in gains.items()})
    return found


def vehicle(c: Configuration) -> dict[str, Any]:
    """Return gains of `coupled_eso` for the vehicle: weights over the mean slope of 0.75."""
    weights = np.maximum(np.array(c.plant.weights), 0.05) / 0.75
    found: dict[str, Any] = {
        'controller.law': 'coupled_eso', 'controller.lambda': 9.09,
        'controller.inertia': np.diag(weights[:3]).ravel().tolist(),
        'controller.theta_0': weights.tolist(), 'controller.theta_min': (0.1 * weights).tolist(),
        'controller.theta_max': (3.0 * weights).tolist()}
    for name, item in c.axes:
        k_star = item.law.gains.k_star
        found.update({f'axes.{name}.controller.k_star': k_star,
                      f'axes.{name}.controller.rho_0': 0.3 * k_star,
                      f'axes.{name}.controller.rho_1': 10.0 * k_star})
    return found


def measure(c: Configuration) -> tuple[float, float]:
    """Return max|x̃| [rad] and total variation of v per second [A/s]; inf where it is lost."""
    try:
        runs = simulate_axes(c).values()
    except (OverflowError, ValueError):
        return math.inf, math.inf
    half = c.loop.samples // 2
    error = max(float(np.abs(run.x[half:, 0] - run.x_d[half:, 0]).max()) for run in runs)
    variation = sum(float(np.abs(np.diff(run.v[half:])).sum()) for run in runs)
    if not math.isfinite(error + variation) or error > 10.0:
        return math.inf, math.inf
    return error, variation / (0.5 * DURATION)


def rows() -> list[tuple[str, Configuration, Mapping[str, Any]]]:
    """Return the first columns of a row, machine, changes; none = as it is configured."""
    arm, rov = (load_configuration(name, [f'loop.duration={DURATION:g}'])
                for name in ('two_link_arm', 'rov_planar'))
    found: list[tuple[str, Configuration, Mapping[str, Any]]] = []
    for title, share, nominal, about in (
            ('exact', 1.0, 1.0, 'M at an elbow angle of 0.6'), ('× 0.6', 0.6, 1.0, 'the same'),
            ('× 0.6', 0.6, 0.6, '0.6 times it')):
        found.append((f'arm | `coupled_eso` | {title} | {about}', arm,
                      coupled(arm, share, nominal)))
    for title, share, wide, gain, about in (
            ('exact', 1.0, False, 1.0, 'M_ii of the view ± 25 %'),
            ('× 0.6', 0.6, False, 1.0, 'the same'),
            ('exact', 1.0, False, 0.5, 'the same, half the gain'),
            ('exact', 1.0, True, 1.0, 'bounds over all elbow angles')):
        found.append((f'arm | independent `robust_eso` | {title} | {about}', arm,
                      independent(arm, share, wide, gain)))
    found.append(('vehicle | `coupled_eso` | exact over 0.75 | diagonal', rov, vehicle(rov)))
    found.append(('vehicle | independent `robust_eso` | exact over 0.75 | M_ii of the view ± 10 %',
                  rov, {}))
    return found


def main() -> int:
    """Measure all rows without and with a sample of delay."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--write', action='store_true', help=f'write the table into {PAGE.name}')
    arguments = parser.parse_args()
    lines = ['| machine | law | weights | inertia | max\\|x̃\\|, delay 0 | TV | delay 1 | TV |',
             f'|{"---|" * 8}']
    for columns, machine, changes in rows():
        row = machine if not changes else Configuration.from_flat({
            **{key: value for key, value in machine.to_flat().items() if '.controller.' not in
               f'.{key}'}, **changes})
        found = [measure(row.replace(**{'loop.delay': delay})) for delay in (0, 1)]
        numbers = ' | '.join('lost | –' if math.isinf(error) else f'{error:.2g} | {variation:.0f}'
                             for error, variation in found)
        lines.append(f'| {columns} | {numbers} |')
        print(lines[-1], flush=True)
    if arguments.write:
        text = PAGE.read_text(encoding='utf-8')
        PAGE.write_text(f'{text.split(BEGIN)[0]}{BEGIN}\n\n' + '\n'.join(lines)
                        + f'\n\n{END}{text.split(END)[1]}', encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())

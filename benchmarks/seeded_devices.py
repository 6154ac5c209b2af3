# SPDX-License-Identifier: Apache-2.0
"""Seeded simulated devices with a known dead-zone, moved and identified (ours).

A seed gives a device: break points and slopes of either side, friction, inertia, a disturbance
and how fast the dead-zone drifts, p(t) = p + A sin ω t with a period from 40 to 120 s. It is moved
and measured with noise by the very experiment that a real one gets. Afterwards

    covered   the bounds hold every value that the parameter took from the first repeat to the last
    drift     the range of these values, max p(t) − min p(t)
    ratio     width of the bounds over the drift

for b_r, b_l, b m_r, b m_l. Where nothing drifts there is no ratio, and covered means p itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.identification.estimation.least_squares import ZONE
from dz_ros.identification.estimation.pipeline import identify
from dz_ros.identification.experiment.moves import Experiment
from dz_ros.identification.experiment.plan import Limits, Plan
from dz_ros.identification.experiment.session import run_session

Array = NDArray[np.float64]

KINDS = ('servo', 'servo, no drift', 'first_order')
PERIODS = (40.0, 120.0)
"""Of the drift [s]."""


@dataclass(frozen=True)
class Device:
    """One device, identified.

    Attributes:
        seed: Its seed.
        bounds: Lower and upper bound of each of `ZONE`, shape (4, 2).
        truth: Least and largest value each took, shape (4, 2).
        values: Mean of the repeats, shape (4,).
        duration: Loop time of the experiment [s].
    """

    seed: int
    bounds: Array
    truth: Array
    values: Array
    duration: float

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Whether the bounds hold the truth, shape (4,)."""
        found: NDArray[np.bool_] = ((self.bounds[:, 0] <= self.truth[:, 0])
                                    & (self.truth[:, 1] <= self.bounds[:, 1]))
        return found

    @property
    def drift(self) -> Array:
        """Range of the true values, shape (4,)."""
        return self.truth[:, 1] - self.truth[:, 0]

    @property
    def width(self) -> Array:
        """Width of the bounds, shape (4,)."""
        return self.bounds[:, 1] - self.bounds[:, 0]


def configured(kind: str, seed: int) -> tuple[Configuration, Limits]:
    """Return a device and limits for its moves.

    Args:
        kind: One of `KINDS`.
        seed: Decides what is drawn, and the noise.
    """
    draw = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(draw.uniform(low, high))

    model = kind.partition(',')[0]
    force = 1.0 if model == 'servo' else 12.0       # scale of everything in the actuator's unit
    flat: dict[str, Any] = {
        'loop.timing': 'lockstep', 'loop.seed': seed, 'plant.model': model,
        'plant.dead_zone.b_r': force * between(0.3, 0.8),
        'plant.dead_zone.b_l': -force * between(0.3, 0.8),
        'plant.dead_zone.m_r': between(0.8, 1.2), 'plant.dead_zone.m_l': between(0.8, 1.2)}
    for name, size in (('b_r', 0.08 * force), ('b_l', 0.08 * force), ('m_r', 0.06),
                       ('m_l', 0.06)):
        amplitude = 0.0 if 'no drift' in kind else between(0.5, 1.0) * size
        flat[f'plant.dead_zone.{name}_drift'] = [amplitude, 2.0 * np.pi / between(*PERIODS)]
    if model == 'servo':
        flat.update({'plant.inertia': between(0.8, 1.2), 'plant.viscous_friction': between(.2, .6),
                     'plant.coulomb_friction': between(0.3, 1.2),
                     'plant.cogging_torque': between(0.0, 0.1), 'plant.noise': [1e-3, 1e-2]})
        limits = Limits(1.5, 1.0, 5.0)
    else:
        flat.update({'plant.linear_drag': between(8.0, 20.0),
                     'plant.quadratic_drag': between(80.0, 160.0),
                     'plant.wave_force': between(0.0, 2.0), 'plant.noise': [5e-3]})
        limits = Limits(0.5, 0.0, 60.0)
    return Configuration.from_flat(flat), limits


def identified(kind: str, seed: int, repeats: int = 16) -> Device:
    """Return a device that was moved and identified.

    Raises:
        DzRosError: It was not identified.
    """
    c, limits = configured(kind, seed)
    experiment = Experiment(limits, Plan(repeats=repeats, seed=seed), c.plant.order,
                            c.loop.period)
    samples = run_session(c, experiment, lambda seq: seq, lambda: '')
    found = identify(samples, c, experiment.moving)
    inside = samples.t[samples.repeat >= 0]
    return Device(seed, np.array([(item.low, item.high) for item in found.bounds.values()]),
                  _truth(c, inside), np.array([item.value for item in found.bounds.values()]),
                  float(samples.t[-1]))


def _truth(c: Configuration, t: Array) -> Array:
    """Return the least and the largest value of each of `ZONE` at these times, shape (4, 2)."""
    rows = []
    for name in ZONE:
        key = name.removeprefix('b·')
        amplitude, omega = getattr(c.dead_zone, f'{key}_drift')
        values = getattr(c.dead_zone, key) + amplitude * np.sin(omega * t)
        values = values * (c.plant.b if key != name else 1.0)
        rows.append((values.min(), values.max()))
    return np.array(rows)

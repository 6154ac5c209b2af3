# SPDX-License-Identifier: Apache-2.0
"""The comparison's scenarios (ours), defined here and nowhere else.

Plant, reference and initial state are the example of [wang2004], but for `stiction`, which needs
a plant with friction; every scenario changes one thing
about plant, actuator, sensor or transport and nothing about the controller, whose gains stay the
same: no law is tuned for a scenario. The exception is the limit of the actuator, which stands on
its plate and is a gain of some laws (v_max, v_clip; of `extended` without effect, because its
anti_windup is off): they have it under `saturation`, and do not clip where the reference or an
observed velocity needs more than the example's. `exact_inverse` keeps the break
points of the example, so under `drift` it is not exact.

- noise: σ = 1e-3 on x, 1e-2 on x', one member a seed
- pulse: ±20 on x'' for 50 ms, at four instants a quarter of the reference's period apart, in the
  window that the metrics are of
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.schema import fields
from dz_ros.core.tracking import guaranteed_bounds
from dz_ros.errors import suggestion, UnknownNameError

DURATION = 60.0
"""Length of every run [s]."""
SEEDS = 5
"""Members of the scenario `noise`."""
PULSE = 20.0
"""Acceleration of the pulse [1/s²]."""
PULSE_LENGTH = 0.05
"""Duration of the pulse [s]."""
FIRST_PULSE = 9.0
"""The first pulse is this long before the end of the run [s]."""
UNLIMITED = {'controller.v_clip': 0.0}
"""Laws that clip v to the example's peak by default do not, where more than that is needed."""


@dataclass(frozen=True)
class Scenario:
    """Something that may happen to the loop.

    Attributes:
        name: Its name.
        summary: What it is, with numbers.
        members: Changes of the configuration, one a run; the scenario's numbers are their mean.
    """

    name: str
    summary: str
    members: tuple[Mapping[str, Any], ...]


def scenarios(duration: float = DURATION, seeds: int = SEEDS) -> dict[str, Scenario]:
    """Return name → scenario, in the order of the tables.

    Args:
        duration: Length of the runs [s]; places the pulses in its last part.
        seeds: Members of the scenario `noise`.
    """
    first = max(duration - min(FIRST_PULSE, 0.45 * duration), 0.0)
    apart = min(0.5 * math.pi, 0.1 * duration)
    pulses = tuple({'plant.disturbance_pulse': [round(first + place * apart, 2), sign * PULSE,
                                                PULSE_LENGTH]}
                   for place in range(4) for sign in (1.0, -1.0))
    found = (
        Scenario('nominal', 'the example as it is', ({},)),
        Scenario('drift', 'b_r = 0.35 + 0.25 sin 0.9t, b_l = -0.4 + 0.3 sin 0.7t', ({
            'plant.dead_zone.b_r': 0.35, 'plant.dead_zone.b_r_drift': [0.25, 0.9],
            'plant.dead_zone.b_l': -0.4, 'plant.dead_zone.b_l_drift': [0.3, 0.7]},)),
        Scenario('b=0.5', 'half the input gain', ({'plant.b': 0.5},)),
        Scenario('b=2', 'twice the input gain', ({'plant.b': 2.0},)),
        Scenario('noise', f"noise of 0.001 on x and 0.01 on x', {seeds} seeds", tuple(
            {'plant.noise': [1e-3, 1e-2], 'loop.seed': seed} for seed in range(seeds))),
        Scenario('saturation', 'the actuator clips |v| to 10; laws with a place for the limit '
                 'have it', ({'plant.command_limit': 10.0, 'controller.v_max': 10.0,
                              'controller.v_clip': 10.0},)),
        Scenario('delay 1', 'the actuator acts one sample late', ({'loop.delay': 1},)),
        Scenario('delay 2', 'the actuator acts two samples late', ({'loop.delay': 2},)),
        Scenario('b=2, delay 1', 'twice the input gain and one sample late',
                 ({'plant.b': 2.0, 'loop.delay': 1},)),
        Scenario('disturbance pulse',
                 f"x'' pushed by ±{PULSE:g} for {1e3 * PULSE_LENGTH:g} ms at 4 instants", pulses),
        Scenario('slopes 1.25, 0.5', 'dead-zone steeper on the right',
                 ({'plant.dead_zone.m_r': 1.25, 'plant.dead_zone.m_l': 0.5},)),
        Scenario('slopes 0.5, 1.25', 'dead-zone steeper on the left',
                 ({'plant.dead_zone.m_r': 0.5, 'plant.dead_zone.m_l': 1.25},)),
        Scenario('step', 'a step shaped by three poles at 4 rad/s for the reference', (
            {'trajectory.kind': 'reference_model', 'trajectory.goal': 1.0,
             'trajectory.bandwidth': 4.0,
             'trajectory.t_start': round(duration - min(8.0, 0.4 * duration), 2)},)),
        *(Scenario(f'ω = {rate:g}', f'the reference at {rate:g} rad/s',
                   ({'trajectory.frequency': rate, **UNLIMITED},)) for rate in (0.5, 2.0, 3.0)),
        *(Scenario(f'{bits} bit, {kind}', f'x in {bits} bit a turn, the velocity by '
                   f'{"difference" if kind == "difference" else "the default observer"}',
                   ({'driver.measured': 1, 'plant.resolution': 2.0 * math.pi / 2 ** bits,
                     'driver.observer_kind': kind, **UNLIMITED},))
          for bits in (16, 14, 12) for kind in ('tracking', 'difference')),
        Scenario('per mille', 'commands in whole thousandths of 20', (
            {'plant.command_resolution': 0.02},)),
        Scenario('stiction', 'the servo, static friction 1.5 and Coulomb friction 1, in place of '
                 'the plant', ({'plant.model': 'servo', 'plant.static_friction': 1.5,
                                'plant.x0': [-2.5, 3.5]},)),
        Scenario('backlash', 'a play of 0.5 between command and dead-zone',
                 ({'plant.backlash': 0.5},)),
        Scenario('delay 2, noise', 'two samples late, with the noise of `noise`, one seed',
                 ({'loop.delay': 2, 'plant.noise': [1e-3, 1e-2]},)),
    )
    return {item.name: item for item in found}


def base_configuration(duration: float = DURATION) -> dict[str, Any]:
    """Return the flat configuration that scenarios and entrants change, without gains."""
    c = Configuration.from_flat({'loop.duration': duration})
    gains = {f'controller.{item.name}' for item in fields(type(c.law.gains))}
    return {key: value for key, value in c.to_flat().items() if key not in gains}


def yardstick() -> tuple[float, ...]:
    """Return Ω_ε of the paper's law on the example, units of x, x', the same for every law."""
    c = Configuration.from_flat({})
    design = c.law.design
    assert design is not None
    return guaranteed_bounds(design.lambda_, design.epsilon, c.plant.order)


def choose(kind: str, known: Mapping[str, Any], names: Sequence[str] | None) -> dict[str, Any]:
    """Return those of the known that are named, in the order named; all where none is.

    A name matches entrants of the law of that name too: `exact_inverse` means all three.

    Raises:
        UnknownNameError: A name that matches nothing.
    """
    if not names:
        return dict(known)
    found: dict[str, Any] = {}
    for name in names:
        matches = [item for item in known if item == name or item.startswith(f'{name} k=')]
        if not matches:
            mark = '; ' if any(',' in item for item in known) else ', '     # as they are given
            raise UnknownNameError(kind, name,
                                   f'known: {mark.join(known)}{suggestion(name, known)}')
        found.update({item: known[item] for item in matches})
    return found

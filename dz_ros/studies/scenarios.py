"""The comparison's scenarios and entrants (ours), defined here and nowhere else.

Plant, reference and initial state are the example of [wang2004]; every scenario changes one thing
about plant, actuator, sensor or transport and nothing about the controller, which is told none
of it. Only the limit of the actuator, which stands on its plate, is told under `saturation`: to
`robust` (v_max). `extended` is told as well, without effect, because its anti_windup is off; no
other law has a place for it. All other gains are the same in every scenario: nobody is tuned for
one. `exact_inverse` keeps the break points of the example, so under `drift` it is not exact.

- noise: σ = 1e-3 on x, 1e-2 on x', one member a seed
- kick: ±20 on x'' for 50 ms, at four instants a quarter of the reference's period apart, in the
  window that the metrics are of
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.tracking import guaranteed_bounds
from dz_ros.errors import UnknownNameError

DURATION = 60.0
"""Length of every run [s]."""
SEEDS = 5
"""Members of the scenario `noise`."""
KICK = 20.0
"""Acceleration of the kick [1/s²]."""
KICK_LENGTH = 0.05
"""Duration of the kick [s]."""
FIRST_KICK = 9.0
"""The first kick is this long before the end of the run [s]."""
IDEAL = 'exact_inverse'
"""The law that is told what nobody knows, so no rival."""


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


@dataclass(frozen=True)
class Entrant:
    """A law with its gains.

    Attributes:
        name: Its name.
        summary: What it is.
        changes: Keys of the configuration that make it.
    """

    name: str
    summary: str
    changes: Mapping[str, Any]


def scenarios(duration: float = DURATION, seeds: int = SEEDS) -> dict[str, Scenario]:
    """Return name → scenario, in the order of the tables.

    Args:
        duration: Length of the runs [s]; places the kicks in its last part.
        seeds: Members of the scenario `noise`.
    """
    first = max(duration - min(FIRST_KICK, 0.45 * duration), 0.0)
    apart = min(0.5 * math.pi, 0.1 * duration)
    kicks = tuple({'plant.kick': [round(first + place * apart, 2), sign * KICK, KICK_LENGTH]}
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
        Scenario('saturation', 'the actuator clips |v| to 10; robust is told so (v_max)', (
            {'plant.command_limit': 10.0, 'controller.v_max': 10.0},)),
        Scenario('delay 1', 'the actuator acts one sample late', ({'loop.delay': 1},)),
        Scenario('delay 2', 'the actuator acts two samples late', ({'loop.delay': 2},)),
        Scenario('b=2, delay 1', 'twice the input gain and one sample late',
                 ({'plant.b': 2.0, 'loop.delay': 1},)),
        Scenario('kick', f"x'' pushed by ±{KICK:g} for {1e3 * KICK_LENGTH:g} ms at 4 instants",
                 kicks),
        Scenario('slopes 1.25, 0.5', 'dead-zone steeper on the right',
                 ({'plant.dead_zone.m_r': 1.25, 'plant.dead_zone.m_l': 0.5},)),
        Scenario('slopes 0.5, 1.25', 'dead-zone steeper on the left',
                 ({'plant.dead_zone.m_r': 0.5, 'plant.dead_zone.m_l': 1.25},)),
    )
    return {item.name: item for item in found}


def entrants() -> dict[str, Entrant]:
    """Return name → entrant: every law that comes with the package, and variants worth a row."""
    found = [
        Entrant('robust', 'the recommended law', {'controller.law': 'robust'}),
        Entrant('wang2004', "the paper's law", {'controller.law': 'wang2004'}),
        Entrant('extended', "the paper's law with projection and the bounded integral",
                {'controller.law': 'extended', 'controller.projection': True,
                 'controller.integral': True}),
        *(Entrant(name, summary, {'controller.law': name}) for name, summary in (
            ('pd', 'PD'), ('pid', 'PID'), ('adaptive', 'adaptive without a robust term'),
            ('sliding', 'adaptive sliding, after Slotine and Coetsee'),
            ('sliding_integral', 'the same with an integral in the surface'))),
        *(Entrant(f'{IDEAL} k={k:g}', 'knows b_r and b_l of the example: an ideal, not a rival',
                  {'controller.law': IDEAL, 'controller.k': k})
          for k in (0.0, 1.47, 2.5)),
        *(Entrant(name, summary, {'controller.law': name}) for name, summary in (
            ('adaptive_inverse', 'adaptive inverse, after Tao and Kokotović'),
            ('fuzzy', 'fuzzy compensation, after Lewis et al.'),
            ('neural', 'neural compensation, after Selmic and Lewis'))),
    ]
    return {item.name: item for item in found}


def base_configuration(duration: float = DURATION) -> dict[str, Any]:
    """Return the flat configuration that scenarios and entrants change."""
    return Configuration.from_flat({'loop.duration': duration}).to_flat()


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
            raise UnknownNameError(kind, name, 'known: ' + ', '.join(known))
        found.update({item: known[item] for item in matches})
    return found

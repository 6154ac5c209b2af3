"""From what was found to a configuration that is ready to run (ours).

b and m show only as their product. b is kept as configured and m = (b m)/b, so that all the
uncertainty is in the bounds of m and none in those of b: where b is wrong by a factor, m makes up
for it, and no rule asks for more than the product or for ρ/m, in which b does not stand. Both
sides share one slope in the law: its bounds span those of both.

The dead-zone and the a_i of the configuration become the estimates, its drift none; the gains are
those of `dz_ros.studies.tune`, which keeps the design rules.
"""

from __future__ import annotations

import math
from typing import Any

from dz_ros.analysis.fit_parameters import parameters_with
from dz_ros.core.configuration import Configuration
from dz_ros.core.schema import fields
from dz_ros.errors import ConfigurationError
from dz_ros.identification.bounds import Identified
from dz_ros.studies.tune import Proposal, tune

LAW = 'robust'
"""Where the configured law has no robust gain."""


def known_bounds(c: Configuration, found: Identified) -> dict[str, Any]:
    """Return the keys of what the law may know of the dead-zone, (A4)."""
    b_r, b_l, right, left = found.bounds.values()
    b = c.plant.b
    return {'controller.b_r_bounds': [b_r.low, b_r.high],
            'controller.b_l_bounds': [b_l.low, b_l.high],
            'controller.m_bounds': [min(right.low, left.low) / b, max(right.high, left.high) / b],
            'controller.b_bounds': [b, b]}


def identified_model(c: Configuration, found: Identified) -> tuple[dict[str, Any], str]:
    """Return the keys of plant and dead-zone as found, and what could not be kept."""
    b_r, b_l, right, left = (item.value for item in found.bounds.values())
    zone = {'b_r': max(b_r, 0.0), 'b_l': min(b_l, 0.0), 'm_r': right / c.plant.b,
            'm_l': left / c.plant.b,
            **{f'{name}_drift': [0.0, 0.0] for name in ('b_r', 'b_l', 'm_r', 'm_l')}}
    keys: dict[str, Any] = {f'plant.dead_zone.{name}': value for name, value in zone.items()}
    try:
        keys.update(parameters_with(c.plant, found.a[:c.plant.regressor_count].tolist()))
    except ConfigurationError as error:
        return keys, f'the plant keeps its parameters: {error}'
    return keys, ''


def propose(c: Configuration, found: Identified) -> tuple[Proposal, tuple[str, ...]]:
    """Return the tuned configuration with what it gives in simulation, and notes on it.

    Args:
        c: With which the dead-zone was looked for.
        found: What was found.

    Raises:
        ConfigurationError: No gains keep the design rules at this rate.
    """
    model, note = identified_model(c, found)
    keys = {**known_bounds(c, found), **model}
    notes = [note] if note else []
    if 'k_star' not in {item.name for item in fields(type(c.law.gains))}:
        keys['controller.law'] = LAW
        notes.append(f'{c.law.name} has no k* to choose: {LAW} takes its place')
    if found.delay > 0 and c.loop.delay == 0:
        notes.append(f'commands act {found.delay} samples late: a loop through topics adds up to '
                     'one; set controller.design_delay accordingly')
    kept = {key: value for key, value in c.to_flat().items() if not (
        'controller.law' in keys and key.startswith('controller.') and key not in keys)}
    known = Configuration.from_flat({**kept, **keys})
    try:
        return tune(known), tuple(notes)
    except ConfigurationError as error:
        if error.key != '--effort' or c.plant_settings.command_limit > 0.0:
            raise
    # The effort of the gains as they were says nothing where they do not move this device.
    notes.append('no limit on |v| was known: set plant.command_limit and tune again if there is '
                 'one')
    return tune(known, effort=math.inf), tuple(notes)

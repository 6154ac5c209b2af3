# SPDX-License-Identifier: Apache-2.0
"""A configuration that is ready to run, from what was identified (ours).

b and m show only as their product. b is kept as configured and m = (b m)/b, so that all the
uncertainty is in the bounds of m and none in those of b: where b is wrong by a factor, m makes up
for it, and no rule asks for more than the product or for ρ/m, in which b does not stand. The two
sides may have slopes of their own; the law has one m, whose bounds hold both (mathematics.md §13):
ρ/m_min then divides by the smaller slope, β takes the larger. Where the break points count
friction in, the bounds hold them and 0: what has to be overcome may be either.

The dead-zone and the a_i of the configuration become the estimates, its drift none; the gains are
those of `dz_ros.studies.tune`, which keeps the design rules.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.schema import fields
from dz_ros.errors import ConfigurationError
from dz_ros.identification.estimation.least_squares import ZONE
from dz_ros.identification.estimation.physical_parameters import friction_terms, parameters_with
from dz_ros.identification.estimation.pipeline import Identified
from dz_ros.identification.estimation.prediction_error import Fit
from dz_ros.studies.tune import Proposal, tune

LAW = 'robust'
"""Where the configured law has no robust gain."""


def known_bounds(c: Configuration, found: Identified) -> dict[str, Any]:
    """Return the keys of what the law may know of the dead-zone, (A4)."""
    b_r, b_l, right, left = found.bounds.values()
    b, none = c.plant.b, found.friction_counted
    return {'controller.b_r_bounds': [0.0 if none else b_r.low, b_r.high],
            'controller.b_l_bounds': [b_l.low, 0.0 if none else b_l.high],
            'controller.m_bounds': [min(right.low, left.low) / b, max(right.high, left.high) / b],
            'controller.b_bounds': [b, b]}


def identified_model(c: Configuration, found: Identified,
                     fitted: Fit | None) -> tuple[dict[str, Any], str]:
    """Return the keys of plant and dead-zone, and what could not be kept.

    Args:
        c: With which they were identified.
        found: Means of the repeats.
        fitted: The same refined; None = there is no refinement.
    """
    if fitted is not None:
        a, zone = fitted.a, [fitted[name].value for name in ZONE]
    else:
        zone = [item.value for item in found.bounds.values()]
        if found.friction_counted:
            zone = friction_terms(c.plant, np.array(zone))[1].tolist()
        a = tuple(found.a.tolist())
    keys = zone_keys(zone, c.plant.b)
    try:
        keys.update(parameters_with(c.plant, a))
    except ConfigurationError as error:
        return keys, f'the plant keeps its parameters: {error}'
    return keys, ''


def zone_keys(zone: Sequence[float], b: float) -> dict[str, Any]:
    """Return the keys of a dead-zone without drift, given as `ZONE`."""
    b_r, b_l, right, left = zone
    values = {'b_r': max(b_r, 0.0), 'b_l': min(b_l, 0.0), 'm_r': right / b, 'm_l': left / b}
    return {**{f'plant.dead_zone.{name}': value for name, value in values.items()},
            **{f'plant.dead_zone.{name}_drift': [0.0, 0.0] for name in values}}


def propose(c: Configuration, found: Identified,
            fitted: Fit | None = None) -> tuple[Proposal, tuple[str, ...]]:
    """Return the tuned configuration with what it gives in simulation, and notes on it.

    Args:
        c: With which the dead-zone was identified.
        found: The dead-zone and its bounds.
        fitted: The plant refined by prediction error; None = by least squares.

    Raises:
        ConfigurationError: No gains keep the design rules at this rate.
    """
    model, note = identified_model(c, found, fitted)
    keys = {**known_bounds(c, found), **model}
    notes = [note] if note else []
    if 'k_star' not in {item.name for item in fields(type(c.law.gains))}:
        keys['controller.law'] = LAW
        notes.append(f'{c.law.name} has no k* to choose: {LAW} takes its place')
    if found.delay > c.loop.delay:
        keys['loop.delay'] = found.delay
        notes.append(f'commands act {found.delay} samples late: simulated and tuned with '
                     f'loop.delay = {found.delay}, and with one more as a loop through topics '
                     'may add')
    kept = {key: value for key, value in c.to_flat().items() if not (
        'controller.law' in keys and key.startswith('controller.') and key not in keys)}
    known = Configuration.from_flat({**kept, **keys})
    try:
        return tune(known), tuple(notes)
    except ConfigurationError as error:
        if error.key != '--effort' or c.plant_settings.command_limit > 0.0:
            raise
    # The effort of the earlier gains means nothing where they do not move this device.
    notes.append('no limit on |v| was known: set plant.command_limit and tune again if there is '
                 'one')
    return tune(known, effort=math.inf), tuple(notes)

# SPDX-License-Identifier: Apache-2.0
"""The same run without dead-zone, simulated: what the paper's Figs. 5 and 6 show."""

from __future__ import annotations

from dz_ros.core.dataset import from_run, RunData
from dz_ros.core.deadzone import NAMES
from dz_ros.core.loop.coupled import knows_others
from dz_ros.core.loop.offline import simulate
from dz_ros.report.view import View

LONGEST = 120.0
"""Longest simulation [s]."""
MOST_SAMPLES = 1_000_000
"""Most samples of it: a recording may hold any rate."""


def without_dead_zone(view: View) -> RunData | None:
    """Return the run of the same configuration with D(v) = v, simulated; None = not possible.

    Not possible either of one axis whose plant or law depend on the others.

    Raises:
        OverflowError: Without dead-zone the loop diverges.
    """
    c = view.setting.configuration
    if c is None or knows_others(c) or (c.dead_zone.absent and not c.zone_numbers[0]):
        return None
    zone = {f'plant.dead_zone.{key}': value for key, value in (
        ('b_r', 0.0), ('b_l', 0.0), ('m_r', 1.0), ('m_l', 1.0),
        *((f'{name}_drift', (0.0, 0.0)) for name in NAMES),
        ('schedule_points', ()), ('edge_slope', 1.0), *((f'{name}_table', ()) for name in NAMES))}
    duration = max(min(view.rows.duration, LONGEST, MOST_SAMPLES * c.loop.period),
                   2.0 * c.loop.period)
    return from_run(simulate(c.replace(**zone, **{'loop.duration': duration})))

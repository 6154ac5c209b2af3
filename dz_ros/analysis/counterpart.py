"""The same run without dead-zone, simulated: what the paper's Figs. 5 and 6 show."""

from __future__ import annotations

from dz_ros.analysis.view import View
from dz_ros.core.dataset import from_run, RunData
from dz_ros.core.loop import simulate

LONGEST = 120.0
"""Length to which the counterpart of a long run is cut [s]."""


def without_dead_zone(view: View) -> RunData | None:
    """Return the run of the same configuration with D(v) = v, simulated off line.

    None where the run has no configuration that works here, or has no dead-zone itself.

    Raises:
        OverflowError: Without dead-zone the loop diverges.
    """
    c = view.setting.configuration
    if c is None or (c.dead_zone.b_r == c.dead_zone.b_l == 0.0 and not c.dead_zone.constants[0]):
        return None
    zone = {f'plant.dead_zone.{key}': value for key, value in (
        ('b_r', 0.0), ('b_l', 0.0), ('m_r', 1.0), ('m_l', 1.0),
        *((f'{name}_drift', (0.0, 0.0)) for name in ('b_r', 'b_l', 'm_r', 'm_l')))}
    duration = min(max(view.rows.duration, 2.0 * c.loop.period), LONGEST)
    return from_run(simulate(c.replace(**zone, **{'loop.duration': duration})))

# SPDX-License-Identifier: Apache-2.0
"""Whether a device needs more to begin to move than to go on: static friction (ours).

The estimator's model has friction that only depends on the speed. By it a device begins to move at

    v_0 = b + Σ_i a_i Y_i(±) / (b m)       over the friction terms Y_i, on either side

and at the break point alone where friction is counted in. Ramps show where it did begin. Static
friction makes that later, and no dead-zone can: what the law then knows of the dead-zone is true
while it moves, and at rest it may hunt.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.identification.estimation.physical_parameters import FAST
from dz_ros.identification.estimation.pipeline import Identified

SHARE = 0.3
"""Excess over v_0 that counts: a ramp goes on by up to 0.24 until the motion of `servo` shows."""


def excess(found: Identified, breakaway: Sequence[float],
           c: Configuration) -> tuple[float, float] | None:
    """Return the median begin of motion over v_0 on the right and on the left, 1 = as modelled.

    Args:
        found: What was identified.
        breakaway: v at which motion began on each ramp, the sign of v its side.
        c: The model of the plant.

    Returns:
        None where the plant has no friction, or a side has no ramp.
    """
    starts = np.asarray(breakaway, dtype=float)
    if not c.plant.friction or not ((starts > 0.0).any() and (starts < 0.0).any()):
        return None
    explained: dict[float, float] = {}
    y = [0.0] * c.plant.regressor_count
    b_r, b_l, right, left = (item.value for item in found.bounds.values())
    for side, edge, slope in ((1.0, b_r, right), (-1.0, b_l, left)):
        begin = edge
        if not found.friction_counted:
            c.plant.regressors([0.0, side * FAST, *[0.0] * (c.plant.order - 2)],
                               c.plant.constants, y)
            force = sum(float(found.a[i]) * y[i] for i in c.plant.friction)
            begin += force / slope
        explained[side] = begin
    if min(explained[1.0], -explained[-1.0]) <= 0.0:
        return None
    ratios = [float(np.median(starts[starts * side > 0.0])) / begin
              for side, begin in explained.items()]
    return ratios[0], ratios[1]


def static_friction_note(found: Identified, breakaway: Sequence[float],
                         c: Configuration) -> str:
    """Return a warning where both sides begin to move later than modelled; '' else."""
    ratios = excess(found, breakaway, c)
    if ratios is None or min(ratios) <= 1.0 + SHARE:
        return ''
    return (f'motion begins at {ratios[0]:.2f} (right) and {ratios[1]:.2f} (left) times the '
            'command that friction and dead-zone explain while it moves: friction that sticks, '
            'which is no dead-zone and makes a loop hunt at rest; see controller.error_band and '
            'controller.regressors_at')

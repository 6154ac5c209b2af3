# SPDX-License-Identifier: Apache-2.0
"""From rest to rest along the smooth step, once or back and forth (ours).

    x_d = start + (goal − start) σ((t − t_start)/duration)

σ: `dz_ros.core.trajectories.smooth_step`. Largest speed 2.46, largest acceleration 9.37 of
(goal − start)/duration and …/duration².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.schema import parameter
from dz_ros.core.trajectories.base import Trajectory
from dz_ros.core.trajectories.smooth_step import CONTINUOUS, smooth_step


@dataclass(frozen=True)
class PointToPointParameters:
    """Parameters of the motion."""

    start: float = parameter(0.0, 'unit of x', 'where it starts')
    goal: float = parameter(1.0, 'unit of x', 'where it goes')
    t_start: float = parameter(1.0, 's', 'when it starts', minimum=0.0)
    duration: float = parameter(3.0, 's', 'time from start to goal', minimum=0.0,
                                open_minimum=True)
    repeat: bool = parameter(False, '', 'go back and forth for ever')
    dwell: float = parameter(1.0, 's', 'rest at either end when it repeats', minimum=0.0)


class PointToPoint(Trajectory):
    """Polynomial of degree 9 from rest to rest; the goal is held, or left again after a dwell."""

    name = 'point_to_point'
    summary = 'smooth motion from rest to rest, once or back and forth'
    max_order = CONTINUOUS
    Parameters = PointToPointParameters

    @staticmethod
    def evaluate(t: float, p: Sequence[float], x_d: Any) -> None:
        """Write the motion and its derivatives."""
        origin = p[0]
        distance = p[1] - p[0]
        elapsed = t - p[2]
        if p[4] != 0.0 and elapsed > 0.0:
            leg = p[3] + p[5]
            legs = math.floor(elapsed / leg)
            elapsed -= legs * leg
            if legs % 2 == 1:
                origin = p[1]
                distance = -distance
        u = elapsed / p[3]
        if u >= 1.0:  # exactly the goal, not a rounding beside it
            origin += distance
            distance = 0.0
        scale = distance
        for i in range(len(x_d)):
            x_d[i] = scale * smooth_step(u, i)
            scale /= p[3]
        x_d[0] += origin

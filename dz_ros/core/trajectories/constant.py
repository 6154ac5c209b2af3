# SPDX-License-Identifier: Apache-2.0
"""A constant set point, x_d = c."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dz_ros.core.schema import parameter
from dz_ros.core.trajectories.base import Trajectory


@dataclass(frozen=True)
class ConstantParameters:
    """The value held."""

    value: float = parameter(0.0, 'unit of x', 'value c')


class Constant(Trajectory):
    """x_d = c, all derivatives zero."""

    name = 'constant'
    summary = 'a set point that does not move'
    Parameters = ConstantParameters

    @staticmethod
    def evaluate(t: float, p: Sequence[float], x_d: Any) -> None:  # noqa: ARG004
        """Write the value and zeros."""
        x_d[0] = p[0]
        for i in range(1, len(x_d)):
            x_d[i] = 0.0

# SPDX-License-Identifier: Apache-2.0
"""Level h of a tank with an outlet: A h' = w − c √h, w the flow of a valve with a dead-zone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.plants.base import Plant
from dz_ros.core.schema import parameter


@dataclass(frozen=True)
class TankParameters:
    """Parameters of the tank."""

    area: float = parameter(0.05, 'm²', 'cross-section A', minimum=0.0, open_minimum=True)
    outlet: float = parameter(0.5, 'l/s per √m', 'coefficient c of the outlet', minimum=0.0)


class Tank(Plant):
    """Order 1, one regressor: Y = √h, a = c/A, b = 1/A."""

    name = 'tank'
    summary = 'level of a tank with an outlet, order 1'
    order = 1
    regressor_count = 1
    state_units = ('m',)
    actuator_unit = 'l/s'
    regressor_units = ('√m',)
    default_x0 = (0.2,)
    Parameters = TankParameters

    @property
    def a(self) -> tuple[float, ...]:
        """c/A [√m/s]."""
        return (self.parameters.outlet * self.b,)

    @property
    def b(self) -> float:
        """1/A [m/s per l/s]."""
        return float(1e-3 / self.parameters.area)

    @staticmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:  # noqa: ARG004
        """Write √h, 0 for an empty tank."""
        y[0] = math.sqrt(max(x[0], 0.0))

# SPDX-License-Identifier: Apache-2.0
"""The example plant of Wang, Su and Hong (2004), (19) as printed [wang2004].

    x'' = a1 (1 − e^−x)/(1 + e^−x) − a2 (x² + 2x) sin x − 0.5 a3 x sin 3t + b w

State (x, x') without physical units. Y1 = −(1 − e^−x)/(1 + e^−x) = −tanh(x/2),
Y2 = (x² + 2x) sin x; the term in a3 is the disturbance, which the controller ignores.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.plants.base import Plant
from dz_ros.core.schema import parameter


@dataclass(frozen=True)
class ExampleParameters:
    """Parameters of (19); the values are the paper's."""

    a1: float = parameter(1.0, '1/s²', 'weight of the first nonlinearity')
    a2: float = parameter(1.0, '1/s²', 'weight of the second nonlinearity')
    a3: float = parameter(1.0, '1/s²', 'weight of the disturbance 0.5 a3 x sin 3t')
    b: float = parameter(1.0, '1/s²', 'input gain', minimum=0.0, open_minimum=True)


class Wang2004(Plant):
    """Plant (19), position in the second term."""

    name = 'wang2004'
    summary = 'example (19) of Wang, Su and Hong 2004 as printed, order 2'
    order = 2
    regressor_count = 2
    state_units = ('1', '1/s')
    actuator_unit = '1'
    regressor_units = ('1', '1')
    default_x0 = (-2.5, 3.5)
    Parameters = ExampleParameters

    @property
    def a(self) -> tuple[float, ...]:
        """True a_1, a_2."""
        return (self.parameters.a1, self.parameters.a2)

    @property
    def b(self) -> float:
        """True input gain."""
        return float(self.parameters.b)

    @property
    def extra(self) -> tuple[float, ...]:
        """a_3, the weight of the disturbance."""
        return (self.parameters.a3,)

    @staticmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:  # noqa: ARG004
        """Write Y1 = −tanh(x/2), Y2 = (x² + 2x) sin x."""
        position = x[0]
        y[0] = -math.tanh(0.5 * position)
        y[1] = (position * position + 2.0 * position) * math.sin(position)

    @staticmethod
    def disturbance(t: float, x: Sequence[float], p: Sequence[float]) -> float:
        """Return 0.5 a3 x sin 3t."""
        return 0.5 * p[3] * x[0] * math.sin(3.0 * t)

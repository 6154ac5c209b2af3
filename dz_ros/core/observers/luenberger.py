# SPDX-License-Identifier: Apache-2.0
"""A velocity that is not measured, from positions: the discrete Luenberger observer (ours).

With the reference's acceleration a taken for the plant's, over the interval T between two
measurements x:

    x⁻ = x̂ + T v̂ + ½ T² a        v⁻ = v̂ + T a                      prediction
    r = x − x⁻                                                      residual
    x̂ = x⁻ + (1 − z²) r          v̂ = v⁻ + ((1 − z)²/T) r            correction

which puts both poles of the error at z = e^(−ωT). It begins at rest. An acceleration that is not
the reference's leaves a velocity error of about twice that acceleration over ω.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dz_ros.core.design.linear_loop import LinearObserver
from dz_ros.core.observers.base import closed, Observer


class Luenberger(Observer):
    """Two states, a double pole at −ω."""

    name = 'luenberger'
    size = 3

    @staticmethod
    def kernel(omega: float, memory: Any, x: float, x_d: float, v_d: float,  # noqa: ARG004
               a_d: float, dt: float) -> float:
        """One measurement; memory: begun, x̂, v̂."""
        if memory[0] == 0.0:
            memory[0], memory[1], memory[2] = 1.0, x, 0.0
        if dt <= 0.0:
            memory[1] = x
            return float(memory[2])
        z = math.exp(-omega * dt)
        predicted = memory[1] + dt * memory[2] + 0.5 * dt * dt * a_d
        moving = memory[2] + dt * a_d
        residual = x - predicted
        memory[1] = predicted + (1.0 - z * z) * residual
        memory[2] = moving + (1.0 - z) ** 2 / dt * residual
        return float(memory[2])

    @classmethod
    def linear(cls, omega: float, period: float) -> LinearObserver:
        """Return the observer on the error."""
        z = math.exp(-omega * period)
        return closed(np.array([[1.0, period], [0.0, 1.0]]),
                      np.array([1.0 - z * z, (1.0 - z) ** 2 / period]))

# SPDX-License-Identifier: Apache-2.0
"""The backward difference of the position, for comparison: (x_k − x_(k−1))/T, noise gain √2/T."""

from __future__ import annotations

from typing import Any

import numpy as np

from dz_ros.core.design.linear_loop import LinearObserver
from dz_ros.core.observers.base import Observer


class Difference(Observer):
    """No observer at all; ω is not used."""

    name = 'difference'
    size = 3

    @staticmethod
    def kernel(omega: float, memory: Any, x: float, x_d: float,  # noqa: ARG004
               v_d: float, a_d: float, dt: float) -> float:  # noqa: ARG004
        """One measurement; memory: begun, x before, velocity before."""
        if memory[0] == 0.0:
            memory[0], memory[1] = 1.0, x
        if dt > 0.0:
            memory[2] = (x - memory[1]) / dt
        memory[1] = x
        return float(memory[2])

    @classmethod
    def linear(cls, omega: float, period: float) -> LinearObserver:  # noqa: ARG003
        """Return the difference on the error."""
        return LinearObserver(np.array([[0.0, 0.0], [-1.0 / period, 0.0]]),
                              np.array([1.0, 1.0 / period]))

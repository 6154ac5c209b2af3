# SPDX-License-Identifier: Apache-2.0
"""A velocity from positions by observing the tracking error: α-β-γ with a triple pole (ours).

e = x − x_d is what is observed, and its velocity and acceleration with it:

    ê⁻ = ê + T ê' + ½ T² ê'',  ê'⁻ = ê' + T ê''                     prediction
    r = e − ê⁻
    ê = ê⁻ + (1 − z³) r,  ê' = ê'⁻ + 1.5 (1 − z)² (1 + z)/T r,  ê'' += (1 − z)³/T² r

with z = e^(−ωT); the velocity is x_d' + ê'. What the reference does costs nothing, and a constant
acceleration beside it leaves no error. By rule ω = 3 K b̂; below about 1.8 K b̂ the loop of
`robust_eso` oscillates in its layer. It begins with the reference's velocity.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dz_ros.core.design.linear_loop import LinearObserver
from dz_ros.core.observers.base import closed, Observer


class Tracking(Observer):
    """Three states of the error, a triple pole at −ω."""

    name = 'tracking'
    size = 4

    @staticmethod
    def kernel(omega: float, memory: Any, x: float, x_d: float, v_d: float,
               a_d: float, dt: float) -> float:  # noqa: ARG004
        """One measurement; memory: begun, ê, ê', ê''."""
        e = x - x_d
        if memory[0] == 0.0:
            memory[0], memory[1], memory[2], memory[3] = 1.0, e, 0.0, 0.0
        if dt <= 0.0:
            memory[1] = e
            return float(v_d + memory[2])
        z = math.exp(-omega * dt)
        predicted = memory[1] + dt * memory[2] + 0.5 * dt * dt * memory[3]
        moving = memory[2] + dt * memory[3]
        residual = e - predicted
        memory[1] = predicted + (1.0 - z * z * z) * residual
        memory[2] = moving + 1.5 * (1.0 - z) * (1.0 - z) * (1.0 + z) / dt * residual
        memory[3] += (1.0 - z) * (1.0 - z) * (1.0 - z) / (dt * dt) * residual
        return float(v_d + memory[2])

    @classmethod
    def linear(cls, omega: float, period: float) -> LinearObserver:
        """Return the observer on the error."""
        z = math.exp(-omega * period)
        return closed(np.array([[1.0, period, 0.5 * period * period], [0.0, 1.0, period],
                                [0.0, 0.0, 1.0]]),
                      np.array([1.0 - z ** 3, 1.5 * (1.0 - z) ** 2 * (1.0 + z) / period,
                                (1.0 - z) ** 3 / period ** 2]))

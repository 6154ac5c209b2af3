# SPDX-License-Identifier: Apache-2.0
"""A velocity from positions by sliding modes: Levant's differentiator of second order.

Of the tracking error e = x − x_d, with σ = z_0 − e and L ≥ |e'''| [levant2003], discrete with the
Taylor terms that keep it homogeneous [livne_levant2014]:

    z_0 += T (z_1 − 2 L^(1/3) |σ|^(2/3) sign σ) + ½ T² z_2
    z_1 += T (z_2 − 2.12 L^(2/3) |σ|^(1/3) sign σ)
    z_2 −= 1.1 T L sign σ

The velocity is x_d' + z_1, taken one prediction on, since z_k is made of measurements before t_k.
Here L = σ_x ω³ with σ_x = 1e-3 units of x, so that ω is a rate as for the others (ours).
"""

from __future__ import annotations

from typing import Any

from dz_ros.core.observers.base import Observer

SCALE = 1e-3
"""σ_x, the error at which its rate is ω [unit of x]."""


class Levant(Observer):
    """Three states of the error, exact without noise after a finite time."""

    name = 'levant'
    size = 4

    @staticmethod
    def kernel(omega: float, memory: Any, x: float, x_d: float, v_d: float,
               a_d: float, dt: float) -> float:  # noqa: ARG004
        """One measurement; memory: begun, z_0, z_1, z_2, for the time of the measurement."""
        e = x - x_d
        if memory[0] == 0.0:
            memory[0], memory[1], memory[2], memory[3] = 1.0, e, 0.0, 0.0
        if dt <= 0.0:
            memory[1] = e
            return float(v_d + memory[2])
        distance = memory[1] - e
        side = 1.0 if distance > 0.0 else -1.0
        root = (SCALE * abs(distance) * abs(distance)) ** (1.0 / 3.0)
        first = memory[2] - 2.0 * omega * root * side
        root = (SCALE * SCALE * abs(distance)) ** (1.0 / 3.0)
        second = memory[3] - 2.12 * omega * omega * root * side
        memory[1] += dt * first + 0.5 * dt * dt * memory[3]
        memory[2] += dt * second
        memory[3] -= 1.1 * dt * SCALE * omega * omega * omega * side
        return float(v_d + memory[2])

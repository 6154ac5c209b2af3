# SPDX-License-Identifier: Apache-2.0
"""Forces of a vehicle in a plane from its thrusters, and the thrusts for a wanted force (ours).

    τ = B f,   f = B⁺ τ,   B⁺ = Bᵀ (B Bᵀ)⁻¹,   f ← f min(1, f_max/max|f_j|)

τ = (surge [N], sway [N], yaw [N m]), f: thrust of each thruster [N]. The pseudo-inverse shares a
force with the least Σ f_j². Where a thruster would exceed f_max all of them are scaled, so that
the direction of τ stays [fossen2011].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

FORCES = 3
"""Surge, sway, yaw."""


def vectored(angle: float, lever: float) -> np.ndarray:
    """Return B of four thrusters in a cross, shape (3, 4).

    Front right, front left, rear right, rear left, each pushing forwards.

    Args:
        angle: Between each thruster and the vehicle's axis [rad], above 0 and below π/2.
        lever: Arm of each about the centre of mass [m].
    """
    ahead, aside = np.cos(angle), np.sin(angle)
    return np.array([[ahead, ahead, ahead, ahead], [aside, -aside, -aside, aside],
                     [lever, -lever, lever, -lever]])


def pseudo_inverse(matrix: np.ndarray) -> np.ndarray:
    """Return B⁺, shape (thrusters, 3)."""
    return np.asarray(np.linalg.pinv(matrix))


def allocate(inverse: Sequence[float], at: int, wanted: Sequence[float], most: float,
             thrusts: Any) -> float:
    """Write the thrust of each thruster for a wanted force; return the share of it that is given.

    Plain scalar code.

    Args:
        inverse: B⁺ row by row from index `at` on.
        at: Index.
        wanted: Surge, sway, yaw, shape (3,).
        most: f_max of every thruster [N].
        thrusts: Buffer, shape (thrusters,).
    """
    largest = most
    for j in range(len(thrusts)):
        total = 0.0
        for i in range(FORCES):
            total += inverse[at + FORCES * j + i] * wanted[i]
        thrusts[j] = total
        largest = max(largest, abs(total))
    share = most / largest
    for j in range(len(thrusts)):
        thrusts[j] *= share
    return share

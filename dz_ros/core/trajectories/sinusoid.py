# SPDX-License-Identifier: Apache-2.0
"""Sinusoid x_d = offset + A sin(ω t + φ); A = 2.5, ω = 1 are the paper's [wang2004]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.schema import parameter
from dz_ros.core.trajectories.base import Trajectory


@dataclass(frozen=True)
class SinusoidParameters:
    """Parameters of the sinusoid."""

    amplitude: float = parameter(2.5, 'unit of x', 'amplitude A')
    frequency: float = parameter(1.0, 'rad/s', 'angular frequency ω', minimum=0.0)
    phase: float = parameter(0.0, 'rad', 'phase φ at t = 0')
    offset: float = parameter(0.0, 'unit of x', 'mean value')


class Sinusoid(Trajectory):
    """x_d^(i) = A ω^i sin(ω t + φ + i π/2)."""

    name = 'sinusoid'
    summary = 'offset + A sin(ωt + φ); the paper tracks 2.5 sin t'
    Parameters = SinusoidParameters

    @staticmethod
    def evaluate(t: float, p: Sequence[float], x_d: Any) -> None:
        """Write the sinusoid and its derivatives."""
        angle = p[1] * t + p[2]
        sine = math.sin(angle)
        cosine = math.cos(angle)
        scale = p[0]
        for i in range(len(x_d)):
            quarter = i % 4
            if quarter == 0:
                x_d[i] = scale * sine
            elif quarter == 1:
                x_d[i] = scale * cosine
            elif quarter == 2:
                x_d[i] = -scale * sine
            else:
                x_d[i] = -scale * cosine
            scale *= p[1]
        x_d[0] += p[3]

# SPDX-License-Identifier: Apache-2.0
"""Linear sweep of frequency, faded in and out so that it starts and ends at rest (ours).

    x_d = offset + g(t) A sin q(t),   q = ω_1 t + (ω_2 − ω_1) t²/(2 D),   0 ≤ t ≤ D

g rises from 0 to 1 within `fade` as a smooth step (`dz_ros.core.trajectories.smooth_step`) and
falls back before D; afterwards x_d = offset. With S_m, C_m the m-th derivatives of sin q and cos q
and κ = q'' = (ω_2 − ω_1)/D,

    S_{m+1} = q' C_m + m κ C_{m−1},   C_{m+1} = −q' S_m − m κ S_{m−1},

and the product with g follows from the rule of Leibniz.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.schema import parameter
from dz_ros.core.trajectories.base import Trajectory
from dz_ros.core.trajectories.smooth_step import CONTINUOUS, smooth_step
from dz_ros.errors import ConfigurationError


@dataclass(frozen=True)
class ChirpParameters:
    """Parameters of the sweep."""

    amplitude: float = parameter(1.0, 'unit of x', 'amplitude A')
    start_frequency: float = parameter(0.2, 'rad/s', 'angular frequency ω_1 at t = 0', minimum=0.0)
    end_frequency: float = parameter(3.0, 'rad/s', 'angular frequency ω_2 at the end', minimum=0.0)
    duration: float = parameter(20.0, 's', 'length D of the sweep', minimum=0.0, open_minimum=True)
    fade: float = parameter(2.0, 's', 'time in which the amplitude rises, and falls again',
                            minimum=0.0, open_minimum=True)
    offset: float = parameter(0.0, 'unit of x', 'mean value, held after the sweep')

    def check(self, prefix: str) -> None:
        """Check that rise and fall fit into the sweep."""
        if 2.0 * self.fade > self.duration:
            raise ConfigurationError(f'{prefix}fade', self.fade, 'must be at most half of '
                                     f'{prefix}duration = {self.duration:g} s')


class Chirp(Trajectory):
    """A sinusoid whose frequency grows or falls linearly."""

    name = 'chirp'
    summary = 'linear sweep of frequency, from rest to rest'
    max_order = CONTINUOUS
    Parameters = ChirpParameters

    @property
    def constants(self) -> tuple[float, ...]:
        """A, ω_1, κ, D, fade, offset."""
        p = self.parameters
        return (p.amplitude, p.start_frequency, (p.end_frequency - p.start_frequency) / p.duration,
                p.duration, p.fade, p.offset)

    @staticmethod
    def evaluate(t: float, p: Sequence[float], x_d: Any) -> None:
        """Write the sweep and its derivatives."""
        count = len(x_d)
        if t <= 0.0 or t >= p[3]:
            for i in range(count):
                x_d[i] = 0.0
            x_d[0] = p[5]
            return
        rate = p[1] + p[2] * t
        angle = (p[1] + 0.5 * p[2] * t) * t
        sine, cosine = math.sin(angle), math.cos(angle)
        sine_before, cosine_before = 0.0, 0.0
        for m in range(count):
            x_d[m] = p[0] * sine
            bend = m * p[2]
            sine_next = rate * cosine + bend * cosine_before
            cosine_next = -rate * sine - bend * sine_before
            sine_before, cosine_before = sine, cosine
            sine, cosine = sine_next, cosine_next
        if t < p[4]:
            u, slope = t / p[4], 1.0 / p[4]
        elif t > p[3] - p[4]:
            u, slope = (p[3] - t) / p[4], -1.0 / p[4]
        else:
            x_d[0] += p[5]
            return
        for m in range(count - 1, -1, -1):  # downwards: each needs the lower ones unfaded
            total = 0.0
            weight = 1.0
            for j in range(m, -1, -1):
                total += weight * smooth_step(u, m - j) * x_d[j]
                weight = weight * slope * j / (m - j + 1)
            x_d[m] = total
        x_d[0] += p[5]

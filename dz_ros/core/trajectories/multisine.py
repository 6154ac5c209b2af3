# SPDX-License-Identifier: Apache-2.0
"""Sum of sinusoids, x_d = offset + Σ A_j sin(ω_j t + φ_j): r sinusoids excite 2r parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.schema import parameter
from dz_ros.core.trajectories.base import Trajectory
from dz_ros.errors import ConfigurationError


@dataclass(frozen=True)
class MultisineParameters:
    """Parameters of the sum; the frequencies decide how many sinusoids it has."""

    amplitudes: tuple[float, ...] = parameter(
        (1.5, 1.0), 'unit of x', 'amplitude A_j of each sinusoid, or one for all')
    frequencies: tuple[float, ...] = parameter(
        (0.7, 1.9), 'rad/s', 'angular frequency ω_j of each sinusoid', minimum=0.0)
    phases: tuple[float, ...] = parameter(
        (0.0,), 'rad', 'phase φ_j of each sinusoid at t = 0, or one for all')
    offset: float = parameter(0.0, 'unit of x', 'mean value')

    def check(self, prefix: str) -> None:
        """Check that the lists fit together."""
        count = len(self.frequencies)
        if count == 0:
            raise ConfigurationError(f'{prefix}frequencies', [], 'must have at least one number')
        for name in ('amplitudes', 'phases'):
            given = getattr(self, name)
            if len(given) not in (1, count):
                allowed = '1 number' if count == 1 else f'1 or {count} numbers'
                raise ConfigurationError(f'{prefix}{name}', list(given),
                                         f'must have {allowed}, one for each of frequencies')


class Multisine(Trajectory):
    """x_d^(i) = Σ A_j ω_j^i sin(ω_j t + φ_j + i π/2)."""

    name = 'multisine'
    summary = 'offset + sum of A sin(ωt + φ), rich enough to distinguish parameters'
    Parameters = MultisineParameters

    @property
    def constants(self) -> tuple[float, ...]:
        """Offset, then amplitude, frequency, phase of each sinusoid."""
        p = self.parameters
        count = len(p.frequencies)
        amplitudes = p.amplitudes if len(p.amplitudes) == count else p.amplitudes * count
        phases = p.phases if len(p.phases) == count else p.phases * count
        return (p.offset, *(number for sinusoid in zip(amplitudes, p.frequencies, phases,
                                                       strict=True) for number in sinusoid))

    @staticmethod
    def evaluate(t: float, p: Sequence[float], x_d: Any) -> None:
        """Write the sum and its derivatives."""
        for i in range(len(x_d)):
            x_d[i] = 0.0
        for j in range(1, len(p), 3):
            frequency = p[j + 1]
            angle = frequency * t + p[j + 2]
            sine = math.sin(angle)
            cosine = math.cos(angle)
            scale = p[j]
            for i in range(len(x_d)):
                quarter = i % 4
                if quarter == 0:
                    x_d[i] += scale * sine
                elif quarter == 1:
                    x_d[i] += scale * cosine
                elif quarter == 2:
                    x_d[i] -= scale * sine
                else:
                    x_d[i] -= scale * cosine
                scale *= frequency
        x_d[0] += p[0]

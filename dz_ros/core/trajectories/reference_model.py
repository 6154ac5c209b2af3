# SPDX-License-Identifier: Apache-2.0
"""A step, shaped by a critically damped reference model of one order more than the plant (ours).

    x_d = start + (goal − start) f(z),   f = 1 − e^−z Σ_{i<N} z^i/i!,   z = ω (t − t_start)

The step response of (ω/(p + ω))^N. With g_j = e^−z z^j/j!, dg_j/dz = g_{j−1} − g_j and df/dz =
g_{N−1}, so

    d^m f/dz^m = Σ_{i<m} (−1)^(m−1−i) C(m−1, i) g_{N−1−i}.

N = n + 1 poles make x_d^(n) continuous: the reference asks for no jump of the command.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.schema import parameter
from dz_ros.core.trajectories.base import Trajectory


@dataclass(frozen=True)
class ReferenceModelParameters:
    """Parameters of step and model."""

    start: float = parameter(0.0, 'unit of x', 'value before the step')
    goal: float = parameter(1.0, 'unit of x', 'value after the step')
    t_start: float = parameter(1.0, 's', 'time of the step', minimum=0.0)
    bandwidth: float = parameter(2.0, 'rad/s', 'each pole of the model lies at −ω', minimum=0.0,
                                 open_minimum=True)


class ReferenceModel(Trajectory):
    """Step response of N equal poles."""

    name = 'reference_model'
    summary = 'a step shaped by a critically damped reference model'
    Parameters = ReferenceModelParameters

    @property
    def constants(self) -> tuple[float, ...]:
        """Start, step, start time, ω, N."""
        p = self.parameters
        return (p.start, p.goal - p.start, p.t_start, p.bandwidth, float(self.order + 1))

    @staticmethod
    def evaluate(t: float, p: Sequence[float], x_d: Any) -> None:
        """Write the response and its derivatives."""
        for i in range(len(x_d)):
            x_d[i] = 0.0
        x_d[0] = p[0]
        z = p[3] * (t - p[2])
        if z <= 0.0:
            return
        poles = int(p[4])
        decay = math.exp(-z)
        rest = 0.0
        term = decay
        for i in range(poles):
            rest += term
            term = term * z / (i + 1)
        x_d[0] += p[1] * (1.0 - rest)
        scale = p[1]
        for m in range(1, len(x_d)):
            scale *= p[3]
            total = 0.0
            weight = 1.0 if m % 2 == 1 else -1.0
            for i in range(m):
                if poles - 1 - i >= 0:
                    term = decay
                    for j in range(poles - 1 - i):
                        term = term * z / (j + 1)
                    total += weight * term
                weight = -weight * (m - 1 - i) / (i + 1)
            x_d[m] = scale * total

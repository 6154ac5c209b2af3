# SPDX-License-Identifier: Apache-2.0
"""PI control of the filtered error: v = −k_p s − k_i ∫ s dt, with s = Λᵀ x̃."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dz_ros.core.laws.base import Law
from dz_ros.core.schema import parameter
from dz_ros.core.signals import S, Signal, STATUS, V_DAMPING, V_EXTRA
from dz_ros.core.tracking import error_weights


@dataclass(frozen=True)
class PiGains:
    """Gains."""

    lambda_: float = parameter(1.0, '1/s', 'slope λ of the filtered error', minimum=0.0,
                               open_minimum=True)
    k_p: float = parameter(10.0, 'actuator unit per unit of s', 'proportional gain', minimum=0.0)
    k_i: float = parameter(1.0, 'actuator unit per unit of s and second', 'integral gain',
                           minimum=0.0)


class Pi(Law):
    """Any order; the memory is the integral, which is published as it was used."""

    name = 'pi'
    summary = 'PI control of the filtered error'
    Gains = PiGains

    @property
    def constants(self) -> tuple[float, ...]:
        """k_p, k_i, Λ."""
        g = self.gains
        return (g.k_p, g.k_i, *error_weights(g.lambda_, self.order))

    @property
    def signals(self) -> tuple[Signal, ...]:
        """The integral, in the unit of s times s."""
        return (Signal('integral', 'x^(n-1) s', 'integral of the filtered error', symbol='∫s'),)

    def initial_memory(self) -> tuple[float, ...]:
        """Nothing integrated yet."""
        return (0.0,)

    @staticmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
               x: Sequence[float], y: Sequence[float], dt: float,  # noqa: ARG004
               new_memory: Any, terms: Any) -> float:
        """One sample."""
        s = 0.0
        for i in range(len(x)):
            s += c[2 + i] * (x[i] - x_d[i])
        new_memory[0] = memory[0] + dt * s
        terms[S] = s
        terms[V_DAMPING] = -c[0] * s
        terms[V_EXTRA] = -c[1] * memory[0]
        terms[STATUS] = 0.0
        terms[STATUS + 1] = memory[0]
        v: float = terms[V_DAMPING] + terms[V_EXTRA]
        return v

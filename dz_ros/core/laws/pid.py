"""PID control, the second baseline [astrom_hagglund1995], for any order n (ours for n ≠ 2).

    v  = −k_d (λⁿ I + n λ^(n−1) x̃ + … + n λ x̃^(n−2) + x̃^(n−1)),   the weights of (p + λ)ⁿ
    I' = x̃
    n = 2:  v = −k_d (x̃' + 2λ x̃ + λ² I)

I advances by one Euler step after v. Proven for a linear plant only; behind a dead-zone the
integral has to cross the band at every change of sign, which costs time and overshoot, and at
rest it may hunt. No anti-windup: I runs on while the actuator saturates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dz_ros.core.laws.base import Design, Law
from dz_ros.core.records import STATUS
from dz_ros.core.schema import parameter
from dz_ros.core.tracking import error_weights, filtered_error


@dataclass(frozen=True)
class PidGains:
    """Gains of PID control; the values are ours."""

    lambda_: float = parameter(1.0, '1/s', 'n-fold corner frequency λ', minimum=0.0,
                               open_minimum=True)
    k_d: float = parameter(10.0, 'actuator unit per unit of x^(n−1)', 'gain k_d', minimum=0.0,
                           open_minimum=True)


class Pid(Law):
    """Proportional, integral and derivative action, n-fold corner."""

    name = 'pid'
    summary = "PID baseline: -k_d (x̃' + 2λ x̃ + λ² ∫x̃)"
    Gains = PidGains

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, weights of I, x̃, …, x̃^(n−1)."""
        return (self.gains.k_d, *error_weights(self.gains.lambda_, self.order + 1))

    @property
    def signal_names(self) -> tuple[str, ...]:
        """I as used in v."""
        return ('integral',)

    @property
    def design(self) -> Design:
        """What the design rules need: no layer, no robust term."""
        return Design(self.gains.lambda_, self.gains.k_d, 0.0, 0.0, self.gains.k_d, 0.0)

    def initial_memory(self) -> tuple[float, ...]:
        """I = 0."""
        return (0.0,)

    def memory_from_signals(self, signals: Sequence[float]) -> tuple[float, ...]:
        """I is published as it was used."""
        return tuple(signals)

    @staticmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
               x: Sequence[float], y: Sequence[float], dt: float,  # noqa: ARG004
               new_memory: Any, terms: Any) -> float:
        """One sample."""
        s = c[1] * memory[0] + filtered_error(c, 2, x_d, x)
        v = -c[0] * s
        new_memory[0] = memory[0] + dt * (x[0] - x_d[0])
        terms[0] = s
        terms[1] = 0.0
        terms[2] = x_d[len(x)]
        terms[3] = v
        terms[4] = 0.0
        terms[5] = 0.0
        terms[6] = 0.0
        terms[7] = 0.0
        terms[STATUS] = 0.0
        terms[STATUS + 1] = memory[0]
        return v

"""PD control, the first baseline [astrom_hagglund1995], written in s (ours).

    v = −k_d s (+ x_d^(n) if feed_forward),   s = Λᵀ x̃;   for n = 2: −k_d (x̃' + λ x̃)

Any order n; for n = 2 the proportional gain is k_d λ, the derivative gain k_d. k_d = 10 is that of
[wang2004], λ = 1 as for the other laws here (ours); feed_forward takes b m = 1 for granted and is
off.

Proven: nothing, here or in [wang2004]. Nothing adapts and no term covers the dead-zone, so not
even a perfect model makes the error go to zero; behind a dead-zone alone it is of the order of
its width over k_d λ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dz_ros.core.laws.base import Design, Law
from dz_ros.core.records import STATUS
from dz_ros.core.schema import parameter
from dz_ros.core.tracking import error_weights


@dataclass(frozen=True)
class PdGains:
    """Gains of PD control."""

    lambda_: float = parameter(1.0, '1/s', 'slope λ of the filtered error (8)',
                               minimum=0.0, open_minimum=True)
    k_d: float = parameter(10.0, 'actuator unit per unit of s', 'gain k_d',
                           minimum=0.0, open_minimum=True)
    feed_forward: bool = parameter(False, '', 'add x_d^(n) to the command')


class Pd(Law):
    """Proportional action on the filtered error."""

    name = 'pd'
    summary = 'PD baseline: -k_d s, optionally + x_d^(n)'
    Gains = PdGains

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, weight of x_d^(n), Λ."""
        g = self.gains
        return (g.k_d, 1.0 if g.feed_forward else 0.0, *error_weights(g.lambda_, self.order))

    @property
    def signal_names(self) -> tuple[str, ...]:
        """None: nothing is estimated."""
        return ()

    @property
    def design(self) -> Design:
        """What the design rules need: no layer, no robust term."""
        return Design(self.gains.lambda_, self.gains.k_d, 0.0, 0.0, self.gains.k_d, 0.0)

    def initial_memory(self) -> tuple[float, ...]:
        """Return the empty memory."""
        return ()

    def memory_from_signals(self, signals: Sequence[float]) -> tuple[float, ...]:  # noqa: ARG002
        """Return the empty memory."""
        return ()

    @staticmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],  # noqa: ARG004
               x: Sequence[float], y: Sequence[float], dt: float,  # noqa: ARG004
               new_memory: Any, terms: Any) -> float:  # noqa: ARG004
        """One sample."""
        n = len(x)
        s = 0.0
        for i in range(n):
            s += c[2 + i] * (x[i] - x_d[i])
        v_damping = -c[0] * s
        v_feed_forward = c[1] * x_d[n]
        terms[0] = s
        terms[1] = 0.0
        terms[2] = x_d[n]
        terms[3] = v_damping
        terms[4] = v_feed_forward
        terms[5] = 0.0
        terms[6] = 0.0
        terms[7] = 0.0
        terms[STATUS] = 0.0
        return v_damping + v_feed_forward

# SPDX-License-Identifier: Apache-2.0
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

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from dz_ros.core.laws.base import Design, Law, Numbers, Tunable
from dz_ros.core.schema import parameter
from dz_ros.core.signals import S, STATUS, U_FD, V_DAMPING, V_FEED_FORWARD
from dz_ros.core.tracking import error_weights, filtered_error


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
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 0.3, 60.0), Tunable('k_d', 2.0, 150.0),)

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, weight of x_d^(n), Λ."""
        g = self.gains
        return (g.k_d, 1.0 if g.feed_forward else 0.0, *error_weights(g.lambda_, self.order))

    @cached_property
    def design(self) -> Design:
        """What the design rules need: no layer, no robust term."""
        return Design(self.gains.lambda_, self.gains.k_d, 0.0, 0.0, self.gains.k_d, 0.0)

    @staticmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,  # noqa: ARG004
               dt: float, new_memory: Any, terms: Any) -> float:  # noqa: ARG004
        """One sample."""
        n = len(x)
        s = filtered_error(c, 2, x_d, x)
        v_damping = -c[0] * s
        v_feed_forward = c[1] * x_d[n]
        terms[S] = s
        terms[U_FD] = x_d[n]
        terms[V_DAMPING] = v_damping
        terms[V_FEED_FORWARD] = v_feed_forward
        terms[STATUS] = 0.0
        return v_damping + v_feed_forward

# SPDX-License-Identifier: Apache-2.0
"""Linear active disturbance rejection with one or two extended states [gao2003].

    v = (x_d^(n) − K_cᵀ x̃ − f̂)/b̂,   K_c the weights of (p + λ)^n without the leading one
    e = x̃^(n−1):  e' = f + b̂ v − x_d^(n),   f all the rest: plant, dead-zone, disturbance

f̂ from an observer of e with all poles at −ω_o: f constant (one extended state) or a ramp (two),
discrete with poles at z = e^(−ω_o T); that it takes the measured x̃^(n−1) instead of all states
from x is ours, as is d: the command that acts in the observer is that of d samples ago. No
regressors, no bounds. Written with s and u_fd: K_cᵀ x̃ = λ s + Λ_vᵀ x̃.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Any, ClassVar

from dz_ros.core.design.linear_loop import LayerModel
from dz_ros.core.laws.base import Design, publish, Tunable
from dz_ros.core.laws.nominal import clipped, Nominal, nominal_terms
from dz_ros.core.schema import parameter
from dz_ros.core.signals import Signal, STATUS, V_DAMPING, V_EXTRA, V_FEED_FORWARD
from dz_ros.core.tracking import error_weights, feed_forward_weights


@dataclass(frozen=True)
class LadrcGains:
    """Gains; the values are ours."""

    lambda_: float = parameter(15.0, '1/s', 'n-fold corner λ of the loop', minimum=0.0,
                               open_minimum=True)
    observer_rate: float = parameter(60.0, 'rad/s', 'ω_o of the observer', minimum=0.0,
                                     open_minimum=True)
    input_gain: float = parameter(1.0, 'unit of x^(n) per actuator unit', 'b̂, nominal b m',
                                  minimum=0.0, open_minimum=True)
    extended_states: int = parameter(1, '1', 'states of the rest: 1 = constant, 2 = a ramp',
                                     minimum=1, maximum=2)
    design_delay: int = parameter(1, 'samples', 'loop delay d that the observer reckons with',
                                  minimum=0, maximum=1)
    v_clip: float = parameter(16.7, 'actuator unit', 'v is clipped to this, and the observer '
                              'reckons with it; 0 = not', minimum=0.0)


class Ladrc(Nominal):
    """All that is not b̂ v is one disturbance, estimated and cancelled."""

    name = 'ladrc'
    summary = 'linear active disturbance rejection, after Gao 2003'
    Gains: ClassVar[type] = LadrcGains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 1.0, 60.0), Tunable('observer_rate', 5.0, 200.0),
        Tunable('input_gain', 0.5, 2.5))

    def __init__(self, gains: Any = None, order: int = 2, regressor_count: int = 2,
                 period: float = 0.005) -> None:
        super(Nominal, self).__init__(gains, order, regressor_count, period)

    @property
    def own(self) -> tuple[float, ...]:
        """ω_o, number of extended states, d."""
        g = self.gains
        return (g.observer_rate, float(g.extended_states), float(g.design_delay))

    @property
    def moving(self) -> tuple[int, ...]:
        """Places of ê, f̂, f̂' where there is one, v⁻."""
        return (1, 2, 3, 4) if self.gains.extended_states == 2 else (1, 2, 4)

    @property
    def constants(self) -> tuple[float, ...]:
        """λ/b̂, 1/b̂, Λ, Λ_v, zeros for the regressors, limit of v, those of the observer."""
        g, n = self.gains, self.order
        return (g.lambda_ / g.input_gain, 1.0 / g.input_gain, *error_weights(g.lambda_, n),
                *feed_forward_weights(g.lambda_, n), *(0.0,) * self.regressor_count,
                g.v_clip, *self.own)

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """The memory: begun, ê, f̂, f̂', v⁻."""
        return (Signal('started', '1', '1 after the first sample'),
                Signal('e_hat', 'x^(n-1)', 'observed x̃^(n−1)', symbol='ê'),
                Signal('f_hat', 'x^(n)', 'estimate of the rest', symbol='f̂'),
                Signal('f_dot', 'x^(n)/s', 'its rate', symbol="f̂'"),
                Signal('v_last', 'v', 'command before', symbol='v⁻'))

    @cached_property
    def design(self) -> Design:
        """What the design rules need: no robust term, no layer."""
        g = self.gains
        lead = feed_forward_weights(g.lambda_, self.order)[-1] / g.input_gain
        gain = g.lambda_ / g.input_gain
        return Design(g.lambda_, gain, 0.0, 0.0, gain, lead)

    def layer_model(self, gain: float | None = None) -> LayerModel:
        """Return the law, which is linear everywhere; another gain is another λ."""
        if gain is None:
            return super().layer_model()
        return type(self)(replace(self.gains, lambda_=gain * self.gains.input_gain), self.order,
                          self.regressor_count, self.period).layer_model()

    @staticmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
               x: Sequence[float], y: Sequence[float], dt: float,
               new_memory: Any, terms: Any) -> float:
        """One sample."""
        n = len(x)
        nominal_terms(c, x_d, x, y, terms)
        at = 3 + 2 * n + len(y)
        e = x[n - 1] - x_d[n - 1]
        e_hat = memory[1]
        f_hat = memory[2]
        f_dot = memory[3]
        if memory[0] == 0.0:
            e_hat = e
        if dt > 0.0:
            z = math.exp(-c[at] * dt)
            rest = e - e_hat
            if c[at + 1] == 1.0:
                e_hat += (1.0 - z * z) * rest
                f_hat += (1.0 - z) * (1.0 - z) / dt * rest
            else:
                e_hat += (1.0 - z * z * z) * rest
                f_hat += 1.5 * (1.0 - z) * (1.0 - z) * (1.0 + z) / dt * rest
                f_dot += (1.0 - z) * (1.0 - z) * (1.0 - z) / (dt * dt) * rest
        terms[V_EXTRA] = -f_hat * c[1]
        whole = (terms[V_DAMPING] + terms[V_FEED_FORWARD]) + terms[V_EXTRA]
        v = clipped(whole, c[at - 1])
        terms[V_EXTRA] += v - whole
        for i in range(len(memory)):
            new_memory[i] = memory[i]
        if dt > 0.0:
            acts = v
            if c[at + 2] == 1.0:
                acts = memory[4]
            new_memory[0] = 1.0
            new_memory[1] = e_hat + dt * (acts / c[1] - x_d[n] + f_hat) + 0.5 * dt * dt * f_dot
            new_memory[2] = f_hat + dt * f_dot
            new_memory[3] = f_dot
            new_memory[4] = v
        publish(memory, STATUS + 1, terms)
        return float(v)

# SPDX-License-Identifier: Apache-2.0
"""L1 adaptive control, piecewise-constant [hovakimyan_cao2010], over a nominal model.

    predictor    ŝ' = −a (ŝ − s) + b̂ (v − ff + σ̂)
    adaptation   σ̂ = −a e^(−aT)/(1 − e^(−aT)) (ŝ − s)/b̂     what cancels ŝ − s within the next T
    filter       w' = ω (σ̂ − w),   v = ff − k_d s − w

The adaptation is as fast as the sampling; the filter decides what of it acts. s in place of the
whole state is ours. In every sample the filter advances by the exact step with the σ̂ just found,
then v follows, then the predictor advances by the exact step with s, v, σ̂ held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any, ClassVar

from dz_ros.core.laws.base import publish, Tunable
from dz_ros.core.laws.nominal import clipped, Nominal, nominal_terms, NominalGains
from dz_ros.core.schema import parameter
from dz_ros.core.signals import Signal, STATUS, V_DAMPING, V_EXTRA, V_FEED_FORWARD, V_REGRESSOR


@dataclass(frozen=True)
class L1Gains(NominalGains):
    """Gains; the values are ours."""

    predictor_rate: float = parameter(20.0, '1/s', 'a of the predictor', minimum=0.0,
                                      open_minimum=True)
    filter_rate: float = parameter(40.0, 'rad/s', 'ω of the low-pass filter', minimum=0.0,
                                   open_minimum=True)


class L1(Nominal):
    """Fast adaptation behind a low-pass filter."""

    name = 'l1'
    summary = 'L1 adaptive control, piecewise constant, after Hovakimyan and Cao 2010'
    Gains: ClassVar[type] = L1Gains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 0.3, 60.0), Tunable('k_d', 2.0, 150.0),
        Tunable('predictor_rate', 1.0, 200.0), Tunable('filter_rate', 2.0, 200.0))

    @property
    def own(self) -> tuple[float, ...]:
        """Constants a and ω."""
        return (self.gains.predictor_rate, self.gains.filter_rate)

    @property
    def moving(self) -> tuple[int, ...]:
        """Places of ŝ, w."""
        return (1, 2)

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """The memory: begun, ŝ, w."""
        return (Signal('started', '1', '1 after the first sample'),
                Signal('s_hat', 'x^(n-1)', 'predicted s', symbol='ŝ'),
                Signal('v_filtered', 'v', 'filtered estimate of the rest', symbol='w'))

    @staticmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
               x: Sequence[float], y: Sequence[float], dt: float,
               new_memory: Any, terms: Any) -> float:
        """One sample."""
        s = nominal_terms(c, x_d, x, y, terms)
        at = 3 + 2 * len(x) + len(y)
        rate = c[at]
        s_hat = memory[1]
        if memory[0] == 0.0:
            s_hat = s
        w = memory[2]
        sigma = 0.0
        z = 1.0
        if dt > 0.0:
            z = math.exp(-rate * dt)
            sigma = -rate * z / (1.0 - z) * (s_hat - s) * c[1]
            w += (1.0 - math.exp(-c[at + 1] * dt)) * (sigma - w)
        terms[V_EXTRA] = -w
        whole = (((terms[V_DAMPING] + terms[V_FEED_FORWARD]) + terms[V_REGRESSOR])
                 + terms[V_EXTRA])
        v = clipped(whole, c[at - 1])
        terms[V_EXTRA] += v - whole
        for i in range(len(memory)):
            new_memory[i] = memory[i]
        if dt > 0.0:
            rest = v - terms[V_FEED_FORWARD] - terms[V_REGRESSOR]
            new_memory[0] = 1.0
            new_memory[1] = s + z * (s_hat - s) + (1.0 - z) / rate * (rest + sigma) / c[1]
            new_memory[2] = w
        publish(memory, STATUS + 1, terms)
        return float(v)

# SPDX-License-Identifier: Apache-2.0
"""Neural dead-zone compensation, after Selmic and Lewis [selmic_lewis2000].

    r = −s,   w = (14) with k,   θ̂, φ̂ by (15), (16)
    u = w + Ŵ_iᵀσ_i(w) = v                      compensator; σ_i: N sigmoids and jump functions
        1(w ≥ 0),  (1 − e^−w) 1(w ≥ 0),  and both mirrored
    D̂(u) = Ŵᵀσ(Vᵀu + v_0)                       estimator of the dead-zone, N sigmoids
    Ŵ_i' = G [σ_i r (Ŵᵀσ'(u)Vᵀ) − k1|r| Ŵ_i − k2|r| ‖Ŵ_i‖ Ŵ_i]
    Ŵ'   = S [−σ'(u)Vᵀ (Ŵ_iᵀσ_i) r − k1|r| Ŵ]

Slopes V and offsets v_0 are drawn once, from `seed`; Ŵ_i(0) = 0, Ŵ(0) is the least-squares fit of
D̂ to the dead-zone of the guessed parameters. The slope of D̂ teaches the compensator: where D̂ does
not fit over the range of v, the loop may chatter. Any order n in this form (ours); rebuilt from
descriptions, not transcribed. Boundedness rests on simulation; gains, spread of the nodes and
v_range are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
import math
import random
from typing import Any, ClassVar

import numpy as np

from dz_ros.core.deadzone import DeadZone
from dz_ros.core.laws.adaptive import Adaptive, SwitchingGains
from dz_ros.core.laws.base import Design, Numbers, Tunable
from dz_ros.core.laws.wang2004 import adaptive_step
from dz_ros.core.schema import parameter
from dz_ros.core.signals import S, Signal, V_EXTRA

_JUMPS = 4


@dataclass(frozen=True)
class NeuralGains(SwitchingGains):
    """Gains of (14)–(16), of the two nets, and the dead-zone the estimator starts from."""

    nodes: int = parameter(12, '1', 'sigmoids N of each net', minimum=1, maximum=200,
                           structural=True)
    seed: int = parameter(0, '1', 'seed of slopes and offsets', minimum=0, structural=True)
    neural_gain: float = parameter(10.0, 'actuator unit per unit of s per s',
                                   'adaptation gain G of the compensator', minimum=0.0)
    estimator_gain: float = parameter(1.0, 'actuator unit per unit of s per s',
                                      'adaptation gain S of the estimator', minimum=0.0)
    neural_leakage: float = parameter(0.01, '1 per actuator unit', 'leakage k1 of both nets',
                                      minimum=0.0)
    norm_leakage: float = parameter(0.01, '1 per actuator unit squared', 'leakage k2 of the '
                                    'compensator, times its norm', minimum=0.0)
    v_range: float = parameter(10.0, 'actuator unit', 'the nets span |u| ≤ this: the usual '
                               'range of v', minimum=0.0, open_minimum=True, structural=True)
    b_r_guess: float = parameter(0.35, 'actuator unit', 'b_r of the initial estimator, the '
                                 'middle of its bounds', minimum=0.0)
    b_l_guess: float = parameter(-0.4, 'actuator unit', 'b_l of the initial estimator',
                                 maximum=0.0)
    m_guess: float = parameter(1.05, '1', 'slope of the initial estimator', minimum=0.0,
                               open_minimum=True)


def sigmoid(z: float) -> float:
    """Return 1/(1 + e^−z)."""
    return 0.5 * (1.0 + math.tanh(0.5 * z))


def hidden_layer(generator: random.Random, nodes: int, span: float) -> tuple[float, ...]:
    """Return slopes V, then offsets v_0, of sigmoids spread over ±span, shape (2 nodes,)."""
    centres = [span * (2.0 * (i + generator.random()) / nodes - 1.0) for i in range(nodes)]
    slopes = [(-1.0) ** i * generator.uniform(6.0, 24.0) / span for i in range(nodes)]
    return (*slopes, *(-slope * centre for slope, centre in zip(slopes, centres, strict=True)))


def fitted_weights(hidden: Sequence[float], zone: DeadZone, span: float) -> tuple[float, ...]:
    """Return the least-squares weights of D̂ ≈ D over |u| ≤ span, shape (N,)."""
    nodes = len(hidden) // 2
    points = np.linspace(-span, span, 401)
    basis = [[sigmoid(hidden[i] * u + hidden[nodes + i]) for i in range(nodes)] for u in points]
    weights = np.linalg.lstsq(np.asarray(basis), np.asarray([zone(u) for u in points]),
                              rcond=1e-6)[0]
    return tuple(float(item) for item in weights)


@lru_cache(maxsize=16)
def _nets(seed: int, nodes: int, span: float,
          zone: DeadZone) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Return compensator, estimator and its weights: milliseconds of work, the same each time."""
    generator = random.Random(seed)
    compensator = hidden_layer(generator, nodes, span)
    estimator = hidden_layer(generator, nodes, span)
    return compensator, estimator, fitted_weights(estimator, zone, span)


class Neural(Adaptive):
    """(14) behind a neural compensator that a neural estimator teaches."""

    name = 'neural'
    summary = 'neural dead-zone compensation after Selmic and Lewis 2000'
    Gains = NeuralGains
    tunable: ClassVar[tuple[Tunable, ...]] = (
        Tunable('lambda', 0.3, 30.0), Tunable('k_d', 2.0, 60.0),
        Tunable('k', 0.3, 8.0), Tunable('epsilon', 0.002, 0.5), Tunable('gamma', 0.02, 20.0))

    def __init__(self, gains: Any = None, order: int = 2, regressor_count: int = 2,
                 period: float = 0.005) -> None:
        super().__init__(gains, order, regressor_count, period)
        g = self.gains
        self._compensator, self._estimator, self._weights = _nets(
            g.seed, g.nodes, g.v_range, DeadZone(m_r=g.m_guess, m_l=g.m_guess, b_r=g.b_r_guess,
                                                 b_l=g.b_l_guess))

    @property
    def constants(self) -> tuple[float, ...]:
        """k_d, k, ε, γ, η, Λ, Λ_v, G, S, k1, k2, slopes and offsets of both nets."""
        g = self.gains
        return (*super().constants, g.neural_gain, g.estimator_gain, g.neural_leakage,
                g.norm_leakage, *self._compensator, *self._estimator)

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """θ̂, φ̂, Ŵ_i, Ŵ as used in v, which are the whole memory."""
        nodes = self.gains.nodes
        return (*super().signals, *(
            Signal(f'{net}{i + 1}', 'v', f'weight {i + 1} of the {net}')
            for net, count in (('compensator', nodes + _JUMPS), ('estimator', nodes))
            for i in range(count)))

    def initial_memory(self) -> tuple[float, ...]:
        """θ̂(0), φ̂(0), Ŵ_i = 0, the fitted Ŵ."""
        return (*super().initial_memory(), *(0.0,) * (self.gains.nodes + _JUMPS), *self._weights)

    @cached_property
    def design(self) -> Design:
        """What the design rules need: k need not cover the dead-zone."""
        return replace(super().design, inverse=True, target=0.0)

    @staticmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,
               dt: float, new_memory: Any, terms: Any) -> float:
        """One sample; new_memory holds σ_i, then σ'V, until they are used up."""
        own = 5 + 2 * len(x)
        first = len(y) + 1
        nodes = (len(memory) - first - _JUMPS) // 2
        inner = own + 4
        outer = inner + 2 * nodes
        second = first + nodes + _JUMPS
        w = adaptive_step(c, memory, x_d, x, y, dt, new_memory, terms)
        s = terms[S]

        for i in range(nodes):
            new_memory[first + i] = sigmoid(c[inner + i] * w + c[inner + nodes + i])
        right = w >= 0.0
        rise = -math.expm1(-abs(w))
        new_memory[first + nodes] = 1.0 if right else 0.0
        new_memory[first + nodes + 1] = rise if right else 0.0
        new_memory[first + nodes + 2] = 0.0 if right else 1.0
        new_memory[first + nodes + 3] = 0.0 if right else rise
        compensation = 0.0
        norm = 0.0
        for i in range(first, second):
            compensation += memory[i] * new_memory[i]
            norm += memory[i] * memory[i]
        norm = math.sqrt(norm)
        u = w + compensation
        terms[V_EXTRA] = compensation

        slope = 0.0
        for i in range(nodes):
            level = sigmoid(c[outer + i] * u + c[outer + nodes + i])
            new_memory[second + i] = level * (1.0 - level) * c[outer + i]
            slope += memory[second + i] * new_memory[second + i]
        leak = c[own + 2] * abs(s)
        leak_inner = leak + c[own + 3] * abs(s) * norm
        for i in range(first, second):
            new_memory[i] = memory[i] + dt * c[own] * (
                -new_memory[i] * s * slope - leak_inner * memory[i])
        for i in range(second, second + nodes):
            new_memory[i] = memory[i] + dt * c[own + 1] * (
                new_memory[i] * compensation * s - leak * memory[i])
        return u

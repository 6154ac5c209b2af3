# SPDX-License-Identifier: Apache-2.0
"""The plant behind its dead-zone, advanced in continuous time by classical RK4.

    x^(n) = b D(v) − Σ a_i Y_i(x) − disturbance(t, x)                      (6)

v is held; dead-zone and disturbance are evaluated at every stage (mathematics.md §3). What a plant
lets stick (`Plant.sticking`) is taken off the right side, which it depends on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from dz_ros.core.deadzone import dead_zone
from dz_ros.core.plants.base import Plant

Numbers = Sequence[float]
Buffer = Any
"""A mutable sequence of floats: a list in Python, a numpy array when compiled."""

Advance = Callable[..., None]


def identity(function: Any) -> Any:
    """Return the function as it is: the place of a compiler that is not there."""
    return function


def make_advance(regressors: Callable[..., None], disturbance: Callable[..., float],
                 jit: Callable[[Any], Any] = identity,
                 sticking: Callable[..., float] = Plant.sticking) -> Advance:
    """Return ``advance(x, v, t, h, steps, p, z, y, k1, k2, k3, stage, push)`` for a plant.

    It moves ``x``, shape (n,), in place from t to t + steps·h with v held. ``p``, ``z``: constants
    of plant and dead-zone; ``y``, shape (r,), and the rest, shape (n,), are buffers; ``push`` is
    an acceleration [unit of x^(n)] added all the while; `jit` compiles the functions; `sticking`:
    that of the plant.
    """
    zone = jit(dead_zone)
    regressors = jit(regressors)
    disturbance = jit(disturbance)

    def free(x: Buffer, w: float, t: float, p: Numbers, y: Buffer, push: float) -> float:
        regressors(x, p, y)
        total: float = p[0] * w - disturbance(t, x, p)
        for i in range(len(y)):
            total -= p[1 + i] * y[i]
        if push != 0.0:
            total += push
        return total

    acceleration = free = jit(free)
    if sticking is not Plant.sticking:
        sticks = jit(sticking)

        def held_back(x: Buffer, w: float, t: float, p: Numbers, y: Buffer,
                      push: float) -> float:
            total: float = free(x, w, t, p, y, push)
            part: float = sticks(total, x, p, y)
            return total - part

        acceleration = jit(held_back)

    def advance(x: Buffer, v: float, t: float, h: float, steps: int, p: Numbers, z: Numbers,
                y: Buffer, k1: Buffer, k2: Buffer, k3: Buffer, stage: Buffer,
                push: float = 0.0) -> None:
        last = len(x) - 1
        half = 0.5 * h
        sixth = h / 6.0
        for step in range(steps):
            now = t + step * h
            w = zone(v, now, z)
            top1 = acceleration(x, w, now, p, y, push)
            for i in range(last):
                k1[i] = x[i + 1]
                stage[i] = x[i] + half * k1[i]
            stage[last] = x[last] + half * top1
            if z[0] != 0.0:     # it drifts
                w = zone(v, now + half, z)
            top2 = acceleration(stage, w, now + half, p, y, push)
            for i in range(last):
                k2[i] = stage[i + 1]
                stage[i] = x[i] + half * k2[i]
            stage[last] = x[last] + half * top2
            top3 = acceleration(stage, w, now + half, p, y, push)
            for i in range(last):
                k3[i] = stage[i + 1]
                stage[i] = x[i] + h * k3[i]
            stage[last] = x[last] + h * top3
            if z[0] != 0.0:
                w = zone(v, now + h, z)
            top4 = acceleration(stage, w, now + h, p, y, push)
            for i in range(last):
                x[i] += sixth * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + stage[i + 1])
            x[last] += sixth * (top1 + 2.0 * top2 + 2.0 * top3 + top4)

    compiled: Advance = jit(advance)
    return compiled


def make_unmodelled(plant: Plant, jit: Callable[[Any], Any] = identity) -> Callable[..., float]:
    """Return ``unmodelled(t, x, w, p, y, push)`` of a plant: its disturbance and what sticks.

    `push` is what a pulse adds to x^(n) and is taken off; ``y``, shape (r,), is a buffer.
    """
    disturbance = jit(plant.disturbance)
    if type(plant).sticking is Plant.sticking:
        def given(t: float, x: Numbers, w: float, p: Numbers, y: Buffer,     # noqa: ARG001
                  push: float) -> float:
            other: float = disturbance(t, x, p)
            return other - push

        alone: Callable[..., float] = jit(given)
        return alone
    regressors, sticks = jit(plant.regressors), jit(plant.sticking)

    def with_friction(t: float, x: Numbers, w: float, p: Numbers, y: Buffer,
                      push: float) -> float:
        other: float = disturbance(t, x, p)
        other -= push
        regressors(x, p, y)
        total = p[0] * w - other
        for i in range(len(y)):
            total -= p[1 + i] * y[i]
        part = sticks(total, x, p, y)
        if part != 0.0:
            other += part
        return other

    found: Callable[..., float] = jit(with_friction)
    return found

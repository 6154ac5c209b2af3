"""The plant behind its dead-zone, advanced in continuous time by classical RK4.

    x^(n) = b D(v) − Σ a_i Y_i(x) − disturbance(t, x)                      (6)

v is held; the dead-zone and the disturbance are evaluated at every stage, so parameters may vary
with time within a sample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from dz_ros.core.deadzone import dead_zone

Numbers = Sequence[float]
Buffer = Any
"""A mutable sequence of floats: a list in Python, a numpy array when compiled."""

Advance = Callable[..., None]


def identity(function: Any) -> Any:
    """Return the function as it is: the place of a compiler that is not there."""
    return function


def make_advance(regressors: Callable[..., None], disturbance: Callable[..., float],
                 jit: Callable[[Any], Any] = identity) -> Advance:
    """Return ``advance(x, v, t, h, steps, p, z, y, k1, k2, k3, stage, push)`` for a plant.

    It moves ``x`` (shape (n,), in place) from t to t + steps·h with v held. ``p`` are the plant's
    constants (b, a_1…a_r, …), ``z`` those of the dead-zone; ``y``, shape (r,), and the rest, shape
    (n,), are buffers. ``push`` is an acceleration [unit of x^(n)] added all the while.

    Args:
        regressors: ``(x, p, y)`` writes Y(x).
        disturbance: ``(t, x, p)`` returns the disturbance.
        jit: Compiler applied to the functions made here.
    """
    zone = jit(dead_zone)
    regressors = jit(regressors)
    disturbance = jit(disturbance)

    def acceleration(x: Buffer, w: float, t: float, p: Numbers, y: Buffer, push: float) -> float:
        regressors(x, p, y)
        total: float = p[0] * w - disturbance(t, x, p)
        for i in range(len(y)):
            total -= p[1 + i] * y[i]
        if push != 0.0:
            total += push
        return total

    acceleration = jit(acceleration)

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

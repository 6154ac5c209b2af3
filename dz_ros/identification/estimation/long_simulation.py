# SPDX-License-Identifier: Apache-2.0
"""A plant with a constant force, refined by simulating long parts without feedback (ours).

Stretches of a second hardly distinguish a constant force, the friction of both sides and viscous
friction: each has a wide confidence interval, and a simulation of many seconds with values from
anywhere in them drifts away. So a_i and the slopes become those with which such simulations stay
near what was measured, bound to the estimates of the stretches by their confidence,

    min Σ_g (S_g/σ²) mean_k |x_k − x̂_k(p)|² + Σ_i ((p_i − p̂_i)/s_i)²

x the position, S_g the length of a part in seconds (residuals of one second count once, they
depend on each other), σ the RMS of the residual itself, s_i the standard error of p̂_i. A
simulation begins with what was measured; an x^(n−1) that was not is the slope at the first sample
of a parabola through a few. Slopes of both sides that agree within their confidence become one:
their difference does nearly what a constant force does, and neither is known as well then. Break
points are not changed, and the confidence intervals stay those of the stretches: residuals of a
long simulation depend on each other too much to give any.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.plants.base import Plant
from dz_ros.identification.estimation.least_squares import COUNT
from dz_ros.identification.estimation.prediction_error import Fit, Prediction, SLOPE
from dz_ros.identification.estimation.stretches import Stretch
from dz_ros.identification.samples import Samples

Array = NDArray[np.float64]

LEAST, LONGEST = 5.0, 30.0
"""Length of a part [s]; a shorter one shows no drift."""
MAX_PARTS = 3
"""Of more, the longest are taken."""
ROUNDS = 3
"""Searches, each with σ of the one before."""
PLACES = ((0.3, 1.0), (0.3, -1.0), (-2.0, 1e-3))
"""(x, x') at which a constant Y_i is the same."""


def constant_term(plant: Plant) -> int | None:
    """Return the place of the one Y_i that is 1 everywhere; None where there is none."""
    rows = []
    for place in PLACES:
        y = [0.0] * plant.regressor_count
        plant.regressors([*place, *[0.0] * (plant.order - 2)], plant.constants, y)
        rows.append(y)
    found = [i for i, column in enumerate(zip(*rows, strict=True)) if set(column) == {1.0}]
    return found[0] if plant.order > 1 and len(found) == 1 else None


def slope_at(x: Array, place: int, period: float) -> float:
    """Return the slope at one of some samples, by a parabola through them.

    Args:
        x: Three or more, shape (K,).
        place: Which of them.
        period: T [s].
    """
    return float(np.polyfit((np.arange(len(x)) - place) * period, x, 2)[1])


def refine_by_simulation(fitted: Fit, samples: Samples, c: Configuration, delay: int) -> Fit:
    """Return the plant with which simulations of long parts stay near the measurement.

    A plant without a constant term, or samples without a long part, leave it as it is.

    Args:
        fitted: The plant by prediction error over stretches.
        samples: Experiment or run.
        c: Model and known constants.
        delay: Samples after which a command acts.
    """
    from scipy.optimize import least_squares

    parts = long_parts(samples, delay)
    values = np.array([item.value for item in fitted.estimates])
    scale = np.array([item.half_width / 2.0 for item in fitted.estimates])
    scale[-COUNT:-COUNT + 2] = 0.0      # break points stay
    free = np.flatnonzero(np.isfinite(scale) & (scale > 0.0))
    if constant_term(c.plant) is None or not parts or not len(free):
        return fitted
    whole = [Stretch(samples.x[:0, 0], samples.x[:0], samples.v[:0], 0, -1, rows)
             for rows in parts]
    predict = Prediction(samples, whole, c, delay, 1.0, np.zeros((len(whole), COUNT)))
    if samples.measured < c.plant.order:
        for start, x in zip(predict.starts, predict.measured, strict=True):
            start[-1] = slope_at(x[:SLOPE + 1, -1], 0, samples.period)
    right, left = fitted.estimates[-2:]
    one = right.seen and left.seen and abs(right.value - left.value) <= (
        right.half_width + left.half_width)
    lengths = [(rows[1] - rows[0] + 1) * samples.period for rows in parts]

    def parameters(q: Array) -> Array:
        p: Array = values.copy()
        p[free] += scale[free] * q
        p[-2:] = np.maximum(p[-2:], 0.1 * values[-2:])      # slopes stay slopes
        if one:
            p[-2:] = p[-2:].mean()
        return p

    def differences(q: Array) -> list[Array]:
        found = predict(parameters(q).tolist(), predict.starts)
        return [item[:, 0] - x[:, 0] for item, x in zip(found, predict.measured, strict=True)]

    def power(q: Array) -> float:
        found = differences(q)
        return sum(length * float(np.mean(item * item))
                   for length, item in zip(lengths, found, strict=True)) / sum(lengths)

    q = np.zeros(len(free))
    size = max(math.sqrt(power(q)), 1e-12)
    for _ in range(ROUNDS):
        def residual(q: Array, size: float = size) -> Array:
            return np.concatenate([*(item * math.sqrt(length / len(item)) / size for length, item
                                     in zip(lengths, differences(q), strict=True)), q])

        q = least_squares(residual, q, max_nfev=15, xtol=1e-4, ftol=1e-4).x
        before, size = size, max(math.sqrt(power(q)), 1e-12)
        if size > 0.9 * before:
            break
    if not power(q) < power(np.zeros_like(q)):
        return fitted
    p = parameters(q).tolist()
    return replace(fitted, estimates=tuple(
        replace(item, value=value) for item, value in zip(fitted.estimates, p, strict=True)))


def long_parts(samples: Samples, delay: int) -> list[tuple[int, int]]:
    """Return first and last row of the longest parts without a hole."""
    edges = [delay - 1, *(np.flatnonzero(~samples.joined)).tolist(), len(samples.seq) - 1]
    edges = [item for item in edges if item >= delay - 1]
    found = []
    for low, high in pairwise(edges):
        count = math.ceil((high - low) * samples.period / LONGEST)
        places = np.linspace(low, high, count + 1).round().astype(int).tolist()
        found += [(begin + 1, end) for begin, end in pairwise(places)
                  if (end - begin - 1) * samples.period >= LEAST]
    return sorted(sorted(found, key=lambda item: item[0] - item[1])[:MAX_PARTS])

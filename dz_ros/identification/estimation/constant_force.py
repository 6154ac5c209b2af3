# SPDX-License-Identifier: Apache-2.0
"""The constant term of a plant, by how far the position drifts in a simulation of all samples.

Over stretches of a second a constant force and the difference of the frictions of both sides
hardly differ, so the confidence interval of a constant term is wide. Simulated once over all that
was measured, an error of it grows with time and shows as drift. So of a plant whose friction is
counted in, the one a_i with Y_i = 1 becomes that value of its interval with which the position
of the longest part without a hole is predicted best, from its first state on and up to a
constant; all else stays as it was found. (ours)
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.plants.base import Plant
from dz_ros.identification.estimation.prediction_error import Fit, Prediction
from dz_ros.identification.estimation.stretches import Stretch
from dz_ros.identification.samples import Samples

LEAST = 5.0
"""A shorter part shows no drift [s]."""
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


def refine_constant(fitted: Fit, samples: Samples, c: Configuration, delay: int) -> Fit:
    """Return the plant with the constant term that a simulation of all samples shows.

    Args:
        fitted: The plant by prediction error over stretches.
        samples: Experiment or run.
        c: Model and known constants.
        delay: Samples after which a command acts.
    """
    from scipy.optimize import minimize_scalar

    place, rows = constant_term(c.plant), _longest(samples, delay)
    if place is None or (rows[1] - rows[0]) * samples.period < LEAST:
        return fitted
    own = fitted.estimates[place]
    if not (own.seen and own.half_width > 0.0):
        return fitted
    whole = Stretch(samples.x[:0, 0], samples.x[:0], samples.v[:0], 0, -1, rows)
    predict = Prediction(samples, [whole], c, delay, 1.0, np.zeros((1, 4)))
    p = [item.value for item in fitted.estimates]
    measured = predict.measured[0][:, 0]

    def drift(value: float) -> float:
        p[place] = value
        rest = predict(p, predict.starts)[0][:, 0] - measured
        return float(rest.var())        # the speed at the beginning leaves a constant

    best = minimize_scalar(drift, bounds=(own.value - own.half_width, own.value + own.half_width),
                           method='bounded', options={'xatol': 1e-3 * own.half_width})
    if not best.fun < drift(own.value):
        return fitted
    estimates = list(fitted.estimates)
    estimates[place] = replace(own, value=float(best.x))
    return replace(fitted, estimates=tuple(estimates))


def _longest(samples: Samples, delay: int) -> tuple[int, int]:
    """Return first and last row of the longest part without a hole."""
    edges = [delay - 1, *(np.flatnonzero(~samples.joined)).tolist(), len(samples.seq) - 1]
    edges = [item for item in edges if item >= delay - 1]
    return max(((low + 1, high) for low, high in pairwise(edges)), default=(0, 0),
               key=lambda item: item[1] - item[0])

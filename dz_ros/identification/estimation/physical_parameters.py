# SPDX-License-Identifier: Apache-2.0
"""From the constants b, a_1 … a_r of a plant in normal form to its physical parameters (ours).

A model's parameters may outnumber its constants (J, B, T_c, K_t of a servo give a_1, a_2, b). The
search changes as little as it can: first only parameters that act on nothing but a_i; where these
cannot give every a_i, all of them, by the shortest Newton steps in relative size. b and the
model's other constants stay what they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core import schema
from dz_ros.core.plants.base import Plant
from dz_ros.errors import ConfigurationError

Array = NDArray[np.float64]

FAST = 1e6
"""A speed at which smoothed friction has its full size."""
ROUNDING = 1e-9
"""Break points smaller than this share of those with friction counted in are rounding errors."""
HALVINGS = 4
"""How often a step is halved that leads out of the allowed parameters."""
CLOSE = 1e-9
"""Relative difference at which constants count as reached."""


def parameters_with(plant: Plant, a: Sequence[float]) -> dict[str, float]:
    """Return the parameters of a plant, dotted keys, changed so that its a_i are these.

    Raises:
        ConfigurationError: No allowed parameters give them.
    """
    found = next(_parameters(plant, a, plant.b, False), None)
    if found is None:
        raise ConfigurationError('plant.model', plant.name, 'no allowed parameters of this model '
                                 'give ' + ', '.join(f'a{i + 1} = {value:.6g}'
                                                     for i, value in enumerate(a)))
    return found


def parameters_with_gain(plant: Plant, a: Sequence[float], b: float) -> list[dict[str, float]]:
    """Return the ways to another b: of all that act on b one changes, of the rest what a_i take.

    Args:
        plant: The model.
        a: a_i, shape (r,).
        b: The input gain to be reached.

    Returns:
        For each parameter that can do it what differs from `parameters_with`, by dotted key.

    Raises:
        ConfigurationError: No allowed parameters give the a_i with the b that is.
    """
    present = parameters_with(plant, a)
    return [{key: value for key, value in found.items()
             if not math.isclose(value, present[key], rel_tol=1e-9)}
            for found in _parameters(plant, a, b, True)]


def _parameters(plant: Plant, a: Sequence[float], b: float,
                one: bool) -> Iterator[dict[str, float]]:
    """Yield parameters, by dotted key, that give the constants.

    Args:
        plant: The model.
        a: a_i, shape (r,).
        b: The input gain.
        one: Whether exactly one of those that act on more than a_i may change, each in turn; else
            none of them and then, as a second way, all.
    """
    group = type(plant.parameters)
    kept = schema.to_dict(plant.parameters)
    names = [item.name for item in schema.fields(group) if item.kind == 'float']
    before = np.array([kept[name] for name in names], dtype=float)
    scale = np.where(before == 0.0, 1.0, np.abs(before))

    def constants(q: Array) -> Array:
        values: dict[str, Any] = {**kept, **dict(zip(names, q.tolist(), strict=True))}
        return np.array(type(plant)(schema.build(group, values, 'plant.')).constants)

    target = np.array(plant.constants)
    count = len(plant.a)
    target[0], target[1:1 + count] = b, a
    slopes = _slopes(constants, before, scale)
    others = (np.abs(slopes[1 + count:]) < 1e-12).all(axis=0)
    alone = (np.abs(slopes[0]) < 1e-12) & others
    acting = np.asarray(np.abs(slopes).max(axis=0) > 0.0)
    ways = [alone & acting, acting]
    if one:
        ways = []
        for place in np.flatnonzero((np.abs(slopes[0]) > 1e-12) & others).tolist():
            way = alone & acting
            way[place] = True
            ways.append(way)
    for free in ways:
        found = _newton(constants, before, scale, target, free)
        if found is not None:
            yield {f'plant.{name}': float(value)
                   for name, value in zip(names, found.tolist(), strict=True)}


def friction_terms(plant: Plant, zone: Array) -> tuple[Array, Array]:
    """Return a_i of the friction terms, and `ZONE` without what they explain.

    Args:
        plant: The model, whose `friction` names the terms.
        zone: b_r, b_l with friction counted in, b m_r, b m_l, shape (4,).
    """
    y, rows = [0.0] * plant.regressor_count, []
    for side in (1.0, -1.0):
        plant.regressors([0.0, side * FAST, *[0.0] * (plant.order - 2)], plant.constants, y)
        rows.append([y[i] for i in plant.friction])
    matrix, target = np.array(rows), zone[2:] * zone[:2]
    a = np.linalg.lstsq(matrix, target, rcond=None)[0]
    rest = (target - matrix @ a) / zone[2:]
    rest[np.abs(rest) < ROUNDING * np.abs(zone[:2]).max()] = 0.0
    return a, np.array([max(rest[0], 0.0), min(rest[1], 0.0), *zone[2:]])


def _slopes(constants: Any, q: Array, scale: Array) -> Array:
    """Return d constants / d q in relative steps, shape (constants, parameters).

    A parameter that may not be a little larger, such as one that is 0 = off, has none.
    """
    here, columns = constants(q), []
    for j in range(len(q)):
        other = q.copy()
        other[j] += 1e-6 * scale[j]
        try:
            columns.append((constants(other) - here) / 1e-6)
        except ConfigurationError:
            columns.append(np.zeros_like(here))
    return np.column_stack(columns)


def _newton(constants: Any, q: Array, scale: Array, target: Array,
            free: NDArray[np.bool_]) -> Array | None:
    """Return parameters that give the constants, changing only the free ones; None = none."""
    size = np.where(target == 0.0, 1.0, np.abs(target))
    try:
        for _ in range(50):
            rest = (target - constants(q)) / size
            if np.abs(rest).max() < 1e-15:
                break
            slopes = _slopes(constants, q, scale) / size[:, np.newaxis]
            step = np.zeros(len(q))
            step[free] = np.linalg.pinv(slopes[:, free]) @ rest
            q = _shorter(constants, q, step * scale)
        return q if np.abs((target - constants(q)) / size).max() < CLOSE else None
    except (ConfigurationError, ArithmeticError):
        return None


def _shorter(constants: Any, q: Array, step: Array) -> Array:
    """Return q + step, by half a step or less where that is no allowed parameter.

    Raises:
        ConfigurationError, ArithmeticError: However short, it is not allowed.
    """
    for _ in range(HALVINGS):
        try:
            constants(q + step)
            break
        except (ConfigurationError, ArithmeticError):
            step = 0.5 * step
    constants(q + step)
    return np.asarray(q + step)

"""From the constants b, a_1 … a_r of a plant in normal form to its physical parameters (ours).

A model's parameters may outnumber its constants (J, B, T_c, K_t of a servo give a_1, a_2, b). The
search changes as little as it can: first only parameters that act on nothing but a_i; where these
cannot give every a_i, all of them, by the shortest Newton steps in relative size. b and the
model's other constants stay what they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core import schema
from dz_ros.core.plants.base import Plant
from dz_ros.errors import ConfigurationError

Array = NDArray[np.float64]

CLOSE = 1e-9
"""Relative difference at which constants count as reached."""


def parameters_with(plant: Plant, a: Sequence[float]) -> dict[str, float]:
    """Return the parameters of a plant, dotted keys, changed so that its a_i are these.

    Raises:
        ConfigurationError: No allowed parameters give them.
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
    target[1:1 + count] = a
    slopes = _slopes(constants, before, scale)
    alone = (np.abs(slopes[0]) < 1e-12) & (np.abs(slopes[1 + count:]) < 1e-12).all(axis=0)
    acting = np.asarray(np.abs(slopes).max(axis=0) > 0.0)
    for free in (alone & acting, acting):
        found = _newton(constants, before, scale, target, free)
        if found is not None:
            return {f'plant.{name}': float(value)
                    for name, value in zip(names, found.tolist(), strict=True)}
    raise ConfigurationError('plant.model', plant.name, 'no allowed parameters of this model give '
                             + ', '.join(f'a{i + 1} = {value:.6g}' for i, value in enumerate(a)))


def _slopes(constants: Any, q: Array, scale: Array) -> Array:
    """Return d constants / d q in relative steps, shape (constants, parameters)."""
    columns = []
    for j in range(len(q)):
        other = q.copy()
        other[j] += 1e-6 * scale[j]
        columns.append((constants(other) - constants(q)) / 1e-6)
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
            q = q + step * scale
        return q if np.abs((target - constants(q)) / size).max() < CLOSE else None
    except ConfigurationError:
        return None

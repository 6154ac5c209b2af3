"""Dead-zone parameters that drift: least squares with a broken line in time for each (ours).

The equation is that of `regression`, but b_r, b_l, b m_r, b m_l are functions of time, linear
between nodes t_j, the middles of the repeats, and constant before the first and after the last:

    p(t) = Σ_j p_j h_j(t),      h_j the hat function of node j

All p_j and the a_i are found together. A repeat by itself would take what it saw of a slope early
and of a break point late for one dead-zone that never was, and a drift by some per cent within it
moves its break points by several times as much.

Errors: `errors` of the p_j from the residual, taken as white. What all have in common, the error
of their mean, from the stretches as clusters, since disturbances last:

    cov p = G/(G − P) H⁻¹ (Σ_g X_gᵀ e_g e_gᵀ X_g) H⁻¹,   H = Σ_g X_gᵀ X_g

G stretches, P unknowns, X_g the columns and e_g the residuals of one.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.errors import RecordingError
from dz_ros.identification.regression import BLIND, CLOSE, CONDITION, hinges, Line, ROUNDS, ZONE
from dz_ros.identification.stretches import Stack

Array = NDArray[np.float64]

COUNT = len(ZONE)


@dataclass(frozen=True)
class Drifting:
    """A dead-zone over time.

    Attributes:
        a: a_i, then the factor of the disturbance where there is one.
        values: p_j, a row a node, columns `ZONE`, shape (R, 4).
        errors: Standard errors of `values` by the residual, taken as white, shape (R, 4).
        common: Standard error of the mean of each column, shape (4,).
        residual: RMS of what the equation leaves, in the unit of what was measured last.
    """

    a: Array
    values: Array
    errors: Array
    common: Array
    residual: float


def hats(times: Array, nodes: Array) -> Array:
    """Return h_j at each time, shape (times, nodes); rows add up to 1."""
    found: Array = np.column_stack([np.interp(times, nodes, row) for row in np.eye(len(nodes))])
    return found


def solve_drifting(stack: Stack, times: Array, nodes: Array, start: Line) -> Drifting:
    """Return the dead-zone over time.

    Args:
        stack: The stretches.
        times: Middle of each [s], shape (G,).
        nodes: t_j [s], ascending, shape (R,).
        start: Constants to begin with.

    Raises:
        RecordingError: The stretches do not tell.
    """
    weights = hats(times, nodes)
    owner = stack.owner
    rest_count = stack.y.shape[1]
    size = rest_count + COUNT * len(nodes)
    values = np.tile(start.zone, (len(nodes), 1))
    step = 0.25 * float(np.abs(stack.v).max())
    for _ in range(ROUNDS):
        ends = (weights @ values[:, :2])[owner]
        columns = np.column_stack([-stack.y, stack.integral(hinges(stack.v, ends))])
        gram, target = _normal(stack, columns, weights, size)
        scale = np.sqrt(np.diag(gram))
        if not (scale > 0.0).all():
            raise RecordingError(BLIND)
        scaled = gram / np.outer(scale, scale)
        if np.linalg.cond(scaled) > CONDITION ** 2:
            raise RecordingError(BLIND)
        solution = np.linalg.solve(scaled, target / scale) / scale
        found = solution[rest_count:].reshape(COUNT, len(nodes)).T
        slopes = found[:, 2:]
        if slopes.min() <= 0.0:
            raise RecordingError(f'{BLIND}; a slope came out negative')
        change = np.clip(-found[:, :2] / slopes, -step, step)
        values = np.column_stack([values[:, :2] + change, slopes])
        step *= 0.8
        if np.abs(change).max() < 10.0 * CLOSE * float(np.abs(stack.v).max()):
            break
    return _with_errors(stack, columns, weights, solution, scaled, scale, values)


def _normal(stack: Stack, columns: Array, weights: Array, size: int) -> tuple[Array, Array]:
    """Return Xᵀ X and Xᵀ left of all unknowns: a, then each of `ZONE` at every node."""
    spread = _spread(columns.shape[1] - COUNT, weights)
    gram, target = np.zeros((size, size)), np.zeros(size)
    for g, (begin, end) in enumerate(stack.edges):
        part = columns[begin:end]
        gram += spread[g].T @ (part.T @ part) @ spread[g]
        target += spread[g].T @ (part.T @ stack.left[begin:end])
    return gram, target


def _spread(rest_count: int, weights: Array) -> list[Array]:
    """Return for each stretch how its own columns are made of all the unknowns'."""
    found = []
    for row in weights:
        matrix = np.zeros((rest_count + COUNT, rest_count + COUNT * len(row)))
        matrix[:rest_count, :rest_count] = np.eye(rest_count)
        for i in range(COUNT):
            begin = rest_count + i * len(row)
            matrix[rest_count + i, begin:begin + len(row)] = row
        found.append(matrix)
    return found


def _with_errors(stack: Stack, columns: Array, weights: Array, solution: Array, scaled: Array,
                 scale: Array, values: Array) -> Drifting:
    rest_count, nodes = stack.y.shape[1], weights.shape[1]
    inverse = np.linalg.inv(scaled) / np.outer(scale, scale)
    pushes, power = [], 0.0
    for (begin, end), matrix in zip(stack.edges, _spread(rest_count, weights), strict=True):
        rest = stack.left[begin:end] - columns[begin:end] @ (matrix @ solution)
        pushes.append(matrix.T @ (columns[begin:end].T @ rest))
        power += float(rest @ rest)
    size = len(solution)
    variance = power / max(1, len(stack.left) - size - stack.count)
    if stack.count <= size:
        raise RecordingError(f'{BLIND}: {stack.count} stretches of motion for {size} unknowns')
    push = np.array(pushes)
    robust = inverse @ (push.T @ push) @ inverse * stack.count / (stack.count - size)
    errors = np.sqrt(variance * np.diag(inverse))[rest_count:].reshape(COUNT, nodes).T
    # Of break points the unknown is b m δ.
    turn = np.column_stack([1.0 / values[:, 2], 1.0 / values[:, 3], np.ones((nodes, 2))])
    common = []
    for i in range(COUNT):
        part = slice(rest_count + i * nodes, rest_count + (i + 1) * nodes)
        mean = turn[:, i] / nodes
        common.append(math.sqrt(float(mean @ robust[part, part] @ mean)))
    return Drifting(solution[:rest_count], values, errors * turn, np.array(common),
                    math.sqrt(variance))

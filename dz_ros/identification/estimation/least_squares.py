# SPDX-License-Identifier: Apache-2.0
"""Dead-zone and plant from stretches: least squares with two hinges (ours).

With w = D(v) the integrated equation (`stretches`) is linear in a_i, b m_r, b m_l once the break
points are known; near them it is linear in their corrections δ too (Muggeo's iteration for broken
lines [muggeo2003]):

    left = −Σ a_i ∫Y_i + b m_r ∫(v − b_r)⁺ − b m_r δ_r ∫1(v > b_r) + the same on the left
    b_r ← b_r + δ_r                                                            until it stays

b and m show only as their product; the two sides have slopes of their own (mathematics.md §13).
a_i are constants of the plant, as (6) has them. Break points and slopes are constants as well, or
functions of time, linear between nodes t_j, the middles of the repeats, constant outside:

    p(t) = Σ_j p_j h_j(t),      h_j the hat function of node j

All p_j and the a_i are found together: a repeat by itself would take a slope from its begin and a
break point from its end for one dead-zone, which a drift by some per cent moves several times as
far. `common`, the error of what all p_j have in common, takes the stretches as clusters, since
disturbances last:

    cov p = G/(G − P) H⁻¹ (Σ_g X_gᵀ e_g e_gᵀ X_g) H⁻¹,   H = Σ_g X_gᵀ X_g

G stretches, P unknowns, X_g the columns and e_g the residuals of one.

**Friction counted in** (`by_side`): where there is no dead-zone beside Coulomb friction, the
friction terms are left out of Y and the break points are those of the motion, 1(x' > 0) in place
of 1(v > b_r) and v⁺ in place of (v − b_r)⁺: the command at which slow motion neither gains nor
loses speed. This is linear, without iteration.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.errors import RecordingError
from dz_ros.identification.estimation.stretches import Stack

Array = NDArray[np.float64]

ZONE = ('b_r', 'b_l', 'b·m_r', 'b·m_l')
"""Parameters of the dead-zone, in this order."""
COUNT = len(ZONE)

BLIND = ('the motion does not distinguish friction, slopes and break points: allow more speed, '
         'travel and effort')
ROUNDS = 40
"""Iterations at most."""
CLOSE = 1e-6
"""Change of a break point, as a share of the largest |v|, at which it stays."""
CONDITION = 1e4
"""Beyond this condition number of the scaled equations the parameters cannot be separated."""
STARTS = (0.1, 0.3, 0.5)
"""Shares of the largest |v| at which the search for the break points begins."""


@dataclass(frozen=True)
class Line:
    """Parameters of plant and dead-zone.

    Attributes:
        a: a_i, then the factor of the disturbance where there is one.
        zone: p_j, a row a node, columns `ZONE`, shape (R, 4).
        errors: Standard errors of `zone` by the residual, taken as white, shape (R, 4).
        common: Standard error of the mean of each column, shape (4,).
        residual: RMS of what the equation leaves, in the unit of what was measured last.
    """

    a: Array
    zone: Array
    errors: Array
    common: Array
    residual: float

    @property
    def at_limit(self) -> bool:
        """Whether a break point was stopped at 0, where its side ends."""
        return bool((self.zone[:, :2] == 0.0).any())


def hats(times: Array, nodes: Array) -> Array:
    """Return h_j at each time, shape (times, nodes); rows add up to 1."""
    found: Array = np.column_stack([np.interp(times, nodes, row) for row in np.eye(len(nodes))])
    return found


def solve(stack: Stack, by_side: bool = False) -> Line:
    """Return the constants that leave the least, from several starts.

    Args:
        stack: The stretches.
        by_side: Count friction in.

    Raises:
        RecordingError: The stretches do not show them.
    """
    if stack.v.max() <= 0.0 or stack.v.min() >= 0.0:
        raise RecordingError('nothing to identify: the command has one sign only')
    most = float(np.abs(stack.v).max())
    weights = np.ones((stack.count, 1))
    lines: list[Line] = []
    problem = RecordingError('nothing to identify')
    for share in STARTS[:1] if by_side else STARTS:
        start = np.array([[share * most, -share * most]])
        try:
            lines.append(_search(stack, weights, start, 0.5 * most, by_side))
        except RecordingError as error:
            problem = error
    if not lines:
        raise problem
    return min(lines, key=lambda line: line.residual)


def residual_without_zone(stack: Stack) -> float:
    """Return the RMS that a plant without a dead-zone leaves, friction and two slopes its own."""
    columns = np.column_stack([-stack.y, stack.integral(hinges(stack.v, np.zeros(2))[:, 2:])])
    rest = stack.left - columns @ np.linalg.lstsq(columns, stack.left)[0]
    free = max(1, len(rest) - columns.shape[1] - stack.count)
    return math.sqrt(float(rest @ rest) / free)


def solve_over_time(stack: Stack, times: Array, nodes: Array, start: Line,
                    by_side: bool = False) -> Line:
    """Return the dead-zone over time.

    Args:
        stack: The stretches.
        times: Middle of each [s], shape (G,).
        nodes: t_j [s], ascending, shape (R,).
        start: Constants to begin with.
        by_side: Count friction in.

    Raises:
        RecordingError: The stretches do not show them.
    """
    return _search(stack, hats(times, nodes), np.tile(start.zone[:, :2], (len(nodes), 1)),
                   0.25 * float(np.abs(stack.v).max()), by_side)


def _search(stack: Stack, weights: Array, ends: Array, step: float, by_side: bool) -> Line:
    """Iterate from break points (b_r, b_l) of each node, shape (R, 2)."""
    most = float(np.abs(stack.v).max())
    rest_count, nodes = stack.y.shape[1], weights.shape[1]
    for _ in range(1 if by_side else ROUNDS):
        columns = np.column_stack([-stack.y, stack.integral(
            side_hinges(stack) if by_side else hinges(stack.v, (weights @ ends)[stack.owner]))])
        gram, target = _normal(stack, columns, weights)
        scale = np.sqrt(np.diag(gram))
        if not (scale > 0.0).all():
            raise RecordingError(BLIND)
        scaled = gram / np.outer(scale, scale)
        if np.linalg.cond(scaled) > CONDITION ** 2:
            raise RecordingError(BLIND)
        solution = np.linalg.solve(scaled, target / scale) / scale
        found = solution[rest_count:].reshape(COUNT, nodes).T
        slopes = found[:, 2:]
        if slopes.min() <= 0.0:
            raise RecordingError(f'{BLIND}; a slope came out negative')
        change = -found[:, :2] / slopes
        if by_side:
            ends = change
            break
        change = np.clip(change, -step, step)
        ends = ends + change
        if nodes == 1:
            ends = np.array([[max(ends[0, 0], 0.0), min(ends[0, 1], 0.0)]])
        step *= 0.8         # samples change sides: let it settle
        if np.abs(change).max() < (CLOSE if nodes == 1 else 10.0 * CLOSE) * most:
            break
    return _with_errors(stack, columns, weights, solution, np.linalg.inv(scaled)
                        / np.outer(scale, scale), np.column_stack([ends, slopes]))


def hinges(v: Array, ends: Array) -> Array:
    """Return what multiplies −b m_r δ_r, −b m_l δ_l, b m_r, b m_l in each sample, shape (N, 4).

    Args:
        v: Commands, shape (N,).
        ends: Break points b_r, b_l, shape (2,) or (N, 2).
    """
    b_r, b_l = ends[..., 0], ends[..., 1]
    above, below = v > b_r, v < b_l
    return np.column_stack([above, below, np.where(above, v - b_r, 0.0),
                            np.where(below, v - b_l, 0.0)])


def side_hinges(stack: Stack) -> Array:
    """Return the same with friction counted in: −b m_r b_r, −b m_l b_l by the side of motion."""
    return np.column_stack([stack.side > 0, stack.side < 0, np.maximum(stack.v, 0.0),
                            np.minimum(stack.v, 0.0)])


def _normal(stack: Stack, columns: Array, weights: Array) -> tuple[Array, Array]:
    """Return Xᵀ X and Xᵀ left of all unknowns: a, then each of `ZONE` at every node."""
    if weights.shape[1] == 1:
        return columns.T @ columns, columns.T @ stack.left
    rest_count = columns.shape[1] - COUNT
    size = rest_count + COUNT * weights.shape[1]
    gram, target = np.zeros((size, size)), np.zeros(size)
    for (begin, end), spread in zip(stack.edges, _spread(rest_count, weights), strict=True):
        part = columns[begin:end]
        gram += spread.T @ (part.T @ part) @ spread
        target += spread.T @ (part.T @ stack.left[begin:end])
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


def _with_errors(stack: Stack, columns: Array, weights: Array, solution: Array, inverse: Array,
                 zone: Array) -> Line:
    rest_count, nodes, size = stack.y.shape[1], weights.shape[1], len(solution)
    if stack.count <= size and nodes > 1:
        raise RecordingError(f'{BLIND}: {stack.count} stretches of motion for {size} unknowns')
    pushes, power = [], 0.0
    for (begin, end), spread in zip(stack.edges, _spread(rest_count, weights), strict=True):
        rest = stack.left[begin:end] - columns[begin:end] @ (spread @ solution)
        pushes.append(spread.T @ (columns[begin:end].T @ rest))
        power += float(rest @ rest)
    variance = power / max(1, len(stack.left) - size - stack.count)
    push = np.array(pushes)
    robust = inverse @ (push.T @ push) @ inverse * stack.count / max(1, stack.count - size)
    errors = np.sqrt(variance * np.diag(inverse))[rest_count:].reshape(COUNT, nodes).T
    # Of break points the unknown is b m δ.
    turn = np.column_stack([1.0 / zone[:, 2:], np.ones((nodes, 2))])
    common = []
    for i in range(COUNT):
        part = slice(rest_count + i * nodes, rest_count + (i + 1) * nodes)
        mean = turn[:, i] / nodes
        common.append(math.sqrt(float(mean @ robust[part, part] @ mean)))
    return Line(solution[:rest_count], zone, errors * turn, np.array(common),
                math.sqrt(variance))

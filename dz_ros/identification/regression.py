"""Dead-zone and plant from stretches of motion: least squares with two hinges (ours).

With w = D(v) the integrated equation (`stretches`) is linear in a_i, b m_r, b m_l once the break
points are known; near them it is linear in their corrections δ too (Muggeo's iteration for broken
lines [muggeo2003]):

    left = −Σ a_i ∫Y_i + b m_r ∫(v − b_r)⁺ − b m_r δ_r ∫1(v > b_r) + the same on the left
    b_r ← b_r + δ_r                                                            until it stays

b and m show only as their product. a_i are constants of the plant, as (6) has them: they are found
from all repeats together. Here break points and slopes are constants as well; `drifting` lets them
drift, and begins with what is found here.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.errors import RecordingError
from dz_ros.identification.stretches import Stack

Array = NDArray[np.float64]

ZONE = ('b_r', 'b_l', 'b·m_r', 'b·m_l')
"""What a repeat tells, in this order."""

BLIND = ('the motion does not tell friction, slopes and break points apart: allow more speed, '
         'travel and effort')
ROUNDS = 40
"""Iterations at most."""
CLOSE = 1e-6
"""Change of a break point, as a share of the largest |v|, at which it stays."""
CONDITION = 1e4
"""Beyond this condition number of the scaled equations nothing tells the parameters apart."""
STARTS = (0.1, 0.3, 0.5)
"""Shares of the largest |v| at which the search for the break points begins."""


@dataclass(frozen=True)
class Line:
    """Parameters of plant and dead-zone.

    Attributes:
        a: a_i, then the factor of the disturbance where there is one, shape (r,) or (r + 1,).
        zone: `ZONE`, shape (4,).
        errors: Standard errors of `zone` by the residual, taken as white, shape (4,).
        residual: RMS of what the equation leaves, in the unit of what was measured last.
    """

    a: Array
    zone: Array
    errors: Array
    residual: float


def solve(stack: Stack, a: Array | None = None, start: Array | None = None) -> Line:
    """Return the least-squares parameters of stretches.

    Args:
        stack: The stretches.
        a: What `Line.a` says, where it is known; None = to be found.
        start: Break points (b_r, b_l) to begin with; None = several, of which the best is kept.

    Raises:
        RecordingError: The stretches do not tell.
    """
    if stack.v.max() <= 0.0 or stack.v.min() >= 0.0:
        raise RecordingError('nothing to identify: the command has one sign only')
    if start is not None:
        return _search(stack, a, np.asarray(start, dtype=float))
    most = float(np.abs(stack.v).max())
    lines: list[Line] = []
    problem = RecordingError('nothing to identify')
    for share in STARTS:
        try:
            lines.append(_search(stack, a, np.array([share * most, -share * most])))
        except RecordingError as error:
            problem = error
    if not lines:
        raise problem
    return min(lines, key=lambda line: line.residual)


def _search(stack: Stack, a: Array | None, ends: Array) -> Line:
    most = float(np.abs(stack.v).max())
    target = stack.left if a is None else stack.left + stack.y @ a
    step = 0.5 * most
    for _ in range(ROUNDS):
        columns = stack.integral(hinges(stack.v, ends))
        if a is None:
            columns = np.column_stack([-stack.y, columns])
        scale = np.sqrt((columns * columns).sum(axis=0))
        if not (scale > 0.0).all():
            raise RecordingError(BLIND)
        columns = columns / scale
        gram = columns.T @ columns
        if np.linalg.cond(gram) > CONDITION ** 2:
            raise RecordingError(BLIND)
        solution = np.linalg.solve(gram, columns.T @ target) / scale
        slopes = solution[-2:]
        if slopes.min() <= 0.0:
            raise RecordingError(f'{BLIND}; a slope came out negative')
        change = np.clip(-solution[-4:-2] / slopes, -step, step)
        ends = np.array([max(ends[0] + change[0], 0.0), min(ends[1] + change[1], 0.0)])
        step *= 0.8         # samples change sides: let it settle
        if np.abs(change).max() < CLOSE * most:
            break
    rest = target - columns @ (solution * scale)
    variance = float(rest @ rest) / max(1, len(rest) - len(solution) - stack.count)
    spread = (np.sqrt(variance * np.diag(np.linalg.inv(gram))) / scale)[-4:]
    return Line(solution[:-4] if a is None else a, np.array([*ends, *slopes]),
                np.array([*(spread[:2] / slopes), *spread[2:]]), math.sqrt(variance))


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

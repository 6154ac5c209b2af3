"""Where the search for a plant's parameters begins: the model integrated over windows (ours).

Over a window the model is linear in its parameters if the dead-zone is taken as passed,

    Δx^(n−1) + ∫disturbance = −Σ a_i ∫Y_i + (b m) ∫v − (b m b_r) ∫1(v>0) − (b m b_l) ∫1(v<0)

which ordinary least squares solves. Rough where the command rests inside the dead-zone; the search
that follows is not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dz_ros.analysis.fit_data import Segment
from dz_ros.core.configuration import Configuration

Array = NDArray[np.float64]

WINDOW = 10
"""Intervals in a window."""


def configured_parameters(c: Configuration) -> Array:
    """Return a_1 … a_r, b m, b_r, b_l of a configuration, m the mean of its slopes."""
    zone = c.dead_zone
    return np.array([*c.plant.a, c.plant.b * 0.5 * (zone.m_r + zone.m_l), zone.b_r, zone.b_l])


def first_guess(segments: Sequence[Segment], c: Configuration) -> Array:
    """Return a_1 … a_r, b m, b_r, b_l to begin with; the configured ones where this fails.

    Args:
        segments: The run.
        c: Model and known constants.
    """
    r = c.plant.regressor_count
    configured = configured_parameters(c)
    rows, changes = [], []
    y = [0.0] * r
    constants = c.plant.constants
    for segment in segments:
        table = []
        for x, pieces in zip(segment.x[:-1].tolist(), segment.pieces, strict=True):
            c.plant.regressors(x, constants, y)
            span = sum(piece[1] for piece in pieces)
            drive = sum(piece[1] * piece[2] for piece in pieces)
            right = sum(piece[1] for piece in pieces if piece[2] > 0.0)
            left = sum(piece[1] for piece in pieces if piece[2] < 0.0)
            pushed = c.plant.disturbance(pieces[0][0], x, constants) * span
            table.append([*(-span * item for item in y), drive, -right, -left, pushed])
        sums = np.vstack([np.zeros(r + 4), np.cumsum(np.array(table), axis=0)])
        for begin in range(0, len(sums) - WINDOW, WINDOW):
            window = sums[begin + WINDOW] - sums[begin]
            rows.append(window[:-1])
            changes.append(segment.x[begin + WINDOW, -1] - segment.x[begin, -1] + window[-1])
    if len(rows) < 2 * (r + 3):
        return configured
    found = np.linalg.lstsq(np.array(rows), np.array(changes), rcond=None)[0]
    gain = found[r]
    guess = np.array([*found[:r], gain, found[r + 1] / gain, found[r + 2] / gain])
    if not np.isfinite(guess).all() or gain <= 1e-6:
        return configured
    guess[r + 1] = max(guess[r + 1], 1e-3)
    guess[r + 2] = min(guess[r + 2], -1e-3)
    return guess

# SPDX-License-Identifier: Apache-2.0
"""What a device's measurement shows of its sensor: one step, and its noise (ours).

A position that is counted changes by whole multiples of one step q. q is the smallest change that
is seen, if nearly all small changes are multiples of it; of a measurement that is not counted, or
is brought to the sample by a velocity, they are not, and q = 0 means that no step shows.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SMALL = 20.0
"""Changes up to this number of steps are compared."""
NEAR, SHARE = 0.05, 0.95
"""Distance from a whole number of steps, and the share of changes that must be as near."""
LEAST = 20
"""Fewer changes show no step."""


def resolution(x: Array) -> float:
    """Return one step of a position, 0 where none shows.

    Args:
        x: Positions in the order of time, shape (K,); NaN = not measured.
    """
    steps = np.abs(np.diff(x[np.isfinite(x)]))
    scale = float(np.abs(x[np.isfinite(x)]).max(initial=0.0))
    steps = steps[steps > 1e-12 * max(scale, 1e-300)]
    if len(steps) < LEAST:
        return 0.0
    least = float(steps.min())
    counts = steps[steps < SMALL * least] / least
    if len(counts) < LEAST or np.mean(np.abs(counts - np.round(counts)) < NEAR) < SHARE:
        return 0.0
    return float(np.mean(steps[steps < SMALL * least] / np.round(counts)))


def white_noise(values: Array) -> float:
    """Return the standard deviation of white noise, by third differences.

    Args:
        values: In the order of time, shape (K,); NaN = not measured.
    """
    steps = np.diff(values, n=3)
    steps = steps[np.isfinite(steps)]
    # By the median: few outliers are no noise.
    return float(np.median(np.abs(steps))) / (0.6745 * math.sqrt(20.0)) if len(steps) else 0.0


def measurement_noise(x: Array) -> float:
    """Return the standard deviation of noise and rounding of a measurement.

    Args:
        x: In the order of time, shape (K,); NaN = not measured.
    """
    return max(white_noise(x), resolution(x) / math.sqrt(12.0))

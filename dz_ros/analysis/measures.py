"""Single measures of arrays: windows, settling, total variation, what is left above 10 Hz."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.errors import ConfigurationError

Array = NDArray[np.float64]

WINDOW = 10.0
"""Default length of the window at the end of a run [s]."""
CORNER = 10.0
"""Corner of the high-pass applied to v [Hz]."""
SHORT = 20_000
"""Up to so many samples are filtered in plain Python."""


def choose_window(t: Array, window: tuple[float, float] | None = None) -> tuple[float, float]:
    """Return the window of a run: the one given, else its last 10 s or its last half.

    Raises:
        ConfigurationError: The window given is not one, or holds fewer than two samples.
    """
    first, last = float(np.nanmin(t)), float(np.nanmax(t))
    if window is None:
        return last - min(WINDOW, 0.5 * (last - first)), last
    begin, end = window
    inside = np.count_nonzero((t >= begin - 1e-9) & (t <= end + 1e-9))
    if not begin < end or inside < 2:
        raise ConfigurationError('window', list(window),
                                 'must be two instants with at least two samples between them; '
                                 f'the run goes from {first:g} to {last:g} s')
    return float(begin), float(end)


def settled_after(t: Array, error: Array, tolerance: float, since: float = -math.inf,
                  remain: float = 0.0) -> float | None:
    """Return the first sampled instant from which on |x̃| < tolerance holds to the end.

    Args:
        t: Time, ascending [s], shape (N,).
        error: x̃, shape (N,); NaN counts as outside.
        tolerance: In the unit of x̃.
        since: Instants before this are not looked at [s].
        remain: It must hold at least this long before the end [s].
    """
    rows = t >= since - 1e-9
    t, error = t[rows], error[rows]
    if not len(t):
        return None
    outside = np.flatnonzero(~(np.abs(error) < tolerance))
    begin = int(outside[-1]) + 1 if len(outside) else 0
    if begin >= len(t) or t[-1] - t[begin] < remain - 1e-9:
        return None
    return float(t[begin])


def high_passed(v: Array, rate: float, corner: float = CORNER) -> Array | None:
    """Return v without what is slower than the corner, phase untouched; None where impossible.

    Args:
        v: Equidistant samples, shape (N,).
        rate: Samples per second; must exceed twice the corner.
        corner: Corner of the 4th-order Butterworth high-pass, run forwards and backwards [Hz].
    """
    if rate <= 2.0 * corner or len(v) < 30 or not np.isfinite(v).all():
        return None
    if len(v) <= SHORT:
        return both_ways(v, rate, corner)
    from scipy import signal
    sections = signal.butter(4, corner, 'highpass', fs=rate, output='sos')
    return np.asarray(signal.sosfiltfilt(sections, v))


def both_ways(v: Array, rate: float, corner: float) -> Array:
    """Return what `high_passed` does without scipy, whose import takes longer than a simulation.

    Two sections of second order by the bilinear transform, quality 1/(2 cos π/8), 1/(2 cos 3π/8);
    begun in the steady state of the first value, with 15 samples mirrored in each end.
    """
    k = math.tan(math.pi * corner / rate)
    edge = 15
    x = np.concatenate((2.0 * v[0] - v[edge:0:-1], v, 2.0 * v[-1] - v[-2:-edge - 2:-1])).tolist()
    for _ in range(2):
        first = x[0]
        for damping in (2.0 * math.cos(math.pi / 8.0), 2.0 * math.cos(3.0 * math.pi / 8.0)):
            scale = 1.0 / (1.0 + damping * k + k * k)
            a1, a2 = 2.0 * (k * k - 1.0) * scale, (1.0 - damping * k + k * k) * scale
            z1, z2 = -scale * first, scale * first
            first = 0.0
            for i, value in enumerate(x):
                y = scale * value + z1
                z1 = z2 - 2.0 * scale * value - a1 * y
                z2 = scale * value - a2 * y
                x[i] = y
        x.reverse()
    return np.array(x[edge:-edge])


def largest(values: Array) -> float | None:
    """Return max|values| of those that are numbers."""
    known = values[~np.isnan(values)]
    return float(np.abs(known).max()) if len(known) else None


def rms(values: Array) -> float | None:
    """Return the root mean square of those that are numbers."""
    known = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(known * known))) if len(known) else None


def share(known: Array, condition: NDArray[np.bool_]) -> float | None:
    """Return how often a condition holds among the samples where `known` is a number."""
    count = int(np.count_nonzero(~np.isnan(known)))
    return float(np.count_nonzero(condition[~np.isnan(known)])) / count if count else None


def variation(t: Array, v: Array) -> float | None:
    """Return Σ|Δv| per second over the samples that have a command."""
    known = ~np.isnan(v)
    t, v = t[known], v[known]
    if len(t) < 2 or t[-1] <= t[0]:
        return None
    return float(np.abs(np.diff(v)).sum() / (t[-1] - t[0]))

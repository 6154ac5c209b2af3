# SPDX-License-Identifier: Apache-2.0
"""The numbers of a run (mathematics.md §9, ours): accuracy, the command's cost, Ω_ε.

Over a window at the end of the run (default its last 10 s, its last half where that is shorter):

    max|x̃|, RMS x̃, max|s|/ε, RMS and peak v, total variation Σ|v_{k+1} − v_k| per second,
    RMS of v above 10 Hz (4th-order Butterworth high-pass, forwards and backwards: no phase),
    share of samples in Ω_ε: |x̃_i| ≤ 2^(i−1) λ^(i−n) ε

and over the whole run: peak v, the instant after which |x̃| < tolerance for good, the same counted
from a pulse. x̃ is that of the *measured* state: measurement noise is part of it. Small error
bought with chatter is no win: read max|x̃| and total variation together.

Over 300 lines: the metrics, and the measures of arrays that they consist of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.loop.compiled import quick
from dz_ros.core.tracking import error_weights, guaranteed_bounds
from dz_ros.errors import ConfigurationError
from dz_ros.runs.setting import Setting
from dz_ros.runs.table import RunTable

Array = NDArray[np.float64]

WINDOW = 10.0
"""Default length of the window at the end of a run [s]."""
CORNER = 10.0
"""Corner of the high-pass applied to v [Hz]."""
SHORT = 20_000
"""Number of samples up to which plain Python filters."""
TOLERANCE = 0.05
"""Default |x̃| below which a run counts as settled where x has no unit: the example's."""
RELATIVE_TOLERANCE = 0.02
"""The same where x has a unit, as a share of the largest |x_d|; the example's is the same."""
LARGE = 1e150
"""Commands below this have differences and squares that are finite."""
FOR_GOOD = 0.1
"""Share of the run that must remain below the tolerance for it to be 'for good'."""


def quantity(label: str, unit: str, sentence: str) -> Any:
    """Declare a metric: its label, its unit expression, what it is."""
    return field(metadata={'label': label, 'unit': unit, 'sentence': sentence})


@dataclass(frozen=True, repr=False)
class Metrics:
    """Numbers of a run; None where there is nothing to compute one from.

    Attributes:
        window: First and last instant of the window [s].
        samples: States in the window.
        tolerance: |x̃| that counts as settled, unit of x.
        state_error_max: max|x̃_i| in the window, units of x, x', …, shape (n,).
        error_max: max|x̃|, unit of x.
        error_rms: RMS x̃, unit of x.
        s_over_epsilon_max: max|s|/ε, dimensionless.
        layer_share: Share of samples with |s| ≤ ε, 0 … 1.
        omega_share: Share of samples in Ω_ε, 0 … 1.
        v_rms: RMS v, actuator unit.
        v_peak: max|v| in the window, actuator unit.
        v_peak_run: max|v| of the whole run, actuator unit.
        v_variation: Total variation of v, actuator unit per second.
        v_highpass: RMS of v above 10 Hz, actuator unit.
        settling_time: Instant after which |x̃| < tolerance for good [s]; None = never.
        recovery_time: From the pulse until |x̃| < tolerance for good [s]; None = never, or none.
    """

    window: tuple[float, float]
    samples: int
    tolerance: float
    state_error_max: tuple[float | None, ...]
    error_max: float | None = quantity(
        'max |x̃|', 'x', 'largest tracking error in the window')
    error_rms: float | None = quantity(
        'RMS x̃', 'x', 'root mean square of the tracking error in the window')
    s_over_epsilon_max: float | None = quantity(
        'max |s| / ε', '1', 'largest filtered error over the half-width of the boundary layer; '
        'below 1 the state never leaves the layer and estimates rest')
    layer_share: float | None = quantity(
        'share with |s| ≤ ε', '%', 'part of the window spent inside the boundary layer')
    omega_share: float | None = quantity(
        'share in Ω_ε', '%', 'part of the window in which every state error lies within the '
        'bounds the theorem names')
    v_rms: float | None = quantity('RMS v', 'v', 'root mean square of the command in the window')
    v_peak: float | None = quantity(
        'peak |v|, window', 'v', 'largest command in the window')
    v_peak_run: float | None = quantity(
        'peak |v|, whole run', 'v', 'largest command of the whole run, the start included')
    v_variation: float | None = quantity(
        'total variation of v', 'v/s', 'sum of all changes of the command per second; chatter '
        'shows here first')
    v_highpass: float | None = quantity(
        'v above 10 Hz', 'v', 'RMS of the command after a zero-phase 4th-order Butterworth '
        'high-pass at 10 Hz: what an actuator has to swallow besides the motion')
    settling_time: float | None = quantity(
        'settled after', 's', 'instant after which |x̃| stays below the tolerance for good')
    recovery_time: float | None = quantity(
        'recovered after the pulse', 's', 'time from the disturbance pulse until |x̃| stays below '
        'the tolerance for good')

    def __repr__(self) -> str:
        """Return one line: the window and the numbers that there are, to four digits."""
        known = [f'{name} {value:.4g}' for name, _ in self.described()
                 if (value := getattr(self, name)) is not None]
        begin, end = self.window
        return f'<Metrics of {begin:g} to {end:g} s: {", ".join(known)}>'

    def to_dict(self) -> dict[str, Any]:
        """Return everything by name, ready for JSON: what is not finite is None."""
        return {item.name: jsonable(getattr(self, item.name)) for item in fields(self)}

    def shown(self, name: str) -> float | None:
        """Return a number in the unit that `described` gives it: shares in percent."""
        value: float | None = getattr(self, name)
        percent = self.__dataclass_fields__[name].metadata.get('unit') == '%'
        return 100.0 * value if percent and value is not None else value

    @staticmethod
    def described() -> tuple[tuple[str, Mapping[str, str]], ...]:
        """Return name → label, unit, sentence of every single number, in order."""
        return tuple((item.name, item.metadata) for item in fields(Metrics) if item.metadata)


def jsonable(value: Any) -> Any:
    """Return a value made of plain Python types; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [jsonable(item) for item in value]
    if isinstance(value, (np.floating, np.integer, np.bool_)):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def filtered_error(rows: RunTable, setting: Setting) -> Array:
    """Return s: the law's own where it is published, else Λᵀx̃ (8) with the configured λ."""
    if 's' in rows.terms:
        return _while(rows.active, rows.terms['s'])
    if setting.lambda_ is None:
        return np.full(len(rows.t), np.nan)
    return np.asarray(rows.error @ np.asarray(error_weights(setting.lambda_, setting.order)))


def while_active(rows: RunTable) -> RunTable:
    """Return a table whose terms, but for the status, are NaN where the law was inactive."""
    return replace(rows, terms={name: values if name == 'status' else _while(rows.active, values)
                                for name, values in rows.terms.items()})


def layer_width(rows: RunTable, setting: Setting) -> Array:
    """Return ε of every sample, shape (N,): the law's own signal where it publishes one.

    NaN where the law was inactive, so that such samples enter no share and no s/ε.
    """
    width = rows.terms['epsilon'] if 'epsilon' in rows.terms else np.full(
        len(rows.t), math.nan if setting.epsilon is None else setting.epsilon)
    return _while(rows.active, width)


def _while(active: NDArray[np.bool_], values: Array) -> Array:
    """Return values, NaN where the law was inactive."""
    return values if active.all() else np.where(active, values, math.nan)


def default_tolerance(rows: RunTable, setting: Setting) -> float:
    """Return the |x̃| that counts as settled, unit of x."""
    if setting.unit('x') in ('', '1'):
        return TOLERANCE
    reach = largest(rows.x_d[:, 0])
    if not reach or not math.isfinite(reach):
        return TOLERANCE
    return RELATIVE_TOLERANCE * reach


def measure(rows: RunTable, setting: Setting, *, window: tuple[float, float] | None = None,
            pulse: float | None = None, tolerance: float | None = None) -> Metrics:
    """Return the metrics of a run.

    Args:
        rows: The run as one table.
        setting: What is known of it.
        window: First and last instant [s]; None = the last 10 s, or the last half of a short run.
        pulse: Instant of a disturbance to recover from [s].
        tolerance: |x̃| that counts as settled, unit of x; None = 0.05 where x has no unit, else
            2 % of the largest |x_d|.

    Raises:
        ConfigurationError: The window holds no two samples, or the tolerance is not positive.
    """
    if tolerance is None:
        tolerance = default_tolerance(rows, setting)
    if not tolerance > 0.0:
        raise ConfigurationError('tolerance', tolerance, 'must be > 0, in the unit of x')
    begin, end = choose_window(rows.t, window)
    inside = _span((rows.t >= begin - 1e-9) & (rows.t <= end + 1e-9))
    errors = [np.abs(rows.x[:, i] - rows.x_d[:, i]) for i in range(rows.x.shape[1])]
    t, v, error = rows.t[inside], rows.v[inside], [item[inside] for item in errors]
    windowed = replace(rows, seq=rows.seq[inside], t=t, v=v, x=rows.x[inside],
                       x_d=rows.x_d[inside], terms={
                           name: rows.terms[name][inside] for name in ('s', 'epsilon', 'status')
                           if name in rows.terms})
    epsilon = layer_width(windowed, setting)
    with np.errstate(over='ignore', invalid='ignore'):
        ratio = np.abs(filtered_error(windowed, setting) / epsilon)
    remain = FOR_GOOD * rows.duration
    recovered = None if pulse is None else settled_after(rows.t, errors[0], tolerance, pulse,
                                                         min(remain, 0.5 * (rows.t[-1] - pulse)))
    with np.errstate(over='ignore', invalid='ignore'):
        largest_errors = tuple(largest(item) for item in error)
        return Metrics(
            (begin, end), len(t), tolerance, largest_errors, largest_errors[0], rms(error[0]),
            largest(ratio), share(ratio, ratio <= 1.0), _omega_share(error, epsilon, setting),
            rms(v), largest(v), largest(rows.v), variation(t, v),
            _highpass_rms(rows, setting, inside),
            settled_after(rows.t, errors[0], tolerance, remain=remain),
            None if recovered is None or pulse is None else recovered - pulse)


def _span(mask: NDArray[np.bool_]) -> slice | NDArray[np.bool_]:
    """Return a mask as a slice where it is one, so that what it selects need not be copied."""
    first, count = int(mask.argmax()), int(np.count_nonzero(mask))
    return slice(first, first + count) if mask[first:first + count].all() else mask


def _omega_share(error: Sequence[Array], epsilon: Array, setting: Setting) -> float | None:
    """Return the share of samples with every |x̃_i|, `error`, each of shape (N,), within Ω_ε."""
    if setting.lambda_ is None:
        return None
    bounds = guaranteed_bounds(setting.lambda_, 1.0, len(error))
    within, known = np.ones(len(epsilon), dtype=bool), epsilon
    for item, scale in zip(error, bounds, strict=True):
        within &= item <= scale * epsilon
        known = known + item
    return share(known, within)


def _highpass_rms(rows: RunTable, setting: Setting,
                  inside: slice | NDArray[np.bool_]) -> float | None:
    """Return the RMS of high-passed v in the window, missing commands interpolated over."""
    if setting.period is None:
        return None
    if (np.abs(rows.v).max() < LARGE        # false for NaN and infinity too
            and np.array_equal(rows.t, np.arange(len(rows.t)) * setting.period)):
        begin, end = (inside.start, inside.stop) if isinstance(inside, slice) else (0, len(rows.t))
        rest = high_passed(rows.v, 1.0 / setting.period, since=begin)   # each sample at its place
        return None if rest is None else rms(
            rest[:end - begin] if isinstance(inside, slice) else rest[inside])
    known = np.isfinite(rows.v)
    if not known.any():
        return None
    place = np.rint((rows.t - rows.t[0]) / setting.period)
    if place[-1] > 4 * len(place):
        return None
    v = np.interp(np.arange(place[-1] + 1.0), place[known], rows.v[known])
    rest = high_passed(v, 1.0 / setting.period)
    return None if rest is None else rms(rest[place[inside].astype(np.int64)])


def window_length(duration: float) -> float:
    """Return the length of the window of a run that names none [s]: 10 s, or half a short run."""
    return min(WINDOW, 0.5 * duration)


def choose_window(t: Array, window: tuple[float, float] | None = None) -> tuple[float, float]:
    """Return the window of a run: the one given, else its last 10 s or its last half.

    Raises:
        ConfigurationError: The window given is not one, or holds fewer than two samples.
    """
    first, last = float(t.min()), float(t.max())
    if math.isnan(first):
        first, last = float(np.nanmin(t)), float(np.nanmax(t))
    if window is None:
        return last - window_length(last - first), last
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
        since: Instants before this are left out [s].
        remain: It must hold at least this long before the end [s].
    """
    if since > -math.inf:
        rows = t >= since - 1e-9
        t, error = t[rows], error[rows]
    if not len(t):
        return None
    outside = np.flatnonzero(~(np.abs(error) < tolerance))
    begin = int(outside[-1]) + 1 if len(outside) else 0
    if begin >= len(t) or t[-1] - t[begin] < remain - 1e-9:
        return None
    return float(t[begin])


def high_passed(v: Array, rate: float, corner: float = CORNER, since: int = 0) -> Array | None:
    """Return v without what is slower than the corner, phase untouched; None where impossible.

    Args:
        v: Equidistant samples, shape (N,).
        rate: Samples per second; must exceed twice the corner.
        corner: Corner of the 4th-order Butterworth high-pass, run forwards and backwards [Hz].
        since: Sample from which on it is returned, shape (N − since,).
    """
    if rate <= 2.0 * corner or len(v) < 30 or not np.isfinite(v).all():
        return None
    if len(v) <= SHORT:
        return both_ways(v, rate, corner, since)
    from scipy import signal
    sections = signal.butter(4, corner, 'highpass', fs=rate, output='sos')
    return np.asarray(signal.sosfiltfilt(sections, v)[since:])


def both_ways(v: Array, rate: float, corner: float, since: int = 0) -> Array:
    """Return what `high_passed` does without scipy, whose import takes longer than a simulation.

    Two sections of second order by the bilinear transform, quality 1/(2 cos π/8), 1/(2 cos 3π/8);
    begun in the steady state of the first value, with 15 samples mirrored in each end.
    """
    k = math.tan(math.pi * corner / rate)
    edge = 15
    x: Any = np.concatenate((2.0 * v[0] - v[edge:0:-1], v, 2.0 * v[-1] - v[-2:-edge - 2:-1]))
    run = quick(high_pass)
    if run is high_pass:
        x = x.tolist()
    run(k, *DAMPING, float(x[0]), x)
    x = x[:since + edge - 1:-1]     # backwards, and no further than is wanted
    if run is not high_pass:
        x = x.copy()
    run(k, *DAMPING, float(x[0]), x)
    return np.array(x[:edge - 1:-1])


DAMPING = (2.0 * math.cos(math.pi / 8.0), 2.0 * math.cos(3.0 * math.pi / 8.0))
"""One over the quality of each section of the 4th-order Butterworth filter."""


def high_pass(k: float, damping1: float, damping2: float, first: float, x: Any) -> None:
    """Run two sections of second order over x, shape (N,), in place; plain scalar code.

    Args:
        k: tan(π corner / rate).
        damping1: One over the first section's quality.
        damping2: One over that of the second.
        first: Value in whose steady state they begin.
        x: A list of floats, or an array where this is compiled.
    """
    scale1 = 1.0 / (1.0 + damping1 * k + k * k)
    scale2 = 1.0 / (1.0 + damping2 * k + k * k)
    a1, a2 = 2.0 * (k * k - 1.0) * scale1, (1.0 - damping1 * k + k * k) * scale1
    b1, b2 = 2.0 * (k * k - 1.0) * scale2, (1.0 - damping2 * k + k * k) * scale2
    z1, z2 = -scale1 * first, scale1 * first
    y1, y2 = -scale2 * 0.0, scale2 * 0.0
    for i in range(len(x)):
        value = x[i]
        middle = scale1 * value + z1
        z1 = z2 - 2.0 * scale1 * value - a1 * middle
        z2 = scale1 * value - a2 * middle
        last = scale2 * middle + y1
        y1 = y2 - 2.0 * scale2 * middle - b1 * last
        y2 = scale2 * middle - b2 * last
        x[i] = last


def largest(values: Array) -> float | None:
    """Return max|values| of those that are numbers."""
    if len(values):
        found = float(np.abs(values).max())
        if not math.isnan(found):
            return found
    known = values[~np.isnan(values)]
    return float(np.abs(known).max()) if len(known) else None


def rms(values: Array) -> float | None:
    """Return the root mean square of those that are numbers."""
    known = _numbers(values)
    return math.sqrt(float(np.add.reduce(known * known)) / len(known)) if len(known) else None


def share(known: Array, condition: NDArray[np.bool_]) -> float | None:
    """Return how often a condition holds among the samples where `known` is a number."""
    missing = np.isnan(known)
    if missing.any():
        condition = condition[~missing]
    return float(np.count_nonzero(condition)) / len(condition) if len(condition) else None


def variation(t: Array, v: Array) -> float | None:
    """Return Σ|Δv| per second over the samples that have a command."""
    known = ~np.isnan(v)
    if not known.all():
        t, v = t[known], v[known]
    if len(t) < 2 or t[-1] <= t[0]:
        return None
    return float(np.abs(v[1:] - v[:-1]).sum() / (t[-1] - t[0]))


def _numbers(values: Array) -> Array:
    """Return those that are numbers."""
    missing = np.isnan(values)
    return values[~missing] if missing.any() else values

"""The numbers of a run (mathematics.md §9, ours): accuracy, the command's cost, Ω_ε.

Over a window at the end of the run (default its last 10 s, its last half where that is shorter):

    max|x̃|, RMS x̃, max|s|/ε, RMS and peak v, total variation Σ|v_{k+1} − v_k| per second,
    RMS of v above 10 Hz (4th-order Butterworth high-pass, forwards and backwards: no phase),
    share of samples in Ω_ε: |x̃_i| ≤ 2^(i−1) λ^(i−n) ε

and over the whole run: peak v, the instant after which |x̃| < tolerance for good, the same counted
from a kick. x̃ is that of the *measured* state: measurement noise is part of it. Small error
bought with chatter is no win: read max|x̃| and total variation together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.analysis.align import Aligned
from dz_ros.analysis.measures import (
    choose_window,
    high_passed,
    largest,
    rms,
    settled_after,
    share,
    variation,
)
from dz_ros.analysis.setting import Setting
from dz_ros.core.tracking import error_weights, guaranteed_bounds
from dz_ros.errors import ConfigurationError

Array = NDArray[np.float64]

TOLERANCE = 0.05
"""Default |x̃| below which a run counts as settled where x has no unit: the example's."""
RELATIVE_TOLERANCE = 0.02
"""The same where x has a unit, as a share of the largest |x_d|; the example's is the same."""
FOR_GOOD = 0.1
"""Share of the run that must remain below the tolerance for it to be 'for good'."""


def quantity(label: str, unit: str, sentence: str) -> Any:
    """Declare a metric: its label, its unit as `Setting.unit` takes it, what it is."""
    return field(metadata={'label': label, 'unit': unit, 'sentence': sentence})


@dataclass(frozen=True)
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
        recovery_time: From the kick until |x̃| < tolerance for good [s]; None = never, or no kick.
    """

    window: tuple[float, float]
    samples: int
    tolerance: float
    state_error_max: tuple[float | None, ...]
    error_max: float | None = quantity(
        'max |x̃|', 'x0', 'largest tracking error in the window')
    error_rms: float | None = quantity(
        'RMS x̃', 'x0', 'root mean square of the tracking error in the window')
    s_over_epsilon_max: float | None = quantity(
        'max |s| / ε', '1', 'largest filtered error over the half-width of the boundary layer; '
        'below 1 the state never leaves the layer and estimates rest')
    layer_share: float | None = quantity(
        'share with |s| ≤ ε', '1', 'part of the window spent inside the boundary layer')
    omega_share: float | None = quantity(
        'share in Ω_ε', '1', 'part of the window in which every state error lies within the '
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
        'recovered after kick', 's', 'time from the kick until |x̃| stays below the tolerance '
        'for good')

    def to_dict(self) -> dict[str, Any]:
        """Return everything by name, ready for JSON: what is not finite is None."""
        return {item.name: jsonable(getattr(self, item.name)) for item in fields(self)}

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


def filtered_error(rows: Aligned, setting: Setting) -> Array:
    """Return s: the law's own where it is published, else Λᵀx̃ (8) with the configured λ."""
    if 's' in rows.terms:
        return rows.terms['s']
    if setting.lambda_ is None:
        return np.full(len(rows.t), np.nan)
    return np.asarray(rows.error @ np.asarray(error_weights(setting.lambda_, setting.order)))


def layer_width(rows: Aligned, setting: Setting) -> Array:
    """Return ε of every sample, shape (N,): the law's own signal where it publishes one."""
    if 'epsilon' in rows.terms:
        return rows.terms['epsilon']
    return np.full(len(rows.t), math.nan if setting.epsilon is None else setting.epsilon)


def default_tolerance(rows: Aligned, setting: Setting) -> float:
    """Return the |x̃| that counts as settled, unit of x."""
    reach = largest(rows.x_d[:, 0])
    if setting.unit('x0') in ('', '1') or not reach or not math.isfinite(reach):
        return TOLERANCE
    return RELATIVE_TOLERANCE * reach


def measure(rows: Aligned, setting: Setting, *, window: tuple[float, float] | None = None,
            kick: float | None = None, tolerance: float | None = None) -> Metrics:
    """Return the metrics of a run.

    Args:
        rows: The run as one table.
        setting: What is known of it.
        window: First and last instant [s]; None = the last 10 s, or the last half of a short run.
        kick: Instant of a disturbance to recover from [s].
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
    inside = (rows.t >= begin - 1e-9) & (rows.t <= end + 1e-9)
    error, v = rows.error[inside], rows.v[inside]
    epsilon = layer_width(rows, setting)
    ratio = np.abs(filtered_error(rows, setting) / epsilon)[inside]
    remain = FOR_GOOD * rows.duration
    recovered = None if kick is None else settled_after(rows.t, rows.error[:, 0], tolerance, kick,
                                                        min(remain, 0.5 * (rows.t[-1] - kick)))
    with np.errstate(over='ignore', invalid='ignore'):
        return Metrics(
            (begin, end), int(np.count_nonzero(inside)), tolerance,
            tuple(largest(error[:, i]) for i in range(error.shape[1])),
            largest(error[:, 0]), rms(error[:, 0]), largest(ratio), share(ratio, ratio <= 1.0),
            _omega_share(error, epsilon[inside], setting), rms(v), largest(v),
            largest(rows.v), variation(rows.t[inside], v), _highpass_rms(rows, setting, inside),
            settled_after(rows.t, rows.error[:, 0], tolerance, remain=remain),
            None if recovered is None or kick is None else recovered - kick)


def _omega_share(error: Array, epsilon: Array, setting: Setting) -> float | None:
    """Return the share of samples with every |x̃_i| within Ω_ε."""
    if setting.lambda_ is None:
        return None
    scale = np.asarray(guaranteed_bounds(setting.lambda_, 1.0, error.shape[1]))
    with np.errstate(invalid='ignore'):
        within = np.all(np.abs(error) <= scale * epsilon[:, np.newaxis], axis=1)
    return share(error.sum(axis=1) + epsilon, np.asarray(within))


def _highpass_rms(rows: Aligned, setting: Setting, inside: NDArray[np.bool_]) -> float | None:
    """Return the RMS of high-passed v in the window, missing commands interpolated over."""
    known = np.isfinite(rows.v)
    if setting.period is None or not known.any():
        return None
    place = np.rint((rows.t - rows.t[0]) / setting.period)
    if place[-1] > 4 * len(place):
        return None
    v = np.interp(np.arange(place[-1] + 1.0), place[known], rows.v[known])
    rest = high_passed(v, 1.0 / setting.period)
    return None if rest is None else rms(rest[place[inside].astype(np.int64)])

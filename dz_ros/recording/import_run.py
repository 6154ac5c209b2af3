# SPDX-License-Identifier: Apache-2.0
"""A run as the recorder writes it, from columns of another tool's file (ours).

Each row is a sample at its own time, numbered by the rows' own period, which differs from
1/loop.rate by no more than 2 % and is that of the run's configuration: rows that come early, late
or in a burst are neighbours all the same. Resampled, sample k is at k T after the first, T =
1/loop.rate; x and x_d are taken linearly between two rows, the command is held. Where rows are
missing, which two further apart than 1.5 of the file's own T show, the samples between are a gap:
they are not made up.

A velocity that is not given is observed from what is measured (`dz_ros.core.observers`), with the
acceleration of the reference where there is one; `info['observed']` names it, and identification
does not believe it. Derivatives of the reference that are not given are those of local
polynomials. The run's configuration has points of the reference as its trajectory. What else is
missing (terms, truth, round trips) stays missing and is named.

Over 300 lines: one pass from columns to channels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import Channel, own_period, RunData
from dz_ros.core.design.observation import observer_of
from dz_ros.core.observers.base import Observer
from dz_ros.core.records import Command, Reference, SEQ_LIMIT, State
from dz_ros.core.trajectories.waypoints import Waypoints, WaypointsParameters
from dz_ros.errors import ConfigurationError, RecordingError
from dz_ros.recording.import_columns import Column
from dz_ros.recording.import_map import KEY, Source
from dz_ros.recording.row_numbers import row_numbers

Array = NDArray[np.float64]

GAP = 1.5
"""Rows further apart than this number of periods have a gap between them."""
OFF_RATE = 0.02
"""Largest share by which the rows' rate may differ from loop.rate."""
SAME_TIME = 1e-5
"""Two times that differ by less than this share of a period are the same one."""
MOST_APART = 500.0
"""Largest ratio of the rows' period and loop.rate's, either way, between which to resample."""
LONGEST = 1e9
"""A run lasts less than this [s], as ``loop.duration`` has it."""
MOST_RESAMPLED = 2**24
"""Samples that resampling makes at most, gaps included: a day at 190 Hz."""
LATEST_START = 2**62
"""Log time of the first sample at most [ns since the epoch], so that the last one has one."""
FIRST_POINTS, MAX_POINTS = 50, 1000
"""Points of the reference that the run's configuration has as its trajectory, at first and at
most."""
NEAR = 1e-4
"""Share of the reference's extent within which its trajectory is to follow it."""
MAX_JUDGED = 20000
"""Rows at which that is judged, at most."""
SMOOTH, DEGREE = 5, 4
"""Half-width [samples] and degree of the polynomials that the reference's derivatives are of."""


@dataclass(frozen=True)
class Imported:
    """A run made of columns.

    Attributes:
        run: The run.
        notes: What was found missing, irregular or made up, a line each.
    """

    run: RunData
    notes: tuple[str, ...]


def import_run(columns: Mapping[str, Column], sources: Mapping[str, Source], c: Configuration,
               resample: bool, start_ns: int) -> Imported:
    """Return a run.

    Args:
        columns: Column name → numbers.
        sources: Signal → column, factor, offset.
        c: Plant (order, units), rate, observer; kept as the run's configuration.
        resample: Take values at multiples of T instead of those nearest to them.
        start_ns: Log time of the first sample [ns since the epoch].

    Raises:
        ConfigurationError: A signal that cannot be missed is not there, or another rate.
        RecordingError: The times or numbers cannot be used.
    """
    n = c.plant.order
    with np.errstate(over='ignore', invalid='ignore'):      # what is not finite is named below
        given = {name: columns[source.column].values * source.factor + source.offset
                 for name, source in sources.items()}
    _check_given(given, n, columns[sources['x0'].column].times is not None
                 if 'x0' in sources else True)
    notes: list[str] = []
    times = {name: given['stamp'] if 'stamp' in sources else _times(columns[source.column])
             for name, source in sources.items() if name != 'stamp'}
    clean = {name: _ordered(times[name], given[name], name, notes) for name in times}
    _check_numbers(clean)
    base = clean['x0'][0]
    if len(base) < 2:
        raise RecordingError('fewer than two rows with a time: there is no run in them')
    seq, t = _grid(base, c, resample, notes)
    signals = {name: _taken(values, t + base[0], name == 'v', resample)
               for name, values in clean.items()}
    for name, values in signals.items():
        if not np.isfinite(values).any():
            rows = clean[name][0]
            raise RecordingError(
                f'{name} has no number at the times of x0: its rows are from {rows[0]:.10g} to '
                f'{rows[-1]:.10g} s, those of x0 from {base[0]:.10g} to {base[-1]:.10g} s '
                '(messages without a header have the times at which they were recorded)')
    holes = np.zeros(len(t), dtype=bool) if not resample else _in_gaps(base, t + base[0])
    if holes.any():
        seq, t = seq[~holes], t[~holes]
        signals = {name: values[~holes] for name, values in signals.items()}
    lost = int(seq[-1]) + 1 - len(seq)
    if lost:
        notes.append(f'{lost} of {int(seq[-1]) + 1} samples are gaps and stay gaps')
    reference = _reference(signals, seq, t, n, notes)
    info = {'mode': 'import'}
    x = [signals[f'x{i}'] for i in range(n) if f'x{i}' in signals]
    if len(x) < n:
        observer = observer_of(c)
        known = reference is not None and bool(np.isfinite(reference).all())
        followed = reference[:, n - 2:] if reference is not None and known else np.zeros(
            (len(t), 3))
        x.append(_observed(x[-1], followed, seq, t, observer))
        info['observed'] = f'x{n - 1}'
        notes.append(f'x{n - 1} is missing: observed from x{n - 2} at '
                     f'{observer.omega:g} rad/s (driver.observer), no measurement')
    for name, values in signals.items():
        bad = int(np.count_nonzero(~np.isfinite(values)))
        if bad:
            notes.append(f'{name} is no number in {bad} of {len(values)} samples')
    notes.append('missing: ' + ', '.join([*(['reference'] if reference is None else []),
                                          *(['command'] if 'v' not in signals else []),
                                          "the law's terms", 'truth', 'round trips']))
    run = _as_run(seq, t, np.column_stack(x), signals.get('v'), reference, n, start_ns)
    configuration = {**c.to_flat(), 'loop.duration': float(t[-1])}
    if own_period(seq, t, c.loop.period) != c.loop.period:
        configuration['loop.rate'] = float(f'{1.0 / own_period(seq, t, c.loop.period):.6g}')
        notes.append(f'loop.rate = {configuration["loop.rate"]:g} is that of the rows')
    if 'observed' in info and 'driver.measured' in configuration:
        # A loop around this device observes it as well: gains and rules are to count that in.
        configuration['driver.measured'] = n - 1
    if reference is not None:
        configuration = {**{key: value for key, value in configuration.items()
                            if not key.startswith('trajectory.')},
                         **_waypoints(t, reference)}
    return Imported(RunData(run, configuration, {**info, 'import': '; '.join(notes)}),
                    tuple(notes))


def _waypoints(t: Array, reference: Array) -> dict[str, Any]:
    """Return the reference as the keys of a trajectory, a spline through points of it.

    Points are added where the spline is not near the reference. A log that ends in motion has one
    more behind its end, so that the rest there comes after it.

    Args:
        t: Times [s], shape (N,).
        reference: x_d … x_d^(n), shape (N, n + 1).
    """
    rows = np.flatnonzero(np.isfinite(reference).all(axis=1))
    if len(rows) < 2:
        return {}
    x_d, order = reference[:, 0], reference.shape[1] - 1
    extent = float(np.ptp(x_d[rows]))
    judged = rows[::-(-len(rows) // MAX_JUDGED)]
    stop = 0.1 * float(t[rows[-1]] - t[rows[0]])
    beyond = 0.5 * stop * float(reference[rows[-1], 1])
    evenly = np.linspace(0, len(rows) - 1, min(FIRST_POINTS, len(rows)))
    chosen = np.unique(rows[evenly.astype(int)])
    while True:
        times, positions = t[chosen].tolist(), x_d[chosen].tolist()
        if abs(beyond) > NEAR * extent:
            times.append(times[-1] + stop)
            positions.append(positions[-1] + beyond)
        keys = {'trajectory.kind': 'waypoints', 'trajectory.times': times,
                'trajectory.positions': positions}
        room = MAX_POINTS - len(chosen)
        curve = Waypoints(WaypointsParameters(times=tuple(times), positions=tuple(positions)),
                          order)
        error = np.abs([curve(item)[0] for item in t[judged].tolist()] - x_d[judged])
        piece = np.searchsorted(chosen, judged, side='right') - 1
        worst = np.zeros(len(chosen))
        np.maximum.at(worst, piece, error)
        low, high = np.searchsorted(rows, chosen), np.searchsorted(rows, [*chosen[1:], rows[-1]])
        worst[high - low < 2] = 0.0
        bad = np.argsort(-worst, kind='stable')[:max(room, 0)]
        bad = bad[worst[bad] > NEAR * extent]
        if not len(bad):
            return keys
        chosen = np.unique(np.append(chosen, rows[(low[bad] + high[bad]) // 2]))


def _check_given(given: Mapping[str, Array], n: int, timed: bool) -> None:
    """Check that what cannot be missed is given."""
    named = ', '.join(given)
    if 'stamp' not in given and not timed:
        raise ConfigurationError(KEY, named, 'must name the column of the time: stamp=COLUMN')
    for i in range(max(1, n - 1)):
        if f'x{i}' not in given:
            raise ConfigurationError(KEY, named, f'must name the column of x{i}; of a plant of '
                                     f'order {n} only x{n - 1} can be observed' if n > 1 else
                                     f'must name the column of x{i}')
    orders = [i for i in range(n + 1) if f'xd{i}' in given]
    if orders and orders != list(range(len(orders))):
        raise ConfigurationError(KEY, f'xd{orders[-1]}', 'cannot be used without '
                                 + ', '.join(f'xd{i}' for i in range(orders[-1])
                                             if i not in orders))


def _times(column: Column) -> Array:
    if column.times is None:
        raise ConfigurationError(KEY, '', 'must name the column of the time: stamp=COLUMN')
    return column.times


def _check_numbers(clean: Mapping[str, tuple[Array, Array]]) -> None:
    """Refuse columns without a number."""
    for name, (_, values) in clean.items():
        if not np.isfinite(values).any():
            raise RecordingError(f'{name} is no number in any row'
                                 + ('' if name == 'x0' else f': leave it out of {KEY}'))


def _ordered(times: Array, values: Array, name: str, notes: list[str]) -> tuple[Array, Array]:
    """Return times and values of the rows whose time is one and later than all before."""
    good = np.isfinite(times)
    if not good.any():
        raise RecordingError(f'the time of {name} is no number in any row')
    undated = int(np.count_nonzero(~good))
    times, values = times[good], values[good]
    later = times > np.concatenate([[-np.inf], np.maximum.accumulate(times)[:-1]])
    text = []
    if undated:
        text.append(f'{undated} rows of {name} have no time')
    if not later.all():
        text.append(f'{int(np.count_nonzero(~later))} rows of {name} do not come after the row '
                    'before')
    notes += [f'{item}: left out' for item in text if name == 'x0']
    return times[later], values[later]


def _grid(times: Array, c: Configuration, resample: bool,
          notes: list[str]) -> tuple[Array, Array]:
    """Return seq and stamps [s] of the samples; notes what was left out.

    Raises:
        ConfigurationError: The rows come at another rate, and are not to be resampled.
        RecordingError: They last longer than a run can.
    """
    period = c.loop.period
    with np.errstate(over='ignore'):
        t = times - times[0]
    longest = min(LONGEST, period * (MOST_RESAMPLED if resample else SEQ_LIMIT))
    if not t[-1] < longest - period:
        raise RecordingError(f'the rows last {t[-1]:.4g} s, from {times[0]:.6g} s to '
                             f'{times[-1]:.6g} s: must be less than {longest:.4g} s at '
                             f'{c.loop.rate:g} Hz{", resampled" if resample else ""}; is the unit '
                             'of the time another, or one of the times wrong?')
    steps = np.diff(t)
    own = float(np.median(steps))
    # Without the steps over gaps, which may be many, and as many others on the other side.
    regular = steps[np.abs(steps / own - 1.0) < GAP - 1.0]
    own = float(np.median(regular)) if len(regular) else own
    if resample:
        if not 1.0 / MOST_APART < own / period < MOST_APART:
            raise RecordingError(f'the rows are {own * 1e3:.4g} ms apart, loop.rate = '
                                 f'{c.loop.rate:g} means {period * 1e3:.4g} ms: more than '
                                 f'{MOST_APART:g} times as much or as little; is the unit of the '
                                 'time another?')
        seq = np.arange(int(t[-1] / period + SAME_TIME) + 1, dtype=float)
        notes.append(f'resampled from {own * 1e3:.4g} ms to {period * 1e3:.4g} ms')
        return seq, seq * period
    if abs(own / period - 1.0) > OFF_RATE:
        raise ConfigurationError('loop.rate', c.loop.rate, f'means {period * 1e3:.4g} ms, the '
                                 f'rows are {own * 1e3:.4g} ms apart: give --resample, or --set '
                                 f'loop.rate={1.0 / own:.6g}')
    numbers = row_numbers(t, own)
    seq, first = np.unique(numbers, return_index=True)
    if len(seq) < len(numbers):
        notes.append(f'{len(numbers) - len(seq)} rows share a sample with the row before: left '
                     'out')
    return seq, t[first]


def _taken(column: tuple[Array, Array], t: Array, held: bool, resample: bool) -> Array:
    """Return a column at instants: held, between two rows, or of the nearest row."""
    times, values = column
    within = np.clip(t, times[0], times[-1])
    same = np.abs(within - t) < SAME_TIME * float(np.median(np.diff(times))) if (
        len(times) > 1) else np.zeros(len(t), dtype=bool)
    t = np.where(same, within, t)
    if held:
        rows = np.searchsorted(times, t + 1e-9, side='right') - 1
        return np.where(rows >= 0, values[np.maximum(rows, 0)], np.nan)
    if resample:
        return np.interp(t, times, values, left=np.nan, right=np.nan)
    rows = np.clip(np.searchsorted(times, t), 1, max(len(times) - 1, 1))
    rows = np.where(t - times[rows - 1] <= times[np.minimum(rows, len(times) - 1)] - t, rows - 1,
                    np.minimum(rows, len(times) - 1))
    near = np.abs(times[rows] - t) < GAP * float(np.median(np.diff(times)))
    return np.where(near, values[rows], np.nan)


def _in_gaps(times: Array, t: Array) -> NDArray[np.bool_]:
    """Return whether each instant lies within a gap of the rows."""
    steps = np.diff(times)
    rows = np.clip(np.searchsorted(times, t - 1e-9), 1, len(times) - 1)
    inside: NDArray[np.bool_] = ((steps[rows - 1] > GAP * float(np.median(steps)))
                                 & (t > times[rows - 1] + 1e-9) & (t < times[rows] - 1e-9))
    return inside


def _reference(signals: Mapping[str, Array], seq: Array, t: Array, n: int,
               notes: list[str]) -> Array | None:
    """Return x_d … x_d^(n), shape (N, n + 1), those not given by local polynomials."""
    if 'xd0' not in signals:
        return None
    found = [signals[f'xd{i}'] for i in range(n + 1) if f'xd{i}' in signals]
    made = [f'xd{i}' for i in range(len(found), n + 1)]
    if made:
        notes.append(f'{", ".join(made)} missing: derivatives of xd{len(found) - 1} by '
                     'local polynomials')
    known, last = len(found), found[-1]
    period = float(np.median(np.diff(t)))
    fitted = np.full((len(t), n + 2 - known), np.nan)
    for low, high in _parts(seq):
        fitted[low:high] = _derivatives(last[low:high], period, n + 1 - known)
    return np.column_stack([*found, *fitted.T[1:]])


def _parts(seq: Array) -> Sequence[tuple[int, int]]:
    """Return first and one past the last row of each part without a gap."""
    cuts = np.flatnonzero(np.diff(seq) != 1) + 1
    return list(pairwise([0, *cuts.tolist(), len(seq)]))


def _derivatives(values: Array, period: float, count: int) -> Array:
    """Return a signal and its derivatives by local polynomials, shape (N, count + 1)."""
    found = np.full((len(values), count + 1), np.nan)
    width = min(2 * SMOOTH + 1, len(values) - 1 + len(values) % 2)
    if width <= count:
        found[:, 0], found[:, 1:] = values, 0.0
        return found
    half = width // 2
    degree = min(max(DEGREE, count + 1), width - 1)
    factors = np.cumprod([1.0, *range(1, count + 1)])
    for k in range(len(values)):
        begin = min(max(k - half, 0), len(values) - width)
        if half <= k < len(values) - half and k > half:
            continue                        # by convolution below
        offsets = (np.arange(begin, begin + width) - k) * period
        weights = np.linalg.pinv(np.vander(offsets, degree + 1, increasing=True))[:count + 1]
        found[k] = weights @ values[begin:begin + width] * factors
    if len(values) > width:
        offsets = np.arange(-half, half + 1) * period
        weights = np.linalg.pinv(np.vander(offsets, degree + 1, increasing=True))[:count + 1]
        for i in range(count + 1):
            found[half:len(values) - half, i] = np.convolve(
                values, weights[i][::-1], 'valid') * factors[i]
    return found


def _observed(x: Array, reference: Array, seq: Array, t: Array, observer: Observer) -> Array:
    """Return the velocity an observer gives, restarted behind each gap."""
    found = np.full(len(x), np.nan)
    for low, high in _parts(seq):
        observer.restart()
        last = t[low]
        for k in range(low, high):
            if np.isfinite(x[k]):
                found[k] = observer.step(float(x[k]), reference[k], float(t[k] - last))
                last = t[k]
    return found


def _as_run(seq: Array, t: Array, x: Array, v: Array | None, reference: Array | None, n: int,
            start_ns: int) -> dict[str, Channel]:
    """Return the channels."""
    start_ns = min(max(start_ns, 0), LATEST_START)      # a file's time may be any
    times = start_ns + np.round(t * 1e9).astype(np.int64)
    before = np.concatenate([[-1.0], seq[:-1]])
    stamps = np.concatenate([[0.0], t[:-1]])
    zero = np.zeros(len(t))

    def channel(labels: tuple[str, ...], *parts: Any) -> Channel:
        return Channel(labels, np.column_stack(parts), times, times)

    found = {}
    if reference is not None:
        found['reference'] = channel(Reference.labels(n), seq, t, reference)
    found['state'] = channel(State.labels(n), seq, t, x, before, stamps, zero)
    if v is not None:
        found['command'] = channel(Command.labels(), seq, t, v, seq, t, zero)
    return found

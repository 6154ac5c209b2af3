"""Experiments as runs, and any run as if it had been an experiment (ours).

An experiment is written as a run like any other: states, commands, and an event for each begin of
a repeat, so that it can be looked at and evaluated again. A run without such events is cut into
equal parts which stand for repeats; what it shows of a dead-zone is what the loop happened to do.
Commands are placed where the log says they began to act, as fits do it (`analysis.fit_data`); a
sample in which one took over from another gets their mean over it.
"""

from __future__ import annotations

import json

import numpy as np
from numpy.typing import NDArray

from dz_ros.analysis.audit_samples import rows_with_seq
from dz_ros.analysis.audit_spans import events
from dz_ros.analysis.fit_data import arrivals
from dz_ros.analysis.setting import state_columns
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.records import Command, State
from dz_ros.errors import DzRosError, RecordingError
from dz_ros.identification.experiment import MOVING, NOISE
from dz_ros.identification.plan import LEAST_REPEATS
from dz_ros.identification.session import Samples
from dz_ros.identification.stretches import SMOOTH

Array = NDArray[np.float64]

REPEAT = 'repeat'
"""Event at the begin of a repeat; its number, −1 = between repeats, and the seq of its sample."""
PARTS, PART = 12, 5.0
"""A run is cut into so many parts at most, none shorter than this [s]."""


def as_run(samples: Samples, c: Configuration, start_ns: int) -> RunData:
    """Return an experiment as a run.

    Args:
        samples: The experiment.
        c: With which it was made.
        start_ns: When it began [ns since the epoch].
    """
    good = np.isfinite(samples.x).all(axis=1)
    seq, t = samples.seq[good].astype(float), samples.t[good]
    times = start_ns + np.round(t * 1e9).astype(np.int64)
    before = np.concatenate([[-1.0], seq[:-1]])
    stamps = np.concatenate([[0.0], t[:-1]])
    state = np.column_stack([seq, t, samples.x[good], before, stamps, np.zeros(len(seq))])
    command = np.column_stack([seq, t, samples.v[good], seq, t, np.zeros(len(seq))])
    begins = np.flatnonzero(np.diff(samples.repeat, prepend=-2) != 0).tolist()
    told = tuple((start_ns + round(float(samples.t[row]) * 1e9), 'identify', json.dumps({
        'node': 'identify', 'event': REPEAT, 'repeat': int(samples.repeat[row]),
        'seq': int(samples.seq[row])})) for row in begins)
    return RunData({'state': Channel(State.labels(c.plant.order), state, times, times),
                    'command': Channel(Command.labels(), command, times, times)},
                   c.to_flat(), {'mode': 'identification'}, told)


def from_run(run: RunData, c: Configuration) -> tuple[Samples, float]:
    """Return a run as samples, and the speed that counts as motion in it.

    Args:
        run: The run.
        c: Order, rate, command limit; its delay is not used, it is found.

    Raises:
        RecordingError: No states or commands, or too short.
    """
    times, commands = arrivals(run, c.replace(**{'loop.delay': 0}))
    state = run.channels['state']
    rows = rows_with_seq(state)
    seq, first = np.unique(state['seq'][rows].astype(np.int64), return_index=True)
    rows = rows[first]
    x = state.values[rows][:, state_columns(state.labels)]
    if x.shape[1] != c.plant.order:
        raise RecordingError(f'the run has {x.shape[1]} states, plant.model = {c.plant.name!r} '
                             f'has order {c.plant.order}')
    stamps = state['stamp'][rows]
    v = _means(stamps, np.array(times), np.array(commands))
    samples = Samples(seq, x, v, _repeats(run, seq, c.loop.period), ('run',) * len(seq),
                      _measured(c), c.loop.period)
    return samples, _motion(samples)


def _means(stamps: Array, times: Array, commands: Array) -> Array:
    """Return the mean of the commands held from each stamp to the next, shape (K,)."""
    held = np.concatenate([[0.0], commands])
    total = np.concatenate([[0.0], np.cumsum(np.diff(times) * commands[:-1])])

    def integral(t: Array) -> Array:
        place = np.searchsorted(times, t + 1e-9, side='right')
        base = np.where(place > 0, total[np.maximum(place - 1, 0)], 0.0)
        since: Array = t - times[np.maximum(place - 1, 0)]
        return np.where(place > 0, base + since * held[place], 0.0)

    step = np.diff(stamps, append=2.0 * stamps[-1] - stamps[-2] if len(stamps) > 1 else 1.0)
    found: Array = (integral(stamps + step) - integral(stamps)) / np.where(step > 0.0, step, 1.0)
    return found


def _repeats(run: RunData, seq: NDArray[np.int64], period: float) -> NDArray[np.int64]:
    """Return the repeat of each sample: as the events say, or parts of equal length."""
    told = [(int(item['seq']), int(item['repeat'])) for _, _, item in events(run, REPEAT)
            if isinstance(item.get('seq'), int) and isinstance(item.get('repeat'), int)]
    if told:
        told.sort()
        place = np.searchsorted([item[0] for item in told], seq, side='right')
        return np.array([-1, *(item[1] for item in told)])[place]
    span = float(seq[-1] - seq[0]) * period
    parts = min(PARTS, int(span / PART))
    if parts < LEAST_REPEATS:
        raise RecordingError(f'the run is too short: {span:.3g} s, at least '
                             f'{LEAST_REPEATS * PART:g} s are needed to see whether the dead-zone '
                             'drifts')
    edges = np.linspace(seq[0], seq[-1] + 1, parts + 1)
    return np.searchsorted(edges, seq, side='right') - 1


def _measured(c: Configuration) -> int:
    """Return how many states the driver measures; all where it cannot be asked."""
    try:
        return c.make_driver().measured
    except DzRosError:
        return c.plant.order


def _motion(samples: Samples) -> float:
    """Return the speed that counts as motion: a share of the largest, above the noise."""
    if samples.x.shape[1] == 1:
        return 0.0
    speed = samples.x[:, 1][np.isfinite(samples.x[:, 1])]
    noise = float(np.diff(speed, n=3).std()) / np.sqrt(20.0)
    filtered = noise / np.sqrt(max(1.0, SMOOTH / samples.period))
    return float(max(MOVING * float(np.quantile(np.abs(speed), 0.99)), NOISE * filtered))

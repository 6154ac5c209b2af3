# SPDX-License-Identifier: Apache-2.0
"""One table from the channels of a run: a row for each state, joined by ``seq``.

A command belongs to the state whose seq it echoes (its own seq where it echoes none), terms and
truth to the state with the same seq, a reference to the state with the same seq and stamp. Where
that one is missing or the stamps differ (a real-time loop that skipped a period), the reference
nearest in time is brought to the state's stamp, as the controller does (`extrapolate`).

The table is as long as the distinct states; what is missing is NaN, and counted. A plant that
restarted while recording went on makes several runs of one: the longest is taken. The steps of a
controller, which may answer a state twice or one that is missing, are `dz_ros.runs.steps`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.loop.controller import SNAP
from dz_ros.core.records import extrapolate, Status
from dz_ros.errors import RecordingError
from dz_ros.runs.axes import require_one
from dz_ros.runs.sequence import count_sequence, first_of_each, longest_stretch, SequenceCount
from dz_ros.runs.setting import Setting, state_columns

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

CARRY_LIMIT = 10
"""Sample intervals by which a reference may be carried; beyond, the row has no reference."""


@dataclass(frozen=True)
class RunTable:
    """A run as one table, rows in ascending stamp.

    Attributes:
        seq: seq of the states, shape (N,).
        t: Their stamps [s], shape (N,).
        x: Measured states, shape (N, n).
        x_d: References at the states' stamps, shape (N, n + 1).
        v: Commands, shape (N,).
        terms: Label → term of the law, shape (N,); empty without that channel.
        truth: Label → true w, d, disturbance, shape (N,); empty without that channel.
        counts: Channel → counts of its seq.
        missing: Channel → states without a row of it.
        carried: References brought to another stamp.
        not_finite: States with a number that is not finite; without a stamp they have no row.
        restarts: Number of restarts of the plant; the longest stretch between them is the table.
    """

    seq: Integers
    t: Array
    x: Array
    x_d: Array
    v: Array
    terms: Mapping[str, Array]
    truth: Mapping[str, Array]
    counts: Mapping[str, SequenceCount]
    missing: Mapping[str, int]
    carried: int
    not_finite: int
    restarts: int

    @classmethod
    def of(cls, run: RunData) -> RunTable:
        """Return a run as one table.

        Raises:
            RecordingError: There are fewer than two states, they all carry the same stamp, or no
                x0; the run has several axes.
        """
        require_one(run)
        run, restarts = longest_stretch(run)
        state = run.channels.get('state')
        if state is None or np.count_nonzero(
                np.isfinite(state['stamp'][first_of_each(state['seq'])[1]])) < 2:
            held = ', '.join(name for name, channel in run.channels.items() if len(channel))
            raise RecordingError('the run has no two states to analyse; '
                                 f'channels with messages: {held or "none"}')
        seq, rows = first_of_each(state['seq'])
        dated = np.isfinite(state['stamp'][rows])
        undated = int(np.count_nonzero(~dated))
        seq, rows = seq[dated], rows[dated]
        in_time = np.argsort(state['stamp'][rows], kind='stable')
        seq, rows = seq[in_time], rows[in_time]
        if np.ptp(state['stamp'][rows]) <= 0.0:
            raise RecordingError("the run's states all carry the same stamp; there is no time to "
                                 'analyse them over')
        columns = state_columns(state.labels)
        if not columns:
            raise RecordingError("the run's states carry no x0: "
                                 f'{", ".join(state.labels[:20])}')
        order = len(columns)
        t = state['stamp'][rows]
        x = state.values[rows][:, columns]
        x_d, carried = _references(run, seq, t, order)
        v = joined(run.channels.get('command'), seq, ('v',))
        terms = run.channels.get('terms')
        truth = run.channels.get('truth')
        found_terms = joined(terms, seq, terms.labels[2:] if terms else ())
        found_truth = joined(truth, seq, truth.labels[2:] if truth else ())
        blank = np.full(len(seq), np.nan)
        table = {'reference': x_d[:, 0], 'command': v.get('v', blank),
                 'terms': next(iter(found_terms.values()), blank),
                 'truth': next(iter(found_truth.values()), blank)}
        return cls(
            seq, t, x, x_d, v.get('v', blank), found_terms, found_truth,
            {name: count_sequence(channel['seq']) for name, channel in run.channels.items()},
            {name: int(np.count_nonzero(np.isnan(table[name]))) for name in table
             if name in run.channels},
            carried, undated + int(np.count_nonzero(~np.isfinite(x).all(axis=1))), restarts)

    @cached_property
    def active(self) -> NDArray[np.bool_]:
        """The samples whose terms the law computed, shape (N,); all without a status."""
        status = self.terms.get('status')
        if status is None or not status.any():
            return np.ones(len(self.t), dtype=bool)
        return where_active(status)

    @property
    def error(self) -> Array:
        """x̃ = x − x_d of the measured state, shape (N, n)."""
        return self.x - self.x_d[:, :self.x.shape[1]]

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """The table's columns by name, each of shape (N,).

        A term or a truth that has the name of a column before it takes none's place: it is
        ``terms.NAME``, ``truth.NAME``.
        """
        found: dict[str, NDArray[Any]] = {
            'seq': self.seq, 't': self.t,
            **{f'x{i}': item for i, item in enumerate(self.x.T)},
            **{f'xd{i}': item for i, item in enumerate(self.x_d.T)}, 'v': self.v}
        for kind, columns in (('terms', self.terms), ('truth', self.truth)):
            for name, item in columns.items():
                own = name
                while own in found:
                    own = f'{kind}.{own}'
                found[own] = item
        return found

    @property
    def duration(self) -> float:
        """From the first to the last state [s]."""
        return float(self.t[-1] - self.t[0])


def where_active(status: Array) -> NDArray[np.bool_]:
    """Return where status bits leave a law active, shape (N,); where they are unknown too."""
    known = np.isfinite(status) & (status >= 0.0)
    bits = np.where(known, status, 0.0).astype(np.int64)
    return np.asarray(~known | (bits & Status.INACTIVE == 0), dtype=np.bool_)


def joined(channel: Channel | None, seq: Integers, labels: tuple[str, ...]) -> dict[str, Array]:
    """Return columns of a channel at the states' seq, NaN where it has no such row."""
    if channel is None or not len(channel):
        return {}
    keys = channel['seq']
    if 'echo_seq' in channel.labels:
        keys = np.where(channel['echo_seq'] >= 0.0, channel['echo_seq'], keys)
    distinct, rows = first_of_each(keys)
    if not len(distinct):
        return {}
    place = np.minimum(np.searchsorted(distinct, seq), len(distinct) - 1)
    hit = distinct[place] == seq
    return {label: np.where(hit, channel[label][rows[place]], np.nan) for label in labels}


def _references(run: RunData, seq: Integers, t: Array, order: int) -> tuple[Array, int]:
    """Return references at the states' stamps, shape (N, order + 1), and how many were carried."""
    channel = run.channels.get('reference')
    blank = np.full((len(seq), order + 1), np.nan)
    labels = tuple(f'xd{i}' for i in range(order + 1))
    if channel is None or not {'stamp', *labels} <= set(channel.labels):
        return blank, 0
    values = np.column_stack([channel[label] for label in labels])
    rows = np.flatnonzero(np.isfinite(values).all(axis=1) & np.isfinite(channel['stamp']))
    if not len(rows):
        return blank, 0
    rows = rows[np.argsort(channel['stamp'][rows], kind='stable')]
    stamps = channel['stamp'][rows]
    after = np.clip(np.searchsorted(stamps, t), 1, max(len(stamps) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(stamps) - 1)
    source = rows[np.where(t - stamps[before] <= stamps[after] - t, before, after)]
    x_d = values[source]
    h = t - channel['stamp'][source]
    known = np.abs(h) <= CARRY_LIMIT * (Setting.of(run).period or 0.0)
    moved = known & (np.abs(h) >= SNAP)
    columns = list(x_d[moved].T)
    extrapolate(columns, h[moved], columns)
    x_d[moved] = np.column_stack(columns)
    return np.where(known[:, np.newaxis], x_d, np.nan), int(np.count_nonzero(moved))

# SPDX-License-Identifier: Apache-2.0
"""A run as arrays: channels of records, the same whether recorded, replayed or simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.offline import Run
from dz_ros.core.records import Command, Reference, State, Terms, Truth
from dz_ros.core.signals import STATUS
from dz_ros.errors import MissingLabelError

Array = NDArray[np.float64]
Times = NDArray[np.int64]

OWN_PERIOD, MOST_OFF, SURE, LEAST_ROWS = 1e-4, 0.025, 4.0, 400
"""Shares by which the samples' own period must and may differ from the stated one to be taken
instead, standard errors it must differ by, and samples that show it."""


@dataclass(frozen=True)
class Channel:
    """All messages of one topic, in the order received.

    Of a loop of several axes a row holds the numbers of all of them, one axis after the other:
    shape (N, n len(labels)). `axis` gives the channel of one; a column asked for by its name is
    that of the first axis, where seq and stamp are those of all.

    Attributes:
        labels: Column names, from the record's ``labels``.
        values: One row a message, shape (N, len(labels)).
        log_time, publish_time: When each was recorded, published [ns since the epoch], shape (N,).
        axes: Names of the axes; empty: one, without a name.
    """

    labels: tuple[str, ...]
    values: Array
    log_time: Times
    publish_time: Times
    axes: tuple[str, ...] = ()

    def axis(self, name: str) -> Channel:
        """Return the channel of one axis, a view of the same numbers.

        Raises:
            ValueError: There is no such axis.
        """
        width = len(self.labels)
        begin = self.axes.index(name) * width
        return Channel(self.labels, self.values[:, begin:begin + width], self.log_time,
                       self.publish_time)

    def __getitem__(self, label: str) -> Array:
        """Return one column, shape (N,).

        Raises:
            MissingLabelError: No such column.
        """
        if label not in self.labels:
            raise MissingLabelError(f'records without {label}: they carry '
                                    f'{", ".join(self.labels[:20])}')
        return self.values[:, self.labels.index(label)]

    def table(self, labels: Sequence[str]) -> Array:
        """Return columns in the order asked for, shape (N, …); NaN where there is none."""
        blank = np.full(len(self.values), np.nan)
        return np.column_stack([blank[:, None][:, :0], *(
            self[label] if label in self.labels else blank for label in labels)])

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.values)


@dataclass(frozen=True)
class RunData:
    """A whole run.

    Attributes:
        channels: Record name (reference, state, command, terms, truth) → channel, those it has.
        configuration: Dotted key → value, as run; empty = unknown.
        info: What else is known: mode, host, versions, seed, …
        events: (log_time [ns], node, text) in order.
    """

    channels: Mapping[str, Channel]
    configuration: Mapping[str, Any] = field(default_factory=dict)
    info: Mapping[str, str] = field(default_factory=dict)
    events: tuple[tuple[int, str, str], ...] = ()

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes; empty: one, without a name (`dz_ros.runs.axes` gives one of them)."""
        return next((channel.axes for channel in self.channels.values() if channel.axes), ())


def from_run(run: Run, start_ns: int = 0) -> RunData:
    """Return a simulated run as channels; sample k is logged at start_ns + t_k.

    Each state echoes the command of the sample before it.
    """
    c = run.configuration
    count = len(run.t)
    seq = np.arange(count, dtype=float)
    before = np.maximum(seq - 1.0, -1.0)
    before_t = np.concatenate(([0.0], run.t[:-1]))
    times = start_ns + np.round(run.t * 1e9).astype(np.int64)
    order = c.plant.order

    def channel(labels: tuple[str, ...], *columns: Array) -> Channel:
        return Channel(labels, np.column_stack(columns), times, times)

    return RunData({
        'reference': channel(Reference.labels(order), seq, run.t, run.x_d),
        'state': channel(State.labels(order), seq, run.t, run.x_measured, before, before_t,
                         np.zeros(count)),
        'command': channel(Command.labels(), seq, run.t, run.v, seq, run.t,
                           np.zeros(count)),
        'terms': channel(Terms.labels(c.law.signal_names), seq, run.t, run.terms[:, :STATUS],
                         np.full(count, c.loop.period), run.terms[:, STATUS:STATUS + 1], seq, seq,
                         run.terms[:, STATUS + 1:]),
        'truth': channel(Truth.labels(), seq, run.t, run.truth),
    }, c.to_flat(), {'mode': 'offline'})


def from_runs(runs: Mapping[str, Run], configuration: Configuration,
              start_ns: int = 0) -> RunData:
    """Return the simulated loops of all axes as one run; of one axis that of `from_run`.

    Args:
        runs: Axis → its loop, all of the same duration; one axis is called ''.
        configuration: That of the machine.
        start_ns: When sample 0 is logged [ns since the epoch].
    """
    each = {name: from_run(run, start_ns) for name, run in runs.items()}
    first = next(iter(each.values()))
    if len(each) == 1:
        return replace(first, configuration=configuration.to_flat())
    channels = {}
    for topic, channel in first.channels.items():
        values = np.column_stack([data.channels[topic].values for data in each.values()])
        channels[topic] = replace(channel, values=values, axes=tuple(each))
    return RunData(channels, configuration.to_flat(), first.info)


def own_period(seq: Array, t: Array, stated: float) -> float:
    """Return the period of samples [s]: the stated one where theirs does not differ from it.

    Args:
        seq: Their numbers, ascending, shape (N,).
        t: Their times [s], shape (N,).
        stated: Period that they are to have [s].
    """
    if len(seq) < LEAST_ROWS or not np.isfinite(t).all():
        return stated
    # A clock that was set, or jitter, makes the quarters differ among themselves.
    slopes = np.array([np.polyfit(number, time, 1)[0] / stated for number, time in zip(
        np.array_split(seq, 4), np.array_split(t, 4), strict=True)])
    whole = float(np.polyfit(seq, t, 1)[0]) / stated
    off, error = abs(whole - 1.0), float(slopes.std(ddof=1)) / 2.0
    agree = float(np.abs(slopes - whole).max()) < 0.5 * off
    return whole * stated if max(OWN_PERIOD, SURE * error) < off < MOST_OFF and agree else stated

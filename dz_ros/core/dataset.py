"""A run as arrays: what recordings are read into and what analysis works on.

The same shape whether the run was recorded from topics, replayed, or simulated: channels of
records, each a table whose columns are the record's labels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.loop import Run
from dz_ros.core.records import Command, Reference, State, STATUS, Terms, Truth

Array = NDArray[np.float64]
Times = NDArray[np.int64]


@dataclass(frozen=True)
class Channel:
    """All messages of one topic, in the order received.

    Attributes:
        labels: Column names, from the record's ``labels``.
        values: One row a message, shape (N, len(labels)).
        log_time: When the recorder received each message [ns since the epoch], shape (N,).
        publish_time: When it was published [ns since the epoch], shape (N,).
    """

    labels: tuple[str, ...]
    values: Array
    log_time: Times
    publish_time: Times

    def __getitem__(self, label: str) -> Array:
        """Return one column, shape (N,).

        Raises:
            KeyError: No such column.
        """
        if label not in self.labels:
            raise KeyError(f'{label}: this channel has {", ".join(self.labels)}')
        return self.values[:, self.labels.index(label)]

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.values)


@dataclass(frozen=True)
class RunData:
    """A whole run.

    Attributes:
        channels: Record name (reference, state, command, terms, truth) → channel; a name is
            missing where the run has no such channel.
        configuration: Dotted key → value, as run; empty where the run does not say.
        info: What else is known: mode, host, versions, seed, …
        events: (log_time [ns], node, text) of everything that happened, in order.
    """

    channels: Mapping[str, Channel]
    configuration: Mapping[str, Any] = field(default_factory=dict)
    info: Mapping[str, str] = field(default_factory=dict)
    events: tuple[tuple[int, str, str], ...] = ()


def from_run(run: Run, start_ns: int = 0) -> RunData:
    """Return a simulated run as channels; sample k is logged at start_ns + t_k.

    Each state echoes the command of the sample before it, as a loop without transport would.
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

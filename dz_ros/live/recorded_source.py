# SPDX-License-Identifier: Apache-2.0
"""Recorded runs as the page shows them: one, or two laid over each other; of several axes each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.dataset import RunData
from dz_ros.core.events import ConfigurationEvent, typed
from dz_ros.core.records import SEQ_LIMIT
from dz_ros.errors import ConfigurationError, LoopError
from dz_ros.live.columns import Layout
from dz_ros.live.counts import counts, NAMES
from dz_ros.live.derived import Deriver
from dz_ros.live.describe import facts
from dz_ros.live.history import ANSWER, History, pack
from dz_ros.live.node_configurations import brief
from dz_ros.live.requests import finite
from dz_ros.live.source import Source
from dz_ros.runs.history import RunHistory
from dz_ros.runs.sequence import longest_stretch
from dz_ros.runs.table import joined, RunTable

Array = NDArray[np.float64]
MOST_ROWS = 60000
"""More rows than this are thinned to those that a picture needs."""
PIECE = 20000
"""Rows sent at once where none is left out."""
PEAK_COLUMNS = ('x0', 'error', 'v', 's_over_epsilon')
"""Columns of which no peak is lost in thinning."""


class Recorded(Source):
    """Recorded runs.

    Args:
        runs: Name → run, in the order shown.
        axis: Name of the axis that they are of; '' = one without a name.
        axes: Names of all axes that can be looked at.

    Attributes:
        layout: Columns of all runs.
        tables: Rows of each run, complete.

    Raises:
        RecordingError: A run has nothing to show.
    """

    def __init__(self, runs: Mapping[str, RunData], axis: str = '',
                 axes: Sequence[str] = ()) -> None:
        self._names = list(runs)
        self._axis, self._axes = axis, list(axes)
        labels: dict[str, tuple[str, ...]] = {}
        for run in runs.values():
            for topic, channel in run.channels.items():
                known = labels.get(topic, ())
                labels[topic] = (*known, *(item for item in channel.labels if item not in known))
        self.layout = Layout(labels)
        self.tables: list[Array] = []
        self._events: list[dict[str, Any]] = []
        self._histories: list[RunHistory] = []
        for number, run in enumerate(runs.values()):
            self._add(number, run)
        self.history = History(1, 1)

    @property
    def problems(self) -> list[str]:
        """Return why the configuration of a run cannot be used here, a line for each such run."""
        return [f'{name}: {history.problem}' for name, history in zip(
            self._names, self._histories, strict=True) if history.problem]

    def _add(self, number: int, run: RunData) -> None:
        """Join a run's channels; put its configurations and events in order."""
        run, _ = longest_stretch(run)
        deriver = Deriver(self.layout)
        history = RunHistory(run.configuration)
        if history.configuration is not None:
            deriver.state(0.0, history.configuration)
        state = run.channels.get('state')
        for log_time, event in typed(run.events):
            changed = None
            if isinstance(event, ConfigurationEvent):
                changed = history.add(event, log_time)
                if history.configuration is not None:
                    deriver.state(log_time * 1e-9, history.configuration)
            stamp = 0.0 if state is None or not len(state) else float(np.interp(
                log_time, state.log_time, state['stamp']))
            # Of a second run only the curves are shown; its events would mark the first one's.
            if number == 0:
                self._events.append({**brief(event, changed), 'time': log_time * 1e-9,
                                     'stamp': stamp})
        self.tables.append(deriver.complete(self._table(run)))
        self._histories.append(history)

    def _table(self, run: RunData) -> Array:
        """Return the records' columns of a run, shape (N, layout.base)."""
        found = RunTable.of(run)
        order = found.x.shape[1]
        state = run.channels['state']
        extra = {**joined(state, found.seq, ('round_trip',)),
                 **joined(run.channels.get('command'), found.seq, ('hold',))}
        place = {int(seq): row for row, seq in enumerate(state['seq'].tolist())}
        rows = [place[int(seq)] for seq in found.seq]
        columns: dict[str, Any] = {
            'seq': found.seq.astype(float), 'stamp': found.t,
            'published': state.publish_time[rows] * 1e-9, 'v': found.v, **extra,
            **{f'x{i}': found.x[:, i] for i in range(order)},
            **{f'xd{i}': found.x_d[:, i] for i in range(order + 1)},
            **found.terms, **found.truth}
        blank = np.full(len(found.t), np.nan)
        return np.column_stack([columns.get(name, blank)
                                for name in self.layout.names[:self.layout.base]])

    def hello(self) -> dict[str, Any]:
        """Return columns, names and lengths of the runs."""
        c = self._histories[0].configuration
        described = {**facts(c), 'parameters': []}
        return {**described, 'rate': self._rate(), 'mode': 'run', 'runs': self._names,
                'title': f'{" and ".join(self._names)}{self._axis and f", axis {self._axis}"}',
                'axes': self._axes, 'axis': self._axis,
                'lengths': [len(table) for table in self.tables],
                'columns': self.layout.describe(c),
                'minutes': 0, 'namespace': ''}

    def _rate(self) -> float:
        """Return the samples a second of the first run."""
        c = self._histories[0].configuration
        return c.loop.rate if c is not None else 1.0 / float(
            np.median(np.diff(self.tables[0][:, 1])))

    def now(self) -> list[dict[str, Any]]:
        """Return the events of the first run, in one text however many they are."""
        return [{'kind': 'events', 'events': self._events}]

    async def ask(self, request: dict[str, Any]) -> bytes | dict[str, Any]:
        """Return the rows of a run between two instants, or how long periods and trips took there.

        Rows are thinned where they are many, except where a number to skip is given: then the
        next `PIECE` of them are sent as they are. Times are always counted over every row.

        Raises:
            ConfigurationError: Not a run, not instants, not a number to skip.
        """
        run = request.get('run')
        if isinstance(run, bool) or not isinstance(run, int) or not 0 <= run < len(self.tables):
            raise ConfigurationError('run', run, f'must be 0 to {len(self.tables) - 1}')
        limits = []
        for name, default in (('from', -np.inf), ('to', np.inf)):
            value = finite(request[name]) if name in request else default
            if value is None:
                raise ConfigurationError(name, request[name], 'must be an instant in s')
            limits.append(value)
        table = self.tables[run]
        first, last = np.searchsorted(table[:, 1], limits)
        if request.get('do') == 'histogram':
            return {'histogram': {name: self._counts(table[first:last], name) for name in NAMES}}
        if 'skip' in request:
            skip = request['skip']
            if isinstance(skip, bool) or not isinstance(skip, int) or not 0 <= skip < SEQ_LIMIT:
                raise ConfigurationError('skip', skip, 'must be a number of rows')
            first = min(first + skip, last)
            return pack(ANSWER, request['id'], table[first:min(last, first + PIECE)], run, 0.0)
        rows = self._thin(table[max(first - 1, 0):last + 1])
        return pack(ANSWER, request['id'], rows, run, 0.0)

    def _counts(self, rows: Array, name: str) -> dict[str, Any]:
        """Return how long something took in some rows."""
        place = self.layout.place(name)
        values = np.empty(0) if place is None else rows[:, place]
        return counts(values, name, 1.0 / self._rate())

    def _thin(self, rows: Array) -> Array:
        """Return so few rows that a browser can keep them, the extremes of each stretch."""
        if len(rows) <= MOST_ROWS:
            return rows
        places = [self.layout.place(name) for name in PEAK_COLUMNS]
        peaks = [place for place in places if place is not None]
        size = -(-len(rows) * 2 * len(peaks) // MOST_ROWS)
        count = len(rows) // size
        kept = [np.arange(count * size, len(rows)), np.arange(0, count * size, size)]
        for place in peaks:
            stretches = rows[:count * size, place].reshape(count, size)
            kept.append(np.arange(count) * size + np.where(
                np.isnan(stretches), np.inf, stretches).argmin(axis=1))
            kept.append(np.arange(count) * size + np.where(
                np.isnan(stretches), -np.inf, stretches).argmax(axis=1))
        return rows[np.unique(np.concatenate(kept))]


class RecordedAxes(Source):
    """Recorded runs of several axes: a summary, and each axis as `Recorded` shows it.

    Args:
        axes: Axis → name → run of this axis.
        failures: Why runs failed, a line each.
        tables: Tables of the summary: heading, head, rows of texts.

    Raises:
        RecordingError: A run has nothing to show.
    """

    def __init__(self, axes: Mapping[str, Mapping[str, RunData]], failures: Sequence[str],
                 tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[str]]]]) -> None:
        self._each = {axis: Recorded(runs, axis, list(axes)) for axis, runs in axes.items()}
        self._runs = list(next(iter(axes.values())))
        self._failures, self._tables = list(failures), list(tables)
        self.history = History(1, 1)

    @property
    def problems(self) -> list[str]:
        """Return why configurations cannot be used here, a line for each axis of each run."""
        return [f'axis {axis}: {problem}' for axis, recorded in self._each.items()
                for problem in recorded.problems]

    def of_axis(self, axis: str) -> Source | None:
        """Return the runs of an axis, for '' this summary; None = there is no such axis."""
        return self._each.get(axis) if axis else self

    def hello(self) -> dict[str, Any]:
        """Return the summary: names of runs and axes, failures, tables."""
        return {'mode': 'axes', 'title': ' and '.join(self._runs), 'runs': self._runs,
                'axes': list(self._each), 'failures': self._failures, 'tables': self._tables}

    async def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """Refuse: a summary has no rows.

        Raises:
            LoopError: Always.
        """
        raise LoopError(f'{request.get("do")}: the summary has none; ask for one of axes '
                        f'{", ".join(self._each)}')

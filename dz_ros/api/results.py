# SPDX-License-Identifier: Apache-2.0
"""Runs, comparisons and findings as the Python API gives them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.axes import spoken
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.design.finding import ERROR, Finding, WARNING, worst
from dz_ros.errors import ConfigurationError, MissingDependencyError
from dz_ros.report.compare import Comparison as _Comparison
from dz_ros.report.compare import overlaid
from dz_ros.report.report import pictures
from dz_ros.report.verdict import judge
from dz_ros.report.view import View
from dz_ros.runs.axes import axis_run, require_one
from dz_ros.runs.metrics import Metrics

Array = NDArray[np.float64]


class Run:
    """A run, simulated or recorded: its samples, metrics and figures.

    Of a recording of several axes, `axis` gives the run of one of them; what describes one axis
    (all but `axes`, `axis`, `save` and the length) raises a RecordingError before.

    Args:
        data: Its channels.
        name: Short name; '' = none.

    Attributes:
        data: Its channels as recorded, `dz_ros.core.dataset.RunData`.
    """

    def __init__(self, data: RunData, name: str = '') -> None:
        self.data = data
        self.name = name

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of its axes; empty: one, without a name."""
        return self.data.axes

    def axis(self, name: str) -> Run:
        """Return the run of one of its axes.

        Raises:
            RecordingError: There is no such axis.
        """
        return Run(axis_run(self.data, name), f'{self.name} {name}'.lstrip())

    @cached_property
    def view(self) -> View:
        """The run as one table, with metrics and timing.

        Raises:
            RecordingError: It has several axes, or no two states.
        """
        require_one(self.data, 'axis()')
        return View.of(self.data)

    @property
    def configuration(self) -> Configuration | None:
        """Its configuration; None where it has none that can be built here."""
        return self.view.setting.configuration

    @property
    def metrics(self) -> Metrics:
        """Its numbers over the last 10 s, or the last half of a shorter run."""
        return self.view.metrics

    @property
    def t(self) -> Array:
        """Stamps of the states [s], shape (N,)."""
        return self.view.rows.t

    @property
    def x(self) -> Array:
        """Measured states [state units], shape (N, n)."""
        return self.view.rows.x

    @property
    def x_d(self) -> Array:
        """References x_d … x_d^(n) [state units], shape (N, n + 1)."""
        return self.view.rows.x_d

    @property
    def error(self) -> Array:
        """Tracking error x̃ = x − x_d [state units], shape (N, n)."""
        return self.view.rows.error

    @property
    def v(self) -> Array:
        """Commands [actuator unit], shape (N,)."""
        return self.view.rows.v

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """Name → column, shape (N,): seq, t, x0 …, xd0 …, v, the terms of the law, the truth."""
        return self.view.rows.columns

    @property
    def units(self) -> dict[str, str]:
        """Name of a column → its unit, '' where it has none or it is not known."""
        return self.view.setting.column_units(self.columns)

    @property
    def metric_units(self) -> dict[str, str]:
        """Name of a metric → its unit, '' where it has none or it is not known."""
        found = {name: self.view.setting.unit(described['unit'])
                 for name, described in Metrics.described() if described['unit'] != '%'}
        return {name: '' if found.get(name, '1') == '1' else found[name]
                for name, _ in Metrics.described()}

    def to_pandas(self) -> Any:
        """Return the columns as a DataFrame with index t [s]; ``attrs['units']`` has their units.

        Of several axes the columns have two levels, axis and column, and the units as well.

        Raises:
            MissingDependencyError: pandas is not installed.
        """
        if self.axes:
            each = {name: self.axis(name).to_pandas() for name in self.axes}
            frame = _pandas().concat(each, axis=1, names=['axis', 'column'])
            frame.attrs['units'] = {name: item.attrs['units'] for name, item in each.items()}
            return frame
        frame = _pandas().DataFrame(self.columns).set_index('t')
        frame.attrs['units'] = self.units
        return frame

    def plot(self, *names: str) -> Any:
        """Return figures of the run: a matplotlib Figure for one name, name → Figure otherwise.

        Of several axes: axis → that of the axis.

        Args:
            *names: tracking, error, command, filtered_error, estimates, …; none = all there are.

        Raises:
            ConfigurationError: No figure of that name for this run.
            MissingDependencyError: matplotlib is not installed.
        """
        if self.axes:
            return {name: self.axis(name).plot(*names) for name in self.axes}
        return _figures({picture.name: picture.figure for picture in pictures(self.view)}, names)

    def save(self, directory: str | os.PathLike[str]) -> Path:
        """Write the run as a recording that ``dz`` and rosbag2 read; return its directory.

        Raises:
            RunExistsError: The directory exists; nothing is overwritten.
        """
        from dz_ros.recording.save import save_run

        save_run(self.data, Path(directory))
        return Path(directory)

    def __len__(self) -> int:
        """Return the number of samples."""
        first = self.axis(self.axes[0]) if self.axes else self
        return len(first.view.rows.seq)

    def __repr__(self) -> str:
        """Return one line: what ran, how well, a failure; of several axes a line for each."""
        if self.axes:
            first = f'<Run {f"{self.name}: " if self.name else ""}{spoken(self.axes)}'
            return '\n'.join([first, *(f'  {self.axis(name)!r}' for name in self.axes)]) + '>'
        setting, metrics = self.view.setting, self.metrics
        unit = f' {setting.unit("x")}'.removesuffix(' 1').rstrip()
        error = '' if metrics.error_max is None else f', max|x̃| {metrics.error_max:.4g}{unit}'
        name = f'{self.name}: ' if self.name else ''
        failed = ''.join(f', FAILED: {item}' for item in judge(self.view).failures[:1])
        return (f'<Run {name}{setting.law or "?"} on {setting.plant or "?"}, {len(self)} samples, '
                f'{self.view.rows.duration:.4g} s{error}{failed}>')


@dataclass(frozen=True, repr=False)
class Comparison:
    """Runs side by side.

    Attributes:
        comparison: Name → view, in the order given.
    """

    comparison: _Comparison

    @property
    def rows(self) -> list[list[str]]:
        """Metric and one text a run, units included."""
        return self.comparison.rows()

    @property
    def differences(self) -> list[list[str]]:
        """Key and one text a run, for keys of the configurations that differ."""
        return self.comparison.differences()

    def to_pandas(self) -> Any:
        """Return the metrics as a DataFrame, one row a run.

        Raises:
            MissingDependencyError: pandas is not installed.
        """
        return _pandas().DataFrame.from_dict(
            {name: view.metrics.to_dict() for name, view in self.comparison.views.items()},
            orient='index')

    def plot(self, *names: str) -> Any:
        """Return overlaid figures, as `Run.plot`: error, command, layer."""
        return _figures({picture.name: picture.figure for picture in overlaid(self.comparison)},
                        names)

    def __repr__(self) -> str:
        """Return the table of metrics."""
        table = [['', *self.comparison.views], *self.rows]
        widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
        return '\n'.join('  '.join(text.ljust(width) for text, width in
                                   zip(row, widths, strict=True)).rstrip() for row in table)


class AxesComparison(dict[str, Comparison]):
    """Runs of several axes side by side: axis → comparison; prints as text."""

    def to_pandas(self) -> Any:
        """Return the metrics as a DataFrame, one row an axis and run.

        Raises:
            MissingDependencyError: pandas is not installed.
        """
        return _pandas().concat({axis: found.to_pandas() for axis, found in self.items()},
                                names=['axis', 'run'])

    def __repr__(self) -> str:
        """Return the table of metrics of each axis."""
        return '\n'.join(f'axis {axis}\n{found!r}' for axis, found in self.items())


class Findings(tuple[Finding, ...]):
    """Findings of the design rules for a configuration; prints as text, gravest last."""

    __slots__ = ()

    @property
    def worst(self) -> str:
        """The gravest level: error, warning or info."""
        return worst(self)

    def __repr__(self) -> str:
        """Return a line for each finding and what to change."""
        order = {ERROR: 2, WARNING: 1}
        return '\n'.join(f'{item.level:<7}  {item.rule}: {item.words}'
                         + (f' → {item.change}' if item.change else '')
                         for item in sorted(self, key=lambda item: order.get(item.level, 0)))


def _figures(found: Mapping[str, Any], names: Iterable[str]) -> Any:
    """Return the figures of some names.

    Raises:
        ConfigurationError: There is no such figure.
    """
    wanted = list(names)
    for name in wanted:
        if name not in found:
            raise ConfigurationError('plot', name, f'must be one of {", ".join(found)}')
    if len(wanted) == 1:
        return found[wanted[0]]
    return {name: figure for name, figure in found.items() if not wanted or name in wanted}


def _pandas() -> Any:
    """Return the module pandas."""
    try:
        import pandas
    except ImportError:
        raise MissingDependencyError("pandas is not installed: pip install 'dz_ros[pandas]'"
                                     ) from None
    return pandas

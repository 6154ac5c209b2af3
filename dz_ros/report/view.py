# SPDX-License-Identifier: Apache-2.0
"""A run with everything that pictures and pages need of it, computed once."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.dataset import RunData
from dz_ros.core.records import Status, Terms
from dz_ros.core.signals import declared, Role, Signal
from dz_ros.runs.metrics import filtered_error, jsonable, layer_width, measure, Metrics
from dz_ros.runs.setting import Setting
from dz_ros.runs.table import RunTable
from dz_ros.runs.timing import measure_timing, Timing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """A run, looked at.

    Attributes:
        run: The run.
        setting: What is known of it besides its channels.
        rows: The run as one table.
        metrics: Its numbers.
        timing: Its timing.
        s: Filtered error, shape (N,); NaN where unknown.
        epsilon: Half-width ε of the boundary layer in every sample, shape (N,); NaN = none.
        disturbed: True where an instant to recover from was given.
    """

    run: RunData
    setting: Setting
    rows: RunTable
    metrics: Metrics
    timing: Timing
    s: Array
    epsilon: Array
    disturbed: bool = False

    @classmethod
    def of(cls, run: RunData, *, window: tuple[float, float] | None = None,
           pulse: float | None = None, tolerance: float | None = None) -> View:
        """Return a run, looked at; the arguments are those of `metrics.measure`.

        Raises:
            RecordingError: The run has no two states.
            ConfigurationError: The window or the tolerance is not one.
        """
        setting = Setting.of(run)
        rows = RunTable.of(run)
        return cls(run, setting, rows,
                   measure(rows, setting, window=window, pulse=pulse, tolerance=tolerance),
                   measure_timing(run, setting), filtered_error(rows, setting),
                   layer_width(rows, setting), pulse is not None)

    @property
    def has_layer(self) -> bool:
        """True where the law has a boundary layer of known width."""
        return bool(np.isfinite(self.widest))

    @property
    def widest(self) -> float:
        """Largest ε; that of the configuration where no sample has one; NaN = none."""
        known = self.epsilon[np.isfinite(self.epsilon)]
        if len(known):
            return float(known.max())
        return math.nan if self.setting.epsilon is None else self.setting.epsilon

    @property
    def terms(self) -> tuple[Signal, ...]:
        """What the run's terms carry, as declared."""
        return declared(self.rows.terms, self.setting.signals)

    @property
    def signals(self) -> tuple[Signal, ...]:
        """The law's own signals, those that only repeat its memory left out."""
        common = Terms.labels(())
        return tuple(item for item in self.terms
                     if item.name not in common and item.role is not Role.MEMORY)

    @property
    def frozen(self) -> dict[str, int]:
        """Reason → samples in which adaptation did not advance."""
        if 'status' not in self.rows.terms:
            return {}
        status = self.rows.terms['status']
        bits = status[np.isfinite(status) & (status >= 0.0)].astype(np.int64)
        counts = {str(flag.name).lower(): int(np.count_nonzero(bits & flag)) for flag in Status}
        return {name: count for name, count in counts.items() if count}

    def to_dict(self) -> dict[str, Any]:
        """Return the run's numbers by name, ready for JSON: no NaN, no infinity."""
        found: dict[str, Any] = jsonable({
            'mode': self.setting.mode, 'plant': self.setting.plant, 'law': self.setting.law,
            'trajectory': self.setting.trajectory, 'order': self.setting.order,
            'duration': self.rows.duration, 'samples': len(self.rows.seq),
            'metrics': self.metrics.to_dict(), 'timing': self.timing.to_dict(),
            'data': {'missing': self.rows.missing, 'carried_references': self.rows.carried,
                     'not_finite': self.rows.not_finite, 'restarts': self.rows.restarts,
                     'frozen': self.frozen},
            'info': dict(self.run.info)})
        return found

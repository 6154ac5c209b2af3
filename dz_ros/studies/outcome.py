# SPDX-License-Identifier: Apache-2.0
"""One closed loop offline and its numbers, as one flat row: what arena and sweeps are made of.

The numbers are those of `dz_ros.runs.metrics` over the last 10 s (the last half of a shorter
run), but of the *true* state: measurement noise is what the law has to live with, not part of its
error. A run is lost by the criterion of `dz_ros.core.design.stability`, where it overflows, and
where anything in it raises, a plant or law of one's own most likely; its row has the reason and
stays in the table. `omega` is the share of the window within Ω_ε, in a comparison that of a
yardstick which is the same for every law, so that a law cannot win by naming a wider set.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from functools import lru_cache
import math
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration, SELECTORS
from dz_ros.core.design.linear_loop import largest_beta, LayerModel
from dz_ros.core.design.stability import run_is_lost
from dz_ros.core.loop.compiled import prepare_fast
from dz_ros.core.loop.offline import Run
from dz_ros.core.signals import TERM_NAMES
from dz_ros.core.units import Units
from dz_ros.errors import ConfigurationError, DzRosError
from dz_ros.runs.metrics import choose_window, measure
from dz_ros.runs.setting import Setting
from dz_ros.runs.table import RunTable
from dz_ros.studies.code_folder import keep_compiled

Row = dict[str, Any]
Stages = Generator[None, None, Row]
"""A row that is being made; it pauses once its run is prepared."""

NUMBERS = ('error_max', 'error_rms', 's_over_epsilon_max', 'layer_share', 'v_rms', 'v_peak',
           'v_peak_run', 'v_variation', 'v_highpass', 'settling_time', 'recovery_time')
"""Metrics of a row; see `dz_ros.runs.metrics.Metrics`."""
COLUMNS = (*NUMBERS, 'omega', 'chatter_share', 'lost', 'reason')
"""Every column of a row: `NUMBERS`; share of the window within Ω_ε, 0 … 1; loop gain over the
gain at which chatter begins at this b m and this delay; 1 where the run was lost; why."""
CHOOSING = frozenset({'loop.axes', *(f'{section}.{key}' for section, key in SELECTORS.items())})
"""Keys that choose axes or a class; where one is changed, others are set aside."""
TOGETHER = 32
"""Most rows of which the runs are prepared before the first of them."""
LONGEST = 300
"""Letters of a reason at most; some compilers explain themselves over pages."""


def run_row(configuration: Configuration, yardstick: Sequence[float] | None = None) -> Row:
    """Return the row of one run; a run that fails has a row as well.

    Args:
        configuration: What to run.
        yardstick: Bounds on |x̃_i| that count as Ω_ε, shape (n,); None = the law's own.
    """
    return _side_by_side([_run_stages(configuration, yardstick)])[0]


def _run_stages(configuration: Configuration, yardstick: Sequence[float] | None) -> Stages:
    """Make the row of one run; pause before the run."""
    row: Row = {**dict.fromkeys(COLUMNS), 'lost': 0, 'reason': ''}
    try:
        row['chatter_share'] = chatter_share(configuration)
        if configuration.loop.samples < 4:
            return {**row, 'lost': 1, 'reason': 'loop.duration is too short to measure anything'}
        run_loop = prepare_fast(configuration)
        yield
        run = run_loop()
        if not (np.isfinite(run.x).all() and np.isfinite(run.v).all()):
            finite = np.isfinite(run.x).all(axis=1) & np.isfinite(run.v)
            begin = run.t[int(finite.argmin())]
            return {**row, 'lost': 1, 'reason': f'diverged: not finite from t = {begin:g} s on'}
        row.update(measured(run, yardstick))
        if run_is_lost(run):
            row.update(lost=1, reason='does not follow its reference at the end')
    except (ArithmeticError, ValueError) as error:
        return {**row, 'lost': 1, 'reason': f'diverged: {one_line(error)}'}
    except Exception as error:  # noqa: BLE001  whatever a class of one's own raises
        return {**row, 'lost': 1, 'reason': f'failed: {one_line(error)}'}
    return row


def one_line(error: Exception) -> str:
    """Return class and message of an error in one line, cut where it is long."""
    text = ' '.join(f'{type(error).__name__}: {error}'.split()).rstrip(': ')
    return text if len(text) <= LONGEST else f'{text[:LONGEST - 1]}…'


def row_of(base: Mapping[str, Any], changed: Mapping[str, Any],
           yardstick: Sequence[float] | None = None) -> Row:
    """Return the row of a flat configuration with keys changed; if refused, with the reason.

    Args:
        base: Flat configuration.
        changed: Keys of it that are changed.
        yardstick: As of `run_row`.
    """
    return _side_by_side([_changed_stages(base, changed, yardstick)])[0]


def _changed_stages(base: Mapping[str, Any], changed: Mapping[str, Any],
                    yardstick: Sequence[float] | None,
                    known: Configuration | None = None) -> Stages:
    """Make the row of `row_of`; sections without changes are those of `known`, that of `base`."""
    try:
        configuration = (Configuration.from_changed(base, changed)
                         if known is None or known.axes or any(
                             key in CHOOSING or key.startswith('axes.') for key in changed)
                         else known.replace(**changed))
    except DzRosError as error:
        return {**dict.fromkeys(COLUMNS), 'lost': 1, 'reason': f'refused: {error}'}
    except Exception as error:  # noqa: BLE001  the same
        return {**dict.fromkeys(COLUMNS), 'lost': 1, 'reason': f'failed: {one_line(error)}'}
    if configuration.misfitting:    # runs from other states are not to be compared
        return {**dict.fromkeys(COLUMNS), 'lost': 1,
                'reason': f'refused: {"; ".join(configuration.misfit_notes)}'}
    return (yield from _run_stages(configuration, yardstick))


def rows_of(base: Mapping[str, Any], changes: Sequence[Mapping[str, Any]],
            yardstick: Sequence[float] | None = None) -> list[Row]:
    """Return the rows of several runs: one task of a pool. What is compiled is kept."""
    keep_compiled()
    try:
        known = Configuration.from_changed(base, {})
    except Exception:  # noqa: BLE001  the changes may mend it; if not, each row has the reason
        known = None
    rows: list[Row] = []
    for begin in range(0, len(changes), TOGETHER):
        rows += _side_by_side([_changed_stages(base, changed, yardstick, known)
                               for changed in changes[begin:begin + TOGETHER]])
    return rows


def _side_by_side(rows: Sequence[Stages]) -> list[Row]:
    """Return rows whose runs are prepared one after the other, before the first of them.

    A run takes what its preparation needs out of the processor's caches; so it is fetched once for
    all. To run several before their metrics gains nothing: their arrays need new memory.
    """
    made: dict[int, Row] = {}
    while waiting := [place for place in range(len(rows)) if place not in made]:
        for place in waiting:
            try:
                next(rows[place])
            except StopIteration as end:
                made[place] = end.value
    return [made[place] for place in range(len(rows))]


def measured(run: Run, yardstick: Sequence[float] | None = None) -> Row:
    """Return the metrics of a run and its share within Ω_ε."""
    c = run.configuration
    rows, setting = aligned(run), setting_of(c)
    instant, acceleration, _ = c.plant_settings.disturbance_pulse
    found = measure(rows, setting, pulse=instant if acceleration else None)
    row: Row = {name: getattr(found, name) for name in NUMBERS}
    row['omega'] = found.omega_share
    if yardstick is not None:
        begin, _ = choose_window(run.t)
        inside = run.t >= begin - 1e-9
        within = np.abs(rows.error[inside]) <= np.asarray(yardstick)
        row['omega'] = float(within.all(axis=1).mean())
    return row


def aligned(run: Run) -> RunTable:
    """Return an offline run as the table that analysis works on, with the true state."""
    terms = {name: run.terms[:, place] for place, name in enumerate(
        (*TERM_NAMES, 'status', *run.configuration.law.signal_names))}
    return RunTable(np.arange(len(run.t)), run.t, run.x, run.x_d, run.v, terms, {}, {}, {}, 0, 0,
                    0)


def setting_of(c: Configuration) -> Setting:
    """Return what analysis needs to know of a configuration."""
    design = c.law.design
    epsilon = design.epsilon if design is not None and design.epsilon > 0.0 else None
    return Setting('offline', c.plant.order, c.loop.period, c.plant.name, c.law.name,
                   c.trajectory.name, getattr(c.law.gains, 'lambda_', None), epsilon,
                   Units.of(c.plant), c.law.signals, True, {}, {}, c)


def chatter_share(c: Configuration) -> float | None:
    """Return b m over that at which chatter begins (1 = the boundary of the rule).

    At the plant's own b, the larger slope of its dead-zone and the configured delay; None where
    the law's gain is not known.
    """
    design = c.law.design
    model = c.law.layer_model()
    if design is None or model is None or design.gain + design.lead <= 0.0:
        return None
    beta = c.plant.b * max(c.dead_zone.m_r, c.dead_zone.m_l)
    largest = _largest_beta(_Key(model), c.loop.period, c.loop.delay)
    return beta / largest if largest > 0.0 else math.inf


class _Key:
    """A law's model as a key: equal where its numbers are."""

    def __init__(self, model: LayerModel) -> None:
        self.model = model
        self._numbers = tuple((item.shape, item.tobytes())
                              for item in (model.a, model.b, model.c, model.d))

    def __hash__(self) -> int:
        return hash(self._numbers)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self._numbers == other._numbers


@lru_cache(maxsize=64)
def _largest_beta(key: _Key, period: float, delay: int) -> float:
    """Return `largest_beta`, found once for runs that differ in something else."""
    return largest_beta(key.model, period, delay)


def require_end(c: Configuration) -> None:
    """Refuse a configuration whose runs would not end.

    Raises:
        ConfigurationError: Its duration is 0.
    """
    if c.loop.samples == 0:
        raise ConfigurationError('loop.duration', c.loop.duration,
                                 'a loop offline needs an end: at least one sample interval')

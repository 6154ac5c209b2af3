"""One closed loop off line and its numbers, as one flat row: what arena and sweeps are made of.

The numbers are those of `dz_ros.analysis.metrics` over the last 10 s (the last half of a shorter
run), but of the *true* state: measurement noise is what the law has to live with, not part of its
error. A run is lost where `dz_ros.core.stability` says so, where it overflows, and where anything
in it raises, a plant or law of one's own most likely; its row says why and stays in the
table. `omega` is the share of the window within Ω_ε, in a comparison that of a yardstick which is
the same for every law, so that a law cannot win by naming a wider set.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

import numpy as np

from dz_ros.analysis.align import Aligned
from dz_ros.analysis.measures import choose_window
from dz_ros.analysis.metrics import measure
from dz_ros.analysis.setting import Setting
from dz_ros.core.boundary_layer import largest_beta
from dz_ros.core.compiled import simulate_fast
from dz_ros.core.configuration import Configuration
from dz_ros.core.loop import Run
from dz_ros.core.records import TERM_NAMES
from dz_ros.core.stability import run_is_lost
from dz_ros.errors import ConfigurationError, DzRosError

Row = dict[str, Any]

NUMBERS = ('error_max', 'error_rms', 's_over_epsilon_max', 'layer_share', 'v_rms', 'v_peak',
           'v_peak_run', 'v_variation', 'v_highpass', 'settling_time', 'recovery_time')
"""Metrics of a row; see `dz_ros.analysis.metrics.Metrics`."""
COLUMNS = (*NUMBERS, 'omega', 'chatter_share', 'lost', 'reason')
"""Every column of a row: `NUMBERS`; share of the window within Ω_ε, 0 … 1; loop gain over the
gain at which chatter begins at this b m and this delay; 1 where the run was lost; why."""
LONGEST = 300
"""Letters of a reason at most; some compilers explain themselves over pages."""


def run_row(configuration: Configuration, yardstick: Sequence[float] | None = None) -> Row:
    """Return the row of one run; a run that fails has a row as well.

    Args:
        configuration: What to run.
        yardstick: Bounds on |x̃_i| that count as Ω_ε, shape (n,); None = the law's own.
    """
    row: Row = {**dict.fromkeys(COLUMNS), 'lost': 0, 'reason': ''}
    try:
        row['chatter_share'] = chatter_share(configuration)
        if configuration.loop.samples < 4:
            return {**row, 'lost': 1, 'reason': 'loop.duration is too short to measure anything'}
        run = simulate_fast(configuration)
        finite = np.isfinite(run.x).all(axis=1) & np.isfinite(run.v)
        if not finite.all():
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
    """Return the row of a flat configuration with keys changed; refused ones say why."""
    try:
        configuration = Configuration.from_flat({**base, **changed})
    except DzRosError as error:
        return {**dict.fromkeys(COLUMNS), 'lost': 1, 'reason': f'refused: {error}'}
    except Exception as error:  # noqa: BLE001  the same
        return {**dict.fromkeys(COLUMNS), 'lost': 1, 'reason': f'failed: {one_line(error)}'}
    return run_row(configuration, yardstick)


def rows_of(base: Mapping[str, Any], changes: Sequence[Mapping[str, Any]],
            yardstick: Sequence[float] | None = None) -> list[Row]:
    """Return the rows of several runs: one task of a pool."""
    return [row_of(base, changed, yardstick) for changed in changes]


def measured(run: Run, yardstick: Sequence[float] | None = None) -> Row:
    """Return the metrics of a run and its share within Ω_ε."""
    c = run.configuration
    rows, setting = aligned(run), setting_of(c)
    instant, acceleration, _ = c.plant_settings.kick
    found = measure(rows, setting, kick=instant if acceleration else None)
    row: Row = {name: getattr(found, name) for name in NUMBERS}
    row['omega'] = found.omega_share
    if yardstick is not None:
        begin, _ = choose_window(run.t)
        within = np.abs(rows.error[run.t >= begin - 1e-9]) <= np.asarray(yardstick)
        row['omega'] = float(within.all(axis=1).mean())
    return row


def aligned(run: Run) -> Aligned:
    """Return a run off line as the table that analysis works on, with the true state."""
    terms = {name: run.terms[:, place] for place, name in enumerate(
        (*TERM_NAMES, 'status', *run.configuration.law.signal_names))}
    return Aligned(np.arange(len(run.t)), run.t, run.x, run.x_d, run.v, terms, {}, {}, {}, 0, 0, 0)


def setting_of(c: Configuration) -> Setting:
    """Return what analysis needs to know of a configuration."""
    design = c.law.design
    epsilon = design.epsilon if design is not None and design.epsilon > 0.0 else None
    return Setting('offline', c.plant.order, c.loop.period, c.plant.name, c.law.name,
                   c.trajectory.name, getattr(c.law.gains, 'lambda_', None), epsilon,
                   c.plant.state_units, c.plant.actuator_unit, True, {}, {}, c)


def chatter_share(c: Configuration) -> float | None:
    """Return the loop gain over that at which chatter begins (1 = the boundary of the rule).

    At the plant's own b, the larger slope of its dead-zone and the configured delay; None where
    the law's gain is not known.
    """
    design = c.law.design
    if design is None or design.gain + design.lead <= 0.0:
        return None
    beta = c.plant.b * max(c.dead_zone.m_r, c.dead_zone.m_l)
    largest = largest_beta(design.gain + design.lead, design.integral_rate, c.loop.period,
                           c.loop.delay)
    return beta / largest if largest > 0.0 else math.inf


def require_end(c: Configuration) -> None:
    """Refuse a configuration whose runs would not end.

    Raises:
        ConfigurationError: Its duration is 0.
    """
    if c.loop.samples == 0:
        raise ConfigurationError('loop.duration', c.loop.duration,
                                 'a loop off line needs an end: at least one sample interval')

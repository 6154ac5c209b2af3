# SPDX-License-Identifier: Apache-2.0
"""Maps of a sweep: error, total variation and loss over one key or two.

Over them lies the boundary of chatter as the design rule gives it, (K + λ φ̂) b m T = μ_d, and the
measured one, where the total variation passes four times that of the calm part of the sweep.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.errors import ConfigurationError
from dz_ros.report.style import BLACK, BLUE, new_figure, Picture, RED, styled
from dz_ros.studies.outcome import COLUMNS

Array = NDArray[np.float64]
Rows = Sequence[Mapping[str, Any]]

SHOWN = (('error_max', 'largest |x̃|'), ('v_variation', 'total variation of v per second'),
         ('lost', 'share of runs lost'))
CALM = 0.8
"""Runs with a smaller loop gain than this share of the rule's limit are calm."""
WILD = 4.0
"""Chatter has begun where the total variation is this many times the calm median."""


def pictures(rows: Rows, x: str | None = None, y: str | None = None) -> list[Picture]:
    """Return the picture of a sweep: curves over one key, maps over two.

    Args:
        rows: Of `dz_ros.studies.sweep.read_sweep`.
        x: Key along the horizontal axis; None = the sweep's first.
        y: Key along the vertical axis; None = the second, if there is one.

    Raises:
        ConfigurationError: No rows, or a key that was not swept or has no numbers.
        MissingDependencyError: matplotlib is not installed.
    """
    if not rows:
        raise ConfigurationError('sweep', 0, 'has no runs yet')
    keys = [key for key in rows[0] if key != 'run' and key not in COLUMNS]
    x = x or keys[0]
    if y is None:
        y = next((key for key in keys if key != x), None)
    for key in (x, y):
        if key is None:
            continue
        if key not in keys:
            raise ConfigurationError('--x, --y', key,
                                     f'was not swept; choose of {", ".join(keys)}')
        if any(isinstance(row[key], (str, bool)) for row in rows):
            raise ConfigurationError('--x, --y', key, 'has names as values, not numbers')
    with styled():
        return [_curves(rows, x) if y is None else _maps(rows, x, y)]


def column(rows: Rows, key: str) -> Array:
    """Return a column, NaN where a row has none."""
    return np.array([math.nan if row[key] is None else float(row[key]) for row in rows])


def threshold(rows: Rows) -> float | None:
    """Return the total variation from which on a run chatters; None without calm runs."""
    share, wild = column(rows, 'chatter_share'), column(rows, 'v_variation')
    calm = wild[(share < CALM) & np.isfinite(wild)]
    return WILD * float(np.median(calm)) if len(calm) else None


def is_geometric(values: Array) -> bool:
    """Return whether distinct values are spread by ratios rather than by steps."""
    known = np.unique(values)
    if len(known) < 4 or known[0] <= 0.0:
        return False
    steps, ratios = np.diff(known), np.diff(np.log(known))
    return bool(np.ptp(ratios) / ratios.mean() < np.ptp(steps) / steps.mean())


def crossing(x: Array, values: Array, level: float) -> float | None:
    """Return the x at which values pass a level, interpolated; None if they never do."""
    order = np.argsort(x)
    x, values = x[order], values[order]
    known = np.isfinite(values)
    x, values = x[known], values[known]
    for i in range(len(x) - 1):
        a, b = values[i] - level, values[i + 1] - level
        if a == 0.0 or a * b < 0.0:
            return float(x[i] + (x[i + 1] - x[i]) * (a / (a - b) if a != b else 0.0))
    return None


def _curves(rows: Rows, x: str) -> Picture:
    """Return error, variation and loss over one key, the worst of equal places."""
    at = column(rows, x)
    places = np.unique(at)
    log = is_geometric(at)
    figure = new_figure(8.0, 6.2)
    share = _reduced(places, at, column(rows, 'chatter_share'))
    predicted = crossing(places, share, 1.0)
    limit = threshold(rows)
    # The variation leaps over decades from one place to the next: interpolate its logarithm.
    leap = np.log(np.maximum(_reduced(places, at, column(rows, 'v_variation')), 1e-12))
    measured = None if limit is None else crossing(places, leap, math.log(limit))
    for ax, (name, title) in zip(figure.subplots(3, 1, sharex=True), SHOWN, strict=True):
        values = column(rows, name)
        ax.plot(places, _reduced(places, at, values, np.mean if name == 'lost' else np.max),
                color=BLUE, marker='.', ms=4.0, gid=name)
        if predicted is not None:
            ax.axvline(predicted, color=BLACK, lw=0.9, gid='predicted')
        if measured is not None:
            ax.axvline(measured, color=RED, lw=0.9, ls='--', gid='measured')
        ax.set_title(title)
        if name != 'lost' and np.nanmin(values) > 0.0:
            ax.set_yscale('log')
        if log:
            ax.set_xscale('log')
    ax.set_xlabel(x)
    return Picture(f'sweep_{_file(x)}', f'Sweep over {x}',
                   _caption(f'{len(rows)} runs over {x}', predicted, measured),
                   f'Error, total variation and loss over {x}.', figure)


def _reduced(places: Array, at: Array, values: Array, how: Any = np.max) -> Array:
    """Return one value a place: the worst, or the mean, of those that are numbers."""
    found = np.full(len(places), math.nan)
    for i, place in enumerate(places):
        known = values[(at == place) & np.isfinite(values)]
        if len(known):
            found[i] = how(known)
    return found


def _caption(lead: str, predicted: float | None, measured: float | None) -> str:
    parts = [lead]
    if predicted is not None:
        parts.append(f'black: chatter begins by the design rule, at {predicted:.4g}')
    if measured is not None:
        parts.append(f'red: the total variation passes {WILD:g} times the calm one, at '
                     f'{measured:.4g}')
    return '; '.join(parts) + '.'


def _maps(rows: Rows, x: str, y: str) -> Picture:
    """Return error, variation and loss over two keys; of further keys the worst."""
    from matplotlib.colors import LogNorm
    at, up = column(rows, x), column(rows, y)
    columns, lines = np.unique(at), np.unique(up)
    grid = len(columns) * len(lines) <= len(rows)
    limit = threshold(rows)
    figure = new_figure(11.0, 3.9)
    for ax, (name, title) in zip(figure.subplots(1, 3, sharex=True, sharey=True), SHOWN,
                                 strict=True):
        values = column(rows, name)
        known = values[np.isfinite(values)]
        norm = LogNorm(known.min(), known.max()) if name != 'lost' and len(known) \
            and 0.0 < known.min() < known.max() else None
        style = {'cmap': 'viridis', 'norm': norm} if norm else {'cmap': 'viridis'}
        if name == 'lost':
            style = {'cmap': 'Greys', 'vmin': 0.0, 'vmax': 1.0}
        if grid:
            how = np.mean if name == 'lost' else np.max
            cells = np.array([_reduced(columns, at[up == line], values[up == line], how)
                              for line in lines])
            shown = ax.pcolormesh(columns, lines, cells, shading='nearest', **style)
        else:
            shown = ax.scatter(at, up, c=values, s=9.0, **style)
        ax.set_title(title)
        ax.grid(False)
        figure.colorbar(shown, ax=ax)
        for key, level, colour, dash in (('chatter_share', 1.0, BLACK, '-'),
                                         ('v_variation', limit, RED, '--')):
            if level is not None:
                _boundary(ax, at, up, column(rows, key), level, colour, dash,
                          (columns, lines) if grid else None)
        ax.set_xlabel(x)
        if is_geometric(at):
            ax.set_xscale('log')
            ax.xaxis.set_minor_formatter('')
        if is_geometric(up):
            ax.set_yscale('log')
    figure.axes[0].set_ylabel(y)
    return Picture(f'sweep_{_file(x)}_{_file(y)}', f'Sweep over {x} and {y}',
                   f'{len(rows)} runs. Black: chatter begins by the design rule. Red, dashed: the '
                   f'total variation passes {WILD:g} times the calm one. White: lost, no number.',
                   f'Maps of error, total variation and loss over {x} and {y}.', figure)


def _boundary(ax: Any, at: Array, up: Array, values: Array, level: float, colour: str,
              dash: str, grid: tuple[Array, Array] | None) -> None:
    """Draw the line on which values pass a level, where there is one."""
    finite = np.isfinite(values)
    if not finite.any() or not values[finite].min() < level < values[finite].max():
        return
    if values[finite].min() > 0.0:
        values, level = np.log(np.maximum(values, 1e-12)), math.log(level)
    style = {'levels': [level], 'colors': [colour], 'linestyles': [dash], 'linewidths': 1.2}
    if grid is None:
        if np.count_nonzero(finite) > 3:
            ax.tricontour(at[finite], up[finite], values[finite], **style)
    elif min(len(grid[0]), len(grid[1])) > 1:
        cells = np.array([_reduced(grid[0], at[up == line], values[up == line])
                          for line in grid[1]])
        ax.contour(*grid, np.ma.masked_invalid(cells), **style)


def _file(key: str) -> str:
    """Return a key as part of a file name."""
    return ''.join(letter if letter.isalnum() else '_' for letter in key)

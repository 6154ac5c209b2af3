# SPDX-License-Identifier: Apache-2.0
"""How pictures of runs look: one palette, legends beside the data, units on every axis.

matplotlib is imported when the first picture is made, used through its object interface and
drawn by Agg: no window, no global state. Colours are Okabe and Ito's, which colour-blind readers
can distinguish.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import io
import math
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.text import plain
from dz_ros.errors import MissingDependencyError, RecordingError

Array = NDArray[np.float64]

BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK, GREY, PALE = (
    '#0072B2', '#E69F00', '#009E73', '#D55E00', '#CC79A7', '#56B4E9', '#1a1a1a', '#8c8c8c',
    '#cfcfcf')
CYCLE = (BLUE, RED, GREEN, ORANGE, PURPLE, SKY, BLACK)
DPI = 130
POINTS = 6000
"""Points of a line beyond which it is drawn by the extremes of its stretches."""
LARGEST_DRAWN = 1e100
"""What is larger is left out: the arithmetic of axes ends there."""

RC = {
    'font.size': 9.0, 'axes.titlesize': 9.5, 'axes.labelsize': 9.0, 'legend.fontsize': 8.5,
    'axes.spines.top': False, 'axes.spines.right': False, 'axes.linewidth': 0.7,
    'axes.grid': True, 'grid.color': '#e4e4e4', 'grid.linewidth': 0.6, 'axes.axisbelow': True,
    'lines.linewidth': 1.1, 'xtick.direction': 'out', 'ytick.direction': 'out',
    'xtick.major.width': 0.7, 'ytick.major.width': 0.7, 'axes.titlelocation': 'left',
    'axes.titlepad': 7.0, 'legend.frameon': False, 'legend.handlelength': 1.6,
    'legend.columnspacing': 1.2, 'legend.borderaxespad': 0.0, 'figure.facecolor': 'white',
    'axes.formatter.useoffset': False, 'axes.formatter.limits': (-4, 5),
    'mathtext.fontset': 'dejavusans',
}


@dataclass(frozen=True)
class Picture:
    """A figure and what goes with it.

    Attributes:
        name: File name without ending.
        title: Heading.
        caption: What is to be seen, with the numbers that matter.
        alt: What the picture shows, for readers without it.
        figure: The matplotlib Figure.
    """

    name: str
    title: str
    caption: str
    alt: str
    figure: Any

    def png(self) -> bytes:
        """Return the picture as a PNG file's bytes.

        Raises:
            RecordingError: Its numbers are too large, or too far apart, for its axes.
        """
        buffer = io.BytesIO()
        try:
            with styled():
                self.figure.savefig(buffer, format='png', dpi=DPI)
        except (ValueError, OverflowError) as error:
            raise RecordingError(f'picture {self.name} cannot be drawn: {error}') from error
        return buffer.getvalue()


@contextmanager
def styled() -> Iterator[None]:
    """Hold the style for the figures made or drawn inside; huge numbers overflow without a word.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise MissingDependencyError(
            'pictures need matplotlib: pip install matplotlib') from error
    with matplotlib.rc_context(RC), np.errstate(all='ignore'):
        yield


def new_figure(width: float, height: float) -> Any:
    """Return an empty figure of this size [inch]."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    figure = Figure(figsize=(width, height), layout='constrained')
    FigureCanvasAgg(figure)
    return figure


def axis_label(symbol: str, unit: str) -> str:
    """Return ``symbol [unit]`` (mathtext, plain text), the symbol alone where there is no unit."""
    return f'{symbol}  [{plain(unit)}]' if unit else symbol


def mathtext(symbol: str) -> str:
    """Return the mathtext of a declared symbol: hats, ``_`` subscripts, ``^(…)`` powers."""
    text = re.sub('(.)\u0302', r'\\hat{\1}', plain(symbol))
    text = re.sub(r'\^(\([^)]*\))', r'^{\1}', re.sub(r'_([^ _^]+)', r'_{\1}', text))
    return f'${text}$'


def derivative(symbol: str, order: int) -> str:
    """Return the mathtext of a derivative: dots, from the third on a number in brackets."""
    dots = {0: symbol, 1: rf'\dot{{{symbol}}}', 2: rf'\ddot{{{symbol}}}'}
    return dots.get(order, rf'{symbol}^{{({order})}}')


def legend(ax: Any, columns: int = 6) -> None:
    """Put the legend above the axes at the right, where no data is."""
    if ax.get_legend_handles_labels()[1]:
        ax.legend(loc='lower right', bbox_to_anchor=(1.0, 1.015), ncols=columns)


def thin(t: Array, y: Array, points: int = POINTS) -> tuple[Array, Array]:
    """Return a line of about `points` points that keeps every peak: extremes of each stretch."""
    if len(t) <= points:
        return t, y
    size = math.ceil(2 * len(t) / points)
    count = len(t) // size
    stretches = y[:count * size].reshape(count, size)
    low = np.where(np.isnan(stretches), np.inf, stretches).argmin(axis=1)
    high = np.where(np.isnan(stretches), -np.inf, stretches).argmax(axis=1)
    start = np.arange(0, count * size, size)
    rows = np.unique(np.concatenate([start + low, start + high, np.arange(count * size, len(t))]))
    return t[rows], y[rows]


def line(ax: Any, t: Array, y: Array, name: str, **style: Any) -> None:
    """Draw y over t where an axis can show it; the line's gid is `name`, to find it again."""
    shown = thin(t, np.where(np.abs(y) <= LARGEST_DRAWN, y, np.nan))
    ax.plot(*shown, gid=name, **style)


def fit_y(ax: Any, *values: Array, margin: float = 0.06, include: tuple[float, ...] = ()) -> None:
    """Set the y limits to the values drawn and the numbers to include, with a margin."""
    known = [item[np.abs(item) <= LARGEST_DRAWN] for item in values]
    numbers = np.concatenate([*known, np.asarray(include, dtype=float)])
    if not len(numbers):
        return
    low, high = float(numbers.min()), float(numbers.max())
    pad = margin * (high - low) or 0.1 * abs(high) or 1.0
    ax.set_ylim(low - pad, high + pad)


def mark_gaps(ax: Any, t: Array, period: float | None, most: int = 50) -> None:
    """Shade where a run has no samples for more than three periods (the longest `most`)."""
    if period is None or len(t) < 2:
        return
    steps = np.diff(t)
    gaps = np.flatnonzero(steps > 3.0 * period)
    for row in gaps[np.argsort(steps[gaps])[::-1][:most]]:
        label = 'no samples' if not any(item.get_gid() == 'gap' for item in ax.patches) else None
        ax.axvspan(t[row], t[row + 1], color='#f3d9d0', lw=0, zorder=0, gid='gap', label=label)

# SPDX-License-Identifier: Apache-2.0
"""A figure, what it is to be, and whether it is: the lines of one table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
import statistics
import sys
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Row:
    """One figure.

    Attributes:
        what: What was measured, against what.
        value: The figure.
        target: What it is to be; None = told, not judged.
        unit: Unit, '×' for a ratio.
        least: True where more is better.
        detail: The numbers behind it.
        interval: Ends of the 90 % interval of a median over turns; None = of a single turn.
    """

    what: str
    value: float
    target: float | None = None
    unit: str = '×'
    least: bool = False
    detail: str = ''
    interval: Sequence[float] | None = None

    @property
    def met(self) -> bool:
        """Whether the figure is what it is to be."""
        return self.target is None or self._reaches(self.value)

    @property
    def missed(self) -> bool:
        """Whether it is not, and the interval, if there is one, does not hold the target."""
        return not self.met and (self.interval is None or not any(map(self._reaches,
                                                                      self.interval)))

    def _reaches(self, value: float) -> bool:
        assert self.target is not None
        return value >= self.target if self.least else value <= self.target

    def cells(self) -> tuple[str, str, str, str, str]:
        """Return what, value, target, verdict, detail as text."""
        unit = self.unit if self.unit in ('×', '') else f' {self.unit}'
        target = '' if self.target is None else (
            f'{"≥" if self.least else "≤"} {self.target:g}{unit}')
        verdict = ('' if self.target is None else 'met' if self.met else
                   '**MISSED**' if self.missed else 'open')
        value = f'{self.value:.3g}{unit}'
        if self.interval is not None:
            value += f' ({self.interval[0]:.3g} to {self.interval[1]:.3g})'
        return self.what, value, target, verdict, self.detail


HEAD = ('figure', 'measured', 'target', '', 'behind it')


def markdown(rows: Sequence[Row]) -> list[str]:
    """Return the table as lines of Markdown."""
    return ['| ' + ' | '.join(HEAD) + ' |', '|---|---|---|---|---|',
            *('| ' + ' | '.join(cell.replace('|', '\\|') for cell in row.cells()) + ' |'
              for row in rows)]


def show(rows: Sequence[Row]) -> int:
    """Print the table; return 1 if something falls short."""
    print(*markdown(rows), sep='\n')
    missed = sum(row.missed for row in rows)
    judged = sum(row.target is not None for row in rows)
    print(f'{sum(row.met for row in rows if row.target is not None)} of {judged} targets met, '
          f'{missed} missed', flush=True)
    return 1 if missed else 0


def in_turns(what: str, ratios: Sequence[float], target: float | None = None,
             **rest: Any) -> Row:
    """Return the row of a figure measured once in each of several turns: its median.

    Args:
        what: As of `Row`.
        ratios: The figure of each turn.
        target: As of `Row`.
        **rest: Further attributes.
    """
    return Row(what, statistics.median(ratios), target, interval=interval(ratios), **rest)


def interval(values: Sequence[float], share: float = 0.9) -> tuple[float, float]:
    """Return the ends of an interval that holds the median with this probability at least.

    Order statistics, so nothing is assumed of how the values are distributed; all of them where
    they are too few.
    """
    found, count = sorted(values), len(values)
    outside, k = 1.0, 0
    while k < (count - 1) // 2:
        outside = sum(comb(count, i) for i in range(k + 1)) / 2.0 ** (count - 1)
        if outside > 1.0 - share:
            break
        k += 1
    k = max(k - 1, 0)
    return found[k], found[count - 1 - k]


def spread(values: Sequence[float], scale: float = 1.0) -> dict[str, float]:
    """Return p50, p99, p99.9 and the largest of some values, times a scale."""
    p50, p99, p999, most = np.percentile(np.asarray(values), [50.0, 99.0, 99.9, 100.0]) * scale
    return {'p50': float(p50), 'p99': float(p99), 'p999': float(p999), 'max': float(most)}


def say(text: str) -> None:
    """Tell how far a measurement is, beside the table."""
    print(text, file=sys.stderr, flush=True)


def brief(found: dict[str, Any], unit: str = 'µs') -> str:
    """Return a spread in a few words."""
    return (f'p50 {found["p50"]:.0f}, p99 {found["p99"]:.0f}, p99.9 {found["p999"]:.0f}, '
            f'max {found["max"]:.0f} {unit}')

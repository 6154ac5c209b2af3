"""A figure, what it is to be, and whether it is: the lines of one table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
    """

    what: str
    value: float
    target: float | None = None
    unit: str = '×'
    least: bool = False
    detail: str = ''

    @property
    def met(self) -> bool:
        """Whether the figure is what it is to be."""
        if self.target is None:
            return True
        return self.value >= self.target if self.least else self.value <= self.target

    def cells(self) -> tuple[str, str, str, str, str]:
        """Return what, value, target, verdict, detail as text."""
        unit = self.unit if self.unit in ('×', '') else f' {self.unit}'
        target = '' if self.target is None else (
            f'{"≥" if self.least else "≤"} {self.target:g}{unit}')
        verdict = '' if self.target is None else 'met' if self.met else '**MISSED**'
        return self.what, f'{self.value:.3g}{unit}', target, verdict, self.detail


HEAD = ('figure', 'measured', 'target', '', 'behind it')


def markdown(rows: Sequence[Row]) -> list[str]:
    """Return the table as lines of Markdown."""
    return ['| ' + ' | '.join(HEAD) + ' |', '|---|---|---|---|---|',
            *('| ' + ' | '.join(cell.replace('|', '\\|') for cell in row.cells()) + ' |'
              for row in rows)]


def show(rows: Sequence[Row]) -> int:
    """Print the table; return 1 if something falls short."""
    print(*markdown(rows), sep='\n')
    missed = sum(not row.met for row in rows)
    judged = sum(row.target is not None for row in rows)
    print(f'{judged - missed} of {judged} targets met', flush=True)
    return 1 if missed else 0


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

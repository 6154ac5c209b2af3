# SPDX-License-Identifier: Apache-2.0
"""The comparison: every entrant in every scenario, its numbers in one table.

A cell is an entrant in a scenario: the mean over the scenario's members (seeds, pulses), with the
smallest and the largest beside it. Everything follows from `Plan`: the same plan gives the same
numbers, on one core or on many.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import csv
from dataclasses import dataclass, field
import io
from itertools import pairwise
from typing import Any

from dz_ros.studies.entrants import Entrant, entrants
from dz_ros.studies.outcome import COLUMNS, Row, rows_of
from dz_ros.studies.pool import AHEAD, cores, execute, Task
from dz_ros.studies.scenarios import (
    base_configuration,
    choose,
    DURATION,
    Scenario,
    scenarios,
    SEEDS,
    yardstick,
)


@dataclass(frozen=True)
class Cell:
    """One entrant in one scenario.

    Attributes:
        rows: A row for each member of the scenario, see `dz_ros.studies.outcome`.
    """

    rows: tuple[Row, ...]

    def values(self, name: str) -> list[float]:
        """Return a number of every member that has it."""
        return [row[name] for row in self.rows if row[name] is not None]

    def mean(self, name: str) -> float | None:
        """Return the mean over the members; None where a member has no such number."""
        found = self.values(name)
        return sum(found) / len(found) if len(found) == len(self.rows) else None

    @property
    def lost(self) -> int:
        """Members that were lost."""
        return sum(bool(row['lost']) for row in self.rows)

    @property
    def within(self) -> bool:
        """Whether every member stayed within Ω_ε of the yardstick all through the window."""
        return all(row['omega'] == 1.0 for row in self.rows)


@dataclass(frozen=True)
class Plan:
    """What is compared.

    Attributes:
        entrants: Name → entrant.
        scenarios: Name → scenario.
        duration: Length of every run [s].
        seeds: Members of the scenario `noise`.
    """

    entrants: Mapping[str, Entrant]
    scenarios: Mapping[str, Scenario]
    duration: float = DURATION
    seeds: int = SEEDS

    @classmethod
    def of(cls, laws: Sequence[str] | None = None, chosen: Sequence[str] | None = None,
           duration: float = DURATION, seeds: int = SEEDS) -> Plan:
        """Return a plan; without names it is all of them.

        Raises:
            UnknownNameError: An unknown entrant or scenario.
        """
        return cls(choose('laws', entrants(), laws),
                   choose('scenarios', scenarios(duration, seeds), chosen), duration, seeds)

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.entrants) * sum(len(item.members) for item in self.scenarios.values())

    def configurations(self) -> dict[tuple[str, str, int], dict[str, Any]]:
        """Return (entrant, scenario, member) → flat configuration of every run."""
        base = base_configuration(self.duration)
        return {(entrant.name, scenario.name, place): {**base, **entrant.changes, **member}
                for entrant in self.entrants.values() for scenario in self.scenarios.values()
                for place, member in enumerate(scenario.members)}


@dataclass(frozen=True)
class Arena:
    """The comparison's result.

    Attributes:
        plan: What was compared.
        cells: (entrant, scenario) → cell.
    """

    plan: Plan
    cells: Mapping[tuple[str, str], Cell] = field(default_factory=dict)

    def column(self, scenario: str) -> dict[str, Cell]:
        """Return entrant → cell of one scenario."""
        return {name: self.cells[name, scenario] for name in self.plan.entrants}

    def ranking(self, scenario: str, name: str = 'error_max') -> list[str]:
        """Return entrants by the mean of a number, smallest first; without it, or lost: last."""
        def key(entrant: str) -> tuple[bool, float]:
            cell = self.cells[entrant, scenario]
            mean = cell.mean(name)
            return bool(cell.lost) or mean is None, mean or 0.0

        return sorted(self.plan.entrants, key=key)

    def csv(self) -> str:
        """Return every run as CSV, 17 significant digits."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator='\n')
        writer.writerow(('law', 'scenario', 'member', *COLUMNS))
        for (entrant, scenario), cell in self.cells.items():
            for place, row in enumerate(cell.rows):
                writer.writerow((entrant, scenario, place, *(text(row[name])
                                                             for name in COLUMNS)))
        return out.getvalue()


def text(value: Any) -> str:
    """Return a value of a row as CSV text: nothing for None, every digit of a float."""
    return '' if value is None else repr(value) if isinstance(value, float) else str(value)


def run_arena(plan: Plan, jobs: int = 0, cluster: str | None = None,
              progress: Callable[[int, int, str], None] | None = None) -> Arena:
    """Return the comparison.

    Args:
        plan: What to compare.
        jobs: Processes; 0 = one for each core.
        cluster: Address of a dask.distributed scheduler; None = this machine.
        progress: Called with runs done, runs in all, the entrant that some of them were of.
    """
    base, measure_by = base_configuration(plan.duration), yardstick()
    changes = [member for scenario in plan.scenarios.values() for member in scenario.members]
    pieces = divide(plan, jobs or cores())
    tasks: list[Task] = [(rows_of, (base, [{**plan.entrants[name].changes, **item}
                                           for item in changes[begin:end]], measure_by))
                         for name, begin, end in pieces]
    found: dict[str, list[Row]] = {name: [{}] * len(changes) for name in plan.entrants}
    done = 0
    for place, rows in execute(tasks, jobs, cluster):
        name, begin, end = pieces[place]
        found[name][begin:end] = rows
        done += len(rows)
        if progress is not None:
            progress(done, plan.runs, name)
    cells = {}
    for name in plan.entrants:
        rows = iter(found[name])
        for scenario in plan.scenarios.values():
            cells[name, scenario.name] = Cell(tuple(next(rows) for _ in scenario.members))
    return Arena(plan, cells)


def divide(plan: Plan, jobs: int) -> list[tuple[str, int, int]]:
    """Return what each task runs: an entrant, its first run and the one after its last.

    A process compiles a law once, so an entrant is divided only as far as it takes to give every
    process `AHEAD` tasks; a single process, which compiles once anyhow, takes run by run. What
    takes longest to compile goes first.
    """
    runs = plan.runs // len(plan.entrants)
    pieces = runs if jobs == 1 else min(runs, -(-AHEAD * jobs // len(plan.entrants)))
    ends = [runs * piece // pieces for piece in range(pieces + 1)]
    return [(name, begin, end)
            for name in sorted(plan.entrants, key=lambda name: name not in _SLOW)
            for begin, end in pairwise(ends)]


_SLOW = ('neural', 'robust', 'fuzzy', 'adaptive_inverse')

# SPDX-License-Identifier: Apache-2.0
"""Result of an audit: what was compared, what differs, what could not be checked and why.

Two numbers are equal when their 64 bits are; −0.0 is not 0.0. Any two NaN are equal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.runs.metrics import jsonable
from dz_ros.runs.steps import differ

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Difference:
    """One number that is not what the law computes.

    Attributes:
        field: Channel and name, e.g. ``command.v``, ``terms.s``; ``memory.theta1`` is what the
            sample before leaves behind.
        seq: seq of the command.
        stamp: Stamp of the state it answers [s].
        start: Which start of the controller in this log, from 0.
        recorded: The number in the log.
        recomputed: The number computed from the recorded inputs.
    """

    field: str
    seq: int
    stamp: float
    start: int
    recorded: float
    recomputed: float

    @property
    def size(self) -> float:
        """|recorded − recomputed|; infinite where one of them is no number."""
        size = abs(self.recorded - self.recomputed)
        return math.inf if math.isnan(size) else size

    def text(self) -> str:
        """Return it as half a line, every digit shown."""
        restart = f', start {self.start + 1} of the controller' if self.start else ''
        return (f'{self.field} at seq {self.seq}, t = {self.stamp:.9g} s{restart}: recorded '
                f'{self.recorded!r}, recomputed {self.recomputed!r}')


@dataclass(frozen=True)
class FieldResult:
    """One field over the whole run.

    Attributes:
        compared: Numbers compared.
        differing: Those that differ.
        first: The first that differs.
        largest: The one that differs most.
    """

    compared: int = 0
    differing: int = 0
    first: Difference | None = None
    largest: Difference | None = None


@dataclass(frozen=True)
class Reason:
    """Why samples could not be checked.

    Attributes:
        text: The reason.
        samples: Number of samples.
        first: seq of the first of them.
    """

    text: str
    samples: int
    first: int


@dataclass(frozen=True)
class Span:
    """Part of a run in which one configuration held.

    Attributes:
        start: Which start of the controller in this log, from 0.
        first: seq of the first command it holds for.
        law: Name of the law.
        version: Version of dz_ros that recorded it; '' = unknown.
        source: Where the configuration comes from, as text.
        problem: Why the law cannot be computed here; '' where it can.
    """

    start: int
    first: int
    law: str
    version: str
    source: str
    problem: str = ''


@dataclass(frozen=True)
class AuditResult:
    """What an audit found.

    Attributes:
        samples: Samples to be checked: every command from 0 to the last one that left a trace.
        checked: Samples of which every number could be compared.
        not_checkable: Why the others could not, or only in part.
        fields: Field → result, in the order in which the law computes them.
        first: First difference.
        largest: Largest difference.
        findings: Further things that are wrong: missing messages, contradictions.
        notes: Things to know that are not wrong.
        spans: The configurations, in order.
        version: Version of dz_ros that recomputed.
    """

    samples: int
    checked: int
    not_checkable: tuple[Reason, ...]
    fields: Mapping[str, FieldResult]
    first: Difference | None
    largest: Difference | None
    findings: tuple[str, ...]
    notes: tuple[str, ...]
    spans: tuple[Span, ...]
    version: str

    @property
    def differences(self) -> int:
        """Numbers that differ."""
        return sum(item.differing for item in self.fields.values())

    @property
    def compared(self) -> int:
        """Numbers compared."""
        return sum(item.compared for item in self.fields.values())

    @property
    def passed(self) -> bool:
        """True where all that was to be checked was checked, is equal, and nothing is missing."""
        return bool(self.samples and self.checked == self.samples
                    and not self.differences and not self.findings)

    def to_dict(self) -> dict[str, Any]:
        """Return everything by name, ready for JSON."""
        found = asdict(self)
        found.update(passed=self.passed, differences=self.differences, compared=self.compared)
        made: dict[str, Any] = jsonable(found)
        return made


@dataclass
class Tally:
    """Collects comparisons, field by field.

    Attributes:
        seq: seq of every sample, shape (N,).
        stamp: Stamp of the state of every sample [s], shape (N,).
        start: Start of the controller of every sample, shape (N,).
        fields: Field → result so far.
    """

    seq: Integers
    stamp: Array
    start: Integers
    fields: dict[str, FieldResult] = field(default_factory=dict)

    def add(self, name: str, places: Integers, recorded: Array, recomputed: Array) -> None:
        """Compare numbers of one field.

        Args:
            name: The field.
            places: Samples they belong to, ascending, shape (M,).
            recorded: Numbers in the log, shape (M,).
            recomputed: Numbers computed, shape (M,).
        """
        before = self.fields.get(name, FieldResult())
        wrong = np.flatnonzero(differ(recorded, recomputed))
        first, largest = before.first, before.largest
        if len(wrong):
            with np.errstate(invalid='ignore', over='ignore'):
                size = np.abs(recorded[wrong] - recomputed[wrong])
            size[np.isnan(size)] = np.inf
            at = [wrong[0], wrong[int(np.argmax(size))]]
            head, worst = (Difference(
                name, int(self.seq[places[i]]), float(self.stamp[places[i]]),
                int(self.start[places[i]]), float(recorded[i]), float(recomputed[i])) for i in at)
            first = first or head
            largest = worst if largest is None or worst.size > largest.size else largest
        self.fields[name] = FieldResult(before.compared + len(places),
                                        before.differing + len(wrong), first, largest)

    def first(self) -> Difference | None:
        """Return the first difference; of one sample the one that the law computes first."""
        return min(self._all('first'), key=lambda item: (item.start, item.seq), default=None)

    def largest(self) -> Difference | None:
        """Return the largest difference."""
        return max(self._all('largest'), key=lambda item: item.size, default=None)

    def _all(self, which: str) -> Sequence[Difference]:
        return [getattr(item, which) for item in self.fields.values() if item.differing]

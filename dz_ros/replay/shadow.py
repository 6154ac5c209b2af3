# SPDX-License-Identifier: Apache-2.0
"""Differences between the answers of a controller and those recorded, by sample (ours).

Answers are matched by echo_seq, the state they answer; of answers to the same state the first
counts. Two numbers are the same if they are equal or both NaN. Times of transport, and the seq of
what was published, the reference's among them, are no part of an answer.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.dataset import Channel, RunData
from dz_ros.errors import RecordingError
from dz_ros.runs.metrics import jsonable
from dz_ros.runs.sequence import first_of_each, longest_stretch

Integers = NDArray[np.int64]

_NO_PART = ('seq', 'stamp', 'echo_seq', 'echo_stamp', 'hold', 'reference_seq')


@dataclass(frozen=True)
class Difference:
    """How one number differs.

    Attributes:
        name: Label, ``v`` or that of a term.
        differing: Samples in which it differs by more than the tolerance.
        largest: Largest |difference|, unit of the number; inf where a NaN meets a number.
        largest_seq: State in whose answer that is; None without difference.
        first_seq: First state in whose answer it differs by more than the tolerance.
    """

    name: str
    differing: int
    largest: float
    largest_seq: int | None
    first_seq: int | None


@dataclass(frozen=True)
class First:
    """The first command beyond the tolerance: seq and stamp [s] of its state, both values."""

    seq: int
    stamp: float
    recorded: float
    live: float


@dataclass(frozen=True)
class Comparison:
    """Recorded and live answers.

    Attributes:
        recorded: Commands recorded, one a state.
        live: Commands of the live controller, one a state.
        compared: States that both answered.
        tolerance: Largest |difference| that passes, in each number's own unit.
        command: How v differs.
        terms: How each term differs, those that both have.
        not_compared: Terms that only one of them has.
        first: First command beyond the tolerance.
    """

    recorded: int
    live: int
    compared: int
    tolerance: float
    command: Difference
    terms: tuple[Difference, ...]
    not_compared: tuple[str, ...]
    first: First | None

    @property
    def same(self) -> bool:
        """True where every recorded command was answered alike, its terms included."""
        return (self.compared == self.recorded > 0
                and not any(item.differing for item in (self.command, *self.terms)))

    def to_dict(self) -> dict[str, Any]:
        """Return everything by name, ready for JSON: no infinity, no NaN."""
        found: dict[str, Any] = jsonable({**asdict(self), 'same': self.same})
        return found


def compare_answers(recorded: RunData, live: RunData, tolerance: float = 0.0) -> Comparison:
    """Return how live answers differ from recorded ones.

    Args:
        recorded: The run.
        live: The run of the controller that was fed with it.
        tolerance: Largest |difference| that passes.

    Raises:
        RecordingError: One of them holds no commands.
    """
    recorded, live = longest_stretch(recorded)[0], longest_stretch(live)[0]
    for run, whose in ((recorded, 'the run'), (live, 'the live controller')):
        if not len(run.channels.get('command', ())):
            raise RecordingError(f'{whose} has no commands to compare')
    seq, ours, theirs, counts = _matched(recorded.channels['command'], live.channels['command'])
    old, new = recorded.channels['command'], live.channels['command']
    command = _difference('v', seq, old['v'][ours], new['v'][theirs], tolerance)
    first = None
    if command.first_seq is not None:
        row = int(np.searchsorted(seq, command.first_seq))
        first = First(command.first_seq, float(old['echo_stamp'][ours][row]),
                      float(old['v'][ours][row]), float(new['v'][theirs][row]))
    terms: tuple[Difference, ...] = ()
    alone: tuple[str, ...] = ()
    a, b = recorded.channels.get('terms'), live.channels.get('terms')
    if a is not None and b is not None:
        at, rows, others, _ = _matched(a, b)
        terms = tuple(_difference(name, at, a[name][rows], b[name][others], tolerance)
                      for name in a.labels if name in b.labels and name not in _NO_PART)
        alone = tuple(sorted(set(a.labels) ^ set(b.labels)))
    return Comparison(*counts, len(seq), tolerance, command, terms, alone, first)


def _matched(a: Channel, b: Channel) -> tuple[Integers, Integers, Integers, tuple[int, int]]:
    """Return the seq that both answer, the rows of each, and how many each answers."""
    first, rows = first_of_each(a['echo_seq'])
    second, others = first_of_each(b['echo_seq'])
    seq, i, j = np.intersect1d(first, second, assume_unique=True, return_indices=True)
    return seq, rows[i], others[j], (len(first), len(second))


def _difference(name: str, seq: Integers, a: NDArray[np.float64], b: NDArray[np.float64],
                tolerance: float) -> Difference:
    """Return how two columns differ, rows of the same seq."""
    with np.errstate(invalid='ignore'):
        size = np.abs(a - b)
    size[(a == b) | (np.isnan(a) & np.isnan(b))] = 0.0
    size[np.isnan(size)] = math.inf
    beyond = np.flatnonzero(size > tolerance)
    largest = int(np.argmax(size)) if len(size) and size.max() > 0.0 else None
    return Difference(name, len(beyond), 0.0 if largest is None else float(size[largest]),
                      None if largest is None else int(seq[largest]),
                      int(seq[beyond[0]]) if len(beyond) else None)

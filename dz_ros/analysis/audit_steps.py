"""Computing recorded steps again with the law's own kernel, in plain floats.

Each step starts from the memory that its own signals tell; that this is the memory which the step
before left is compared apart. So one wrong number does not spoil the rest of the run. Where a step
agrees better with what the step before left than with what its signals tell, the signals are what
is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.laws.base import Law
from dz_ros.core.records import STATUS

Array = NDArray[np.float64]
Row = Sequence[float]


@dataclass(frozen=True)
class Inputs:
    """Steps of one configuration, one entry a step, as plain lists.

    Attributes:
        ready: Whether state, reference and interval are known.
        follows: Whether the step before is the one listed before.
        x: Measured states.
        x_d: References at the states' stamps.
        dt: Accepted intervals [s].
        signals: Recorded signals; None where the terms are not in the log.
        terms: Recorded `TERM_NAMES`; None where the terms are not in the log.
        v: Recorded commands; None where the command is not in the log.
    """

    ready: Sequence[bool]
    follows: Sequence[bool]
    x: Sequence[Row]
    x_d: Sequence[Row]
    dt: Row
    signals: Sequence[Row | None]
    terms: Sequence[Row | None]
    v: Sequence[float | None]


@dataclass(frozen=True)
class Outputs:
    """Steps computed again; NaN rows where `done` is False.

    Attributes:
        done: Whether the step was computed, shape (N,).
        v: Commands, shape (N,).
        terms: `TERM_NAMES`, the law's status, its signals, shape (N, 9 + …).
        expected: Memory that the step before left, shape (N, M).
        told: Memory that the signals tell, shape (N, M).
        linked: Whether both are known, shape (N,).
        failed: Step → why the law could not be computed.
        last: Memory after the last step; None where unknown.
    """

    done: NDArray[np.bool_]
    v: Array
    terms: Array
    expected: Array
    told: Array
    linked: NDArray[np.bool_]
    failed: dict[int, str]
    last: tuple[float, ...] | None


def memory_names(law: Law) -> tuple[str, ...]:
    """Return names for the law's memory: those of the signals it is read from, else places."""
    names = law.signal_names
    count = len(law.initial_memory())
    marks = [1.0 + 2.0 ** -20 * (i + 1) for i in range(len(names))]
    try:
        told = law.memory_from_signals(marks)
    except (ArithmeticError, ValueError, LookupError):
        told = ()
    return tuple(names[marks.index(told[i])] if i < len(told) and told[i] in marks else str(i)
                 for i in range(count))


def compute(c: Configuration, inputs: Inputs, before: tuple[float, ...] | None) -> Outputs:
    """Return the steps computed again.

    Args:
        c: The configuration that held.
        inputs: The steps.
        before: Memory before the first of them; None where unknown.
    """
    law = c.law
    kernel, constants, recall = law.kernel, law.constants, law.memory_from_signals
    regressors, plant = c.plant.regressors, c.plant.constants
    y = [0.0] * c.plant.regressor_count
    size = len(law.initial_memory())
    buffer = [0.0] * (STATUS + 1 + len(law.signal_names))
    after = [0.0] * size
    blank_terms, blank = (math.nan,) * len(buffer), (math.nan,) * size
    done, v, terms, expected, told, linked = [], [], [], [], [], []
    failed: dict[int, str] = {}
    carried = before
    for i, ready in enumerate(inputs.ready):
        if i and not inputs.follows[i]:
            carried = None
        if not size:
            carried = ()
        signals = inputs.signals[i]
        memory = carried if signals is None else tuple(recall(signals))
        linked.append(carried is not None and signals is not None)
        expected.append(blank if carried is None else carried)
        told.append(blank if memory is None else memory)
        result = None
        if ready and memory is not None:
            x, x_d, dt = inputs.x[i], inputs.x_d[i], inputs.dt[i]
            try:
                regressors(x, plant, y)
                result = kernel(constants, memory, x_d, x, y, dt, after, buffer)
                if carried is not None and carried != memory:
                    again, other = [0.0] * size, list(buffer)
                    second = kernel(constants, carried, x_d, x, y, dt, again, other)
                    if _agreement(second, other, again, inputs, i, recall) > _agreement(
                            result, buffer, after, inputs, i, recall):
                        result, after, buffer, told[i] = second, again, other, carried
            except (ArithmeticError, ValueError) as error:
                failed[i] = str(error)
                result = None
        done.append(result is not None)
        v.append(math.nan if result is None else result)
        terms.append(blank_terms if result is None else tuple(buffer))
        carried = None if result is None else tuple(after)
    count = len(done)
    return Outputs(np.array(done, dtype=bool), np.array(v, dtype=float),
                   np.array(terms, dtype=float).reshape(count, len(buffer)),
                   np.array(expected, dtype=float).reshape(count, size),
                   np.array(told, dtype=float).reshape(count, size),
                   np.array(linked, dtype=bool), failed, carried)


def _agreement(v: float, buffer: Row, after: Row, inputs: Inputs, i: int,
               recall: Callable[[Row], Row]) -> int:
    """Return how much of the log agrees with a computed step, its signals aside: 0 … 3."""
    terms, command = inputs.terms[i], inputs.v[i]
    following = None
    if i + 1 < len(inputs.v) and inputs.follows[i + 1]:
        following = inputs.signals[i + 1]
    return ((terms is not None and list(buffer[:STATUS]) == list(terms)) + (v == command)
            + (following is not None and list(recall(following)) == list(after)))

# SPDX-License-Identifier: Apache-2.0
"""Largest disturbance and derivatives along the reference, computed once for each (ours).

It takes milliseconds to seconds, and a controller checks the rules again whenever a gain is set.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TYPE_CHECKING
from weakref import WeakKeyDictionary

from dz_ros.core.trajectories.base import Trajectory

if TYPE_CHECKING:
    from dz_ros.core.configuration import Configuration

STEP, LARGEST_COUNT = 0.01, 6000
"""Step of the search for the largest disturbance [s], and its largest number of steps."""
POINTS = 2000
"""Steps of the search for the largest derivatives."""
SPAN = 60.0
"""Length that is searched where a run has no end [s]."""
_REMEMBERED = 16
_known: OrderedDict[Any, Any] = OrderedDict()


class _Numbers:
    """The constants of a trajectory as a key: hashed once, however many they are."""

    def __init__(self, numbers: tuple[float, ...]) -> None:
        self._numbers = numbers
        self._hash = hash(numbers)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, _Numbers) and self._hash == other._hash
                                 and self._numbers == other._numbers)


_numbers: WeakKeyDictionary[Trajectory, _Numbers] = WeakKeyDictionary()


def disturbance_along_reference(c: Configuration) -> float:
    """Return the largest |disturbance| of the plant's model on the reference [unit of x^(n)]."""
    plant, trajectory, constants = c.plant, c.trajectory, c.plant.constants
    span = c.loop.duration or SPAN
    step = max(STEP, span / LARGEST_COUNT)
    steps = round(span / step)

    def find() -> float:
        return max(abs(plant.disturbance(t, trajectory(t)[:plant.order], constants))
                   for t in (step * k for k in range(steps + 1)))

    found: float = _remembered(c, ('disturbance', type(plant), constants), find)
    return found


def largest_derivatives(c: Configuration) -> tuple[float, ...]:
    """Return the largest |x_d|, |x_d'|, …, |x_d^(n)| over a run, shape (n + 1,)."""
    span = c.loop.duration or SPAN

    def find() -> tuple[float, ...]:
        values = [c.trajectory(span * k / POINTS) for k in range(POINTS + 1)]
        return tuple(max(abs(value[i]) for value in values) for i in range(c.plant.order + 1))

    found: tuple[float, ...] = _remembered(c, ('derivatives', c.plant.order), find)
    return found


def _remembered(c: Configuration, what: Any, find: Callable[[], Any]) -> Any:
    """Return the result for the same reference, computed once."""
    trajectory = c.trajectory
    if type(trajectory).__call__ is not Trajectory.__call__:    # its constants are not all
        return find()
    if trajectory not in _numbers:
        _numbers[trajectory] = _Numbers(trajectory.constants)
    key = (what, type(trajectory), _numbers[trajectory], trajectory.order, c.loop.duration)
    if key not in _known:
        _known[key] = find()
        if len(_known) > _REMEMBERED:
            _known.popitem(last=False)
    return _known[key]

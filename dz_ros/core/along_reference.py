"""What the design rules must know of the reference, found by following it (ours).

Following it takes milliseconds to seconds, and a controller asks the rules again whenever a gain
is set while the loop runs: so what depends on reference and plant alone is found out once.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TYPE_CHECKING

from dz_ros.core.trajectories.base import Trajectory

if TYPE_CHECKING:
    from dz_ros.core.configuration import Configuration

STEP = 0.01
"""The disturbance is looked at every so often [s]."""
POINTS = 2000
"""The derivatives are looked at in so many steps."""
SPAN = 60.0
"""What is looked at where a run has no end [s]."""
_KEPT = 16
_known: OrderedDict[Any, Any] = OrderedDict()


def disturbance_along_reference(c: Configuration) -> float:
    """Return the largest |disturbance| of the plant's model on the reference [unit of x^(n)]."""
    plant, trajectory, constants = c.plant, c.trajectory, c.plant.constants
    steps = round((c.loop.duration or SPAN) / STEP)

    def find() -> float:
        return max(abs(plant.disturbance(t, trajectory(t)[:plant.order], constants))
                   for t in (STEP * k for k in range(steps + 1)))

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
    """Return what was found for the same reference before, or find it."""
    trajectory = c.trajectory
    if type(trajectory).__call__ is not Trajectory.__call__:    # more than its constants say
        return find()
    key = (what, type(trajectory), trajectory.constants, trajectory.order, c.loop.duration)
    if key not in _known:
        _known[key] = find()
        if len(_known) > _KEPT:
            _known.popitem(last=False)
    return _known[key]

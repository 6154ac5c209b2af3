"""The controller without ROS: which reference and which interval a law's step gets (§7, ours).

The twin of ``nodes/controller_node.py``, and what recomputes a recording. It owns the law's memory
and three rules:

- the reference is the one meant for the state's stamp; where there is none, the newest is brought
  there by its own derivatives, and adaptation is frozen when that is more than two periods;
- adaptation advances by the interval since the last accepted state when it lies in [T/2, 2T],
  else it is frozen for this sample; intervals within a nanosecond of T are T;
- a repeated state is answered by the same command again and an older one not at all; a state of
  seq 0 after later ones is a plant that started anew.
"""

from __future__ import annotations

from collections import deque
import math

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import Command, Reference, State, Status, Terms

SNAP = 1e-9
"""Stamps closer than this are the same instant [s]."""
KEPT = 4
"""References kept: the one of this sample, the next one, and room for disorder."""


def accepted_interval(earlier: float, stamp: float, period: float) -> float:
    """Return the interval by which adaptation may advance [s]; 0 where it is not acceptable."""
    interval = stamp - earlier
    if abs(interval - period) < SNAP:
        return period
    if 0.5 * period - SNAP <= interval <= 2.0 * period + SNAP:
        return interval
    return 0.0


class Controller:
    """Answers states with commands.

    Args:
        configuration: Law, plant structure and period.

    Attributes:
        memory: The law's memory before the next step.
        ignored: Reason → count of the states that were not answered by a step.
        error: x̃ of the last step, unit of x.
    """

    def __init__(self, configuration: Configuration) -> None:
        self.law = configuration.law
        self.period = configuration.loop.period
        self.memory = self.law.initial_memory()
        self.ignored = {'repeated': 0, 'out_of_order': 0, 'not_finite': 0}
        self.error = 0.0
        self._plant = configuration.plant
        self._plant_constants = configuration.plant.constants
        self._y = [0.0] * configuration.plant.regressor_count
        self._references: deque[Reference] = deque(maxlen=KEPT)
        self._last: tuple[State, Command, Terms] | None = None
        self._count = 0

    def set_reference(self, reference: Reference) -> None:
        """Take a reference; one that is not finite is not taken."""
        if all(map(math.isfinite, reference.x_d)):
            self._references.append(reference)
        else:
            self.ignored['not_finite'] += 1

    @property
    def has_reference(self) -> bool:
        """Whether any reference has arrived."""
        return bool(self._references)

    def has_reference_for(self, state: State) -> bool:
        """Whether the reference meant for this very state, by seq or stamp, has arrived."""
        return any(item.seq == state.seq or abs(item.stamp - state.stamp) < SNAP
                   for item in self._references)

    def respond(self, state: State) -> tuple[Command, Terms] | None:
        """Return command and terms for a state; None where it must not be answered.

        Raises:
            LookupError: No reference has arrived yet.
        """
        if not self._references:
            raise LookupError('no reference yet')
        if not all(map(math.isfinite, state.x)):
            self.ignored['not_finite'] += 1
            return None
        last = self._last
        if last is not None and state.seq != 0 and state.seq < last[0].seq:
            self.ignored['out_of_order'] += 1
            return None
        if last is not None and state.seq == last[0].seq:
            self.ignored['repeated'] += 1
            return last[1], last[2]
        reference, late = self._reference_at(state.stamp)
        dt = self.period if last is None else accepted_interval(last[0].stamp, state.stamp,
                                                                self.period)
        status = Status.ADAPTING if dt > 0.0 else Status.BAD_INTERVAL
        if late > 2.0 * self.period:
            dt, status = 0.0, status | Status.STALE_REFERENCE
        self.error = state.x[0] - reference.x_d[0]
        self._plant.regressors(state.x, self._plant_constants, self._y)
        command, self.memory, terms = self.law.step(self.memory, reference, state, self._y, dt,
                                                    status, self._count)
        self._count += 1
        self._last = (state, command, terms)
        return command, terms

    def _reference_at(self, stamp: float) -> tuple[Reference, float]:
        """Return the reference for this instant and how far it had to be brought [s]."""
        for reference in self._references:
            if abs(reference.stamp - stamp) < SNAP:
                return reference, 0.0
        newest = self._references[-1]
        return newest.at(stamp), abs(stamp - newest.stamp)

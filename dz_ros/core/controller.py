"""The controller without ROS: which reference and which interval a law's step gets (§7, ours).

The twin of ``nodes/controller_node.py``, and what recomputes a recording. It owns the law's memory
and three rules:

- the reference is the one meant for the state's stamp; where there is none, the newest is brought
  there by its own derivatives, and adaptation is frozen when that is more than two periods;
- adaptation advances by the interval since the last accepted state when it lies in [T/2, 2T],
  else it is frozen for this sample; intervals within a nanosecond of T are T;
- a repeated state is answered by the same command again and an older one not at all; a state of
  seq 0 after later ones is a plant that started anew.

Every command leaves through one gate (``core/safety/gate.py``). Where the gate holds the law's
command back against s, the step is taken again with adaptation frozen (§6, anti-windup). A step
that violates a limit on error or estimates, or gives a number that is not finite, is not taken.
"""

from __future__ import annotations

from collections import deque
import math

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import Command, Reference, State, Status, TERM_NAMES, Terms
from dz_ros.core.safety.gate import OutputGate

SNAP = 1e-9
"""Stamps closer than this are the same instant [s]."""
KEPT, KEPT_AHEAD = 4, 256
"""References kept: the one of this sample, the next one, and room for disorder; in lockstep those
sent ahead as well."""


def accepted_interval(earlier: float, stamp: float, period: float) -> float:
    """Return the interval by which adaptation may advance [s]; 0 where it is not acceptable."""
    interval = stamp - earlier
    if abs(interval - period) < SNAP:
        return period
    if 0.5 * period - SNAP <= interval <= 2.0 * period + SNAP:
        return interval
    return 0.0


class ViolationError(ArithmeticError):
    """A step that must not be taken; the message says why."""


class Controller:
    """Answers states with commands.

    Args:
        configuration: Law, plant structure and period.

    Attributes:
        memory: The law's memory before the next step.
        ignored: Reason → count of the states that were not answered by a step.
        error: x̃ of the last step, unit of x.
        gate: What every command leaves through.
        count: Number of commands given so far, the seq of the next one.
    """

    def __init__(self, configuration: Configuration) -> None:
        self.ignored = {'repeated': 0, 'out_of_order': 0, 'not_finite': 0}
        self.error = 0.0
        self.count = 0
        self.gate = OutputGate(configuration.safety, configuration.loop.period)
        lockstep = configuration.loop.timing == 'lockstep'
        self._references: deque[Reference] = deque(maxlen=KEPT_AHEAD if lockstep else KEPT)
        self._last: tuple[State, Command, Terms] | None = None
        self._signals: tuple[float, ...] = ()
        self._begins = True
        self.configure(configuration)
        self.memory = self._earlier = self.law.initial_memory()

    def configure(self, configuration: Configuration) -> None:
        """Take other gains and limits from the next step on; the structure must be the same."""
        self.law = configuration.law
        self.period = configuration.loop.period
        self.gate.settings = configuration.safety
        self._plant = configuration.plant
        self._plant_constants = configuration.plant.constants
        self._y = [0.0] * configuration.plant.regressor_count
        names = self.law.signal_names
        self._theta_at = [i for i, name in enumerate(names) if name.startswith('theta')]
        self._phi_at = [i for i, name in enumerate(names) if name == 'phi']

    def restart(self, memory: tuple[float, ...]) -> None:
        """Let the law take over in the next step, with this memory."""
        self.memory = self._earlier = memory
        self._begins = True

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
        return self._in_its_place(state.seq) is not None or any(
            item.seq == state.seq or abs(item.stamp - state.stamp) < SNAP
            for item in self._references)

    def respond(self, state: State) -> tuple[Command, Terms] | None:
        """Return command and terms for a state; None where it must not be answered.

        Raises:
            LookupError: No reference has arrived yet.
            ViolationError: The step must not be taken; the memory is one from before it.
        """
        if not self._references:
            raise LookupError('no reference yet')
        if not all(map(math.isfinite, state.x)):
            self.ignored['not_finite'] += 1
            return None
        last = self._last
        if last is not None and state.seq < last[0].seq and state.seq != 0 and not self._begins:
            self.ignored['out_of_order'] += 1
            return None
        if last is not None and state.seq == last[0].seq:
            self.ignored['repeated'] += 1
            return last[1], last[2]
        reference, late = self._reference_for(state.seq, state.stamp)
        dt = self.period if last is None else accepted_interval(last[0].stamp, state.stamp,
                                                                self.period)
        status = Status.ADAPTING if dt > 0.0 else Status.BAD_INTERVAL
        if late > 2.0 * self.period:
            dt, status = 0.0, status | Status.STALE_REFERENCE
        self.error = state.x[0] - reference.x_d[0]
        if self._begins:
            self.gate.start(state.stamp)
            self._begins = False
        command, memory, terms = self._step(reference, state, dt, status)
        self._check(command, memory, terms)
        limited = self.gate.limit(command.v, state.stamp)
        if dt > 0.0 and (command.v - limited) * terms.values[0] < 0.0:
            command, memory, terms = self._step(reference, state, 0.0, status | Status.SATURATED)
            self._check(command, memory, terms)
            limited = self.gate.limit(command.v, state.stamp)
        v = self.gate.send(command.v, limited, state.stamp)
        if v != command.v:
            command = command._replace(v=v)
        self.count += 1
        self._earlier, self.memory = self.memory, memory
        self._signals = terms.signals
        self._last = (state, command, terms)
        return command, terms

    def safe_answer(self, state: State) -> tuple[Command, Terms]:
        """Return the safe command and its terms for a state; the law is not asked."""
        v = self.gate.safe(state.stamp)
        values = [0.0] * len(TERM_NAMES)
        values[TERM_NAMES.index('v_extra')] = v
        command = Command(self.count, state.stamp, v, state.seq, state.stamp)
        terms = Terms(self.count, state.stamp, tuple(values), 0.0, Status.INACTIVE, -1, state.seq,
                      self._signals or (0.0,) * len(self.law.signal_names))
        self.count += 1
        self._last = (state, command, terms)
        return command, terms

    def newest_reference(self) -> float:
        """Return the stamp of the newest reference [s]; −∞ before the first."""
        return self._references[-1].stamp if self._references else -math.inf

    def _step(self, reference: Reference, state: State, dt: float,
              status: Status) -> tuple[Command, tuple[float, ...], Terms]:
        """Take the law's step.

        Raises:
            ViolationError: It cannot be computed.
        """
        try:
            self._plant.regressors(state.x, self._plant_constants, self._y)
            return self.law.step(self.memory, reference, state, self._y, dt, status,
                                 self.count)
        except (ArithmeticError, ValueError) as error:
            raise ViolationError(f'the law cannot be computed: {error}') from error

    def _check(self, command: Command, memory: tuple[float, ...], terms: Terms) -> None:
        """Look whether a step may be taken.

        Raises:
            ViolationError: It may not.
        """
        numbers = (command.v, *memory, *terms.values, *terms.signals)
        # A sum that is finite has none but finite terms; the reverse need not be so.
        if not math.isfinite(sum(numbers)) and not all(map(math.isfinite, numbers)):
            raise ViolationError('the law gave a number that is not finite')
        limits = self.gate.settings
        if 0.0 < limits.error_limit < abs(self.error):
            raise ViolationError(f'error {self.error:.4g} beyond safety.error_limit '
                                 f'{limits.error_limit:g}')
        if not (limits.theta_limit > 0.0 or limits.phi_limit > 0.0):
            return
        for i, limit, key in ((i, limit, key) for places, limit, key in (
                (self._theta_at, limits.theta_limit, 'theta'),
                (self._phi_at, limits.phi_limit, 'phi')) if limit > 0.0 for i in places):
            if abs(terms.signals[i]) > limit:
                self.memory = self._earlier
                raise ViolationError(f'estimate {self.law.signal_names[i]} {terms.signals[i]:.4g} '
                                     f'beyond safety.{key}_limit {limit:g}')

    def _in_its_place(self, seq: int) -> Reference | None:
        """Return the reference of this seq where those kept are in a row, as nearly always."""
        references = self._references
        place = seq - references[0].seq if references else -1
        if 0 <= place < len(references) and references[place].seq == seq:
            return references[place]
        return None

    def _reference_for(self, seq: int, stamp: float) -> tuple[Reference, float]:
        """Return the reference for this instant and how far it had to be brought [s]."""
        while len(self._references) > KEPT and self._references[0].stamp < stamp - SNAP:
            self._references.popleft()
        likely = self._in_its_place(seq)
        if likely is not None and abs(likely.stamp - stamp) < SNAP:
            return likely, 0.0      # the rest says the same, slower
        for reference in self._references:
            if abs(reference.stamp - stamp) < SNAP:
                return reference, 0.0
        newest = self._references[-1]
        return newest.at(stamp), abs(stamp - newest.stamp)

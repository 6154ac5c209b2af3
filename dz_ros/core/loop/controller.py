# SPDX-License-Identifier: Apache-2.0
"""The controller without ROS: which reference and which interval a law's step gets (§7, ours).

The ROS-free part of ``nodes/controller_node.py``, also used to recompute a recording. It owns the
law's memory and three rules:

- the reference is the one meant for the state's stamp; where there is none, the newest is brought
  there by its own derivatives, and adaptation is frozen when that is more than two periods;
- adaptation advances by the interval since the last accepted state when it lies in [T/2, 2T],
  else it is frozen for this sample; intervals within a nanosecond of T are T;
- a repeated state is answered by the same command again and an older one not at all; a state of
  seq 0 after later ones comes from a plant that was restarted.

Every command passes the command limiter (``core/safety/command_limiter.py``). Where it reduces
the law's command against s, the step is taken again with adaptation frozen (§6,
anti-windup). A step that violates a limit on error or estimates, or gives a number that is not
finite, is not taken; nor is one while the device runs away (``core/safety/runaway_guard.py``).

Over 300 lines: what answers a state, and what must be rewound where it is not taken.
"""

from __future__ import annotations

from collections import deque
import math

from dz_ros.core.configuration import Configuration
from dz_ros.core.plants.coupled import coupled_regressors
from dz_ros.core.records import Command, Reference, State, Status, Terms
from dz_ros.core.safety.command_limiter import CommandLimiter
from dz_ros.core.safety.runaway_guard import runaway_text, RunawayGuard
from dz_ros.core.signals import estimates, S, TERM_NAMES, V_EXTRA
from dz_ros.core.tracking import shown_position

ANSWERED = 2.5
"""A state whose newest command is older shows no runaway [samples]."""
SNAP = 1e-9
"""Stamps closer than this are the same instant [s]."""
REFERENCES, REFERENCES_AHEAD = 4, 256
"""References kept: the one of this sample, the next one, and room for disorder; in lockstep those
sent ahead as well."""


_ADAPTING = Status.ADAPTING
"""Before Python 3.12, to ask an enumeration for a member costs a call."""
Step = tuple[Command, tuple[float, ...], Terms]
"""Command, the law's memory after it, terms."""


def accepted_interval(earlier: float, stamp: float, period: float) -> float:
    """Return the interval by which adaptation may advance [s]; 0 where it is not acceptable."""
    interval = stamp - earlier
    if abs(interval - period) < SNAP:
        return period
    if 0.5 * period - SNAP <= interval <= 2.0 * period + SNAP:
        return interval
    return 0.0


class ViolationError(ArithmeticError):
    """A step that must not be taken; the message gives the reason.

    Attributes:
        step: What the step would give: command, memory after it, terms; None = it has no numbers.
    """

    def __init__(self, message: str, step: Step | None = None) -> None:
        self.step = step
        super().__init__(message)


class Controller:
    """Answers states with commands.

    Args:
        configuration: Law, plant structure and period.

    Attributes:
        memory: The law's memory before the next step.
        ignored: Reason → number of states that were not answered by a step.
        error: x̃ of the last step, unit of x.
        limiter: Command limiter of every command.
        runaway: Judges whether the device gains speed against them.
        against: For how long it had, at the last step [s].
        psi: Scheduling variable as last measured; None = that of the configuration.
        count: Number of commands given so far, the seq of the next one.
        others: Of a law that knows all axes: x_d, x and memory of the others; None = it knows one.
    """

    def __init__(self, configuration: Configuration) -> None:
        self.ignored = {'repeated': 0, 'out_of_order': 0, 'not_finite': 0}
        self.error = 0.0
        self.count = 0
        self.psi: float | None = None
        self.others: tuple[tuple[float, ...], ...] | None = None
        self.limiter = CommandLimiter(configuration.safety, configuration.loop.period)
        self.runaway = RunawayGuard(configuration.plant, configuration.loop.period)
        self.against = 0.0
        lockstep = configuration.loop.timing == 'lockstep'
        self._references: deque[Reference] = deque(
            maxlen=REFERENCES_AHEAD if lockstep else REFERENCES)
        self._last: tuple[State, Command, Terms] | None = None
        self._signals: tuple[float, ...] = ()
        self._begins = True
        self.configure(configuration)
        self.memory = self._earlier = self.law.initial_memory()

    def configure(self, configuration: Configuration) -> None:
        """Take other gains and limits from the next step on; the structure must be the same."""
        self.law = configuration.law
        self.period = configuration.loop.period
        self.limiter.settings = configuration.safety
        self.runaway.plant = configuration.plant
        self._band = configuration.controller_settings.error_band
        self._desired = configuration.controller_settings.regressors_at == 'reference'
        self._schedule = configuration.loop.schedule
        self._plant = configuration.plant
        self._plant_constants = configuration.plant.constants
        self._y = [0.0] * configuration.plant.regressor_count
        names = self.law.signal_names
        *theta, phi = estimates(self.law.regressor_count)
        self._scheduled = self.law.schedule_place >= 0
        self._theta_at = [names.index(item.name) for item in theta if item.name in names]
        self._phi_at = [names.index(phi.name)] if phi.name in names else []

    def follow(self, psi: float | None) -> None:
        """Take the scheduling variable as measured from now on; None = as configured."""
        self.psi = psi

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
        if not math.isfinite(sum(state.x)) and not all(map(math.isfinite, state.x)):
            self.ignored['not_finite'] += 1
            return None
        last = self._last
        if last is not None and state.seq < last[0].seq and state.seq != 0 and not self._begins:
            self.ignored['out_of_order'] += 1
            return None
        if last is not None and state.seq == last[0].seq:
            self.ignored['repeated'] += 1
            return last[1], last[2]
        if self._begins:
            self.begin(state.stamp)
            self._begins = False
        return self._answer(state, self.period if last is None else accepted_interval(
            last[0].stamp, state.stamp, self.period))

    def begin(self, t: float) -> None:
        """Let the law take over at loop time t [s]: rate, ramp and runaway guard begin there."""
        self.limiter.start(t)
        self.runaway.restart()

    def judge_runaway(self, state: State) -> float:
        """Return for how long the device has gained speed against the commands [s]."""
        if state.stamp - state.echo_stamp > ANSWERED * self.period:
            self.runaway.restart()      # the actuator holds another command than the newest
        return self.runaway.sample(state.stamp, self.limiter.output, state.x)

    def answer_again(self, state: State, reference: Reference, memory: tuple[float, ...],
                     interval: float) -> tuple[Command, Terms]:
        """Return what `respond` gave to a recorded state; `begin` begins as `restart` does.

        Args:
            state: The state.
            reference: The reference that was used for it, as it was sent.
            memory: The law's memory before the step.
            interval: Accepted interval since the state answered before [s].

        Raises:
            ViolationError: The step must not be taken.
        """
        self.memory = memory
        self._references.clear()
        self._references.append(reference)
        return self._answer(state, interval)

    def _answer(self, state: State, dt: float) -> tuple[Command, Terms]:
        """Return command and terms of a step.

        Raises:
            ViolationError: The step must not be taken.
        """
        reference, late = self._reference_for(state.seq, state.stamp)
        status = _ADAPTING if dt > 0.0 else Status.BAD_INTERVAL
        if late > 2.0 * self.period:
            dt, status = 0.0, status | Status.STALE_REFERENCE
        self.error = state.x[0] - reference.x_d[0]
        self.against = self.judge_runaway(state)
        command, memory, terms = self._step(reference, state, dt, status)
        self._check(command, memory, terms)
        limited = self.limiter.limit(command.v, state.stamp)
        if dt > 0.0 and (command.v - limited) * terms.values[S] < 0.0:
            command, memory, terms = self._step(reference, state, 0.0, status | Status.SATURATED)
            self._check(command, memory, terms)
            limited = self.limiter.limit(command.v, state.stamp)
        v = self.limiter.send(command.v, limited, state.stamp)
        if v != command.v:
            command = command._replace(v=v)
        self.count += 1
        if self._scheduled:
            memory = self._measured(memory, state.stamp)
        self._earlier, self.memory = self.memory, memory
        self._signals = terms.signals
        self._last = (state, command, terms)
        return command, terms

    def safe_answer(self, state: State) -> tuple[Command, Terms]:
        """Return the safe command and its terms for a state, without a step of the law."""
        v = self.limiter.safe(state.stamp)
        self.runaway.restart()
        values = [0.0] * len(TERM_NAMES)
        values[V_EXTRA] = v
        command = Command(self.count, state.stamp, v, state.seq, state.stamp)
        terms = Terms(self.count, state.stamp, tuple(values), 0.0, Status.INACTIVE, -1, state.seq,
                      self._signals or (0.0,) * len(self.law.signal_names))
        self.count += 1
        self._last = (state, command, terms)
        return command, terms

    def _measured(self, memory: tuple[float, ...], stamp: float) -> tuple[float, ...]:
        """Return the memory with the scheduling variable of a stamp [s] in its place."""
        place, psi = self.law.schedule_place, self.psi
        if psi is None:
            if self._schedule is None:
                return memory
            psi = self._schedule(stamp)
        return (*memory[:place], psi, *memory[place + 1:])

    def newest_reference(self) -> float:
        """Return the stamp of the newest reference [s]; −∞ before the first."""
        return self._references[-1].stamp if self._references else -math.inf

    def _step(self, reference: Reference, state: State, dt: float,
              status: Status) -> Step:
        """Take the law's step.

        Raises:
            ViolationError: It cannot be computed.
        """
        try:
            if self.others is not None:
                x_d, x, memory = self.others
                known = state._replace(x=(*state.x, *x))
                return self.law.step(
                    (*self.memory, *memory), reference._replace(x_d=(*reference.x_d, *x_d)),
                    known, coupled_regressors(self._plant, known.x), dt, status, self.count)
            self._plant.regressors(reference.x_d if self._desired else state.x,
                                   self._plant_constants, self._y)
            if self._band > 0.0:
                state = state._replace(x=(shown_position(state.x[0], reference.x_d[0], self._band),
                                          *state.x[1:]))
            return self.law.step(self.memory, reference, state, self._y, dt, status,
                                 self.count)
        except (ArithmeticError, ValueError) as error:
            raise ViolationError(f'the law cannot be computed: {error}') from error

    def _check(self, command: Command, memory: tuple[float, ...], terms: Terms) -> None:
        """Check whether a step may be taken.

        Raises:
            ViolationError: It may not.
        """
        # A sum that is finite has none but finite terms; the reverse need not be so.
        whole = command.v + sum(memory) + sum(terms.values) + sum(terms.signals)
        if not math.isfinite(whole) and not all(map(
                math.isfinite, (command.v, *memory, *terms.values, *terms.signals))):
            raise ViolationError('the law gave a number that is not finite',
                                 (command, memory, terms))
        limits = self.limiter.settings
        if 0.0 < limits.error_limit < abs(self.error):
            raise ViolationError(f'error {self.error:.4g} beyond safety.error_limit '
                                 f'{limits.error_limit:g}', (command, memory, terms))
        if 0.0 < limits.runaway_time <= self.against:
            raise ViolationError(runaway_text(self.against, limits.runaway_time),
                                 (command, memory, terms))
        if not (limits.theta_limit > 0.0 or limits.phi_limit > 0.0):
            return
        for i, limit, key in ((i, limit, key) for places, limit, key in (
                (self._theta_at, limits.theta_limit, 'theta'),
                (self._phi_at, limits.phi_limit, 'phi')) if limit > 0.0 for i in places):
            if abs(terms.signals[i]) > limit:
                self.memory = self._earlier
                raise ViolationError(f'estimate {self.law.signal_names[i]} {terms.signals[i]:.4g} '
                                     f'beyond safety.{key}_limit {limit:g}',
                                     (command, memory, terms))

    def mark(self) -> tuple[object, ...]:
        """Return where the controller is, for `rewind`."""
        return self.memory, self._earlier, self._signals, self._last, self.count, self._begins

    def rewind(self, mark: tuple[object, ...]) -> None:
        """Undo the step taken since `mark`, which a step of another axis forbids."""
        self.memory, self._earlier, self._signals, self._last, self.count, self._begins = (
            mark)  # type: ignore[assignment]

    def reference_at(self, state: State) -> Reference:
        """Return the reference that a step for this state takes."""
        return self._reference_for(state.seq, state.stamp)[0]

    def _in_its_place(self, seq: int) -> Reference | None:
        """Return the reference of this seq where those kept are in a row, as nearly always."""
        references = self._references
        place = seq - references[0].seq if references else -1
        if 0 <= place < len(references) and references[place].seq == seq:
            return references[place]
        return None

    def _reference_for(self, seq: int, stamp: float) -> tuple[Reference, float]:
        """Return the reference for this instant and how far it had to be brought [s]."""
        references = self._references
        while len(references) > REFERENCES and references[0].stamp < stamp - SNAP:
            references.popleft()
        likely = self._in_its_place(seq)
        if likely is not None and abs(likely.stamp - stamp) < SNAP:
            return likely, 0.0      # the search below gives the same, slower
        for reference in references:
            if abs(reference.stamp - stamp) < SNAP:
                return reference, 0.0
        newest = references[-1]
        return newest.at(stamp), abs(stamp - newest.stamp)

# SPDX-License-Identifier: Apache-2.0
"""Recorded steps taken again by the `Controller` itself, and compared with what was recorded.

Each step starts from the memory in its own signals; that this is the memory which the step before
left is compared apart. So one wrong number does not spoil the rest of the run. Where a step
agrees better with what the step before left than with its signals, the signals are wrong.

The law takes over, as far as a log shows, at the first command, after samples in which the safe
command was sent, and after a gap: there rate and ramp of the command limiter begin again.

Over 300 lines: taking a step again and comparing it are one thing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import copy
from dataclasses import dataclass, field
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.laws.base import Law
from dz_ros.core.loop.controller import accepted_interval, Controller, SNAP, Step, ViolationError
from dz_ros.core.records import Reference, State, Status, Terms
from dz_ros.core.signals import STATUS, TERM_NAMES
from dz_ros.replay.audit.result import Integers, Reason, Tally
from dz_ros.runs.axes import CUT_FROM
from dz_ros.runs.setting import state_columns
from dz_ros.runs.steps import column, StepTable

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Memory = tuple[float, ...]

UNKNOWN_BEFORE = 'what the sample before left, and when it was, is not in the log'
"""Why a sample behind a gap is checked in part only."""
SAFE = {'command': ('v',), 'terms': (*TERM_NAMES, 'dt', 'status')}
"""Channel → what is compared of a sample in which the law was not asked."""


class Unchecked:
    """Why samples are not checked, the first reason of each."""

    def __init__(self, seq: Integers) -> None:
        self._seq = seq
        self._texts: dict[str, int] = {}
        self.code = np.full(len(seq), -1, dtype=np.int64)

    def add(self, rows: Integers, text: str) -> None:
        """Give a reason for samples that have none yet."""
        code = self._texts.setdefault(text, len(self._texts))
        self.code[rows[self.code[rows] < 0]] = code

    def reasons(self) -> list[Reason]:
        """Return those that apply to a sample."""
        found = []
        for text, code in self._texts.items():
            places = np.flatnonzero(self.code == code)
            if len(places):
                found.append(Reason(text, len(places), int(self._seq[places[0]])))
        return found


@dataclass
class _Taken:
    """Steps of one configuration taken again, one entry a step; NaN where it could not be taken.

    Attributes:
        done: Whether it was taken.
        failed: Whether the law could not be computed.
        known: Whether the interval before it is known.
        v: Command, as it leaves the command limiter.
        terms: `TERM_NAMES`, dt, status, signals.
        left, recalled: Memory that the step before left, and memory in the signals.
        linked: Whether both are known.
        against: For how long the device had gained speed against the command [s].
    """

    done: list[bool] = field(default_factory=list)
    failed: list[bool] = field(default_factory=list)
    known: list[bool] = field(default_factory=list)
    v: list[float] = field(default_factory=list)
    terms: list[Sequence[float]] = field(default_factory=list)
    left: list[Memory] = field(default_factory=list)
    recalled: list[Memory] = field(default_factory=list)
    linked: list[bool] = field(default_factory=list)
    against: list[float] = field(default_factory=list)


UNKNOWN_OTHERS = 'what the other axes had is not in the log, and the law knows all axes'
"""Why a sample of a coupled law is not checked."""
OFTEN = 1000
"""Steps between two calls of `progress`."""
Beside = tuple[tuple[float, ...], ...]
"""x_d, x and memory of the other axes, one after the other."""


class Recomputation:
    """The controllers of a run, answering the recorded states again.

    Args:
        run: The run.
        steps: Its steps.
        others: Other axes of the loop, whose messages are the same ones: its steps are theirs.
        progress: Called every `OFTEN` steps with steps taken, of all, and an empty word.

    Attributes:
        tally: What was compared.
        unchecked: Why samples were not, or only in part.
        computed: Which steps were taken again, shape (N,).
        runaways: seq of the samples at which the law stopped and the runaway guard does again.
        passed: seq of the samples that the law answered although the guard stops it here.
        cut: Number of stops before which too few samples are in the log for the guard.
    """

    def __init__(self, run: RunData, steps: StepTable, others: Sequence[RunData] = (),
                 progress: Callable[[int, int, str], None] = lambda *_: None) -> None:
        self._run, self._steps, self._progress = run, steps, progress
        self._others = [Recomputation(item, steps) for item in others]
        self._follows = steps.follows
        self._controller: Controller | None = None
        self._resting = False
        self.tally = Tally(steps.seq, steps.stamp, steps.start)
        self.unchecked = Unchecked(steps.seq)
        self.computed = np.zeros(len(steps.seq), dtype=bool)
        self.runaways: list[int] = []
        self.passed: list[int] = []
        self.cut = 0
        self._began = 0.0

    def take(self, c: Configuration, low: int, high: int, before: Memory | None) -> Memory | None:
        """Take steps of one configuration again, compare; return the memory after the last one.

        Args:
            c: The configuration.
            low: First step.
            high: The step after the last.
            before: Memory before the first; None where unknown.
        """
        rows = np.arange(low, high)
        # The law, once stopped, takes over again with an event, which begins other steps.
        bits = _bits(column(self._run.channels.get('terms'), 'status', self._steps.terms[rows]))
        active = np.flatnonzero((bits & int(Status.INACTIVE)) == 0)
        count = int(active[-1]) + 1 if len(active) else 0
        if (bits[:count] & int(Status.INACTIVE)).any():
            count = len(rows)
        controller = self._ready(c, low)
        last = before
        if count:
            taken, last = self._answers(controller, c, rows[:count], before)
            self._compare(c, rows[:count], taken)
        if count < len(rows):
            if count:
                self._stop_again(controller, c, rows[count:count + 1])
            self._compare_safe(controller, rows[count:])
            self._resting = True
        return last

    def _stop_again(self, controller: Controller, c: Configuration, row: Integers) -> None:
        """Let the runaway guard judge the sample at which the law stopped."""
        state, limit = self._states(row)[0], c.safety.runaway_time
        if limit == 0.0 or state is None or not self._follows[row[0]]:
            self.cut += limit > 0.0
            return
        if controller.judge_runaway(state) >= limit:
            self.runaways.append(state.seq)
        else:
            self.cut += state.stamp - self._began < limit

    def _ready(self, c: Configuration, low: int) -> Controller:
        """Return the controller, with a configuration that holds from a step on."""
        if self._controller is None or self._steps.start[low] != self._steps.start[max(
                low - 1, 0)]:
            self._controller = Controller(c)
        else:
            self._controller.configure(c)
        return self._controller

    def _answers(self, controller: Controller, c: Configuration, rows: Integers,
                 before: Memory | None) -> tuple[_Taken, Memory | None]:
        """Return steps taken again, and the memory after the last one."""
        steps, channels = self._steps, self._run.channels
        found = _Taken()
        law, period = c.law, c.loop.period
        size = len(law.initial_memory())
        blank_terms = (math.nan,) * (STATUS + 2 + len(law.signal_names))
        blank = (math.nan,) * size
        recorded = self._recorded(rows, law)
        states, references = self._states(rows), self._references(rows, c)
        intervals = column(channels.get('terms'), 'dt', steps.terms[rows]).tolist()
        stamps = steps.stamp[rows].tolist()
        earlier = steps.stamp[np.maximum(rows - 1, 0)].tolist()
        follows, first = self._follows[rows].tolist(), (steps.seq[rows] == 0).tolist()
        carried = before
        alone = not self._others and CUT_FROM not in self._run.info
        beside = None if alone or not law.coupled else self._beside(rows, c)
        if beside is not None:
            lacking = [item is None for item in beside]
            self.unchecked.add(rows[np.array(lacking, dtype=bool)], UNKNOWN_OTHERS)
        for i, signals in enumerate(recorded.signals):
            if i % OFTEN == 0:
                self._progress(int(rows[i]), len(steps.seq), '')
            if i and not follows[i]:
                carried = None
            if not size:
                carried = ()
            if first[i] or not follows[i] or self._resting:
                controller.begin(stamps[i])
                self._began = stamps[i]
                self._resting = False
            memory = carried if signals is None else tuple(law.memory_from_signals(signals))
            state, reference = states[i], references[i]
            interval = (period if first[i] else intervals[i] if not follows[i] else
                        accepted_interval(earlier[i], stamps[i], period))
            if law.schedule_place >= 0 and c.loop.schedule_topic:
                controller.follow(recorded.scheduled(i, law.schedule_place))
            step: Step | None = None
            failed = False
            if beside is not None:
                controller.others = beside[i]
            if state is not None and reference is not None and memory is not None and (
                    math.isfinite(interval)) and (beside is None or beside[i] is not None):
                try:
                    if carried is None or carried == memory:
                        step = _again(controller, state, reference, memory, interval)
                    else:
                        other = copy.copy(controller)
                        other.limiter = copy.copy(controller.limiter)
                        other.runaway = copy.copy(controller.runaway)
                        step = _again(controller, state, reference, memory, interval)
                        second = _again(other, state, reference, carried, interval)
                        if recorded.agreement(second, i) > recorded.agreement(step, i):
                            controller.limiter, step, memory = other.limiter, second, carried
                except ViolationError:
                    failed = True
            found.done.append(step is not None)
            found.failed.append(failed)
            found.known.append(first[i] or follows[i])
            found.linked.append(carried is not None and signals is not None)
            found.left.append(blank if carried is None else carried)
            found.recalled.append(blank if memory is None else memory)
            found.against.append(0.0 if step is None else controller.against)
            if step is None:
                controller.runaway.restart()
                self._began = stamps[i]
                found.v.append(math.nan)
                found.terms.append(blank_terms)
                carried = None
            else:
                command, carried, terms = step
                found.v.append(command.v)
                found.terms.append((*terms.values, terms.dt, terms.status, *terms.signals))
        return found, carried

    def _beside(self, rows: Integers, c: Configuration) -> list[Beside | None]:
        """Return what a law that knows all axes was given of the others; None = not in the log.

        Their memories are those in the signals, of laws of the same structure.
        """
        if not self._others:
            return [None] * len(rows)
        of_axes = [(item._states(rows), item._references(rows, c),
                    item._recorded(rows, c.law).signals) for item in self._others]
        found: list[Beside | None] = []
        for i in range(len(rows)):
            x_d: list[float] = []
            x: list[float] = []
            memory: list[float] = []
            for states, references, signals in of_axes:
                state, reference, own = states[i], references[i], signals[i]
                if state is None or reference is None or own is None:
                    break
                used = (reference if abs(reference.stamp - state.stamp) < SNAP
                        else reference.at(state.stamp))
                x_d += used.x_d
                x += state.x
                memory += c.law.memory_from_signals(own)
            else:
                found.append((tuple(x_d), tuple(x), tuple(memory)))
                continue
            found.append(None)
        return found

    def _states(self, rows: Integers) -> list[State | None]:
        """Return the states answered; None where one is not in the log or not finite."""
        channel, places = self._run.channels.get('state'), self._steps.state[rows]
        if channel is None or not len(channel):
            return [None] * len(rows)
        x = channel.values[places][:, state_columns(channel.labels)]
        good = (places >= 0) & np.isfinite(x).all(axis=1) & np.isfinite(self._steps.stamp[rows])
        stamps = self._steps.stamp[rows].tolist()
        seq = channel['seq'][places].tolist()
        # Of a recording without the field every state is taken as answered in time.
        echo = (channel['echo_stamp'][places].tolist() if 'echo_stamp' in channel.labels
                else stamps)
        return [State(int(seq[i]), stamps[i], tuple(item), -1, echo[i]) if there else None
                for i, (item, there) in enumerate(zip(x.tolist(), good.tolist(), strict=True))]

    def _references(self, rows: Integers, c: Configuration) -> list[Reference | None]:
        """Return the references used; None where one is not in the log."""
        channel, places = self._run.channels.get('reference'), self._steps.reference[rows]
        if channel is None or not len(channel):
            return [None] * len(rows)
        table = channel.values[places][:, :3 + c.plant.order].tolist()
        return [Reference(-1, item[1], tuple(item[2:])) if there else None
                for item, there in zip(table, (places >= 0).tolist(), strict=True)]

    def _recorded(self, rows: Integers, law: Law) -> _Recorded:
        """Return what was recorded of steps."""
        channels, steps = self._run.channels, self._steps
        v = column(channels.get('command'), 'v', steps.command[rows]).tolist()
        commands = [value if row >= 0 else None
                    for value, row in zip(v, steps.command[rows].tolist(), strict=True)]
        signals: list[list[float] | None] = [None] * len(rows)
        values: list[list[float] | None] = [None] * len(rows)
        terms = channels.get('terms')
        if terms is not None and len(terms):
            there = (steps.terms[rows] >= 0).tolist()
            head, tail = (terms.table(names)[steps.terms[rows]].tolist()
                          for names in (TERM_NAMES, law.signal_names))
            signals = [item if known else None for item, known in zip(tail, there, strict=True)]
            values = [item if known else None for item, known in zip(head, there, strict=True)]
        return _Recorded(law.memory_from_signals, signals, values, commands,
                         self._follows[rows].tolist())

    def _field(self, name: str, label: str, rows: Integers, expected: Array, where: Flags) -> None:
        """Compare one column of a channel at some steps with what it should be."""
        channel = self._run.channels.get(name)
        places: Integers = getattr(self._steps, name)[rows]
        chosen = where & (places >= 0)
        if channel is not None and len(channel) and label in channel.labels:
            self.tally.add(f'{name}.{label}', rows[chosen], channel[label][places[chosen]],
                           expected[chosen])

    def _compare(self, c: Configuration, rows: Integers, taken: _Taken) -> None:
        """Compare all that was recorded of steps with what the controller does."""
        steps = self._steps
        done, known, linked, failed = (np.array(item, dtype=bool) for item in (
            taken.done, taken.known, taken.linked, taken.failed))
        terms = np.array(taken.terms, dtype=float)
        names = memory_names(c.law)
        left, recalled = (np.array(item, dtype=float).reshape(len(rows), len(names))
                          for item in (taken.left, taken.recalled))
        for j, name in enumerate(names):
            self.tally.add(f'memory.{name}', rows[linked], recalled[linked, j], left[linked, j])
        if c.safety.runaway_time > 0.0:
            passed = np.array(taken.against) >= c.safety.runaway_time
            self.passed += steps.seq[rows][passed].tolist()
        answered = steps.state[rows] >= 0
        stamp = steps.stamp[rows]
        echo = column(self._run.channels.get('state'), 'seq', steps.state[rows])
        self._field('terms', 'stamp', rows, stamp, answered)
        self._field('terms', 'echo_seq', rows, echo, answered)
        self._field('terms', 'dt', rows, terms[:, STATUS], known & done)
        self._field('terms', 'status', rows, terms[:, STATUS + 1], known & done)
        for j, name in enumerate((*TERM_NAMES, '', '', *c.law.signal_names)):
            if name:
                self._field('terms', name, rows, terms[:, j], done)
        self._field('command', 'echo_seq', rows, echo, answered)
        self._field('command', 'stamp', rows, stamp, answered)
        self._field('command', 'echo_stamp', rows, stamp, answered)
        self._field('command', 'v', rows, np.array(taken.v, dtype=float), done)
        self.computed[rows] = done

        named = steps.terms[rows] >= 0
        for where, text in (
                (~answered, 'the state it answers is not in the log'),
                ((steps.reference[rows] < 0) & named, 'the reference it used is not in the log'),
                (failed, 'the law cannot be computed from the recorded numbers'),
                (~done & named, 'the recorded state is not finite'),
                (~named, 'its terms are not in the log'),
                (steps.command[rows] < 0, 'its command is not in the log'),
                (~linked | ~known, UNKNOWN_BEFORE)):
            self.unchecked.add(rows[where], text)

    def _compare_safe(self, controller: Controller, rows: Integers) -> None:
        """Compare samples in which the law was not asked with the safe command."""
        command, terms = controller.safe_answer(State(0, 0.0, ()))
        expected = {'v': command.v, **dict(zip(Terms.labels(()), terms.numbers(), strict=False))}
        for name, labels in SAFE.items():
            for label in labels:
                self._field(name, label, rows, np.full(len(rows), float(expected[label])),
                            np.ones(len(rows), dtype=bool))


@dataclass(frozen=True)
class _Recorded:
    """What was recorded of steps, None where the message is not in the log."""

    recall: Callable[[Sequence[float]], Memory]
    signals: list[list[float] | None]
    terms: list[list[float] | None]
    v: list[float | None]
    follows: list[bool]

    def scheduled(self, i: int, place: int) -> float | None:
        """Return ψ as measured in a step, which the signals of the next hold; None = unknown."""
        if i + 1 == len(self.v) or not self.follows[i + 1]:
            return None
        after = self.signals[i + 1]
        return None if after is None else float(self.recall(after)[place])

    def agreement(self, step: Step, i: int) -> int:
        """Return how much of the log agrees with a step taken again, its signals aside: 0 … 3."""
        command, memory, terms = step
        following = None
        if i + 1 < len(self.v) and self.follows[i + 1]:
            following = self.signals[i + 1]
        recorded = self.terms[i]
        alike = recorded is not None and all(
            number == value or math.isnan(value)        # a field that the log has not
            for number, value in zip(terms.values, recorded, strict=True))
        return (alike + (command.v == self.v[i])
                + (following is not None and tuple(self.recall(following)) == memory))


def _again(controller: Controller, state: State, reference: Reference, memory: Memory,
           interval: float) -> Step:
    """Return a step taken again; its numbers also where it must not be taken."""
    try:
        command, terms = controller.answer_again(state, reference, memory, interval)
    except ViolationError as error:
        if error.step is None:
            raise
        return error.step
    return command, controller.memory, terms


def _bits(status: Array) -> Integers:
    """Return status bits; none where they cannot be read."""
    with np.errstate(invalid='ignore'):
        return np.where((status >= 0.0) & (status < 256.0), status, 0.0).astype(np.int64)


def memory_names(law: Law) -> tuple[str, ...]:
    """Return names for the law's memory: those of the signals it is read from, else places."""
    names = law.signal_names
    count = len(law.initial_memory())
    marks = [1.0 + 2.0 ** -20 * (i + 1) for i in range(len(names))]
    try:
        recalled = law.memory_from_signals(marks)
    except (ArithmeticError, ValueError, LookupError):
        recalled = ()
    return tuple(names[marks.index(recalled[i])] if i < len(recalled) and recalled[i] in marks
                 else str(i) for i in range(count))

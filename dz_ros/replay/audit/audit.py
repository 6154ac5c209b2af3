# SPDX-License-Identifier: Apache-2.0
"""Recomputing every command and every estimate of a run from its recorded inputs.

For each step the log names the state answered (echo_seq) and the reference used (reference_seq);
its signals hold the law's memory before it. With the configuration that held, the `Controller`
that ran online takes the step again, and every number is compared bit for bit:

    v_k, terms_k, memory_{k+1} = controller(memory_k, reference, x_k, t_k − t_{k−1})

So everything that it decides besides the law (mathematics.md §7) is checked too: the accepted
interval, the reference brought to the state's stamp, the reasons for a frozen adaptation, the
command limiter; stamps and echoes are, and that the memory in the signals is what the step
before left behind. Inputs (states, references) and clocks (hold, round_trip, log times) are taken
as they are; truth is not used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.events import ModeEvent, of_kind
from dz_ros.core.loop.controller import SNAP
from dz_ros.core.safety.runaway_guard import REASON
from dz_ros.replay.audit.messages import (
    frozen_notes,
    missing_messages,
    reference_notes,
    state_notes,
)
from dz_ros.replay.audit.recompute import Recomputation
from dz_ros.replay.audit.result import AuditResult, Reason
from dz_ros.replay.audit.spans import Part, parts
from dz_ros.runs.history import RunHistory
from dz_ros.runs.steps import column, StepTable
from dz_ros.version import version

GAP = 'command and terms are not in the log'
"""Why a sample that left no trace is not checked."""


def audit(run: RunData, configuration: Configuration | None = None,
          others: Sequence[RunData] = (),
          progress: Callable[[int, int, str], None] = lambda *_: None) -> AuditResult:
    """Return what recomputing a run finds.

    Args:
        run: The run; any log of the loop's topics, with or without events.
        configuration: What ran, for logs without it; overrules theirs.
        others: The other axes of the loop, in their order: a law that knows all axes needs them.
        progress: Called with the number of samples taken again, of all, and an empty word.
    """
    here = version()
    steps = StepTable.of(run)
    found, findings, notes = parts(run, steps, configuration, here)
    again = Recomputation(run, steps, others, progress)
    last: tuple[float, ...] | None = None
    for part, low, high in _stretches(steps, found):
        if part is None or part.configuration is None:
            again.unchecked.add(np.arange(low, high), 'no configuration is known' if part is None
                                else part.span.problem)
            last = None
            continue
        before = _memory_before(part, steps, low, last)
        last = again.take(part.configuration, low, high, before)
    reasons = again.unchecked.reasons() + _gaps(steps)
    total = len(steps.seq) + sum(item.samples for item in reasons if item.text == GAP)
    missing, unmeasured = missing_messages(run, steps)
    state_findings, more = state_notes(run, steps, found)
    if not total:
        findings.append('no command and no terms are in the log: there is nothing to check')
    notes += [*unmeasured, *more]
    meant = column(run.channels.get('reference'), 'stamp', steps.reference)
    with np.errstate(invalid='ignore'):
        carried = again.computed & (np.abs(steps.stamp - meant) >= SNAP)
    if carried.any():
        wrong, harmless = reference_notes(run, steps, carried)
        findings += wrong
        notes += harmless
    notes += frozen_notes(run, steps)
    findings += runaway_findings(run, again)
    if run.info.get('cut'):
        notes.append(f'the log was cut off: {run.info["cut"]}')
    if run.info.get('notes'):
        notes.append(run.info['notes'])
    tally = again.tally
    return AuditResult(
        total, int(np.count_nonzero(again.unchecked.code < 0)), tuple(reasons),
        dict(tally.fields), tally.first(), tally.largest(),
        (*steps.findings, *findings, *missing, *state_findings), tuple(notes),
        tuple(part.span for part in found), here)


def runaway_findings(run: RunData, again: Recomputation) -> list[str]:
    """Return where the runaway guard decides otherwise than it did in the recorded controller."""
    nodes = {item.event.node for item in RunHistory.of(run).statements('controller')}
    recorded = sum(event.reason.startswith(REASON) for _, event in of_kind(run.events, ModeEvent)
                   if event.node in nodes)
    found = []
    if again.passed:
        found.append(f'the runaway guard stops the law at seq {again.passed[0]}, the recorded '
                     'controller went on')
    repeated = len(again.runaways)
    if not repeated <= recorded <= repeated + again.cut:
        found.append(f'the runaway guard stopped the recorded controller {recorded} times, and '
                     f'stops it {repeated} times here'
                     + (f', first at seq {again.runaways[0]}' if repeated else ''))
    return found


def _stretches(steps: StepTable, found: Sequence[Part]) -> list[tuple[Part | None, int, int]]:
    """Return (part, first step, the one after the last), in order; None covers what none does."""
    place = np.full(len(steps.seq), -1, dtype=np.int64)
    for i, part in enumerate(found):
        place[(steps.start == part.span.start) & (steps.seq >= part.span.first)] = i
    edges = [0, *(np.flatnonzero(np.diff(place)) + 1).tolist(), len(place)]
    return [(found[place[low]] if place[low] >= 0 else None, low, high)
            for low, high in pairwise(edges) if high > low]


def _memory_before(part: Part, steps: StepTable, low: int,
                   last: tuple[float, ...] | None) -> tuple[float, ...] | None:
    """Return the memory before the first step of a part: stated, initial, or left behind."""
    seq = int(steps.seq[low])
    if seq == part.span.first and part.memory is not None:
        return part.memory
    if seq == 0 and part.configuration is not None:
        return part.configuration.law.initial_memory()
    return last if steps.follows[low] else None


def _gaps(steps: StepTable) -> list[Reason]:
    """Return the reason for samples that left neither command nor terms."""
    if not len(steps.seq):
        return []
    before = np.append(-1, steps.seq[:-1])
    before[np.append(True, np.diff(steps.start) > 0)] = -1
    holes = steps.seq - before - 1
    if not holes.any():
        return []
    return [Reason(GAP, int(holes.sum()), int(before[(holes > 0).argmax()] + 1))]

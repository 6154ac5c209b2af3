"""Recomputing every command and every estimate of a run from what the log says went in.

For each step the log names the state answered (echo_seq) and the reference used (reference_seq);
its terms tell the law's memory before it. With the configuration that held, the same code that ran
on line computes the step again, and every number is compared bit for bit:

    v_k, terms_k, memory_{k+1} = law(memory_k, reference, x_k, Y(x_k), dt_k)

What the controller decides besides the law (mathematics.md §7) is derived again too: the interval
dt_k from the stamps of this and the step before, the reference brought to the state's stamp, the
reasons for a frozen adaptation, stamps and echoes, and that the memory the signals tell is what
the step before left behind. Inputs (states, references) and clocks (hold, round_trip, log times)
are taken as they are; truth is not used.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dz_ros.analysis.audit_compare import compare_steps, explain, step_inputs, Why
from dz_ros.analysis.audit_decisions import decide
from dz_ros.analysis.audit_limits import compare_resting, Limits, resting
from dz_ros.analysis.audit_messages import (
    frozen_notes,
    missing_messages,
    reference_notes,
    state_notes,
)
from dz_ros.analysis.audit_result import AuditResult, Reason, Tally
from dz_ros.analysis.audit_samples import collect, LIMIT, Samples
from dz_ros.analysis.audit_spans import Part, parts
from dz_ros.analysis.audit_steps import compute
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.version import version

Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

GAP = 'command and terms are not in the log'
"""Why a sample that left no trace is not checked."""


def audit(run: RunData, configuration: Configuration | None = None) -> AuditResult:
    """Return what recomputing a run finds.

    Args:
        run: The run; any log of the loop's topics, with or without events.
        configuration: What ran, for logs that do not say it; overrules what they say.
    """
    here = version()
    samples = collect(run)
    found, findings, notes = parts(run, samples, configuration, here)
    tally = Tally(samples.seq, samples.stamp, samples.start)
    why = Why(samples.seq)
    carried = np.zeros(len(samples.seq), dtype=bool)
    edges = _edges(samples, found)
    last: tuple[float, ...] | None = None
    limits = Limits()
    for part, (low, high) in edges:
        rows = np.arange(low, high)
        before = _memory_before(part, samples, low, last)
        if part is None or part.configuration is None:
            text = 'no configuration is known' if part is None else part.span.problem
            why.say(_among(rows, why.code), text)
            last = None
            continue
        # The law, once stopped, takes over again with an event, which begins another part.
        rest = resting(run, samples, rows)
        active = int(rest.argmax()) if rest.any() and rest[rest.argmax():].all() else len(rows)
        if active < len(rows):
            compare_resting(run, samples, rows[active:], part.configuration, tally)
        rows = rows[:active]
        if not active:
            limits.rest()
            last = before
            continue
        decided = decide(run, samples, rows, part.configuration)
        inputs = step_inputs(run, samples, rows, decided, part.configuration)
        outputs = compute(part.configuration, inputs, before)
        outputs = limits.apply(samples, rows, outputs, part.configuration)
        compare_steps(run, samples, rows, decided, outputs, part.configuration, tally)
        explain(samples, rows, inputs, decided, outputs, why)
        carried[rows] = outputs.done & decided.carried
        last = outputs.last
        if low + active < high:
            limits.rest()
    reasons = why.reasons() + _gaps(samples)
    total = len(samples.seq) + sum(item.samples for item in reasons if item.text == GAP)
    missing = missing_messages(run, samples)
    state_findings, more = state_notes(run, samples, found)
    if not total:
        findings.append('no command and no terms are in the log: there is nothing to check')
    notes += more
    if carried.any():
        wrong, said = reference_notes(run, samples, carried)
        findings += wrong
        notes += said
    notes += frozen_notes(run, samples)
    if run.info.get('cut'):
        notes.append(f'the log was cut off: {run.info["cut"]}')
    return AuditResult(
        total, int(np.count_nonzero(why.code < 0)), tuple(reasons), dict(tally.fields),
        tally.first(), tally.largest(),
        (*samples.findings, *findings, *missing, *state_findings), tuple(notes),
        tuple(part.span for part in found), here)


def _edges(samples: Samples, found: Sequence[Part]
           ) -> list[tuple[Part | None, tuple[int, int]]]:
    """Return which samples each part covers, in order; None covers what no part does."""
    keys = samples.start * LIMIT + samples.seq
    begins = [part.span.start * LIMIT + part.span.first for part in found]
    places = np.searchsorted(begins, keys, 'right') - 1
    known = np.where(places >= 0, np.array([part.span.start for part in found] or [-1])[
        np.maximum(places, 0)], -1) == samples.start
    places = np.where(known, places, -1)
    edges = []
    low = 0
    for high in [*(np.flatnonzero(np.diff(places)) + 1).tolist(), len(keys)]:
        if high > low:
            part = found[int(places[low])] if places[low] >= 0 else None
            edges.append((part, (low, high)))
        low = high
    return edges


def _memory_before(part: Part | None, samples: Samples, low: int,
                   last: tuple[float, ...] | None) -> tuple[float, ...] | None:
    """Return the memory before the first sample of a part: stated, initial, or left behind."""
    if part is None or part.configuration is None:
        return None
    seq = int(samples.seq[low])
    if seq == part.span.first and part.memory is not None:
        return part.memory
    if seq == 0:
        return part.configuration.law.initial_memory()
    return last if samples.follows[low] else None


def _gaps(samples: Samples) -> list[Reason]:
    """Return the reason for samples that left neither command nor terms."""
    if not len(samples.seq):
        return []
    before = np.append(-1, samples.seq[:-1])
    before[np.append(True, np.diff(samples.start) > 0)] = -1
    holes = samples.seq - before - 1
    if not holes.any():
        return []
    return [Reason(GAP, int(holes.sum()), int(before[(holes > 0).argmax()] + 1))]


def _among(rows: Integers, like: Integers) -> Flags:
    """Return which samples are among these rows."""
    found = np.zeros(len(like), dtype=bool)
    found[rows] = True
    return found


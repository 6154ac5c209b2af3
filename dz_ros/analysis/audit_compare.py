"""Recorded steps as inputs of the law, and the comparison of what comes out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dz_ros.analysis.audit_decisions import column, Decided
from dz_ros.analysis.audit_result import Integers, Reason, Tally
from dz_ros.analysis.audit_samples import Samples
from dz_ros.analysis.audit_steps import Inputs, memory_names, Outputs
from dz_ros.analysis.setting import state_columns
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.records import STATUS, TERM_NAMES

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

UNKNOWN_BEFORE = 'what the sample before left, and when it was, is not in the log'
"""Why a sample behind a gap is checked in part only."""


class Why:
    """Why samples are not checked, the first reason of each."""

    def __init__(self, seq: Integers) -> None:
        self._seq = seq
        self._texts: dict[str, int] = {}
        self.code = np.full(len(seq), -1, dtype=np.int64)

    def say(self, where: Flags, text: str) -> None:
        """Give a reason for samples that have none yet."""
        code = self._texts.setdefault(text, len(self._texts))
        self.code[where & (self.code < 0)] = code

    def reasons(self) -> list[Reason]:
        """Return those that apply to a sample."""
        found = []
        for text, code in self._texts.items():
            places = np.flatnonzero(self.code == code)
            if len(places):
                found.append(Reason(text, len(places), int(self._seq[places[0]])))
        return found


def step_inputs(run: RunData, samples: Samples, rows: Integers, decided: Decided,
                c: Configuration) -> Inputs:
    """Return samples as plain lists."""
    state, terms = run.channels.get('state'), run.channels.get('terms')
    x = np.full((len(rows), c.plant.order), np.nan)
    if state is not None and len(state):
        x = state.values[samples.state[rows]][:, state_columns(state.labels)]
    finite = np.isfinite(x).all(axis=1) & np.isfinite(samples.stamp[rows])
    ready = ((samples.state[rows] >= 0) & (samples.reference[rows] >= 0) & finite
             & np.isfinite(np.asarray(decided.dt)))
    v = column(run.channels.get('command'), 'v', samples.command[rows]).tolist()
    commands = [value if row >= 0 else None
                for value, row in zip(v, samples.command[rows].tolist(), strict=True)]
    signals: list[list[float] | None] = [None] * len(rows)
    values: list[list[float] | None] = [None] * len(rows)
    if terms is not None and len(terms):
        there = (samples.terms[rows] >= 0).tolist()
        table = terms.values[samples.terms[rows]]
        head = table[:, 2:2 + STATUS].tolist()
        tail = table[:, table.shape[1] - len(c.law.signal_names):].tolist()
        signals = [item if known else None for item, known in zip(tail, there, strict=True)]
        values = [item if known else None for item, known in zip(head, there, strict=True)]
    return Inputs(ready.tolist(), samples.follows[rows].tolist(), x.tolist(), decided.x_d,
                  decided.dt, signals, values, commands)


def compare_steps(run: RunData, samples: Samples, rows: Integers, decided: Decided,
                  outputs: Outputs, c: Configuration, tally: Tally) -> None:
    """Compare all that was recorded of samples with what was computed."""
    def field(name: str, label: str, expected: Array, where: Flags) -> None:
        channel = run.channels.get(name)
        at = rows[where & (getattr(samples, name)[rows] >= 0)]
        if channel is not None and len(channel):
            tally.add(f'{name}.{label}', at, channel[label][getattr(samples, name)[at]],
                      expected[at - rows[0]])

    stamp, known = samples.stamp[rows], samples.state[rows] >= 0
    echo = column(run.channels.get('state'), 'seq', samples.state[rows])
    linked = outputs.linked
    for j, name in enumerate(memory_names(c.law)):
        tally.add(f'memory.{name}', rows[linked], outputs.told[linked, j],
                  outputs.expected[linked, j])
    field('terms', 'stamp', stamp, known)
    field('terms', 'echo_seq', echo, known)
    own = decided.status.astype(np.int64)
    status = (own | np.nan_to_num(outputs.terms[:, STATUS]).astype(np.int64)).astype(float)
    field('terms', 'dt', np.asarray(decided.dt), decided.known & (samples.reference[rows] >= 0))
    field('terms', 'status', status, decided.known & outputs.done)
    for j, name in enumerate((*TERM_NAMES, '', *c.law.signal_names)):
        if name:
            field('terms', name, outputs.terms[:, j], outputs.done)
    field('command', 'echo_seq', echo, known)
    field('command', 'stamp', stamp, known)
    field('command', 'echo_stamp', stamp, known)
    field('command', 'v', outputs.v, outputs.done)


def explain(samples: Samples, rows: Integers, inputs: Inputs, decided: Decided,
            outputs: Outputs, why: Why) -> None:
    """Say why samples could not be checked, or only in part."""
    def say(where: Flags, text: str) -> None:
        everywhere = np.zeros(len(why.code), dtype=bool)
        everywhere[rows] = where
        why.say(everywhere, text)

    say(samples.state[rows] < 0, 'the state it answers is not in the log')
    named = samples.terms[rows] >= 0
    say((samples.reference[rows] < 0) & named, 'the reference it used is not in the log')
    say(np.array([i in outputs.failed for i in range(len(rows))], dtype=bool),
        'the law cannot be computed from the recorded numbers')
    say(~np.array(inputs.ready, dtype=bool) & named, 'the recorded state is not finite')
    say(~named, 'its terms are not in the log')
    say(samples.command[rows] < 0, 'its command is not in the log')
    say(~outputs.linked | ~decided.known, UNKNOWN_BEFORE)



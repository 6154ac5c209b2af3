# SPDX-License-Identifier: Apache-2.0
"""Messages that an audit misses: holes in the seq of a channel, states without an answer."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.events import of_kind, UnmeasuredEvent
from dz_ros.core.records import Status
from dz_ros.replay.audit.spans import Part
from dz_ros.runs.steps import by_stamp, counted, StepTable

Integers = NDArray[np.int64]
Hole = tuple[int, int]
"""First and last seq of a run of them."""

SHOWN = 5
"""Holes that are named one by one."""
CHANNELS = ('reference', 'state', 'command', 'terms', 'truth')


def missing_messages(run: RunData, steps: StepTable) -> tuple[list[str], list[str]]:
    """Return (findings, notes), a line for each channel with holes: how many, and which.

    States without a measurement (event `unmeasured`) were skipped, never published: a note.
    """
    found, notes = [], []
    for name in CHANNELS:
        channel = run.channels.get(name)
        if channel is None or not len(channel):
            if name != 'truth' and len(steps.seq):
                found.append(f'{name}: the log has no messages of this channel')
            continue
        holes = []
        if name in ('command', 'terms'):
            at = steps.command if name == 'command' else steps.terms
            for e in range(len(steps.begin_ns)):
                mine = steps.start == e
                seq = steps.seq[mine & (at >= 0)]
                ends = [-1, int(steps.seq[mine].max()) + 1]
                holes += _holes(np.concatenate(([ends[0]], seq, [ends[1]])))
        else:
            stretches = _stretches(channel)
            ranges = _unmeasured(run, channel) if name == 'state' else []
            unmeasured = []
            for e, seq in enumerate(stretches):
                left, known = _split(_holes(seq), ranges[e] if ranges else [])
                holes += left
                unmeasured += known
            if unmeasured:
                notes.append(f'{name}: the device had no measurement for {_count(unmeasured)} '
                             f'sample(s), which have no state: seq {_listed(unmeasured)}')
        if holes:
            found.append(f'{name}: {_count(holes)} message(s) missing: seq {_listed(holes)}')
    return found, notes


def state_notes(run: RunData, steps: StepTable,
                found: Sequence[Part]) -> tuple[list[str], list[str]]:
    """Return (findings, notes) about states that no command answers.

    In lockstep and offline every state is answered. In real time a state may be passed over for
    a newer one. The last state of a loop that was interrupted may have been on its way.
    """
    channel = run.channels.get('state')
    if channel is None or not len(channel) or not len(steps.seq):
        return [], []
    answered = np.zeros(len(channel), dtype=bool)
    answered[steps.state[steps.state >= 0]] = True
    rows, own, seq = counted(channel)
    # A state that was sent again is answered once.
    states, inverse = np.unique(np.column_stack([own, seq]), axis=0, return_inverse=True)
    known = np.bincount(inverse.ravel(), answered[rows], len(states)) > 0.0
    left = states[~known, 1]
    if not len(left):
        return [], []
    planned = next((part.configuration.loop.samples for part in found
                    if part.configuration is not None), 0)
    last = int(seq[-1])
    mode = run.info.get('mode', '')
    tail = bool(left[-1] == last) and not (planned and last == planned) and mode != 'offline'
    notes = [f'state {last}, the last one, has no command: the loop ended before'] if tail else []
    inner = left[:-1] if tail else left
    if not len(inner):
        return [], notes
    text = f'{len(inner)} state(s) have no command, the first with seq {int(inner[0])}'
    if mode in ('lockstep', 'offline') or int(inner[-1]) == last:
        return [text], notes
    return [], [f'{text}: passed over for newer ones', *notes]


def reference_notes(run: RunData, steps: StepTable,
                    carried: NDArray[np.bool_]) -> tuple[list[str], list[str]]:
    """Return (findings, notes) about references that were not meant for their state.

    In lockstep and offline a state gets the reference of its own stamp. In real time that one may
    come too late for it or not at all; that it was published in time does not mean it arrived.

    Args:
        run: The run.
        steps: Its steps.
        carried: Which of them used a reference of another stamp, shape (N,).
    """
    text = f'{np.count_nonzero(carried)} reference(s) were brought to the stamp of the state'
    if run.info.get('mode', '') in ('lockstep', 'offline'):
        return [f'{text}, the first with seq {int(steps.seq[carried.argmax()])}: a loop in '
                'this mode waits for the one meant for it'], []
    references, terms = run.channels['reference'], run.channels['terms']
    places = np.flatnonzero(carried & (steps.terms >= 0))
    answered = steps.terms[places]
    meant = by_stamp(references, steps.stamp[places], terms.log_time[answered])
    early = (meant >= 0) & (references.publish_time[meant] < terms.publish_time[answered])
    if early.any():
        text += (f'; in {np.count_nonzero(early)} of these cases the one meant for it had been '
                 'published before the command, but had not reached the controller')
    return [], [text]


def frozen_notes(run: RunData, steps: StepTable) -> list[str]:
    """Return a line for each recorded reason for which adaptation did not advance."""
    terms = run.channels.get('terms')
    rows = steps.terms[steps.terms >= 0]
    if terms is None or not len(rows):
        return []
    status, seq = terms['status'][rows], steps.seq[steps.terms >= 0]
    bits = np.where((status >= 0.0) & (status < 256.0), status, 0.0).astype(np.int64)
    return [f'adaptation was frozen in {np.count_nonzero(bits & flag)} sample(s), first in seq '
            f'{int(seq[((bits & flag) > 0).argmax()])}: {str(flag.name).lower().replace("_", " ")}'
            for flag in Status if (bits & flag).any()]


def _stretches(channel: Channel) -> list[Integers]:
    """Return the distinct seq of each start of a count, ascending."""
    _, own, seq = counted(channel)
    return [np.unique(seq[own == e]) for e in range(int(own[-1]) + 1)] if len(seq) else []


def _unmeasured(run: RunData, channel: Channel) -> list[list[Hole]]:
    """Return the ranges of seq without a measurement, of each start of the actuator's host."""
    rows, own, _ = counted(channel)
    if not len(own):
        return []
    begins = channel.log_time[rows][np.searchsorted(own, np.arange(int(own[-1]) + 1))]
    found: list[list[Hole]] = [[] for _ in begins]
    for time, event in of_kind(run.events, UnmeasuredEvent):
        for item in event.ranges:
            if len(item) == 2 and 0 <= item[0] <= item[1]:
                place = max(int(np.searchsorted(begins, time, 'right')) - 1, 0)
                found[place].append((item[0], item[1]))
    return [sorted(item) for item in found]


def _split(holes: Sequence[Hole], known: Sequence[Hole]) -> tuple[list[Hole], list[Hole]]:
    """Return the parts of holes outside and inside of known ranges, both ascending."""
    outside, inside = [], []
    ranges = deque(known)
    for low, high in holes:
        while ranges and ranges[0][1] < low:
            ranges.popleft()
        at = low
        for start, end in ranges:
            first, last = max(start, at), min(end, high)
            if start > high:
                break
            if first > last:
                continue
            if first > at:
                outside.append((at, first - 1))
            inside.append((first, last))
            at = last + 1
        if at <= high:
            outside.append((at, high))
    return outside, inside


def _count(holes: Sequence[Hole]) -> int:
    """Return how many numbers lie in holes."""
    return sum(high - low + 1 for low, high in holes)


def _holes(seq: Integers) -> list[tuple[int, int]]:
    """Return first and last of each run of seq that is skipped."""
    places = np.flatnonzero(np.diff(seq) > 1)
    return [(int(seq[i]) + 1, int(seq[i + 1]) - 1) for i in places]


def _listed(holes: Sequence[tuple[int, int]]) -> str:
    """Return holes as text, the first few of them."""
    texts = [str(low) if low == high else f'{low} … {high}' for low, high in holes[:SHOWN]]
    return ', '.join(texts) + (f' and {len(holes) - SHOWN} more' if len(holes) > SHOWN else '')

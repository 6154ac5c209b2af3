"""Messages that an audit misses: holes in the seq of a channel, states without an answer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dz_ros.analysis.audit_samples import by_stamp, rows_with_seq, Samples, starts
from dz_ros.analysis.audit_spans import Part
from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.records import Status

Integers = NDArray[np.int64]

SHOWN = 5
"""Holes that are named one by one."""
CHANNELS = ('reference', 'state', 'command', 'terms', 'truth')


def missing_messages(run: RunData, samples: Samples) -> list[str]:
    """Return a line for each channel with holes: how many messages are missing, and which."""
    found = []
    for name in CHANNELS:
        channel = run.channels.get(name)
        if channel is None or not len(channel):
            if name != 'truth' and len(samples.seq):
                found.append(f'{name}: the log has no messages of this channel')
            continue
        holes = []
        if name in ('command', 'terms'):
            at = samples.command if name == 'command' else samples.terms
            for e in range(len(samples.begin_ns)):
                mine = samples.start == e
                seq = samples.seq[mine & (at >= 0)]
                ends = [-1, int(samples.seq[mine].max()) + 1]
                holes += _holes(np.concatenate(([ends[0]], seq, [ends[1]])))
        else:
            for seq in _stretches(channel):
                holes += _holes(seq)
        if holes:
            found.append(f'{name}: {sum(high - low + 1 for low, high in holes)} message(s) '
                         f'missing: seq {_listed(holes)}')
    return found


def state_notes(run: RunData, samples: Samples,
                found: Sequence[Part]) -> tuple[list[str], list[str]]:
    """Return (findings, notes) about states that no command answers.

    In lockstep and off line every state is answered. In real time a state may be passed over for
    a newer one. The last state of a loop that was interrupted may have been on its way.
    """
    channel = run.channels.get('state')
    if channel is None or not len(channel) or not len(samples.seq):
        return [], []
    answered = np.zeros(len(channel), dtype=bool)
    answered[samples.state[samples.state >= 0]] = True
    rows = rows_with_seq(channel)
    seq = channel['seq'][rows].astype(np.int64)
    key = starts(seq) * (1 << 40) + seq
    # A state that was sent again is answered once.
    _, inverse = np.unique(key, return_inverse=True)
    known = np.zeros(int(inverse.max()) + 1, dtype=bool)
    np.logical_or.at(known, inverse, answered[rows])
    left = np.unique(key[~known[inverse]]) % (1 << 40)
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


def reference_notes(run: RunData, samples: Samples,
                    carried: NDArray[np.bool_]) -> tuple[list[str], list[str]]:
    """Return (findings, notes) about references that were not meant for their state.

    In lockstep and off line a state gets the reference of its own stamp. In real time that one may
    come too late for it or not at all; that it was published in time does not mean it arrived.

    Args:
        run: The run.
        samples: Its steps.
        carried: Which of them used a reference of another stamp, shape (N,).
    """
    text = f'{np.count_nonzero(carried)} reference(s) were brought to the stamp of the state'
    if run.info.get('mode', '') in ('lockstep', 'offline'):
        return [f'{text}, the first with seq {int(samples.seq[carried.argmax()])}: a loop in '
                'this mode waits for the one meant for it'], []
    references, terms = run.channels['reference'], run.channels['terms']
    places = np.flatnonzero(carried & (samples.terms >= 0))
    answered = samples.terms[places]
    meant = by_stamp(references, samples.stamp[places], terms.log_time[answered])
    early = (meant >= 0) & (references.publish_time[meant] < terms.publish_time[answered])
    if early.any():
        text += (f'; in {np.count_nonzero(early)} of these cases the one meant for it had been '
                 'published before the command, but had not reached the controller')
    return [], [text]


def frozen_notes(run: RunData, samples: Samples) -> list[str]:
    """Return a line for each recorded reason for which adaptation did not advance."""
    terms = run.channels.get('terms')
    rows = samples.terms[samples.terms >= 0]
    if terms is None or not len(rows):
        return []
    status, seq = terms['status'][rows], samples.seq[samples.terms >= 0]
    bits = np.where((status >= 0.0) & (status < 256.0), status, 0.0).astype(np.int64)
    return [f'adaptation was frozen in {np.count_nonzero(bits & flag)} sample(s), first in seq '
            f'{int(seq[((bits & flag) > 0).argmax()])}: {str(flag.name).lower().replace("_", " ")}'
            for flag in Status if (bits & flag).any()]


def _stretches(channel: Channel) -> list[Integers]:
    """Return the distinct seq of each start of a count, ascending."""
    seq = channel['seq'][rows_with_seq(channel)].astype(np.int64)
    own = starts(seq)
    return [np.unique(seq[own == e]) for e in range(int(own[-1]) + 1)] if len(seq) else []


def _holes(seq: Integers) -> list[tuple[int, int]]:
    """Return first and last of each run of seq that is skipped."""
    places = np.flatnonzero(np.diff(seq) > 1)
    return [(int(seq[i]) + 1, int(seq[i + 1]) - 1) for i in places]


def _listed(holes: Sequence[tuple[int, int]]) -> str:
    """Return holes as text, the first few of them."""
    texts = [str(low) if low == high else f'{low} … {high}' for low, high in holes[:SHOWN]]
    return ', '.join(texts) + (f' and {len(holes) - SHOWN} more' if len(holes) > SHOWN else '')

"""What a log says of a plant: measured states, and which command the actuator held when.

A command acts from its arrival on: the stamp of the state it answers plus the round trip that a
later state reports of it, plus the configured delay in whole samples. Off line and in lockstep
the round trip is 0.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dz_ros.analysis.audit_samples import rows_with_seq
from dz_ros.analysis.setting import state_columns
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.errors import RecordingError

Array = NDArray[np.float64]
Piece = tuple[float, float, float]
"""Begin [s], span [s], command held."""

SEGMENT = 1.0
"""Longest piece of a run that is predicted from one initial state [s]."""
SEGMENTS = (20, 60)
"""So many of them at least, if the run is long enough, and at most."""
SHORTEST = 8
"""Samples that a segment has at least."""


@dataclass(frozen=True)
class Segment:
    """Consecutive samples without a hole.

    Attributes:
        x: Measured states, shape (L + 1, n).
        pieces: For each of the L intervals the commands held, one after the other.
    """

    x: Array
    pieces: tuple[tuple[Piece, ...], ...]


def arrivals(run: RunData, c: Configuration) -> tuple[list[float], list[float]]:
    """Return the times from which commands act [s], ascending, and the commands.

    Raises:
        RecordingError: The log has no commands or no states.
    """
    state, command = run.channels.get('state'), run.channels.get('command')
    if state is None or command is None or not len(state) or not len(command):
        raise RecordingError('a plant cannot be fitted: the log needs states and commands')
    seq, first = np.unique(command['seq'], return_index=True)
    stamp, v = command['echo_stamp'][first], command['v'][first]
    trip = np.full(len(seq), np.nan)
    echoed = np.searchsorted(seq, state['echo_seq'])
    known = (echoed < len(seq)) & (seq[np.minimum(echoed, len(seq) - 1)] == state['echo_seq'])
    trip[echoed[known]] = state['round_trip'][known]
    # One that was overtaken by the next: as long as usual.
    usual = float(np.nanmedian(trip)) if np.isfinite(trip).any() else 0.0
    at = stamp + np.where(np.isfinite(trip), trip, usual)
    if c.loop.delay:
        at = (np.round(at / c.loop.period) + c.loop.delay) * c.loop.period
    if c.plant_settings.command_limit > 0.0:
        v = np.clip(v, -c.plant_settings.command_limit, c.plant_settings.command_limit)
    good = np.isfinite(at) & np.isfinite(v)
    order = np.argsort(at[good], kind='stable')
    return at[good][order].tolist(), v[good][order].tolist()


def segments(run: RunData, c: Configuration) -> list[Segment]:
    """Return a run as segments, evenly chosen where it is long.

    Raises:
        RecordingError: The log has no commands, or too few states in a row.
    """
    times, commands = arrivals(run, c)
    state = run.channels['state']
    rows = rows_with_seq(state)
    distinct, first = np.unique(state['seq'][rows], return_index=True)
    rows = rows[first]
    t = state['stamp'][rows]
    x = state.values[rows][:, state_columns(state.labels)]
    step = np.diff(t)
    good = np.isfinite(t) & np.isfinite(x).all(axis=1)
    joined = ((np.diff(distinct) == 1) & good[1:] & good[:-1] & (step > 0.0)
              & (step < 5.0 * c.loop.period))
    length = int(min(SEGMENT / c.loop.period, max(len(rows) // SEGMENTS[0], SHORTEST)))
    found: list[tuple[int, int]] = []
    edges = [-1, *np.flatnonzero(~joined).tolist(), len(rows) - 1]
    for before, last in pairwise(edges):
        # No state belongs to two segments: its noise would tie them together.
        begins = range(before + 1, last - min(length, SHORTEST) + 1, length + 1)
        found += [(begin, min(begin + length, last)) for begin in begins]
    if not found:
        raise RecordingError(f'a plant cannot be fitted: the log has no {SHORTEST} states in a '
                             'row')
    if len(found) > SEGMENTS[1]:
        chosen = np.linspace(0, len(found) - 1, SEGMENTS[1]).round().astype(int)
        found = [found[i] for i in chosen]
    stamps = t.tolist()
    return [Segment(x[begin:end + 1], tuple(
        _pieces(stamps[k], stamps[k + 1], times, commands) for k in range(begin, end)))
        for begin, end in found]


def _pieces(begin: float, end: float, times: list[float],
            commands: list[float]) -> tuple[Piece, ...]:
    """Return the commands held from one instant to another."""
    place = bisect_right(times, begin + 1e-9)
    found = []
    while True:
        held = commands[place - 1] if place else 0.0
        until = times[place] if place < len(times) and times[place] < end - 1e-9 else end
        if until > begin:
            found.append((begin, until - begin, held))
        if until == end:
            return tuple(found)
        begin = until
        place += 1

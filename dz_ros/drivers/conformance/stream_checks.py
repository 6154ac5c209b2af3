# SPDX-License-Identifier: Apache-2.0
"""Checks of a stream of states by itself: seq, stamps, echoes, rate, latency (ours).

Part of the conformance kit; ``nodes/check_node.py`` receives the states. Gaps and late echoes in a
stretch in which the machine did not run its processes count against no driver, and are named.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
import math
import statistics

from dz_ros.core.records import State
from dz_ros.drivers.conformance.machine import lateness, overlap, Stall
from dz_ros.drivers.conformance.result import Result

RATE_TOLERANCE = 0.01
"""The rate may be wrong by this share."""
PACE_TOLERANCE = 0.03
"""Loop time may run faster or slower than the wall by this share."""
MOST_GAPS_SHARE, MOST_MISSING_SHARE = 0.02, 0.1
"""Largest share of gaps in seq, and of samples missing in time, on a busy machine."""
SHORT_TRIP_SHARE, MOST_SHORT_SHARE = 0.8, 0.05
"""A round trip below this share of what its answer took is too short; largest share of those."""
STALLED_SHARE = 0.5
"""A stall of this share of T between two states excuses what is missing between them."""
ECHO_SAMPLES = 3
"""A command must be echoed within this number of samples after the state it answers."""


def check_stream(states: Sequence[State], arrivals: Sequence[float], commands: Mapping[int, float],
                 period: float, order: int, taken: Mapping[int, float] | None = None,
                 stalls: Sequence[Stall] = ()) -> Iterator[Result]:
    """Yield what the received states show.

    Args:
        states: In the order of their arrival.
        arrivals: When they arrived, by a steady clock [s], shape as of `states`.
        commands: seq → stamp of the commands sent meanwhile.
        period: T [s].
        order: n.
        taken: seq → how long after the state it answers arrived each command was sent [s].
        stalls: When the machine did not run a process that only waits.
    """
    count = len(states)
    bad = [item for item in states if not all(map(math.isfinite, item.numbers()))]
    yield Result('order and labels', not bad, f'{count} states of order {order}', 'all finite',
                 f'state {bad[0].seq} is not finite' if bad else '')
    if count < 20 or bad:
        yield Result('rate', False, f'{count} states', '>= 20', 'too few to judge'
                     if not bad else 'not judged')
        return
    # A state that a stall held back arrives after it, so look a period back.
    excused = [overlap(stalls, before - period, after) >= STALLED_SHARE * period
               for before, after in pairwise(arrivals)]
    for result in (_seq(states, excused), _stamps(states, period),
                   _echo(states, commands, excused), _rate(states, arrivals, period, excused),
                   _latency(states, period, taken or {})):
        late = lateness(stalls) if result.passed is False else ''
        yield replace(result, words='; '.join(filter(None, (result.words, late))))


def _while_late(count: int) -> str:
    return f' and {count} while the machine was late' if count else ''


def _seq(states: Sequence[State], excused: Sequence[bool]) -> Result:
    steps = [after.seq - before.seq for before, after in pairwise(states)]
    wrong = sum(step < 1 for step in steps)
    gaps = sum(step > 1 and not machine for step, machine in zip(steps, excused, strict=True))
    more = sum(step > 1 and machine for step, machine in zip(steps, excused, strict=True))
    allowed = max(2, round(MOST_GAPS_SHARE * len(steps)))
    passed = not wrong and gaps <= allowed
    return Result('seq', passed, f'{wrong} back or repeated, {gaps} gaps{_while_late(more)}',
                  f'0, <= {allowed}', '' if passed else 'seq must count each state by one')


def _stamps(states: Sequence[State], period: float) -> Result:
    off = max(abs(item.stamp / period - round(item.stamp / period)) * period for item in states)
    back = sum(after.stamp <= before.stamp
               for before, after in pairwise(states))
    passed = not back and off < 0.1 * period
    return Result('stamps', passed, f'{back} back, off k·T by {off * 1e3:.3f} ms',
                  f'0, < {100 * period:.3g} ms',
                  '' if passed else 'stamp is loop time, k·T at sample k')


def _echo(states: Sequence[State], commands: Mapping[int, float],
          excused: Sequence[bool]) -> Result:
    """The echo must be of the newest command that was sent, with its stamp."""
    unknown = [item for item in states if item.echo_seq not in commands and item.echo_seq != -1]
    wrong = [item for item in states if item.echo_seq in commands
             and item.echo_stamp != commands[item.echo_seq]]
    back = sum(after.echo_seq < before.echo_seq
               for before, after in pairwise(states))
    late = more = 0
    for index in range(ECHO_SAMPLES, len(states)):
        # By now at least one command must have come that answers a state that old.
        behind = states[index].echo_stamp < states[index - ECHO_SAMPLES].stamp - 1e-9
        machine = any(excused[index - ECHO_SAMPLES:index])
        late += behind and not machine
        more += behind and machine
    allowed = max(3, round(0.05 * len(states)))
    words = ('echoes a command that was not sent' if unknown else
             'echo_stamp is not that of the command' if wrong else
             'echoes go back' if back else
             'commands are echoed late or not at all' if late > allowed else '')
    return Result('echo', not words, f'{len(unknown) + len(wrong) + back} wrong, {late} late'
                  f'{_while_late(more)}', f'0, <= {allowed}', words)


def _rate(states: Sequence[State], arrivals: Sequence[float], period: float,
          excused: Sequence[bool]) -> Result:
    """By the stamps and by the wall clock."""
    typical = statistics.median(after.stamp - before.stamp for before, after in pairwise(states))
    span, wall = states[-1].stamp - states[0].stamp, arrivals[-1] - arrivals[0]
    pace = span / wall if wall > 0.0 else math.inf
    lost = sum(max(after.stamp - before.stamp - period, 0.0) for (before, after), machine
               in zip(pairwise(states), excused, strict=True) if machine)
    skipped = 1.0 - ((len(states) - 1) * period + lost) / span if span > 0.0 else 1.0
    wrong_rate = abs(typical - period) > RATE_TOLERANCE * period
    words = ('samples must be a period apart' if wrong_rate else
             'loop time must run as the wall does' if abs(pace - 1.0) > PACE_TOLERANCE else
             'too many samples are missing' if skipped > MOST_MISSING_SHARE else '')
    rate = 1.0 / typical if typical > 0.0 else 0.0
    more = _while_late(round(lost / period))
    return Result('rate', not words, f'{rate:.2f} Hz by stamps, '
                  f'{pace:.3f} of the wall, {100.0 * max(skipped, 0.0):.1f} % missing{more}',
                  f'{1.0 / period:g} Hz within {RATE_TOLERANCE:.0%}, '
                  f'1 within {PACE_TOLERANCE:.0%}, <= {MOST_MISSING_SHARE:.0%}', words)


def _latency(states: Sequence[State], period: float, taken: Mapping[int, float]) -> Result:
    """No round trip is shorter than its answer took; the kit holds some back on purpose."""
    trips = sorted(item.round_trip for item in states)
    middle, late = trips[len(trips) // 2], trips[int(0.99 * (len(trips) - 1))]
    known = [(after.round_trip, taken[after.echo_seq]) for before, after in pairwise(states)
             if after.echo_seq != before.echo_seq and after.echo_seq in taken]
    short = sum(trip < SHORT_TRIP_SHARE * own for trip, own in known)
    allowed = max(2, round(MOST_SHORT_SHARE * len(known)))
    words = ('round_trip is the time from publishing a state to the arrival of its command'
             if not (0.0 < middle <= period and trips[0] >= 0.0) else
             'round_trip does not show the time the answers took' if short > allowed else '')
    return Result('latency', not words, f'round trip p50 {middle * 1e3:.3f} ms, p99 '
                  f'{late * 1e3:.3f} ms, {short} of {len(known)} shorter than the answer took',
                  f'0 < p50 <= {period * 1e3:g} ms, <= {allowed}', words)

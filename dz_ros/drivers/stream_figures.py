"""What a stream of states shows by itself: seq, stamps, echoes, rate, latency (ours).

Part of the conformance kit; ``nodes/check_node.py`` hears the states.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
import math
import statistics

from dz_ros.core.records import State
from dz_ros.drivers.conformance import Result

RATE = 0.01
"""The rate may be wrong by this share."""
PACE = 0.03
"""Loop time may run faster or slower than the wall by this share."""
SKIPPED, MISSING = 0.02, 0.1
"""Largest share of gaps in seq, and of samples missing in time, on a busy machine."""
TOO_SHORT, SHORT = 0.8, 0.05
"""A round trip below this share of what its answer took is too short; so many may be."""
LATE_ECHO = 3
"""A command must be echoed so many samples after the state it answers."""


def figures(states: Sequence[State], arrivals: Sequence[float], commands: Mapping[int, float],
            period: float, order: int,
            taken: Mapping[int, float] | None = None) -> Iterator[Result]:
    """Yield what the states heard say.

    Args:
        states: In the order of their arrival.
        arrivals: When they arrived, by a steady clock [s], shape as of `states`.
        commands: seq → stamp of the commands sent meanwhile.
        period: T [s].
        order: n.
        taken: seq → how long after hearing the state it answers each command was sent [s].
    """
    count = len(states)
    bad = [item for item in states if not all(map(math.isfinite, item.numbers()))]
    yield Result('order and labels', not bad, f'{count} states of order {order}', 'all finite',
                 f'state {bad[0].seq} is not finite' if bad else '')
    if count < 20 or bad:
        yield Result('rate', False, f'{count} states', '>= 20', 'too few to judge'
                     if not bad else 'not judged')
        return
    yield _seq(states)
    yield _stamps(states, period)
    yield _echo(states, commands)
    yield _rate(states, arrivals, period)
    yield _latency(states, period, taken or {})


def _seq(states: Sequence[State]) -> Result:
    steps = [after.seq - before.seq for before, after in pairwise(states)]
    wrong = sum(step < 1 for step in steps)
    gaps = sum(step > 1 for step in steps)
    allowed = max(2, round(SKIPPED * len(steps)))
    passed = not wrong and gaps <= allowed
    return Result('seq', passed, f'{wrong} back or repeated, {gaps} gaps', f'0, <= {allowed}',
                  '' if passed else 'seq must count each state by one')


def _stamps(states: Sequence[State], period: float) -> Result:
    off = max(abs(item.stamp / period - round(item.stamp / period)) * period for item in states)
    back = sum(after.stamp <= before.stamp
               for before, after in pairwise(states))
    passed = not back and off < 0.1 * period
    return Result('stamps', passed, f'{back} back, off k·T by {off * 1e3:.3f} ms',
                  f'0, < {100 * period:.3g} ms',
                  '' if passed else 'stamp is loop time, k·T at sample k')


def _echo(states: Sequence[State], commands: Mapping[int, float]) -> Result:
    """The echo must be of a command that was sent, with its stamp, and the newest one."""
    unknown = [item for item in states if item.echo_seq not in commands and item.echo_seq != -1]
    wrong = [item for item in states if item.echo_seq in commands
             and item.echo_stamp != commands[item.echo_seq]]
    back = sum(after.echo_seq < before.echo_seq
               for before, after in pairwise(states))
    late = 0
    for index in range(LATE_ECHO, len(states)):
        # By now at least one command must have come that answers a state so long ago.
        late += states[index].echo_stamp < states[index - LATE_ECHO].stamp - 1e-9
    allowed = max(3, round(0.05 * len(states)))
    words = ('echoes a command nobody sent' if unknown else
             'echo_stamp is not that of the command' if wrong else
             'echoes go back' if back else
             'commands are echoed late or not at all' if late > allowed else '')
    return Result('echo', not words, f'{len(unknown) + len(wrong) + back} wrong, {late} late',
                  f'0, <= {allowed}', words)


def _rate(states: Sequence[State], arrivals: Sequence[float], period: float) -> Result:
    """By the stamps and by the clock on the wall."""
    typical = statistics.median(after.stamp - before.stamp for before, after in pairwise(states))
    span, wall = states[-1].stamp - states[0].stamp, arrivals[-1] - arrivals[0]
    pace = span / wall if wall > 0.0 else math.inf
    skipped = 1.0 - (len(states) - 1) * period / span if span > 0.0 else 1.0
    words = ('samples must be a period apart' if abs(typical - period) > RATE * period else
             'loop time must run as the wall does' if abs(pace - 1.0) > PACE else
             'too many samples are missing' if skipped > MISSING else '')
    rate = 1.0 / typical if typical > 0.0 else 0.0
    return Result('rate', not words, f'{rate:.2f} Hz by stamps, '
                  f'{pace:.3f} of the wall, {100.0 * max(skipped, 0.0):.1f} % missing',
                  f'{1.0 / period:g} Hz within {RATE:.0%}, 1 within {PACE:.0%}, '
                  f'<= {MISSING:.0%}', words)


def _latency(states: Sequence[State], period: float, taken: Mapping[int, float]) -> Result:
    """What the node says of the round trip, against what the answering end knows of it.

    The node's clock starts before the state is heard and stops after its command is sent, so no
    round trip is shorter than its command took to be answered; the kit holds some back on purpose.
    """
    trips = sorted(item.round_trip for item in states)
    middle, late = trips[len(trips) // 2], trips[int(0.99 * (len(trips) - 1))]
    told = [(after.round_trip, taken[after.echo_seq]) for before, after in pairwise(states)
            if after.echo_seq != before.echo_seq and after.echo_seq in taken]
    short = sum(trip < TOO_SHORT * own for trip, own in told)
    allowed = max(2, round(SHORT * len(told)))
    words = ('round_trip is the time from publishing a state to the arrival of its command'
             if not (0.0 < middle <= period and trips[0] >= 0.0) else
             'round_trip does not show the time the answers took' if short > allowed else '')
    return Result('latency', not words, f'round trip p50 {middle * 1e3:.3f} ms, p99 '
                  f'{late * 1e3:.3f} ms, {short} of {len(told)} shorter than the answer took',
                  f'0 < p50 <= {period * 1e3:g} ms, <= {allowed}', words)

# SPDX-License-Identifier: Apache-2.0
"""The four nodes in real time, recorded, beside the least there can be in the same run.

    python benchmarks/loop.py [--quick] [--rounds N] [--only PART]

latency    round trip state → command → plant against bare two-process echoes, and against an
           echo in the idle time of the same processes; ticks against a bare absolute-deadline
           loop
polling    the loop with `process.poll`, and with both ends on any core, beside the loop as it is
           by itself: round trip, ticks, CPU
cpu        share of a core of the nodes against bare nodes that send the same, recorded as well
kilohertz  1 kHz for a minute in all against the bare deadline loop
rates      the highest rate that holds
soak       ten minutes at 200 Hz: what is lost, how memory grows

The first four take short turns with their peers: a machine that others share changes from one
second to the next, so only what is measured within seconds is compared. A row is the median of the
ratios of the turns with its 90 % interval.

Over 300 lines: its parts share loop, peers and turns of one run.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import statistics
import sys
import tempfile

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit import running  # noqa: E402
from benchmarks.speed_kit.rows import brief, in_turns, Row, say, show, spread  # noqa: E402
from dz_ros.runtime.privileges import usable_cores  # noqa: E402

ECHOES = {'events, UDP': ('events', 'UDPv4'), 'events, shared memory': ('events', ''),
          'wait set, UDP': ('wait', 'UDPv4'), 'plain': ('plain', '')}
"""Echo → way and transport; the best of all but `plain` is the floor."""
PARTS = ('latency', 'polling', 'cpu', 'kilohertz', 'rates', 'soak')
TURNS = 10
"""Turns of loop and peers."""
RATES = (1000.0, 1250.0, 1500.0, 2000.0, 2500.0, 3000.0)
LOWER = (800.0, 667.0, 500.0, 400.0, 333.0, 250.0, 200.0)
"""Rates tried upwards; where not even the first holds, downwards [Hz]."""
LATE_SHARE = 0.005
PRIORITY = 50
"""Of SCHED_FIFO, where it is permitted."""


def latency(folder: Path, rounds: int, quick: bool) -> list[Row]:
    """Return round trips and ticks against bare ones, in turns."""
    seconds = 2.0
    permitted = not quick and not running.refused('--priority', str(PRIORITY))
    kinds = {name: spread(running.echo(*ECHOES[name], seconds), 1e6)
             for name in ECHOES if not quick or name in ('events, UDP', 'plain')}
    floor = min((name for name in kinds if name != 'plain'), key=lambda n: kinds[n]['p50'])
    found: dict[str, list[list[float]]] = {name: [] for name in ('loop', 'echo', 'plain', 'fifo',
                                                                 'period', 'bare', 'woven',
                                                                 'between')}
    late = too_late = samples = 0
    for turn in range(rounds):
        found['echo'].append(running.echo(*ECHOES[floor], seconds))
        own = running.loop(2.0 * seconds, folder / f'loop-{turn}')
        found['loop'].append(own.round_trips)
        found['period'].append(own.deviations)
        found['bare'].append(running.bare_ticks(seconds + 0.5))
        woven, between = running.interleaved(seconds, folder / f'woven-{turn}')
        found['woven'].append(woven)
        found['between'].append(between)
        if turn < rounds // 2 or rounds == 1:
            found['plain'].append(running.echo(*ECHOES['plain'], seconds))
        if permitted and turn < rounds // 2:
            found['fifo'].append(running.loop(seconds, folder / f'first-{turn}',
                                              f'process.priority={PRIORITY}').round_trips)
        late, too_late, samples = (late + own.late, too_late + own.too_late,
                                   samples + own.samples)
        say(f'turn {turn + 1} of {rounds}: p50 ' + ', '.join(
            f'{name} {1e6 * statistics.median(turns[-1]):.0f}' for name, turns in found.items()
            if turns) + ' µs')
    spreads = {name: [spread(turn, 1e6) for turn in turns] for name, turns in found.items()}

    def ratios(name: str, peer: str, key: str) -> list[float]:
        return [one[key] / other[key]
                for one, other in zip(spreads[name], spreads[peer], strict=False)]

    def pooled(name: str) -> str:
        return f'{name} {brief(spread([item for turn in found[name] for item in turn], 1e6))}'

    rows = [
        in_turns('round trip over the bare echo, p50', ratios('loop', 'echo', 'p50'), 1.15,
                 detail=f'{pooled("loop")}; {pooled("echo")} ({floor})'),
        in_turns('round trip over the bare echo, p99', ratios('loop', 'echo', 'p99'), 1.3),
        *(in_turns(f'round trip over an echo in the same processes between the samples, {key}',
                   ratios('woven', 'between', key), detail='' if key == 'p99' else
                   f'{pooled("woven")}; {pooled("between")}') for key in ('p50', 'p99')),
        in_turns('round trip over the plain echo, p50', ratios('loop', 'plain', 'p50'), 0.75,
                 detail=pooled('plain')),
        in_turns('ticks, |period − T| over a bare deadline loop, p50',
                 ratios('period', 'bare', 'p50'),
                 detail=f'{pooled("period")}; {pooled("bare")}'),
        in_turns('ticks, |period − T| over a bare deadline loop, p99',
                 ratios('period', 'bare', 'p99'), 1.2),
        Row('ticks too late', too_late, 0.0, 'of them'),
        Row('ticks late', 100.0 * late / samples, 0.2, '%', detail=f'{late} of {samples}')]
    if found['fifo']:
        rows += [in_turns(f'round trip with `process.priority: {PRIORITY}` over the echo without, '
                          f'{key}', ratios('fifo', 'echo', key),
                          detail=pooled('fifo') if key == 'p50' else '')
                 for key in ('p50', 'p99')]
    return rows + [Row(f'another echo ({name}) over the best, p50, one turn',
                       kinds[name]['p50'] / kinds[floor]['p50'], detail=brief(kinds[name]))
                   for name in kinds if name not in (floor, 'plain')]


def polling(folder: Path, rounds: int, quick: bool) -> list[Row]:
    """Return what `process.poll` and cores of their own change, in turns."""
    cores = ','.join(map(str, usable_cores()))
    settings = {'none': 'process.poll=none', 'plant': 'process.poll=plant',
                'both': 'process.poll=both', 'cores': f'process.cores={cores}'}
    choices = tuple(settings)
    found: dict[str, list[running.Measured]] = {name: [] for name in choices}
    for turn in range(rounds):
        first = turn % len(choices)
        for name in choices[first:] + choices[:first]:
            found[name].append(running.loop(3.0 if quick else 4.0, folder / f'{name}-{turn}',
                                            settings[name]))
        say(f'turn {turn + 1} of {rounds}: round trip p50 ' + ', '.join(
            f'{name} {1e6 * statistics.median(turns[-1].round_trips):.0f}'
            for name, turns in found.items()) + ' µs')
    rows = []
    for name in choices[1:]:
        label = settings[name].replace('=', ': ')
        for what, values in (('round trip', 'round_trips'), ('ticks, |period − T|', 'deviations')):
            spreads = {item: [spread(getattr(turn, values), 1e6) for turn in found[item]]
                       for item in ('none', name)}
            for key in ('p50', 'p99'):
                rows.append(in_turns(
                    f'`{label}` over the loop by itself: {what}, {key}',
                    [one[key] / other[key] for one, other in zip(spreads[name], spreads['none'],
                                                                 strict=True)],
                    detail='; '.join(f'{item} {statistics.median(turn[key] for turn in turns):.0f}'
                                     ' µs' for item, turns in spreads.items())))
        for node in ('plant_node', 'controller_node'):
            shares = {item: [100.0 * turn.shares[node] for turn in found[item]]
                      for item in ('none', name)}
            rows.append(in_turns(f'`{label}`: CPU of {node} more than by itself',
                                 [one - other for one, other in zip(shares[name], shares['none'],
                                                                    strict=True)],
                                 unit='% of a core'))
    return rows


def cpu(folder: Path, rounds: int, quick: bool) -> list[Row]:
    """Return shares of a core against bare nodes, in turns."""
    seconds = 2.0 if quick else 4.0
    own, bare, among = [], [], []
    for turn in range(rounds):
        own.append(running.loop(seconds, folder / f'cpu-{turn}').shares)
        bare.append(running.bare_loop(seconds, folder / f'bare-{turn}'))
        among.append(running.stood_in(seconds, folder / f'stood-in-{turn}').shares)
        say(f'turn {turn + 1} of {rounds}: controller {100 * own[-1]["controller_node"]:.1f} %, '
            f'bare {100 * bare[-1]["controller_node"]:.1f} %, '
            f'among ours {100 * among[-1]["controller_node"]:.1f} %')

    def words(turns: list[dict[str, float]]) -> str:
        return ', '.join(f'{name.removesuffix("_node")} '
                         f'{100 * statistics.median(turn[name] for turn in turns):.1f} %'
                         for name in turns[0])

    def ratios(peers: list[dict[str, float]]) -> list[float]:
        return [one['controller_node'] / other['controller_node']
                for one, other in zip(own, peers, strict=True)]

    return [in_turns('CPU of controller_node over a bare node', ratios(bare), 1.3,
                     detail=f'bare nodes: {words(bare)}'),
            in_turns('CPU of controller_node over a bare node in its place among our nodes',
                     ratios(among), detail=words(among)),
            in_turns('CPU of all four nodes', [100.0 * sum(turn.values()) for turn in own], 30.0,
                     unit='% of a core', detail=words(own))]


def kilohertz(folder: Path, rounds: int, quick: bool, *settings: str) -> list[Row]:
    """Return how 1 kHz goes beside the bare deadline loop, in turns."""
    seconds = 3.0 if quick else 60.0 / rounds
    found, alone = running.Measured(), []
    for turn in range(rounds):
        own = running.loop(seconds, folder / f'{len(settings)}-{turn}', 'loop.rate=1000.0',
                           *settings)
        alone += running.bare_ticks(seconds, 1000.0)
        found.add(own)
        say(f'1 kHz, turn {turn + 1} of {rounds}: {rate_words(own)}')
    behind = sum(int(item / 1e-3) for item in alone)
    name = f'1 kHz with `{settings[0]}`' if settings else '1 kHz'
    least = 100.0 * sum(item > 1e-3 for item in alone) / len(alone)
    return [Row(f'{name}: late', 100.0 * found.late / found.samples,
                None if settings else 0.1, '%',
                detail=f'{rate_words(found)}; a bare deadline loop in the same turns: '
                f'{least:.3g} % late, {behind} periods in all, max {1e6 * max(alone):.0f} µs'),
            Row(f'{name}: skipped or unanswered', found.skipped + found.unanswered,
                None if settings else float(behind), 'samples',
                detail='at most the periods by which the bare loop was late'),
            Row(f'{name}: lost', found.lost, None if settings else 0.0, 'messages')]


def holds(found: running.Measured) -> bool:
    """Whether a rate is held."""
    return gone(found) == 0 and found.late <= LATE_SHARE * found.samples


def gone(found: running.Measured) -> int:
    """Return how much was lost in any way."""
    return found.lost + found.unanswered + found.skipped


def rate_words(found: running.Measured) -> str:
    """Return what became of the samples of a rate."""
    return (f'{found.late} of {found.samples} late, {found.skipped} periods skipped, '
            f'{found.unanswered} unanswered, {found.lost} lost, '
            f'round trip {brief(spread(found.round_trips, 1e6))}')


def rates(folder: Path) -> list[Row]:
    """Return which rate is the highest that holds, also by SCHED_FIFO."""
    rows = [highest(folder / 'normal', 'highest rate that holds for 10 s')]
    if running.refused('--priority', str(PRIORITY)):
        return rows
    first = f'process.priority={PRIORITY}'
    return [*rows, highest(folder / 'fifo', f'highest rate that holds for 10 s with `{first}`',
                           first)]


def highest(folder: Path, name: str, *settings: str) -> Row:
    """Return the highest rate that holds."""
    found: dict[float, running.Measured] = {}

    def held(rate: float) -> bool:
        found[rate] = running.loop(10.0, folder / f'{rate:.0f}', f'loop.rate={rate}', *settings)
        say(f'{rate:.0f} Hz: {rate_words(found[rate])}')
        return holds(found[rate])

    folder.mkdir()
    best = 0.0
    for rate in RATES:
        if not held(rate):
            break
        best = rate
    if not best:
        best = next(filter(held, LOWER), 0.0)
    beyond = min((rate for rate in found if rate > best), default=max(found))
    return Row(name, best, unit='Hz', least=True,
               detail=f'at {beyond:.0f} Hz: {rate_words(found[beyond])}')


def soak(folder: Path, seconds: float = 600.0) -> list[Row]:
    """Return what ten minutes lose and how memory grows."""
    found = running.loop(seconds, folder / 'soak', memory_every=10.0)
    grown = {}
    for name, seen in found.memory.items():
        first = next(size for t, size in seen if t >= min(60.0, 0.1 * seconds))
        grown[name] = (seen[-1][1] - first) / 1e6
    minutes = seconds / 60.0
    return [Row(f'{minutes:.0f} min: lost', found.lost, 0.0, 'messages',
                detail=rate_words(found)),
            *(Row(f'{minutes:.0f} min: growth of the memory of {name} since minute one', size,
                  1.0, 'MB') for name, size in grown.items())]


def measure(quick: bool = False, parts: tuple[str, ...] = PARTS, rounds: int = 0) -> list[Row]:
    """Return the lines of the table."""
    rows = []
    rounds = rounds or (1 if quick else TURNS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if 'latency' in parts:
            rows += latency(folder, rounds, quick)
        if 'polling' in parts:
            rows += polling(folder, rounds, quick)
        if 'cpu' in parts:
            rows += cpu(folder, rounds, quick)
        if 'kilohertz' in parts:
            rows += kilohertz(folder, rounds, quick)
            if not quick and not running.refused('--priority', str(PRIORITY)):
                rows += kilohertz(folder, rounds, quick, f'process.priority={PRIORITY}')
        if 'rates' in parts and not quick:
            rows += rates(folder)
        if 'soak' in parts and not quick:
            rows += soak(folder)
    return rows


def main() -> int:
    """Print the table; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--quick', action='store_true', help='short turns, no long runs')
    parser.add_argument('--only', choices=PARTS, action='append', metavar='PART',
                        help=f'this part alone: {", ".join(PARTS)}')
    parser.add_argument('--rounds', type=int, default=0, help='turns')
    arguments = parser.parse_args()
    print(describe('ros-rclpy', 'ros-rmw-fastrtps-cpp'))
    return show(measure(arguments.quick, tuple(arguments.only or PARTS), arguments.rounds))


if __name__ == '__main__':
    sys.exit(main())

"""The four nodes in real time, recorded, beside the least there can be in the same run.

    python benchmarks/loop.py [--quick] [--only latency|cpu|rates|soak] [--rounds N]

latency  round trip state → command → plant against bare two-process echoes, ticks against a bare
         absolute-deadline loop; they take turns, so that they meet the same machine
cpu      share of a core of the nodes against bare nodes that send the same, recorded as well
rates    1 kHz for a minute, then the highest rate that holds
soak     ten minutes at 200 Hz: what is lost, how memory grows
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
from benchmarks.speed_kit.rows import brief, Row, say, show, spread  # noqa: E402

ECHOES = {'events, UDP': ('events', 'UDPv4'), 'events, shared memory': ('events', ''),
          'wait set, UDP': ('wait', 'UDPv4'), 'plain': ('plain', '')}
"""Echo → way and transport; the best of all but `plain` is the floor."""
PARTS = ('latency', 'cpu', 'rates', 'soak')
RATES = (1000.0, 1250.0, 1500.0, 2000.0, 2500.0, 3000.0)
LOWER = (800.0, 667.0, 500.0, 400.0, 333.0, 250.0, 200.0)
"""Rates tried upwards; where not even the first holds, downwards [Hz]."""
LATE_SHARE = 0.005
PRIORITY = 50
"""Of SCHED_FIFO, where it is permitted."""


def latency(folder: Path, rounds: int, quick: bool) -> list[Row]:
    """Return round trips and ticks against bare ones, in turns."""
    echoes: dict[str, list[list[float]]] = {
        name: [] for name in ECHOES if not quick or name in ('events, UDP', 'plain')}
    loops: list[running.Measured] = []
    ticks: list[list[float]] = []
    first: list[running.Measured] = []
    permitted = not quick and not running.refused('--priority', str(PRIORITY))
    seconds = 3.0 if quick else 4.0
    for turn in range(rounds):
        for name in echoes:
            echoes[name].append(running.echo(*ECHOES[name], seconds))
        loops.append(running.loop(2.0 * seconds, folder / f'loop-{turn}'))
        if permitted:
            first.append(running.loop(2.0 * seconds, folder / f'first-{turn}',
                                      f'process.priority={PRIORITY}'))
        ticks.append(running.bare_ticks(seconds))
        say(f'turn {turn + 1} of {rounds}: loop p50 '
            f'{1e6 * statistics.median(loops[-1].round_trips):.0f} µs, ' + ', '.join(
                f'{name} {1e6 * statistics.median(found[-1]):.0f}'
                for name, found in echoes.items()))
    pooled = {name: spread([item for turn in found for item in turn], 1e6)
              for name, found in echoes.items()}
    own = spread([item for turn in loops for item in turn.round_trips], 1e6)
    floor = min((name for name in pooled if name != 'plain'), key=lambda n: pooled[n]['p50'])
    period = spread([item for turn in loops for item in turn.deviations], 1e6)
    bare = spread([item for turn in ticks for item in turn], 1e6)
    samples = sum(turn.samples for turn in loops)
    late = sum(turn.late for turn in loops)
    beside = f'loop {brief(own)}; echo ({floor}) {brief(pooled[floor])}'
    rows = [
        Row('round trip over the bare echo, p50', own['p50'] / pooled[floor]['p50'], 1.15,
            detail=beside),
        Row('round trip over the bare echo, p99', own['p99'] / pooled[floor]['p99'], 1.3),
        Row('round trip over the plain echo, p50', own['p50'] / pooled['plain']['p50'], 0.75,
            detail=f'plain {brief(pooled["plain"])}'),
        Row('ticks, |period − T| over a bare deadline loop, p99', period['p99'] / bare['p99'], 1.2,
            detail=f'loop {brief(period)}; bare {brief(bare)}'),
        Row('ticks too late', sum(turn.too_late for turn in loops), 0.0, 'of them'),
        Row('ticks late', 100.0 * late / samples, 0.2, '%', detail=f'{late} of {samples}')]
    if first:
        fifo = spread([item for turn in first for item in turn.round_trips], 1e6)
        rows += [Row(f'the same with `process.priority: {PRIORITY}` (the echo without), {key}',
                     fifo[key] / pooled[floor][key], detail=brief(fifo) if key == 'p50' else '')
                 for key in ('p50', 'p99')]
    others = [name for name in pooled if name not in (floor, 'plain')]
    return rows + [Row(f'another echo ({name}) over the best, p50',
                       pooled[name]['p50'] / pooled[floor]['p50'], detail=brief(pooled[name]))
                   for name in others]


def cpu(folder: Path, rounds: int, quick: bool) -> list[Row]:
    """Return shares of a core against bare nodes."""
    seconds = 4.0 if quick else 10.0
    own, bare, stood_in = [], [], []
    for turn in range(rounds):
        own.append(running.loop(seconds, folder / f'cpu-{turn}').shares)
        bare.append(running.bare_loop(seconds, folder / f'bare-{turn}'))
        stood_in.append(running.stood_in(seconds, folder / f'stood-in-{turn}'))
    among = statistics.mean(turn.shares['controller_node'] for turn in stood_in)
    mean = {name: statistics.mean(turn[name] for turn in own) for name in own[0]}
    least = {name: statistics.mean(turn[name] for turn in bare) for name in bare[0]}

    def words(shares: dict[str, float]) -> str:
        return ', '.join(f'{name.removesuffix("_node")} {100 * share:.1f} %'
                         for name, share in shares.items())

    return [Row('CPU of controller_node over a bare node', mean['controller_node']
                / least['controller_node'], 1.3, detail=f'bare nodes: {words(least)}'),
            Row('CPU of controller_node over a bare node in its place among our nodes',
                mean['controller_node'] / among, detail=f'bare node {100 * among:.1f} %'),
            Row('CPU of all four nodes', 100.0 * sum(mean.values()), 35.0, '% of a core',
                detail=words(mean))]


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


def rates(folder: Path, quick: bool) -> list[Row]:
    """Return how 1 kHz goes and which rate is the highest that holds, also by SCHED_FIFO."""
    seconds = 5.0 if quick else 60.0
    long = running.loop(seconds, folder / 'kilohertz', 'loop.rate=1000.0')
    alone = running.bare_ticks(seconds, 1000.0)
    say(f'1 kHz: {rate_words(long)}')
    rows = [Row('1 kHz: late', 100.0 * long.late / long.samples, 100.0 * LATE_SHARE, '%',
                detail=f'{rate_words(long)}; a bare deadline loop after it: '
                f'{sum(item > 1e-3 for item in alone)} of {len(alone)} late, '
                f'max {1e6 * max(alone):.0f} µs'),
            Row('1 kHz: lost, unanswered or skipped', gone(long), 0.0, 'samples')]
    if quick:
        return rows
    rows += [highest(folder / 'normal', 'highest rate that holds for 10 s')]
    if running.refused('--priority', str(PRIORITY)):
        return rows
    first = f'process.priority={PRIORITY}'
    long = running.loop(seconds, folder / 'first', 'loop.rate=1000.0', first)
    say(f'1 kHz, {first}: {rate_words(long)}')
    return [*rows,
            Row(f'1 kHz with `{first}`: late', 100.0 * long.late / long.samples, unit='%',
                detail=rate_words(long)),
            Row(f'1 kHz with `{first}`: lost, unanswered or skipped', gone(long),
                unit='samples'),
            highest(folder / 'fifo', f'highest rate that holds for 10 s with `{first}`', first)]


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
            Row(f'{minutes:.0f} min: growth of the memory of a node since minute one',
                max(grown.values()), 2.0, 'MB', detail=', '.join(
                    f'{name} {size:+.2f}' for name, size in grown.items()))]


def measure(quick: bool = False, parts: tuple[str, ...] = PARTS, rounds: int = 0) -> list[Row]:
    """Return the lines of the table."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if 'latency' in parts:
            rows += latency(folder, rounds or (1 if quick else 2), quick)
        if 'cpu' in parts:
            rows += cpu(folder, rounds or (1 if quick else 2), quick)
        if 'rates' in parts:
            rows += rates(folder, quick)
        if 'soak' in parts and not quick:
            rows += soak(folder)
    return rows


def main() -> int:
    """Print the table; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--quick', action='store_true', help='short turns, no long runs')
    parser.add_argument('--only', choices=PARTS, action='append', help='this part alone')
    parser.add_argument('--rounds', type=int, default=0, help='turns')
    arguments = parser.parse_args()
    print(describe('ros-rclpy', 'ros-rmw-fastrtps-cpp'))
    return show(measure(arguments.quick, tuple(arguments.only or PARTS), arguments.rounds))


if __name__ == '__main__':
    sys.exit(main())

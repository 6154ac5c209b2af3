# SPDX-License-Identifier: Apache-2.0
"""CPU and round trip of n axes in one set of nodes, against one axis and against n sets of nodes.

Every loop is `config/servo.yaml` in real time at 200 Hz, recorded. One set of nodes runs n axes of
it (`loop.axes`); n sets run one axis each, every set in a namespace of its own. Turns alternate,
so that all kinds meet the same machine; CPU is that of plant, trajectory, controller and recorder.

    python benchmarks/axes.py [--axes 1 2 3 6 12] [--turns N] [--duration S] [--no-sets]
    python benchmarks/axes.py --write            write the table into docs/axes.md as well
    python benchmarks/axes.py --axes 1 --before DIR   one axis against that of another checkout,
                                                      `wang2004` side by side

A ratio is the median over the turns of that turn's own, with its 90 % interval.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import contextlib
from pathlib import Path
import queue
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit.processes import cpu_ns, nodes_below  # noqa: E402
from benchmarks.speed_kit.rows import in_turns, spread  # noqa: E402
from benchmarks.speed_kit.running import (  # noqa: E402
    environment,
    judge,
    Measured,
    process,
    SETTLED,
    TIME_OUT,
)
from dz_ros.recording.reader import read_run  # noqa: E402
from dz_ros.runs.axes import each_axis  # noqa: E402

CPU_TARGET, TRIP_TARGET = 2.0, 1.5
"""Six axes take at most these multiples of one: CPU, median of the round trip."""
MOST_SETS = 6
"""Sets of nodes side by side in every turn; more are tried in the first one only."""
SAME_LAW = 'wang2004'
"""What runs where checkouts are compared: its law is the same in all of them."""
PAGE = ROOT / 'docs' / 'axes.md'
BEGIN, END = '<!-- cost: benchmarks/axes.py writes it -->', '<!-- end of cost -->'


def words_of(directory: Path, axes: int = 1, namespace: str = '',
             name: str = 'servo') -> list[str]:
    """Return the command line of a recorded loop that runs until it is interrupted."""
    words = ['-m', 'dz_ros', 'run', name, '--duration', '0', '--record', str(directory)]
    if axes > 1:
        words += ['--set', f'loop.axes=[{", ".join(f"axis{i}" for i in range(axes))}]']
    return words + (['--namespace', namespace] if namespace else [])


def settled(running: subprocess.Popen[str], begun: queue.Queue[str]) -> None:
    """Read the output of a loop; note once that it has run for `SETTLED`, or that it ended."""
    assert running.stdout is not None
    lines, noted = [], False
    for line in running.stdout:
        lines.append(line)
        seen = re.match(r't +([\d.]+) s', line)
        if not noted and seen is not None and float(seen[1]) >= SETTLED:
            noted = True
            begun.put('')
    if not noted:
        begun.put(''.join(lines) or 'a loop has ended')


def run(loops: Sequence[list[str]], directories: Sequence[Path], duration: float,
        checkouts: Sequence[Path] = ()) -> list[tuple[float, Measured]]:
    """Run loops side by side; return of each the share of a core and what it was like.

    Args:
        loops: Command line of each.
        directories: Their recordings.
        duration: [s]
        checkouts: Source trees whose loops they are; empty: this one.

    Raises:
        RuntimeError: They do not all run within `TIME_OUT`.
    """
    begun = queue.Queue[str]()
    with contextlib.ExitStack() as stack:
        started = [stack.enter_context(process(words, {**environment(), 'PYTHONPATH': str(tree)},
                                               tree))
                   for words, tree in zip(loops, checkouts or [ROOT] * len(loops), strict=True)]
        for item in started:
            threading.Thread(target=settled, args=(item, begun), daemon=True).start()
        until = time.monotonic() + TIME_OUT
        for ready in range(len(started)):
            try:
                failure = begun.get(timeout=max(0.0, until - time.monotonic()))
            except queue.Empty:
                failure = f'{ready} of {len(started)} run after {TIME_OUT:g} s'
            if failure:
                raise RuntimeError(failure)
        pids = [nodes_below(item.pid).values() for item in started]
        before, since = [sum(map(cpu_ns, item)) for item in pids], time.monotonic()
        time.sleep(duration)
        after, span = [sum(map(cpu_ns, item)) for item in pids], time.monotonic() - since
        for item in started:
            item.send_signal(signal.SIGINT)
        for item in started:
            item.wait(TIME_OUT)
    found = []
    for directory, begin, end in zip(directories, before, after, strict=True):
        one = Measured()
        judge(one, next(iter(each_axis(read_run(directory)).values())))
        found.append(((end - begin) * 1e-9 / span, one))
    return found


def compare(before: Path, turns: int, duration: float) -> list[str]:
    """Return the lines that compare one axis with that of another checkout, side by side."""
    ratios: list[list[float]] = [[], []]
    for turn in range(turns):
        trees = (before, ROOT) if turn % 2 else (ROOT, before)
        with tempfile.TemporaryDirectory() as folder:
            places = [Path(folder) / f'run{i}' for i in range(2)]
            loops = [words_of(place, namespace=f'loop{i}', name=SAME_LAW)
                     for i, place in enumerate(places)]
            found = dict(zip(trees, run(loops, places, duration, trees), strict=True))
        figures = [(share, statistics.median(seen.round_trips))
                   for share, seen in (found[ROOT], found[before])]
        for now, then, kept in zip(*figures, ratios, strict=True):
            kept.append(now / then)
        print(f'turn {turn + 1}: ' + ', '.join(
            f'{name} {100.0 * share:.1f} % of a core, round trip p50 {1e6 * trip:.0f} us'
            for name, (share, trip) in zip(('now', 'before'), figures, strict=True)), flush=True)
    return [f'Measured on {describe("ros-rclpy", "ros-rmw-fastrtps-cpp")}.', *(
        f'{name} of one axis over that of the other checkout: {in_turns(name, kept).cells()[1]}'
        for name, kept in zip(('CPU', 'round trip p50'), ratios, strict=True))]


def measure(counts: Sequence[int], turns: int, duration: float, sets: bool
            ) -> tuple[dict[tuple[int, bool], list[tuple[float, Measured]]], list[int]]:
    """Return (number of axes, whether as sets of nodes) → a share and a run for each turn.

    And the numbers of sets that did not all start.
    """
    found: dict[tuple[int, bool], list[tuple[float, Measured]]] = {}
    failed: list[int] = []
    for turn in range(turns):
        for count in counts:
            for apart in (False, True) if sets and count > 1 and not (
                    turn and count > MOST_SETS) else (False,):
                with tempfile.TemporaryDirectory() as folder:
                    places = [Path(folder) / f'run{i}' for i in range(count if apart else 1)]
                    loops = ([words_of(place, namespace=f'set{i}')
                              for i, place in enumerate(places)] if apart
                             else [words_of(places[0], count)])
                    try:
                        each = run(loops, places, duration)
                    except RuntimeError as error:
                        if count <= MOST_SETS or not apart:
                            sys.exit(str(error))
                        print(f'{count} sets of nodes: {error}', flush=True)
                        failed.append(count)
                        continue
                whole = Measured()
                for _, item in each:
                    whole.add(item)
                found.setdefault((count, apart), []).append(
                    (sum(share for share, _ in each), whole))
                kind = 'sets of nodes' if apart else 'axes in one set'
                print(f'turn {turn + 1}: {count} {kind}: '
                      f'{100.0 * found[count, apart][-1][0]:.0f} % of a core', flush=True)
    return found, failed


def table(found: dict[tuple[int, bool], list[tuple[float, Measured]]],
          failed: Sequence[int]) -> tuple[list[str], bool]:
    """Return the lines of the table, and whether six axes miss a target."""
    lines = [f'Measured on {describe("ros-rclpy", "ros-rmw-fastrtps-cpp")}.', '',
             '| axes | as | CPU [% of a core] | over one axis | round trip p50 [ms] '
             '| over one axis | p99 [ms] | unanswered | lost | skipped |', f'|{"---|" * 10}']
    one = [(share, statistics.median(item.round_trips)) for share, item in found[1, False]]
    missed = False
    for (count, apart), turns in found.items():
        whole = Measured()
        for _, item in turns:
            whole.add(item)
        trips = [statistics.median(item.round_trips) for _, item in turns]
        shares = [share / own for (share, _), (own, _) in zip(turns, one, strict=False)]
        ratios = [trip / own for trip, (_, own) in zip(trips, one, strict=False)]
        rows = [in_turns('CPU', shares, CPU_TARGET), in_turns('round trip', ratios, TRIP_TARGET)]
        if count == 6 and not apart:
            missed = any(row.missed for row in rows)
        cpu, trip = (row.cells()[1] if count > 1 else '' for row in rows)
        lines.append(
            f'| {count} | {"sets of nodes" if apart else "one set"} '
            f'| {100.0 * statistics.median(share for share, _ in turns):.0f} | {cpu} '
            f'| {1e3 * statistics.median(trips):.2f} | {trip} '
            f'| {1e3 * spread(whole.round_trips)["p99"]:.2f} '
            f'| {whole.unanswered} | {whole.lost} | {whole.skipped} |')
    lines += [f'| {count} | sets of nodes | not all started |{" |" * 7}' for count in failed]
    return lines, missed


def main() -> int:
    """Print the table; return 1 where six axes miss a target."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--axes', type=int, nargs='+', default=[1, 2, 3, 6, 12])
    parser.add_argument('--turns', type=int, default=10)
    parser.add_argument('--duration', type=float, default=5.0, help='of each turn [s]')
    parser.add_argument('--no-sets', action='store_true', help='leave out the sets of nodes')
    parser.add_argument('--write', action='store_true', help=f'write the table into {PAGE.name}')
    parser.add_argument('--before', type=Path, metavar='DIR',
                        help='another checkout; only one axis of it is compared with one of this')
    arguments = parser.parse_args()
    if arguments.before:
        print(*compare(arguments.before.resolve(), arguments.turns, arguments.duration), sep='\n')
        return 0
    counts = sorted({1, *arguments.axes})
    lines, missed = table(*measure(counts, arguments.turns, arguments.duration,
                                   not arguments.no_sets))
    print('', *lines, sep='\n')
    if arguments.write:
        head, _, rest = PAGE.read_text(encoding='utf-8').partition(BEGIN)
        PAGE.write_text('\n'.join([f'{head}{BEGIN}\n', *lines, f'\n{END}'])
                        + rest.partition(END)[2], encoding='utf-8')
    return int(missed)


if __name__ == '__main__':
    sys.exit(main())

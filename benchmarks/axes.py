# SPDX-License-Identifier: Apache-2.0
"""CPU and round trip of n axes in one set of nodes, against one axis and against n sets of nodes.

Every loop is `config/servo.yaml` in real time at 200 Hz, recorded. One set of nodes runs n axes of
it (`loop.axes`); n sets run one axis each, every set in a namespace of its own. Turns alternate,
so that all kinds meet the same machine; CPU is that of plant, trajectory, controller and recorder.

    python benchmarks/axes.py [--axes 1 2 3 6 12] [--turns N] [--duration S] [--no-sets]
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


def words_of(directory: Path, axes: int = 1, namespace: str = '') -> list[str]:
    """Return the command line of a recorded loop that runs until it is interrupted."""
    words = ['-m', 'dz_ros', 'run', 'servo', '--duration', '0', '--record', str(directory)]
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


def run(loops: Sequence[list[str]], directories: Sequence[Path],
        duration: float) -> tuple[float, Measured]:
    """Run loops side by side; return the share of a core that they take, and what they were like.

    Args:
        loops: Command line of each.
        directories: Their recordings.
        duration: [s]
    """
    found, begun = Measured(), queue.Queue[str]()
    with contextlib.ExitStack() as stack:
        started = [stack.enter_context(process(words, environment())) for words in loops]
        for item in started:
            threading.Thread(target=settled, args=(item, begun), daemon=True).start()
        for _ in started:
            failure = begun.get(timeout=TIME_OUT)
            if failure:
                sys.exit(failure)
        pids = [pid for item in started for pid in nodes_below(item.pid).values()]
        before, since = sum(map(cpu_ns, pids)), time.monotonic()
        time.sleep(duration)
        share = (sum(map(cpu_ns, pids)) - before) * 1e-9 / (time.monotonic() - since)
        for item in started:
            item.send_signal(signal.SIGINT)
        for item in started:
            item.wait(TIME_OUT)
    for directory in directories:
        data = read_run(directory)
        one = Measured()
        judge(one, next(iter(each_axis(data).values())))
        found.add(one)
    return share, found


def measure(counts: Sequence[int], turns: int, duration: float,
            sets: bool) -> dict[tuple[int, bool], list[tuple[float, Measured]]]:
    """Return (number of axes, whether as sets of nodes) → a share and a run for each turn."""
    found: dict[tuple[int, bool], list[tuple[float, Measured]]] = {}
    for turn in range(turns):
        for count in counts:
            for apart in (False, True) if sets and count > 1 else (False,):
                with tempfile.TemporaryDirectory() as folder:
                    places = [Path(folder) / f'run{i}' for i in range(count if apart else 1)]
                    loops = ([words_of(place, namespace=f'set{i}')
                              for i, place in enumerate(places)] if apart
                             else [words_of(places[0], count)])
                    found.setdefault((count, apart), []).append(run(loops, places, duration))
                kind = 'sets of nodes' if apart else 'axes in one set'
                print(f'turn {turn + 1}: {count} {kind}: '
                      f'{100.0 * found[count, apart][-1][0]:.0f} % of a core', flush=True)
    return found


def main() -> int:
    """Print the table; return 1 where six axes miss a target."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--axes', type=int, nargs='+', default=[1, 2, 3, 6, 12])
    parser.add_argument('--turns', type=int, default=3)
    parser.add_argument('--duration', type=float, default=8.0, help='of each turn [s]')
    parser.add_argument('--no-sets', action='store_true', help='leave out the sets of nodes')
    arguments = parser.parse_args()
    counts = sorted({1, *arguments.axes})
    found = measure(counts, arguments.turns, arguments.duration, not arguments.no_sets)
    print(f'\nMeasured on {describe("ros-rclpy", "ros-rmw-fastrtps-cpp")}.\n')
    print('| axes | as | CPU [% of a core] | over one axis | round trip p50 [ms] | over one axis '
          '| p99 [ms] | unanswered | lost | skipped |')
    print('|---|---|---|---|---|---|---|---|---|---|')
    one_share, one_trip = 0.0, 0.0
    missed = False
    for (count, apart), turns in found.items():
        share = statistics.median(share for share, _ in turns)
        whole = Measured()
        for _, item in turns:
            whole.add(item)
        trips = sorted(whole.round_trips)
        p50, p99 = trips[len(trips) // 2], trips[int(0.99 * len(trips))]
        if count == 1:
            one_share, one_trip = share, p50
        if count == 6 and not apart:
            missed = share > CPU_TARGET * one_share or p50 > TRIP_TARGET * one_trip
        print(f'| {count} | {"sets of nodes" if apart else "one set"} | {100.0 * share:.0f} '
              f'| {share / one_share:.2f} | {1e3 * p50:.2f} | {p50 / one_trip:.2f} '
              f'| {1e3 * p99:.2f} | {whole.unanswered} | {whole.lost} | {whole.skipped} |')
    return int(missed)


if __name__ == '__main__':
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""How long a thread that computes in Python holds up a sample, by CPython's switch interval.

    python benchmarks/switching.py [--quick]

The loop's thread sleeps to absolute deadlines 5 ms apart, as a node does, beside a thread that
computes all the time without a system call, the worst that the thread of a device (`Feeder`, the
serial line, the CANopen bus) can do; or beside none. On waking up it must have the interpreter's
lock, for which the other one is asked after the switch interval only. Beside nothing the same loop
shows what the machine itself adds. The intervals take turns.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
import threading
import time

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit.rows import brief, Row, show, spread  # noqa: E402
from dz_ros.runtime.process import settle, SWITCH_INTERVAL  # noqa: E402

PERIOD = 0.005
DEFAULT = 0.005
"""CPython's own switch interval [s]."""
INTERVALS = (DEFAULT, 1e-3, SWITCH_INTERVAL)


def late(samples: int, interval: float, beside: bool) -> list[float]:
    """Return how long after its deadlines the loop's thread went on [s]."""
    ended = threading.Event()

    def compute() -> None:
        while not ended.is_set():
            sum(i * i for i in range(1000))

    previous = sys.getswitchinterval()
    sys.setswitchinterval(interval)
    thread = threading.Thread(target=compute, daemon=True)
    if beside:
        thread.start()
    found, start = [], time.monotonic()
    for k in range(1, samples + 1):
        left = start + k * PERIOD - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        found.append(time.monotonic() - start - k * PERIOD)
    ended.set()
    if beside:
        thread.join()
    sys.setswitchinterval(previous)
    return found


def measure(quick: bool = False) -> list[Row]:
    """Return the lines of the table."""
    settle()
    turns, samples = (2, 50) if quick else (5, 200)
    kinds = [(interval, True) for interval in INTERVALS] + [(DEFAULT, False)]
    found: dict[tuple[float, bool], list[float]] = {kind: [] for kind in kinds}
    for _ in range(turns):
        for kind in kinds:
            found[kind] += late(samples, *kind)
    rows = []
    for (interval, beside), delays in found.items():
        ours = beside and interval == SWITCH_INTERVAL
        what = (f'beside a thread that computes, switch interval {1e3 * interval:g} ms'
                + (', that of the nodes' if ours else '') if beside else 'beside no thread')
        delay = spread(delays, 1e3)
        rows.append(Row(f'late after a deadline {what}, p50', delay['p50'],
                        1.0 if ours else None, 'ms',
                        detail=brief(spread(delays, 1e6))))
    return rows


def main() -> int:
    """Print the table; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--quick', action='store_true', help='fewer samples')
    arguments = parser.parse_args()
    print(describe())
    return show(measure(arguments.quick))


if __name__ == '__main__':
    sys.exit(main())

"""How punctual an absolute-deadline loop is on this machine, as this process is set up.

    python -m dz_ros.runtime.probe [--rate HZ] [--duration S] [--priority P] [--cores C,…] [--lock]

Prints JSON: what was refused, and how late the ticks were [s].
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import json
import sys
import time
from typing import Any

from dz_ros.runtime.privileges import ask
from dz_ros.runtime.process import end_with_parent, settle


def lateness(rate: float, duration: float) -> list[float]:
    """Return how late each tick of a loop began, in ascending order [s]."""
    start = time.monotonic()
    found = []
    for k in range(1, max(1, round(rate * duration)) + 1):
        deadline = start + k / rate
        left = deadline - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        found.append(max(time.monotonic() - deadline, 0.0))
    return sorted(found)


def summary(ordered: Sequence[float]) -> dict[str, Any]:
    """Return p50, p99 and the largest of ordered numbers, and how many are beyond 1 ms."""
    last = len(ordered) - 1
    return {'p50': ordered[last // 2], 'p99': ordered[round(0.99 * last)], 'max': ordered[last],
            'late': sum(item > 1e-3 for item in ordered), 'ticks': len(ordered)}


def main(argv: Sequence[str] | None = None) -> int:
    """Measure once."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('--rate', type=float, default=200.0)
    parser.add_argument('--duration', type=float, default=2.0)
    parser.add_argument('--priority', type=int, default=0)
    parser.add_argument('--cores', type=int, nargs='*', default=[])
    parser.add_argument('--lock', action='store_true')
    arguments = parser.parse_args(argv)
    end_with_parent()
    settle()
    refused = ask(arguments.priority, arguments.cores, arguments.lock)
    found = summary(lateness(arguments.rate, arguments.duration))
    sys.stdout.write(json.dumps({'refused': refused, **found}) + '\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())

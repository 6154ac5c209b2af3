# SPDX-License-Identifier: Apache-2.0
"""Punctuality of an absolute-deadline loop on this machine, as this process is set up.

    python -m dz_ros.runtime.probe [--rate HZ] [--duration S] [--priority P] [--cores C,…] [--lock]

Prints JSON: what was refused, and how late each tick was [s], in ascending order.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import json
import sys
import time

from dz_ros.runtime.privileges import ask
from dz_ros.runtime.process import end_with_parent, settle


def lateness(rate: float, duration: float) -> list[float]:
    """Return the lateness of each tick of a loop, in ascending order [s]."""
    start = time.monotonic()
    found = []
    for k in range(1, max(1, round(rate * duration)) + 1):
        deadline = start + k / rate
        left = deadline - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        found.append(max(time.monotonic() - deadline, 0.0))
    return sorted(found)


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
    found = lateness(arguments.rate, arguments.duration)
    sys.stdout.write(json.dumps({'refused': refused, 'lateness': found}) + '\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())

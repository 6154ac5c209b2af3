# SPDX-License-Identifier: Apache-2.0
"""What an idle node of somebody else costs a loop that starts: with shared memory and without.

    python benchmarks/strangers.py               20 starts each; about four minutes
    python benchmarks/strangers.py --write       write the table into docs/topics.md as well

Each start is a recorded loop of a second beside nodes that listen to nothing of it or to its
states. The nodes of the loop use UDP, as they do by default, and shared memory by turns. The
figure of a start is the longest time between two states, by the time at which they were published,
less the period.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import os
from pathlib import Path
import statistics
import subprocess
import sys
import tempfile

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from dz_ros.nodes.ros.middleware import TRANSPORTS  # noqa: E402
from dz_ros.recording.reader import read_run  # noqa: E402

WAYS = {'shared memory': 'DEFAULT', 'UDP': ''}
PERIOD = 0.005
STALL = 0.3
"""A longer pause between two states is the one that Fast DDS makes, a third of a second [s]."""
TIME_OUT = 120.0
BEGIN = '<!-- strangers table: benchmarks/strangers.py writes it -->'
END = '<!-- end of strangers -->'
STRANGER = """
import rclpy, sys
from std_msgs.msg import Float64MultiArray
rclpy.init()
node = rclpy.create_node('stranger_' + sys.argv[1])
if sys.argv[1] == '1':
    node.create_subscription(Float64MultiArray, 'state', lambda message: None, 1)
print('ready', flush=True)
rclpy.spin(node)
"""


@contextlib.contextmanager
def strangers(count: int) -> Iterator[None]:
    """Start ordinary nodes with the middleware as it comes; end them."""
    started = [subprocess.Popen([sys.executable, '-c', STRANGER, str(index)], text=True,
                                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
               for index in range(count)]
    try:
        for process in started:
            assert process.stdout is not None
            process.stdout.readline()
        yield
    finally:
        for process in started:
            process.terminate()
            process.wait(TIME_OUT)


def longest_pause(transport: str) -> float:
    """Return by how much the longest time between two states exceeds the period [s]."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'run'
        subprocess.run([sys.executable, '-m', 'dz_ros', 'run', '--duration', '1', '--record',
                        str(path)], cwd=ROOT, env={**os.environ, TRANSPORTS: transport},
                       capture_output=True, timeout=TIME_OUT, check=False)
        states = read_run(path).channels['state']
        times = sorted(states.publish_time[states['seq'] > 0])
    return float(np.diff(times).max()) / 1e9 - PERIOD


def main() -> int:
    """Print the table; return 1 if a start without shared memory was held up."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--starts', type=int, default=20, help='of each kind')
    parser.add_argument('--write', action='store_true')
    arguments = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    busy = f'load average {os.getloadavg()[0]:.1f} before'
    found: dict[str, list[float]] = {way: [] for way in WAYS}
    with strangers(2):
        for _ in range(arguments.starts):
            for way, transport in WAYS.items():
                found[way].append(longest_pause(transport))
    lines = ['', f'Measured on {describe("ros-rclpy", "ros-rmw-fastrtps-cpp")}, {busy}.', '',
             '| transport of the loop | starts | held up for > 0.3 s | median [ms] | '
             'longest [ms] |',
             '|---|---|---|---|---|']
    for way, pauses in found.items():
        held = sum(pause > STALL for pause in pauses)
        lines.append(f'| {way} | {len(pauses)} | {held} | {1e3 * statistics.median(pauses):.1f} | '
                     f'{1e3 * max(pauses):.1f} |')
    lines.append('')
    print('\n'.join(lines))
    if arguments.write:
        path = ROOT / 'docs' / 'topics.md'
        before, _, rest = path.read_text(encoding='utf-8').partition(BEGIN)
        path.write_text(before + BEGIN + '\n'.join(lines) + END + rest.partition(END)[2],
                        encoding='utf-8')
    return int(any(pause > STALL for pause in found['UDP']))


if __name__ == '__main__':
    sys.exit(main())

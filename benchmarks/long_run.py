# SPDX-License-Identifier: Apache-2.0
"""A run of one hour at 200 Hz, five topics: time and memory of `dz bag info` and `dz report`.

The run is a simulated one repeated end to end, its numbering and times going on, written as the
recorder would have.

    python benchmarks/long_run.py [--hours H] [--keep DIR]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from dz_ros.core.configuration import Configuration  # noqa: E402
from dz_ros.core.dataset import Channel, from_run, RunData  # noqa: E402
from dz_ros.core.loop.offline import simulate  # noqa: E402
from dz_ros.recording.save import save_run  # noqa: E402

LIMIT_SECONDS, LIMIT_BYTES = 60.0, 10 ** 9
PIECE = 600.0
"""Length of what is repeated [s]."""
COUNTED = ('seq', 'stamp', 'echo_seq', 'echo_stamp', 'reference_seq')


def long_run(hours: float) -> RunData:
    """Return a simulated run, repeated to this length."""
    configuration = Configuration.from_flat({'loop.duration': PIECE, 'plant.substeps': 1})
    piece = from_run(simulate(configuration), 1_700_000_000_000_000_000)
    times = round(hours * 3600.0 / PIECE)
    period, samples = configuration.loop.period, configuration.loop.samples
    channels = {}
    for name, channel in piece.channels.items():
        values = np.tile(channel.values[:-1], (times, 1))
        lap = np.repeat(np.arange(times), samples)
        for label in set(COUNTED) & set(channel.labels):
            step = samples * period if label.endswith('stamp') else samples
            values[:, channel.labels.index(label)] += lap * step
        log = np.tile(channel.log_time[:-1], times) + lap * round(samples * period * 1e9)
        channels[name] = Channel(channel.labels, values, log, log)
    flat = {**piece.configuration, 'loop.duration': hours * 3600.0}
    return replace(piece, channels=channels, configuration=flat)


def measure(words: list[str]) -> tuple[float, int]:
    """Return seconds and largest memory [bytes] of one command."""
    begin = time.perf_counter()
    process = subprocess.Popen([sys.executable, '-m', 'dz_ros', *words], cwd=ROOT,
                               stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        sys.exit(f'dz {" ".join(words)} failed')
    return time.perf_counter() - begin, usage.ru_maxrss * 1024


def main() -> int:
    """Write the run, time the commands; return 1 if a limit is exceeded."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--hours', type=float, default=1.0)
    parser.add_argument('--keep', type=Path, metavar='DIR', help='write the run here, keep it')
    arguments = parser.parse_args()
    print(describe('mcap', 'numpy', 'matplotlib'))
    with tempfile.TemporaryDirectory() as folder:
        run = arguments.keep or Path(folder) / 'long'
        child = os.fork()           # what writing takes is not what reading is measured by
        if not child:
            summary = save_run(long_run(arguments.hours), run)
            print(f'{summary.messages} messages, {summary.duration:.0f} s, '
                  f'{summary.bytes / 1e6:.0f} MB', flush=True)
            os._exit(0)
        if os.waitpid(child, 0)[1]:
            return 1
        whole = 0.0
        largest = 0
        for words in (['bag', 'info', str(run)],
                      ['report', str(run), '--out', str(Path(folder) / 'report')]):
            seconds, memory = measure(words)
            whole, largest = whole + seconds, max(largest, memory)
            print(f'dz {" ".join(words[:len(words) - (1 if words[0] == "bag" else 3)]):<8} '
                  f'{seconds:6.1f} s   {memory / 1e6:5.0f} MB')
    met = whole < LIMIT_SECONDS and largest < LIMIT_BYTES
    print(f'both: {whole:.1f} s, at most {largest / 1e6:.0f} MB (target {LIMIT_SECONDS:g} s, '
          f'{LIMIT_BYTES / 1e6:.0f} MB): {"met" if met else "missed"}')
    return 0 if met else 1


if __name__ == '__main__':
    sys.exit(main())

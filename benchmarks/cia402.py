# SPDX-License-Identifier: Apache-2.0
"""The bus of the driver cia402: round trips, old answers, and the loop that tracks through it.

    python benchmarks/cia402.py                  about two minutes
    python benchmarks/cia402.py --write          write the tables into docs/drivers.md as well

The simulated drive is a process of its own on python-can's udp_multicast, on this machine. First
a bare 200 Hz loop without ROS, for several leads of SYNC; then config/cia402.yaml as `dz run` has
it, recorded. Processes run at a nice of −15 where that is allowed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

from machine import describe

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from dz_ros.core.safety.health import Report  # noqa: E402
from dz_ros.drivers.hosted import HostedDriver  # noqa: E402
from dz_ros.files.configurations import load_configuration  # noqa: E402
from dz_ros.recording.reader import read_run  # noqa: E402
from dz_ros.runtime.deadlines import Deadlines  # noqa: E402

OPTIONS = ('driver.bus_options=[port=43777, hop_limit=0]', 'safety.state_hold=40',
           'safety.command_hold=20', 'driver.heartbeat_hold=1.0', 'driver.command_hold=1.0')
"""A port of its own; holds that outlast the stalls of a busy machine, which are to be measured."""
SET = tuple(word for text in OPTIONS for word in ('--set', text))
LEADS = (0.0005, 0.001, 0.0015, 0.0025)
NICE = -15
BEGIN, END = '<!-- cia402 tables: benchmarks/cia402.py writes them -->', '<!-- end of cia402 -->'


def start(*words: str) -> subprocess.Popen[str]:
    """Start a verb of `dz`, its output read by us."""
    return subprocess.Popen([sys.executable, '-m', 'dz_ros', *words], cwd=ROOT, text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


@contextmanager
def drive(said: list[str]) -> Iterator[None]:
    """Have a simulated drive; what it says in the end is added to `said`."""
    process = start('driver', 'emulate', 'cia402', 'cia402', *SET)
    assert process.stdout is not None
    print(process.stdout.readline().strip(), flush=True)
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        said += process.communicate(timeout=30.0)[0].splitlines()


def bare(lead: float, seconds: float) -> list[str]:
    """Return a row for one lead: the driver at 200 Hz without ROS."""
    hosted = HostedDriver(load_configuration('cia402', [*OPTIONS, f'driver.sync_lead={lead}']))
    period = 0.005
    missed, said = 0, []
    with drive(said):
        hosted.open()
        try:
            hosted.enable()
            ticks = Deadlines(period, time.monotonic_ns())
            while ticks.index * period < seconds:
                time.sleep(max(0.0, ticks.remaining()))
                k = ticks.begin()
                hosted.advance(k * period, k)
                missed += hosted.measure(k * period) is None
                hosted.command(2.0 * math.sin(2.0 * k * period), k * period)
                if hosted.fault():
                    raise SystemExit(f'the drive is in fault: {hosted.fault()}')
            report = Report()
            hosted.report(report)
        finally:
            hosted.disable(0.0, 0.0)
            hosted.close()
    found = report.values
    samples, old = int(found['samples']), int(found['samples without a fresh answer'])
    return [f'{lead * 1e3:g}', *(found[f'bus round trip {name} [ms]']
                                 for name in ('p50', 'p99', 'max')),
            f'{100.0 * old / samples:.2f}', f'{100.0 * missed / samples:.2f}',
            f'{100.0 * ticks.late / samples:.2f}']


def through_ros(seconds: float) -> list[list[str]]:
    """Return rows about the loop of config/cia402.yaml, recorded."""
    said: list[str] = []
    with tempfile.TemporaryDirectory(prefix='dz_ros-cia402-') as folder, drive(said):
        path = Path(folder) / 'run'
        process = start('run', 'cia402', *SET, '--set', f'loop.duration={seconds}',
                        '--record', str(path), '--quiet')
        output = process.communicate(timeout=seconds + 90.0)[0]
        if process.returncode:
            raise SystemExit(f'dz run failed:\n{output}')
        data = read_run(path)
    state, terms = data.channels['state'], data.channels['terms']
    trajectory = load_configuration('cia402').trajectory
    error = np.abs(state['x0'] - [trajectory(t)[0] for t in state['stamp']])
    window = state['stamp'] > seconds / 2.0
    trips = state['round_trip'][state['echo_seq'] >= 0] * 1e3
    samples = int(state['seq'][-1]) + 1
    return [['largest error in the second half', f'{error[window].max() * 1e3:.2f} mrad'],
            ['median error in the second half', f'{np.median(error[window]) * 1e3:.2f} mrad'],
            ['state to command at the host, p50, p99',
             f'{np.percentile(trips, 50):.2f}, {np.percentile(trips, 99):.2f} ms'],
            ['samples without a state', f'{samples - len(state["seq"])} of {samples}'],
            ['samples in which the law did not act', f'{int(np.sum(terms["status"] >= 8))}'],
            ['at the drive', next(line for line in said if 'after the SYNC' in line)]]


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    """Return a table as lines of Markdown."""
    return [f'| {" | ".join(line)} |' for line in (head, ['---'] * len(head), *rows)]


def main() -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--seconds', type=float, default=15.0, help='length of each part')
    parser.add_argument('--write', action='store_true')
    arguments = parser.parse_args()
    try:
        os.nice(NICE)
        nice = f', nice {NICE}'
    except PermissionError:
        nice = ''
    busy = f', load average {os.getloadavg()[0]:.1f} before'
    lines = ['', f'Measured on {describe("canopen", "python-can")}{nice}{busy}; '
             f'{arguments.seconds:g} s each.', '']
    lines += table(['sync_lead [ms]', 'SYNC to answer p50 [ms]', 'p99', 'max',
                    'samples with an old answer [%]', 'without any [%]', 'host late > 1 ms [%]'],
                   [bare(lead, arguments.seconds) for lead in LEADS])
    lines += ['', *table(['`dz run cia402`', ''], through_ros(arguments.seconds)), '']
    print('\n'.join(lines))
    if arguments.write:
        path = ROOT / 'docs' / 'drivers.md'
        text = path.read_text(encoding='utf-8')
        before, _, rest = text.partition(BEGIN)
        path.write_text(before + BEGIN + '\n'.join(lines) + '\n' + END + rest.partition(END)[2],
                        encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())

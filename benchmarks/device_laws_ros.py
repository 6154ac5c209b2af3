# SPDX-License-Identifier: Apache-2.0
"""`robust` against `robust_eso` over ROS on the emulated devices `serial` and `cia402`.

    python benchmarks/device_laws_ros.py            print the table; six minutes
    python benchmarks/device_laws_ros.py --write    write it into docs/drivers.md

Each run is `dz run CONFIG --record` at 200 Hz beside `dz driver emulate`, a process of its own, on
a pseudo-terminal or python-can's udp_multicast. The laws take turns, so both meet the same
machine. Errors are those of the published states against the trajectory in the last half of a run,
samples in which the law did not act aside; gains of `robust` as in `benchmarks/device_laws.py`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import signal
import statistics
import subprocess
import sys
import tempfile
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.device_laws import head, PAGE, under_robust  # noqa: E402
from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit.rows import interval  # noqa: E402
from dz_ros.core.configuration import Configuration  # noqa: E402
from dz_ros.files.configurations import load_configuration, write_parameters  # noqa: E402
from dz_ros.recording.reader import read_run  # noqa: E402

NAME = 'laws over ROS'
BEGIN, END = f'<!-- {NAME} -->', f'<!-- end of {NAME} -->'
HOLDS = ('safety.state_hold=40', 'safety.command_hold=20', 'safety.echo_limit=40')
"""Holds that outlast the stalls of a busy machine, which are not what is measured."""
INACTIVE = 8
"""Status of the terms from which on the law did not act."""


def own_keys(name: str, folder: Path) -> list[str]:
    """Return KEY=VALUE of a device's configuration that keeps its bus and line to this run."""
    if name == 'cia402':
        return ['driver.bus_options=[port=43781, hop_limit=0]', 'driver.heartbeat_hold=1.0',
                'driver.command_hold=1.0']
    return [f'driver.port={folder / "line"}']


@contextmanager
def device(name: str, parameters: Path, folder: Path) -> Iterator[None]:
    """Have an emulated device."""
    options = ['-o', f'link={folder / "line"}'] if name == 'serial' else []
    process = subprocess.Popen(
        [sys.executable, '-m', 'dz_ros', 'driver', 'emulate', name, str(parameters), *options],
        cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert process.stdout is not None
    try:
        print(process.stdout.readline().strip(), flush=True)
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30.0)


def run(name: str, c: Configuration, seconds: float) -> tuple[float, float, float]:
    """Return max|x̃| and its root mean square [mrad] and the variation of v per second."""
    with tempfile.TemporaryDirectory(prefix='dz_ros-laws-') as made:
        folder = Path(made)
        write_parameters(c, folder / 'law.yaml')
        parameters = folder / 'device.yaml'
        write_parameters(load_configuration(str(folder / 'law.yaml'), own_keys(name, folder)),
                         parameters)
        with device(name, parameters, folder):
            done = subprocess.run(
                [sys.executable, '-m', 'dz_ros', 'run', str(parameters), '--duration',
                 str(seconds), '--record', str(folder / 'run'), '--quiet'],
                cwd=ROOT, text=True, capture_output=True, check=False,
                timeout=seconds + 90.0)
        if not (folder / 'run').exists():
            raise SystemExit(f'dz run of {name} failed:\n{done.stdout}{done.stderr}')
        channels = read_run(folder / 'run').channels
    state, terms, command = channels['state'], channels['terms'], channels['command']
    acting = set(terms['echo_seq'][terms['status'] < INACTIVE])
    used = (state['stamp'] > seconds / 2.0) & np.isin(state['seq'], list(acting))
    if np.sum(used) < 0.9 * seconds / 2.0 / c.loop.period:
        raise SystemExit(f'the law of {name} did not act in many samples:\n{done.stdout}')
    wanted = np.array([c.trajectory(t)[0] for t in state['stamp'][used]])
    error = 1e3 * np.abs(state['x0'][used] - wanted)
    half = command['stamp'] > seconds / 2.0
    return (float(error.max()), float(np.sqrt(np.square(error).mean())),
            float(np.abs(np.diff(command['v'][half])).sum() / (seconds / 2.0)))


def lines(turns: int, seconds: float) -> list[str]:
    """Return the table of both laws on both devices, in turns."""
    made = head('configuration', 'law', 'largest error [mrad]', 'root mean square [mrad]',
                'variation of v per second')
    ratios = head('`robust` over `robust_eso`', 'largest error', 'root mean square',
                  'variation of v')
    for name in ('serial', 'cia402'):
        c = load_configuration(name, list(HOLDS))
        laws: dict[str, Any] = {'robust': under_robust(c), 'robust_eso': c}
        found: dict[str, list[tuple[float, float, float]]] = {law: [] for law in laws}
        for _ in range(turns):
            for law, item in laws.items():
                found[law].append(run(name, item, seconds))
                print(name, law, found[law][-1], flush=True)
        for law, rows in found.items():
            made.append(f'| `{name}` | `{law}` | '
                        + ' | '.join(shown(column) for column in zip(*rows, strict=True)) + ' |')
        each = [[old / new for old, new in zip(first, second, strict=True)]
                for first, second in zip(found['robust'], found['robust_eso'], strict=True)]
        ratios.append(f'| `{name}` | '
                      + ' | '.join(shown(column) for column in zip(*each, strict=True)) + ' |')
    return [*made, '', *ratios]


def shown(values: Any) -> str:
    """Return a median with its interval."""
    low, high = interval(list(values))
    return f'{statistics.median(values):.3g} ({low:.3g} to {high:.3g})'


def main() -> int:
    """Measure both laws."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--turns', type=int, default=5)
    parser.add_argument('--seconds', type=float, default=14.0, help='length of a run')
    parser.add_argument('--write', action='store_true', help=f'write the table into {PAGE.name}')
    arguments = parser.parse_args()
    found = [f'Measured on {describe("canopen", "python-can", "pyserial")}, load average '
             f'{os.getloadavg()[0]:.1f} before; {arguments.turns} turns of each law, '
             f'{arguments.seconds:g} s a run; medians, in brackets '
             + ('the 90 % interval.' if arguments.turns > 4 else 'the least and the largest.'), '',
             *lines(arguments.turns, arguments.seconds)]
    print('\n'.join(found))
    if arguments.write:
        text = PAGE.read_text(encoding='utf-8')
        before, after = text.split(BEGIN)[0], text.split(END)[1]
        PAGE.write_text(f'{before}{BEGIN}\n' + '\n'.join(found) + f'\n{END}{after}',
                        encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())

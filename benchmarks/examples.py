# SPDX-License-Identifier: Apache-2.0
"""The configurations that ship, run in real time over DDS: figures and pictures for the documents.

    python benchmarks/examples.py            print the table
    python benchmarks/examples.py --write    write docs/examples.md and docs/images
    python benchmarks/examples.py --write NAME …    only these; the page keeps the others

Each run is four processes, recorded and reported as `make demo` does it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
from typing import Any

from machine import describe

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / 'docs' / 'images'
PAGE = ROOT / 'docs' / 'examples.md'
EXAMPLES = {
    'wang2004': "the paper's example, plant (19) as printed",
    'robust_eso': 'the same with the recommended law',
    'zhang_feng1997': 'the plant with velocity in the second term',
    'first_order': 'a first-order plant',
    'servo': 'a servo with viscous and Coulomb friction',
    'pendulum': 'an inverted pendulum',
    'valve_actuator': 'a third-order valve-controlled actuator',
    'step': "a step shaped by a reference model, on the paper's plant",
    'axis': 'a driven mass with friction and a constant force, as identified from a log',
    'thruster': 'a vehicle moved by one thruster, whose dead-zone and slopes follow the voltage',
    'six_axes': 'six servos, each with a dead-zone of its own, in one loop',
    'two_link_arm': 'an arm of two joints, coupled, by the coupled law',
    'rov_planar': 'surge, sway and yaw of a vehicle with four thrusters',
}

PICTURES = {
    'tracking': 'Output and reference of {name} over time',
    'error': 'Tracking error of {name} over time',
    'compare_error': 'Tracking errors of the axes of {name} over time',
    'compare_command': 'Commands of the axes of {name} over time',
}
"""Pictures of a report, of one axis or of several → what they show."""


def dz(*words: str) -> str:
    """Run one `dz` command and return what it prints; stop where it fails."""
    done = subprocess.run([sys.executable, '-m', 'dz_ros', *words], cwd=ROOT, text=True,
                          stdout=subprocess.PIPE, check=False)
    if done.returncode:
        raise SystemExit(f'dz {" ".join(words)} failed with exit code {done.returncode}')
    return done.stdout


def measure(name: str, folder: Path) -> dict[str, Any]:
    """Return what `dz report --json` prints about a recorded real-time run."""
    run = folder / name
    dz('run', name, '--record', str(run), '--quiet')
    found: dict[str, Any] = json.loads(dz('report', str(run), '--json', '--out',
                                          str(folder / f'{name}-report')))
    return found


def row(name: str, found: dict[str, Any]) -> str:
    """Return the table's line of one run, of several axes a line for each."""
    if 'axes' in found:
        return '\n'.join(row(f'{name}: {axis}', of_axis)
                         for axis, of_axis in found['axes'].items())
    metrics, topics = found['metrics'], found['timing']['topics']
    missing = sum(topic['missing'] for topic in topics.values())
    window = '{:.0f} to {:.0f} s'.format(*metrics['window'])
    return (f'| `{name}` | {found["order"]} | {window} | {metrics["error_max"]:.4g} | '
            f'{metrics["error_rms"]:.4g} | {metrics["s_over_epsilon_max"]:.2f} | '
            f'{metrics["v_variation"]:.3g} | {metrics["v_peak_run"]:.4g} | '
            f'{100 * topics["state"]["within_1ms"]:.2f} % | {missing} |')


HEADER = ('| configuration | n | window | max x̃ | RMS x̃ | max s/ε | TV of v per s | peak v | '
          'periods within 1 ms | missing |\n|---|---|---|---|---|---|---|---|---|---|')


def main() -> int:
    """Run all examples."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--write', action='store_true', help='write documents and pictures')
    parser.add_argument('names', nargs='*', default=list(EXAMPLES), help='only these')
    arguments = parser.parse_args()
    machine = describe('ros-rclpy', 'numpy', 'mcap')
    print(machine, HEADER, sep='\n')
    rows = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.names:
            rows[name] = row(name, measure(name, Path(folder)))
            print(rows[name], flush=True)
            if arguments.write:
                report = Path(folder) / f'{name}-report'
                for kind in PICTURES:
                    if (report / f'{kind}.png').exists():
                        shutil.copy(report / f'{kind}.png', IMAGES / f'{name}_{kind}.png')
    if arguments.write:
        where = f'Measured on {machine}.'
        if set(arguments.names) != set(EXAMPLES):
            text = PAGE.read_text(encoding='utf-8')
            before = text[text.index('Measured on '):].split('\n')[0]
            names = ', '.join(f'`{name}`' for name in rows)
            where = f'{before.partition("; ")[0].rstrip(".")}; {names} on {machine}.'
            rows = {name: rows.get(name) or '\n'.join(
                line for line in text.splitlines()
                if line.startswith((f'| `{name}`', f'| `{name}:'))) for name in EXAMPLES}
        write(where, rows)
    return 0


def write(where: str, rows: dict[str, str]) -> None:
    """Write docs/examples.md."""
    lines = ['# Examples', '', 'Written by `python benchmarks/examples.py --write`: every '
             'configuration that ships, run in real time as four processes over DDS, recorded and '
             'reported.', '', where, '', HEADER, *rows.values(), '',
             'x̃ in the unit of the output, TV: total variation of v per second, window: '
             'the part of the run the first five figures are of. Each plant, with units and '
             'sources, is in its configuration: `config/`. The timing columns depend on what else '
             'the machine was doing.', '']
    for name in rows:
        lines += [f'## {name}: {EXAMPLES[name]}', '', f'`dz run {name}`', '']
        for kind, shown in PICTURES.items():
            if (IMAGES / f'{name}_{kind}.png').exists():
                lines += [f'![{shown.format(name=name)}](images/{name}_{kind}.png)', '']
    PAGE.write_text('\n'.join(lines), encoding='utf-8')


if __name__ == '__main__':
    sys.exit(main())

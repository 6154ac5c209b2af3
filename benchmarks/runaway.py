# SPDX-License-Identifier: Apache-2.0
"""The runaway guard: false alarms in healthy loops, and when it stops a device of the wrong sign.

    python benchmarks/runaway.py            print the tables
    python benchmarks/runaway.py --write    write them into docs/safety.md
    python benchmarks/runaway.py --only load --write    the last one alone: five minutes, with ROS
    python benchmarks/runaway.py --only alarms --scenarios stiction,backlash --write
                                            rows of these scenarios, in place of theirs or below
                                            those of the other scenarios

False alarms: every law in every scenario of the arena, and every shipped configuration, simulated;
the guard judges each sample as the controller's end does, with the b of the example where the
scenario has another. Once with the a_i that the plant has, and once each with all a_i of the
guard's model half and one and a half of them. Wrong sign: the
controller itself drives the mock driver, whose commands act reversed from the first sample on, or
from 10 s on; its command is limited to one and a half times what the healthy loop takes.

Beside load: loops over topics with processes that compute all the time, at the priority of the
loop, with half of the default runaway_time; first healthy ones, then the wrong sign.

Over 300 lines: its three tables share the guard and the loops it judges.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
import json
import math
import os
from pathlib import Path
import subprocess
import sys
import tempfile
from typing import Any

from machine import describe
import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.compiled import simulate_fast
from dz_ros.core.loop.controller import Controller, ViolationError
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.loop.offline import Run, simulate
from dz_ros.core.records import Reference, State
from dz_ros.core.safety.runaway_guard import REASON, RunawayGuard
from dz_ros.core.safety.settings import SafetySettings
from dz_ros.errors import LoopError
from dz_ros.files.configurations import load_configuration, shipped_configurations
from dz_ros.recording.reader import read_run
from dz_ros.studies.arena import Plan
from dz_ros.studies.scenarios import base_configuration

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / 'docs' / 'safety.md'
ALARMS = '<!-- false alarms: benchmarks/runaway.py writes it -->'
SIGN = '<!-- wrong sign: benchmarks/runaway.py writes it -->'
LOAD = '<!-- beside load: benchmarks/runaway.py writes it -->'
END = '<!-- end of runaway -->'
LIMIT = SafetySettings().runaway_time
MODELS = (1.0, 0.5, 1.5)
"""Factors of the a_i that the guard knows."""
LOST = 1.0
"""A loop whose error of x is larger than this over the last 10 s does not follow."""
BEGINS = (0.0, 10.0)
"""When the sign turns [s]."""
BURNERS = 4
"""Processes that compute beside a loop."""
LOADED = ('robust_eso', 'wang2004', 'servo', 'pendulum', 'first_order')
"""Configurations that run beside them; a healthy loop of theirs is never against the command for
as long as `STRICT`, by the first table."""
STRICT = 0.5 * LIMIT
"""runaway_time beside load [s]."""
OLD = 2.5
"""A state that echoes an older command makes the controller's end begin again [samples]."""
HEALTHY, ROOM = 12.0, 1.5
"""The limit of the command is the second of these times the largest |v| of the healthy loop in the
first number of s."""


@dataclass
class Row:
    """Runs of one scenario.

    Attributes:
        runs: Number of runs; `lost` of them do not follow their reference.
        alarms: Number of runs that the guard stops, for each of `MODELS`.
        longest: Longest time against the command in a run that follows [s], with the law.
    """

    runs: int = 0
    lost: int = 0
    alarms: list[int] = field(default_factory=lambda: [0] * len(MODELS))
    longest: list[float] = field(default_factory=lambda: [0.0] * len(MODELS))
    law: str = ''

    def take(self, run: Run, law: str, b: float) -> None:
        """Count a run; b: of the guard's model."""
        self.runs += 1
        tail = run.t >= run.t[-1] - 10.0
        lost = not np.abs(run.x[tail, 0] - run.x_d[tail, 0]).max() < LOST
        self.lost += lost
        for i, factor in enumerate(MODELS):
            lasted = against(run, factor, b)
            self.alarms[i] += lasted >= LIMIT
            if not lost and lasted > self.longest[i]:
                self.longest[i] = lasted
                self.law = law if i == 0 else self.law


class _Model:
    """A plant whose a_i are known with a factor."""

    def __init__(self, plant: Any, factor: float, b: float) -> None:
        self.a = tuple(factor * item for item in plant.a)
        self.b, self.constants = b, plant.constants
        self.regressors, self.regressor_count = plant.regressors, plant.regressor_count


def against(run: Run, factor: float, b: float) -> float:
    """Return the longest time for which a run's device gains speed against its command [s]."""
    c = run.configuration
    guard = RunawayGuard(_Model(c.plant, factor, b), c.loop.period)
    held = [0.0, *run.v[:-1].tolist()]
    return max(guard.sample(t, v, x) for t, v, x in zip(
        run.t.tolist(), held, run.x_measured.tolist(), strict=True))


def reversed_run(c: Configuration, begin: float) -> tuple[str, float, float, float]:
    """Return how a loop ends whose commands act reversed.

    Returns:
        The reason; s from the first reversed command that was not 0; how far x came meanwhile, and
        the error then [unit of x].
    """
    first = round(begin * c.loop.rate)
    c = c.replace(**{'driver.name': 'mock', 'driver.script': [f'{first}- reversed'],
                     'loop.duration': begin + 20.0})
    controller, device, period = Controller(c), c.make_driver(), c.loop.period
    since, where = math.nan, math.nan
    for k in range(c.loop.samples):
        t, x_d = k * period, [0.0] * (c.plant.order + 1)
        try:
            device.advance(t, k)
        except (LoopError, ArithmeticError, ValueError):
            return 'diverged', t - since, math.inf, math.inf
        c.trajectory.evaluate(t, c.trajectory.constants, x_d)
        controller.set_reference(Reference(k, t, tuple(x_d)))
        x = device.measure()
        try:
            command, _ = controller.respond(State(k, t, x, k - 1, t - period))
        except ViolationError as error:
            return str(error), t - since, abs(x[0] - where), abs(x[0] - x_d[0])
        device.command(command.v, t)
        if k >= first and math.isnan(since) and command.v != 0.0:
            since, where = t, x[0]
    return 'not stopped', t - since, abs(x[0] - where), abs(x[0] - x_d[0])


def arena_rows(laws: Sequence[str] | None, scenarios: Sequence[str] | None, duration: float,
               seeds: int) -> dict[str, Row]:
    """Return scenario → row."""
    found: dict[str, Row] = {}
    b = Configuration.from_flat(base_configuration()).plant.b
    for (law, scenario, _), flat in Plan.of(laws, scenarios, duration=duration,
                                            seeds=seeds).configurations().items():
        row = found.setdefault(scenario, Row())
        try:
            row.take(simulate_fast(Configuration.from_flat(flat)), law, b)
        except (ArithmeticError, ValueError):
            row.runs += 1
            row.lost += 1
    return found


def devices() -> dict[str, Configuration]:
    """Return name → shipped configuration of one axis, its device simulated."""
    found = {}
    for name in shipped_configurations():
        c = load_configuration(name, ['driver.name=simulated', 'loop.timing=realtime'])
        if not c.axis_names:
            found[name] = c
    return found


def configuration_rows(duration: float) -> dict[str, Row]:
    """Return shipped configuration → row; of several axes each is a run."""
    found = {}
    for name in shipped_configurations():
        c = load_configuration(name, ['driver.name=simulated', f'loop.duration={duration}'])
        row = found.setdefault(f'configuration {name}', Row())
        for run in simulate_axes(c, simulate_fast).values():
            own = run.configuration
            row.take(run, own.law.name, own.plant.b)
    return found


def alarm_lines(laws: Sequence[str] | None, scenarios: Sequence[str] | None, duration: float,
                seeds: int) -> list[str]:
    """Return the table of false alarms; of some scenarios only these rows are measured."""
    rows = arena_rows(laws, scenarios, duration, seeds)
    if scenarios is None:
        rows |= configuration_rows(duration)
    return ['| scenario, or configuration | runs | of these lost | alarms | alarms, a_i halved '
            '| alarms, a_i × 1.5 | longest against the command [s] | law |', f'|{"---|" * 8}',
            *(f'| {name} | {row.runs} | {row.lost} | ' + ' | '.join(map(str, row.alarms))
              + f' | {row.longest[0]:.3f} | {row.law or "-"} |' for name, row in rows.items())]


def merged(table: Sequence[str], rows: Sequence[str]) -> list[str]:
    """Return a table with rows in place of those of the same scenario, or after the scenarios."""
    found = {line.split(' | ')[0]: line for line in table}
    own = {line.split(' | ')[0]: line for line in rows}
    configurations = {name for name in found if name.startswith('| configuration ')}
    before = [own.get(name, line) for name, line in found.items() if name not in configurations]
    return [*before, *(line for name, line in own.items() if name not in found),
            *(found[name] for name in found if name in configurations)]


def sign_lines(laws: Sequence[str] | None) -> list[str]:
    """Return the table of loops whose commands act reversed."""
    loops = {law: Configuration.from_flat(flat) for (law, _, _), flat in
             Plan.of(laws, ['nominal']).configurations().items()}
    loops.update((f'configuration {name}', c) for name, c in devices().items())
    lines = ['| loop | command limit | stopped by | after [s] | moved | error then '
             '| … turned at 10 s: by | after [s] | moved | error then |', f'|{"---|" * 10}']
    for name, c in loops.items():
        peak = float(np.abs(simulate(c.replace(**{'loop.duration': HEALTHY})).v).max())
        limited = c.replace(**{'safety.command_limit': ROOM * peak})
        cells = []
        for begin in BEGINS:
            reason, after, moved, error = reversed_run(limited, begin)
            what = ('guard' if reason.startswith(REASON) else reason.partition(' beyond ')[2]
                    .partition(' ')[0] or reason[:40])
            cells.append(f'{what} | {after:.2f} | {moved:.3g} | {error:.3g}')
        lines.append(f'| {name} | {ROOM * peak:.3g} | {" | ".join(cells)} |')
    return lines


def loaded_run(name: str, duration: float, folder: Path, *settings: str) -> tuple[list[str], str]:
    """Run a loop over topics beside load; return cells of its row, and what stopped it.

    Raises:
        SystemExit: It recorded nothing.
    """
    words = ['safety.fault_after=100000', f'safety.runaway_time={STRICT}', *settings]
    # Each in a session of its own, as nodes are: Linux shares a processor out by sessions.
    busy = [subprocess.Popen([sys.executable, '-c', 'while True: pass'], start_new_session=True)
            for _ in range(BURNERS)]
    try:
        done = subprocess.run(
            [sys.executable, '-m', 'dz_ros', 'run', name, '--duration', str(duration), '--quiet',
             '--record', str(folder), *(item for word in words for item in ('--set', word))],
            env={'ROS_DOMAIN_ID': '86', **os.environ}, capture_output=True, text=True, check=False)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    if not folder.exists():
        sys.exit(f'{name} did not run: {done.stdout}{done.stderr}')
    data = read_run(folder)
    state, period = data.channels['state'], 1.0 / data.configuration['loop.rate']
    skipped = np.round(np.diff(state['stamp']) / period).astype(int) - 1
    age = (state['stamp'] - state['echo_stamp']) / period
    counted = {'controller_node': 0, 'actuator': 0}
    stopped = ''
    for _, _, text in data.events:
        event = json.loads(text)
        if event['event'] == 'mode' and event['mode'] == 'fault' and REASON in event['reason']:
            end = event['node'].strip('/')
            counted[end if end in counted else 'actuator'] += 1
            stopped = stopped or ('controller' if end == 'controller_node' else 'actuator')
    adapts = data.channels['terms']['dt'] > 0.0      # not where v is at its limit
    return [f'{len(state)}', f'{int(adapts.sum())}', f'{int(skipped.sum())}',
            f'{int((age[1:] > OLD).sum())}', f'{age[1:].max():.0f}',
            f'{counted["controller_node"]}', f'{counted["actuator"]}'], stopped


def load_lines(duration: float) -> list[str]:
    """Return the table of loops beside load."""
    lines = ['| loop | states | steps that adapt | samples skipped | states with an old command '
             '| oldest [samples] | alarms, controller | alarms, actuator | stopped by |',
             f'|{"---|" * 9}']
    with tempfile.TemporaryDirectory() as folder:
        for name in LOADED:
            cells, stopped = loaded_run(name, duration, Path(folder) / name)
            lines.append(f'| {name} | {" | ".join(cells)} | {stopped or "-"} |')
            print(lines[-1], file=sys.stderr, flush=True)
        for name in LOADED[:3]:
            c = devices()[name]
            peak = float(np.abs(simulate(c.replace(**{'loop.duration': HEALTHY})).v).max())
            cells, stopped = loaded_run(
                name, 10.0, Path(folder) / f'{name}-reversed', 'driver.name=mock',
                'driver.script=["0- reversed"]', f'safety.command_limit={ROOM * peak}',
                'safety.error_limit=0.0')
            lines.append(f'| {name}, reversed | {" | ".join(cells)} | {stopped or "-"} |')
            print(lines[-1], file=sys.stderr, flush=True)
    return [f'{describe("ros-rclpy")}; {BURNERS} processes that compute beside each loop, '
            f'{duration:g} s each:', '', *lines]


def main() -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--write', action='store_true', help=f'write into docs/{PAGE.name}')
    parser.add_argument('--only', choices=('alarms', 'sign', 'load'),
                        help='one of the tables')
    parser.add_argument('--laws', help='laws of the arena, separated by commas (default: all)')
    parser.add_argument('--scenarios', help='scenarios of the arena, separated by commas: only '
                        'their rows of the false alarms (default: all)')
    parser.add_argument('--duration', type=float, default=60.0, help='of each run [s]')
    parser.add_argument('--seeds', type=int, default=5, help='of the scenarios with noise')
    arguments = parser.parse_args()
    laws = arguments.laws.split(',') if arguments.laws else None

    scenarios = arguments.scenarios.split(',') if arguments.scenarios else None
    text = PAGE.read_text(encoding='utf-8')
    tables = {}
    if arguments.only in (None, 'alarms'):
        tables[ALARMS] = alarm_lines(laws, scenarios, arguments.duration, arguments.seeds)
        if scenarios:
            old = text.partition(ALARMS)[2].partition(END)[0].strip().splitlines()
            tables[ALARMS] = merged(old, tables[ALARMS])
    if arguments.only in (None, 'sign'):
        tables[SIGN] = sign_lines(laws)
    if arguments.only in (None, 'load'):
        tables[LOAD] = load_lines(arguments.duration)
    for marker, lines in tables.items():
        print('\n'.join(lines), flush=True)
        head, _, tail = text.partition(marker)
        text = f'{head}{marker}\n' + '\n'.join(lines) + f'\n{END}{tail.partition(END)[2]}'
    if arguments.write:
        PAGE.write_text(text, encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())

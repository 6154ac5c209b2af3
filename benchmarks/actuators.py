# SPDX-License-Identifier: Apache-2.0
"""Laws behind actuators that are more than a dead-zone: supply, friction, backlash, steps.

    python benchmarks/actuators.py            print the tables
    python benchmarks/actuators.py --write    write them into docs/actuators.md

Gains are those of the configurations and of `dz_ros/core/laws/`; nothing is tuned for a row.
Errors are max|x̃| over the second half of the run, TV the total variation of v per second there.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
import math
from pathlib import Path
import re
import sys
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.command_steps import limit_cycle_bound
from dz_ros.core.loop.offline import Run, simulate
from dz_ros.files.configurations import load_configuration

PAGE = Path(__file__).resolve().parent.parent / 'docs' / 'actuators.md'
VOLTAGES = {'20 V': [20.0], '16 V': [16.0], '14 V': [14.0], '20 → 14 V': [20.0, 14.0]}
LAWS = ('pd', 'pid', 'wang2004', 'robust', 'robust_eso', 'ladrc', 'disturbance_observer',
        'adaptive_inverse', 'super_twisting')
REST = {'trajectory.kind': 'point_to_point', 'trajectory.goal': 1.0, 'trajectory.repeat': False,
        'trajectory.t_start': 1.0}
SINE = {'trajectory.kind': 'sinusoid', 'trajectory.amplitude': 1.0, 'trajectory.frequency': 1.0}
COMPENSATIONS = {
    '': {}, 'Y at the reference': {'controller.regressors_at': 'reference'},
    'error band 0.001': {'controller.error_band': 1e-3},
    'both': {'controller.regressors_at': 'reference', 'controller.error_band': 1e-3}}
PLAY_LAWS = ('pid', 'wang2004', 'robust_eso', 'ladrc', 'adaptive_inverse')
PLAYS = (0.0, 0.1, 0.5, 1.0, 2.0, 4.0)
STEPS = (0.005, 0.02, 0.1, 0.5)


def measured(c: Configuration) -> tuple[float, float, Run | None]:
    """Return max|x̃|, TV and the run; inf where the loop is lost."""
    try:
        run = simulate(c)
    except (OverflowError, ValueError):
        return math.inf, math.inf, None
    half = len(run.t) // 2
    error = float(np.abs(run.x[half:, 0] - run.x_d[half:, 0]).max())
    variation = float(np.abs(np.diff(run.v[half:])).sum() / (run.t[-1] - run.t[half]))
    if not error < 1.0:
        return math.inf, math.inf, None
    return error, variation, run


def cell(c: Configuration) -> str:
    """Return error and TV as the text of a cell."""
    error, variation, _ = measured(c)
    return 'lost' if math.isinf(error) else f'{error:.2e}, {variation:.3g}'


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    return ['| ' + ' | '.join(head) + ' |', f'|{"---|" * len(head)}',
            *('| ' + ' | '.join(row) + ' |' for row in rows)]


def known_zone(c: Configuration) -> dict[str, Any]:
    """Return the keys of `scheduled` that know the dead-zone's tables of a configuration."""
    zone = c.dead_zone
    return {'controller.law': 'scheduled', 'controller.table_points': zone.schedule_points,
            'controller.psi_0': c.loop.schedule_values[0],
            **{f'controller.{name}_known': getattr(zone, f'{name}_table')
               for name in ('m_r', 'm_l', 'b_r', 'b_l')}}


def supply() -> list[str]:
    """Return the table of the thruster: law by voltage."""
    base = load_configuration('thruster', ['loop.duration=40'])
    wrong = known_zone(base)
    wrong.update({f'controller.{name}_known': [1.2 * item for item in
                                               wrong[f'controller.{name}_known']]
                  for name in ('m_r', 'm_l', 'b_r', 'b_l')})
    old = {**known_zone(base), 'controller.table_points': [0.0],
           **{f'controller.{name}_known': [getattr(base.dead_zone, name)]
              for name in ('m_r', 'm_l', 'b_r', 'b_l')}}
    rows = []
    for name, keys in (('`robust_eso`', {}),
                       ('`scheduled`, tables of the voltage', known_zone(base)),
                       ('`scheduled`, tables 20 % too large', wrong),
                       ('`scheduled`, the values of 16 V', old)):
        cells = [name]
        for values in VOLTAGES.values():
            times = [10.0, 30.0] if len(values) > 1 else []
            cells.append(cell(base.replace(**{
                **keys, 'loop.schedule_values': values, 'loop.schedule_times': times})))
        rows.append(cells)
    return table(('law', *VOLTAGES), rows)


def moving_share(run: Run) -> float:
    """Return the share of samples of the second half in which the speed is above 1e-5."""
    return float((np.abs(run.x[len(run.t) // 2:, 1]) > 1e-5).mean())


def friction() -> list[str]:
    """Return the table of the servo whose friction sticks: law by task."""
    base = load_configuration('servo', ['loop.duration=40', 'plant.x0=[0.0, 0.0]'])
    smooth, sticks = {'plant.static_friction': 0.0}, {'plant.static_friction': 1.5}
    rows = []
    for law in LAWS:
        for name, keys in COMPENSATIONS.items():
            if name and law not in ('pid', 'robust_eso'):
                continue
            cells = [f'`{law}`' + (f', {name}' if name else '')]
            for task, plant in ((SINE, smooth), (SINE, sticks), (REST, smooth), (REST, sticks)):
                c = base.replace(**{'controller.law': law, **keys, **task, **plant})
                error, variation, run = measured(c)
                if run is None:
                    cells.append('lost')
                    continue
                cells.append(f'{error:.2e}, {variation:.3g}')
                if task is REST:
                    cells[-1] += f', {moving_share(run):.0%}'
            rows.append(cells)
    return table(('law', 'sine, smooth', 'sine, sticks', 'at rest, smooth', 'at rest, sticks'),
                 rows)


def play() -> list[str]:
    """Return the table of the example behind a backlash: law by width."""
    rows = []
    for law in PLAY_LAWS:
        base = Configuration.from_flat({'controller.law': law, 'loop.duration': 30.0})
        rows.append([f'`{law}`', *(cell(base.replace(**{'plant.backlash': width}))
                                   for width in PLAYS)])
    return table(('law', *(f'{width:g}' for width in PLAYS)), rows)


def steps() -> list[str]:
    """Return the table of commands in steps: bound of `dz check` and what was measured."""
    rows = []
    for name, law in (('robust_eso', 'robust_eso'), ('robust_eso', 'wang2004'),
                      ('servo', 'robust_eso')):
        still = {'trajectory.kind': 'constant', 'plant.dead_zone.b_r': 0.0,
                 'plant.dead_zone.b_l': 0.0, 'plant.x0': [0.1, 0.0], 'loop.duration': 30.0}
        base = (load_configuration(name) if law == 'robust_eso' else
                Configuration.from_flat({'controller.law': law})).replace(
                    **still, **{'trajectory.value': 0.123})
        without = measured(base)[0]
        for step in STEPS:
            c = base.replace(**{'plant.command_resolution': step})
            bound = limit_cycle_bound(c, step, c.plant.order)
            assert bound is not None
            rows.append([f'`{law}` on `{c.plant.name}`', f'{step:g}', f'{bound[0]:.2e}',
                         f'{without:.2e}', f'{measured(c)[0]:.2e}'])
    return table(('loop', 'step of v', 'bound of `dz check`', 'measured without steps',
                  'measured'), rows)


TABLES: Mapping[str, Callable[[], list[str]]] = {
    'supply': supply, 'friction': friction, 'play': play, 'steps': steps}


def main() -> int:
    """Measure all tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--tables', nargs='*', default=list(TABLES), choices=list(TABLES),
                        metavar='NAME', help='only these of ' + ', '.join(TABLES))
    parser.add_argument('--write', action='store_true', help=f'write them into {PAGE.name}')
    arguments = parser.parse_args()
    for name in arguments.tables:
        lines = '\n'.join(TABLES[name]())
        print(f'{name}\n\n{lines}\n', flush=True)
        if arguments.write:
            begin, end = f'<!-- {name} -->', f'<!-- end of {name} -->'
            text = PAGE.read_text(encoding='utf-8')
            text, count = re.subn(f'{begin}\n.*?{end}', lambda _, b=begin, t=lines, e=end:
                                  f'{b}\n{t}\n{e}', text, flags=re.DOTALL)
            if count != 1:
                print(f'{PAGE.name} has no place for the table {name}', file=sys.stderr)
                return 1
            PAGE.write_text(text, encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())

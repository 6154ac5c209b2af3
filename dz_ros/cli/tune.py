# SPDX-License-Identifier: Apache-2.0
"""``dz tune``: gains proposed from what is known, and what they give in simulation."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dz_ros.cli.interrupt import prompt_end
from dz_ros.cli.options import add_configuration, configuration_overrides, read_machine
from dz_ros.cli.output import print_json
from dz_ros.cli.progress import stage
from dz_ros.core.axes_keys import axis_key
from dz_ros.core.design.finding import INFO
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import flat_parameters, write_parameters
from dz_ros.runs.metrics import jsonable
from dz_ros.studies.outcome import require_end
from dz_ros.studies.tune import Proposal, tune

BOUNDS = tuple(f'controller.{name}_bounds' for name in ('b_r', 'b_l', 'm', 'b'))
NUMBERS = (('error_max', 'max |x̃|'), ('v_variation', 'TV of v per s'),
           ('v_peak_run', 'peak |v|'), ('omega', 'share in Ω_ε'))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_configuration(parser)
    parser.add_argument('--effort', type=float, default=0.0, metavar='V',
                        help="largest |v| allowed, in the actuator's unit; without this the "
                             "actuator's limit, or a tenth above what the loop takes now")
    parser.add_argument('--disturbance', type=float, metavar='D',
                        help='largest disturbance to withstand, in the unit of x^(n)')
    parser.add_argument('--out', type=Path, metavar='FILE',
                        help='write the proposed configuration there')
    parser.add_argument('--json', action='store_true', help='proposal and numbers as JSON')


def run(arguments: argparse.Namespace) -> int:
    """Propose gains; show what they give; write them where asked."""
    for key in ('effort', 'disturbance'):
        value = getattr(arguments, key)
        if value is not None and not 0.0 <= value < float('inf'):
            raise ConfigurationError(f'--{key}', value, 'must be a finite number >= 0')
    if arguments.out is not None and arguments.out.exists():
        raise ConfigurationError('--out', str(arguments.out),
                                 'exists already; choose another file')
    configuration = read_machine(arguments)
    require_end(configuration)
    _require_bounds(arguments)
    found = {}
    for name, item in configuration.axes or (('', configuration),):
        with prompt_end(), stage('simulating candidates' + (f' for axis {name}' if name else '')):
            found[name] = tune(item, arguments.effort, arguments.disturbance)
    if arguments.json:
        each = {name: jsonable({'proposed': dict(changes(item)), 'why': item.reasons,
                                'simulated': item.rows,
                                'findings': [asdict(finding) for finding in item.findings]})
                for name, item in found.items()}
        print_json(each.get('', {'axes': each}))
    else:
        print('\n\n'.join(format_proposal(item) if not name else
                          f'== axis {name}\n{format_proposal(item)}'
                          for name, item in found.items()))
    if arguments.out is not None:
        write_parameters(found[''].after if '' in found else configuration.replace(
            **{axis_key(name, key): value for name, item in found.items()
               for key, value in changed_keys(item).items()}), arguments.out)
    return 0


def changed_keys(found: Proposal) -> dict[str, Any]:
    """Return the keys whose values the proposal changes, with the values it proposes."""
    before = found.before.to_flat()
    return {key: value for key, value in found.after.to_flat().items()
            if before.get(key) != value}


def _require_bounds(arguments: argparse.Namespace) -> None:
    """Refuse a configuration without the bounds that gains follow from."""
    given = {**flat_parameters(arguments.config, (), arguments.namespace),
             **flat_parameters(None, configuration_overrides(arguments))}
    names = given.get('loop.axes') if arguments.axis is None else [arguments.axis]
    own = [[axis_key(name, key) for name in names] if isinstance(names, list) else []
           for key in BOUNDS]
    lacking = [key for key, of_axes in zip(BOUNDS, own, strict=True)
               if key not in given and not (of_axes and all(item in given for item in of_axes))]
    if lacking:
        raise ConfigurationError(lacking[0], None, f'gains follow from bounds: give '
                                 f'{", ".join(lacking)} in the file or with --set')


def changes(found: Proposal) -> list[tuple[str, Any]]:
    """Return key and proposed value of everything looked at."""
    flat = found.after.to_flat()
    return [(key, flat[key]) for key in found.reasons]


def format_proposal(found: Proposal) -> str:
    """Return the proposal as text: values with reasons, then the simulated numbers."""
    before = found.before.to_flat()
    lines = [f'{found.after.law.name} on {found.after.plant.name}, {found.after.loop.rate:g} Hz']
    for key, value in changes(found):
        now = '' if _short(before[key]) == _short(value) else f'   (now {_short(before[key])})'
        lines.append(f'  {key} = {_short(value)}{now}')
        lines.append(f'      {found.reasons[key]}')
    lines += ['', 'in simulation, with the plant and the dead-zone of the configuration']
    for name, row in found.rows.items():
        if row['lost']:
            lines.append(f'  {name:16} lost: {row["reason"]}')
            continue
        numbers = '   '.join(f'{title} {row[key]:.4g}' for key, title in NUMBERS
                             if row[key] is not None)
        lines.append(f'  {name:16} {numbers}')
    if found.findings:
        lines += ['', 'by the rules of dz check']
        lines += [f'  {"" if item.level == INFO else item.level + " "}{item.rule}: {item.words}'
                  + (f'; {item.change}' if item.change else '') for item in found.findings]
    return '\n'.join(lines)


def _short(value: Any) -> str:
    if isinstance(value, list):
        return f'[{", ".join(_short(item) for item in value)}]'
    return f'{value:.4g}' if isinstance(value, float) else str(value)

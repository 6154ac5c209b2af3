"""``dz tune``: gains proposed from what is known, and what they give in simulation."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from dz_ros.analysis.metrics import jsonable
from dz_ros.cli.options import add_configuration, read_configuration
from dz_ros.errors import ConfigurationError
from dz_ros.files import write_parameters
from dz_ros.studies.outcome import require_end
from dz_ros.studies.tune import Proposal, tune

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
    configuration = read_configuration(arguments)
    require_end(configuration)
    found = tune(configuration, arguments.effort, arguments.disturbance)
    if arguments.json:
        print(json.dumps(jsonable({'proposed': dict(changes(found)), 'why': found.reasons,
                                   'simulated': found.rows}), ensure_ascii=False, indent=2))
    else:
        print(format_proposal(found))
    if arguments.out is not None:
        write_parameters(found.after, arguments.out)
    return 0


def changes(found: Proposal) -> list[tuple[str, Any]]:
    """Return key and proposed value of everything looked at."""
    flat = found.after.to_flat()
    return [(key, flat[key]) for key in found.reasons]


def format_proposal(found: Proposal) -> str:
    """Return the proposal as text: values with reasons, then what simulation says of them."""
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
    return '\n'.join(lines)


def _short(value: Any) -> str:
    if isinstance(value, list):
        return f'[{", ".join(_short(item) for item in value)}]'
    return f'{value:.4g}' if isinstance(value, float) else str(value)

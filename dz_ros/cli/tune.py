# SPDX-License-Identifier: Apache-2.0
"""``dz tune``: gains proposed from what is known, and what they give in simulation.

Of several axes, each is tuned as a loop of its own; the file written is the whole machine's.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dz_ros.cli.interrupt import prompt_end
from dz_ros.cli.options import (
    add_configuration,
    configuration_overrides,
    read_all_axes,
    require_folder,
)
from dz_ros.cli.output import print_json
from dz_ros.cli.progress import stage
from dz_ros.core.axes_keys import axis_key
from dz_ros.core.design.finding import INFO
from dz_ros.core.plants.coupled import CoupledPlant
from dz_ros.errors import ConfigurationError, suggestion
from dz_ros.files.configurations import flat_parameters, write_parameters
from dz_ros.runs.metrics import jsonable
from dz_ros.studies.outcome import require_end
from dz_ros.studies.tune import Proposal, tune

BOUNDS = tuple(f'controller.{name}_bounds' for name in ('b_r', 'b_l', 'm', 'b'))
NUMBERS = (('error_max', 'max |x̃|'), ('v_variation', 'TV of v per s'),
           ('v_peak_run', 'peak |v|'))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_configuration(parser)
    parser.add_argument('--effort', action='append', default=[], metavar='[AXIS=]V',
                        help="largest |v| allowed, in the actuator's unit; without this the "
                             "actuator's limit, or a tenth above what the loop takes now; of "
                             'several axes for all, or with its name for one, e.g. yaw=5; may be '
                             'repeated')
    parser.add_argument('--disturbance', action='append', default=[], metavar='[AXIS=]D',
                        help='largest disturbance to withstand, in the unit of x^(n); for all '
                             'axes or one, as --effort')
    parser.add_argument('--out', type=Path, metavar='FILE',
                        help='write the proposed configuration there; with --axis too that of '
                             'all axes, the others as they are')
    parser.add_argument('--json', action='store_true', help='proposal and numbers as JSON')


def run(arguments: argparse.Namespace) -> int:
    """Propose gains; show what they give; write them where asked."""
    if arguments.out is not None:
        if arguments.out.exists() or arguments.out.is_symlink():
            raise ConfigurationError('--out', str(arguments.out),
                                     'exists already; choose another file')
        require_folder(arguments.out)
    machine = read_all_axes(arguments)
    chosen = ((arguments.axis, machine.axis(arguments.axis)),) if arguments.axis else machine.axes
    axes = dict(chosen or (('', machine),))
    efforts, disturbances = (values_by_axis(f'--{key}', getattr(arguments, key), tuple(axes),
                                            machine.axis_names, zero)
                             for key, zero in (('effort', False), ('disturbance', True)))
    require_end(machine)
    _require_bounds(arguments)
    found = {}
    for name, item in axes.items():
        with prompt_end(), stage('simulating candidates' + (
                f' for axis {name}' if len(axes) > 1 else '')):
            try:
                found[name] = tune(item, efforts.get(name, 0.0), disturbances.get(name))
            except ConfigurationError as error:
                if name and not item.law.coupled:       # such a law is that of all axes
                    error.args = (f'axis {name}: {error}',)
                raise
    alone = arguments.axis is not None or '' in found
    if arguments.json:
        each = {name: jsonable({'proposed': dict(changes(item)), 'why': item.reasons,
                                'simulated': item.rows,
                                'findings': [asdict(finding) for finding in item.findings]})
                for name, item in found.items()}
        print_json(next(iter(each.values())) if alone else {'axes': each})
    else:
        print('\n\n'.join(format_proposal(item) if alone else
                          f'== axis {name}\n{format_proposal(item)}'
                          for name, item in found.items()))
    if arguments.out is not None:
        write_parameters(machine.replace(**{
            axis_key(name, key) if name else key: value for name, item in found.items()
            for key, value in changed_keys(item).items()}), arguments.out)
    return 0


def values_by_axis(option: str, texts: Sequence[str], axes: Sequence[str],
                   known: Sequence[str], zero: bool) -> dict[str, float]:
    """Return axis → value of an option that has ``VALUE`` for all axes or ``AXIS=VALUE`` for one.

    As in a configuration, an axis keeps its own value beside one for all; of two values the last
    one counts.

    Args:
        option: Its name, for errors.
        texts: As given.
        axes: Axes that are meant; '' is the one without a name.
        known: Names of all axes of the machine.
        zero: Whether 0 is allowed.

    Raises:
        ConfigurationError: No finite number > 0 or >= 0, or an axis that is not meant.
    """
    common: dict[str, float] = {}
    own: dict[str, float] = {}
    for text in texts:
        axis, equals, written = text.rpartition('=')
        axis = axis.strip()
        try:
            value = float(written)
        except ValueError:
            value = -1.0
        allowed = 0.0 < value < float('inf') or (zero and value == 0.0)
        if not allowed or (equals and not axis):
            raise ConfigurationError(option, text, f'must be a finite number >{"=" * zero} 0, of '
                                     'one of several axes AXIS=NUMBER')
        if axis and axis not in axes:
            raise ConfigurationError(option, text, (
                f'is of another axis than {axes[0]}' if axis in known else
                f'names axis {axis}, must be one of {", ".join(known)}{suggestion(axis, known)}'
                if known else 'the loop has one axis, without a name: give the number alone'))
        if axis:
            own[axis] = value
        else:
            common = dict.fromkeys(axes, value)
    return {**common, **own}


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
    alone = ', the other axes at rest' if isinstance(found.after.plant, CoupledPlant) else ''
    lines += ['', f'in simulation, with the plant and the dead-zone of the configuration{alone}']
    for name, row in found.rows.items():
        if row['lost']:
            lines.append(f'  {name:16} lost: {row["reason"]}')
            continue
        numbers = [f'{title} {row[key]:.4g}' for key, title in NUMBERS if row[key] is not None]
        if row['omega'] is not None:
            numbers.append(f'in Ω_ε {100.0 * row["omega"]:.4g} %')
        lines.append(f'  {name:16} {"   ".join(numbers)}')
    if found.findings:
        lines += ['', 'by the rules of dz check']
        lines += [f'  {"" if item.level == INFO else item.level + " "}{item.rule}: {item.words}'
                  + (f'; {item.change}' if item.change else '') for item in found.findings]
    return '\n'.join(lines)


def _short(value: Any) -> str:
    if isinstance(value, list):
        return f'[{", ".join(_short(item) for item in value)}]'
    return f'{value:.4g}' if isinstance(value, float) else str(value)

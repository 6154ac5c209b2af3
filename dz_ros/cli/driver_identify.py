"""``dz driver identify``: a dead-zone and its bounds, by moving the device or from a run.

Writes a folder that must not exist: the moves as a run, the bounds, a configuration that is ready
to run, the numbers as JSON, a picture. Exit code 1 where a design rule finds an error in it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import time
from typing import Any

from dz_ros.cli.check import FOUND_ERRORS
from dz_ros.cli.identify_moves import ask, move
from dz_ros.cli.identify_output import proposal_lines, result_lines, write_bounds
from dz_ros.cli.options import add_configuration, read_configuration
from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.design_rules import check
from dz_ros.core.finding import ERROR, worst
from dz_ros.drivers.hosted import HostedDriver
from dz_ros.errors import ConfigurationError, RunExistsError
from dz_ros.files import flat_parameters, write_parameters
from dz_ros.identification.evaluate import evaluate
from dz_ros.identification.experiment import Experiment
from dz_ros.identification.plan import Limits, Plan
from dz_ros.identification.proposal import propose
from dz_ros.identification.recorded import as_run, from_run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_configuration(parser)
    parser.set_defaults(config=None)
    limits = parser.add_argument_group('limits of the moves, in the units of the driver')
    for item in (*schema.fields(Limits), *schema.fields(Plan)):
        limits.add_argument(f'--{item.name}', type=int if item.kind == 'int' else float,
                            metavar=item.name[0].upper(), help=f'{item.spec.description}'
                            f' [{item.spec.unit}]' + (f' (default: {item.default:g})'
                                                      if item.default else ''))
    parser.add_argument('--yes', action='store_true', help='do not ask before it moves')
    parser.add_argument('--from', type=Path, metavar='RUN', dest='run',
                        help='move nothing: read the dead-zone from a recorded run')
    parser.add_argument('--namespace', default='', metavar='NS',
                        help='ROS namespace of the e-stop, or whose topics of RUN to read')
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help='folder to write; must not exist (default: identified-TIME)')


def run(arguments: argparse.Namespace) -> int:
    """Move or read, evaluate, tell, write.

    Raises:
        RunExistsError: The folder is there already.
        ConfigurationError: Limits that are missing or not allowed.
    """
    out = arguments.out or Path(time.strftime('identified-%Y%m%d-%H%M%S'))
    if out.exists():
        raise RunExistsError(f'{out}: exists already; choose another folder with --out')
    made: RunData | None = None
    breakaway: list[float] = []
    if arguments.run is not None:
        c, data = _recorded(arguments)
        samples, margin = from_run(data, c)
    else:
        if arguments.config is None:
            raise ConfigurationError('CONFIG', '', 'must name the configuration of the device, or '
                                     'give --from RUN')
        c = read_configuration(arguments)
        limits, plan = _limits(arguments, c)
        experiment = Experiment(limits, plan, c.plant.order, c.loop.period,
                                c.safety.safe_command)
        ask(c, limits, plan, experiment.duration, arguments.yes)
        start_ns = time.time_ns()
        samples = move(c, experiment, arguments.namespace)
        made, margin = as_run(samples, c, start_ns), experiment.moving
        breakaway = [v for _, v in experiment.breakaway]
        for breach in experiment.breaches:
            print(f'a limit stopped it: {breach}')
    out.mkdir(parents=True)
    print(f'writing {out}')
    if made is not None:        # what was moved for is kept, whatever comes of it
        from dz_ros.recording.save import save_run

        save_run(made, out / 'run')
    found = evaluate(samples, c, margin)
    print('\n'.join(result_lines(found.result, c)))
    write_bounds(found, c, breakaway, out)
    proposal, notes = propose(c, found.result)
    findings = check(proposal.after)
    write_parameters(proposal.after, out / 'identified.yaml')
    print('\n'.join(proposal_lines(proposal, findings, notes, out / 'identified.yaml')))
    return FOUND_ERRORS if worst(findings) == ERROR else 0


def _recorded(arguments: argparse.Namespace) -> tuple[Configuration, RunData]:
    """Return the configuration of a run, or the one given, and the run.

    Raises:
        ConfigurationError: Neither says what ran.
    """
    from dz_ros.analysis.whatif import base_configuration
    from dz_ros.recording.reader import read_run

    data = read_run(arguments.run, arguments.namespace or None)
    if arguments.config is not None:
        return read_configuration(arguments), data
    flat = base_configuration(data)
    if not flat:
        raise ConfigurationError('CONFIG', '', 'the run does not say what ran: name its '
                                 'configuration')
    return Configuration.from_flat({**flat, **flat_parameters(None, arguments.overrides)}), data


def _limits(arguments: argparse.Namespace, c: Configuration) -> tuple[Limits, Plan]:
    """Return limits and plan as given.

    Raises:
        ConfigurationError: One is missing or not allowed.
    """
    driver = c.make_driver()
    units = {'travel': driver.state_units[0], 'effort': driver.command_unit}
    if c.plant.order > 1:
        units['speed'] = driver.state_units[1]
    for name, unit in units.items():
        if getattr(arguments, name) is None:
            raise ConfigurationError(f'--{name}', None, f'must be given [{unit}]: only you know '
                                     f'what {driver.name} may do where it stands')

    def group(kind: Any) -> Any:
        given = {item.name: getattr(arguments, item.name) for item in schema.fields(kind)
                 if getattr(arguments, item.name) is not None}
        return schema.build(kind, given, '--')

    limits: Limits = group(Limits)
    if c.plant.order > 1 and limits.speed <= 0.0:
        raise ConfigurationError('--speed', limits.speed, 'must be > 0')
    least = min(HostedDriver(c).limit, c.plant_settings.command_limit or limits.effort,
                c.safety.command_limit or limits.effort)
    if limits.effort > least:
        raise ConfigurationError('--effort', limits.effort, f'must be <= {least:g}, the limit of '
                                 'the device or of the configuration')
    return limits, group(Plan)

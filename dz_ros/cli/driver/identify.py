# SPDX-License-Identifier: Apache-2.0
"""``dz driver identify``: a dead-zone and its bounds, by moving the device or from a run.

Writes a folder that must not exist: the moves as a run, the bounds, a configuration that is ready
to run, the numbers as JSON, a picture. Exit code 1 where a design rule finds an error in it.
Ctrl-C while the device moves keeps nothing; later the moves are kept.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
import time

from dz_ros.cli.check import FOUND_ERRORS
from dz_ros.cli.driver.identify_moves import ask, move
from dz_ros.cli.driver.identify_output import (
    plant_lines,
    proposal_lines,
    result_lines,
    write_bounds,
)
from dz_ros.cli.driver.move_limits import add_limits, build_limits, given_limits
from dz_ros.cli.interrupt import NOTHING_KEPT, prompt_end
from dz_ros.cli.options import (
    add_allow_import,
    add_configuration,
    one_axis,
    read_all_axes,
    read_configuration,
    read_recording,
)
from dz_ros.cli.output import print_lines
from dz_ros.cli.progress import stage
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.design.finding import ERROR, worst
from dz_ros.core.design.rules import check
from dz_ros.drivers.beside import beside_others
from dz_ros.errors import ConfigurationError, DriverError, RunExistsError
from dz_ros.files.configurations import flat_parameters, write_parameters
from dz_ros.identification.estimation.pipeline import (
    identify,
    identify_log,
    refine_identified,
)
from dz_ros.identification.experiment.moves import Experiment
from dz_ros.identification.experiment.session import NotLetGoError
from dz_ros.identification.proposal import propose
from dz_ros.identification.samples import HOLE, Samples, to_run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_configuration(parser, 'where the e-stop is, whose topics of RUN and sections of CONFIG '
                      'count', default=None)
    add_limits(parser, 'limits of the moves, in the units of the driver')
    parser.add_argument('--yes', action='store_true', help='do not ask before it moves')
    parser.add_argument('--from', type=Path, metavar='RUN', dest='run',
                        help='move nothing: read the dead-zone from a recorded run')
    add_allow_import(parser)
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help='folder to write; must not exist (default: identified-TIME)')


def run(arguments: argparse.Namespace) -> int:
    """Move or read, identify, print, write.

    Raises:
        RunExistsError: The folder is there already.
        ConfigurationError: Limits that are missing or not allowed.
    """
    out = arguments.out or Path(time.strftime('identified-%Y%m%d-%H%M%S'))
    if out.exists():
        raise RunExistsError(f'{out}: exists already; choose another folder with --out')
    breakaway: list[float] = []
    moving: Experiment | None = None
    if arguments.run is None:
        c, moving, samples = _moved(arguments, out)
        breakaway = [v for _, v in moving.breakaway]
        kept = [_kept(out)]
    else:
        kept = [NOTHING_KEPT]
    with prompt_end(lambda: kept[0]):
        if moving is not None:
            with stage('finding the dead-zone'):
                found = identify(samples, c, moving.moving)
        else:
            c, data = _recorded(arguments)
            with stage('finding the dead-zone'):
                samples, found = identify_log(data, c)
            _begin(out)         # a run that cannot be used leaves nothing behind
            kept = [_incomplete(out)]
        if samples.filled:
            print_lines(f'{samples.filled} of {len(samples.seq)} samples were not measured: holes '
                        f'of up to {HOLE * 1e3:.0f} ms, filled from their neighbours')
        print_lines(result_lines(found, c, breakaway))
        with stage('refining the plant'):
            fitted, problem = refine_identified(found, samples, c)
        print_lines(plant_lines(fitted, c, found.friction_counted))
        write_bounds(found, fitted, c, breakaway, out)
        with stage('proposing gains'):
            proposal, notes = propose(c, found, fitted)
        notes = (*notes, problem) if problem else notes
        findings = check(proposal.after)
        write_parameters(proposal.after, out / 'identified.yaml')
        print_lines(proposal_lines(proposal, findings, notes, out / 'identified.yaml'))
    return FOUND_ERRORS if worst(findings) == ERROR else 0


def _moved(arguments: argparse.Namespace,
           out: Path) -> tuple[Configuration, Experiment, Samples]:
    """Move the device and keep the moves; return its configuration, what it did, the samples.

    Raises:
        ConfigurationError: Limits that are missing or not allowed.
        DriverError: The device fails, or it was stopped; or it could not be let go after the
            moves, which are kept.
        KeyboardInterrupt: It was stopped by Ctrl-C.
    """
    if arguments.config is None:
        raise ConfigurationError('CONFIG', '', 'must name the configuration of the device, or '
                                 'give --from RUN')
    machine = read_all_axes(arguments)
    c = one_axis(machine, arguments.axis)
    limits, plan = build_limits(given_limits(arguments), c)
    experiment = Experiment(limits, plan, c.plant.order, c.loop.period, c.safety.safe_command)
    hosted = beside_others(machine, arguments.axis, all_faults=True)
    ask(c, limits, plan, experiment.duration, arguments.yes, hosted)
    start_ns = time.time_ns()
    held: NotLetGoError | None = None
    try:
        samples = move(c, experiment, arguments.namespace, hosted=hosted)
    except KeyboardInterrupt as end:
        raise KeyboardInterrupt('; '.join(filter(None, (str(end), NOTHING_KEPT)))) from None
    except NotLetGoError as error:
        if error.samples is None:
            raise
        held, samples = error, error.samples
        print_lines(f'warning: {error}', sys.stderr)    # whatever becomes of the moves
    made = to_run(samples, c, start_ns)
    if experiment.stalls:
        print_lines(f'the machine stalled {len(experiment.stalls)} times, for up to '
                    f'{max(experiment.stalls):.2f} s; those moves were made again')
    for breach in experiment.breaches:
        print_lines(f'a limit stopped it: {breach}')
    with prompt_end(lambda: _incomplete(out)):
        from dz_ros.recording.save import save_run

        _begin(out)             # the moves are kept, whatever comes of them
        save_run(made, out / 'run')
    if held is not None:
        raise DriverError(f'{held}; {_kept(out)}') from held
    return c, experiment, samples.without_short_holes()


def _kept(out: Path) -> str:
    return (f'the moves are kept in {out / "run"}; dz driver identify --from {out / "run"} '
            'goes on')


def _incomplete(out: Path) -> str:
    return f'{out} is not complete; the same command with another --out begins again'


def _begin(out: Path) -> None:
    """Make the folder."""
    out.mkdir(parents=True)
    print(f'writing {out}')


def _recorded(arguments: argparse.Namespace) -> tuple[Configuration, RunData]:
    """Return the configuration of a run, or the one given, and the run.

    Raises:
        ConfigurationError: There is none.
    """
    from dz_ros.replay.whatif import base_configuration
    from dz_ros.runs.axes import choose_axis

    data = choose_axis(read_recording(arguments.run, arguments.namespace or None), arguments.axis)
    if arguments.config is not None:
        return read_configuration(arguments), data
    flat = base_configuration(data)
    if not flat:
        raise ConfigurationError('CONFIG', '', 'the run does not state what ran: name its '
                                 'configuration')
    return Configuration.from_untrusted(flat, flat_parameters(None, arguments.overrides),
                                        driven=True), data

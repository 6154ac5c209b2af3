# SPDX-License-Identifier: Apache-2.0
"""``dz driver commission``: from a new device to a running loop, step by step.

Every step prints what it found, is recorded, and can be repeated with ``--from STEP``. A step that
fails ends it: exit code 1, or 2 where something that was given is wrong.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from datetime import datetime, timezone
import math
from pathlib import Path
import sys
from typing import Any

from dz_ros.cli.driver.commission_loop import check_step, loop_step, propose_step, report_step
from dz_ros.cli.driver.commission_moves import identify_step, sensor_step, sign_step
from dz_ros.cli.driver.commission_state import Outcome, State, StepFailedError
from dz_ros.cli.driver.move_limits import (
    add_limits,
    build_limits,
    given_limits,
    needed_limits,
)
from dz_ros.cli.options import (
    add_address,
    add_configuration,
    check_port,
    read_configuration,
    refuse_existing,
)
from dz_ros.cli.output import print_lines
from dz_ros.core.configuration import Configuration
from dz_ros.errors import ConfigurationError, DzRosError
from dz_ros.files.configurations import write_parameters
from dz_ros.identification.commissioning import Attempt, DONE, FAILED, StepLog, STEPS
from dz_ros.identification.experiment.plan import Limits, Plan
from dz_ros.runs.metrics import jsonable

STOPPED = 1
SHARE = 0.3
"""The first motion, as a share of the travel, where no other is asked for."""
QUESTIONS = {'travel': 'How far may it move from where it stands',
             'effort': 'How large may |v| be', 'speed': 'How fast may it move'}
LEAST_DURATION = 5.0
"""A shorter first loop shows nothing [s]."""
GIVEN = 'configuration.yaml'
"""File of the configuration that was given, for ``--from``."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_configuration(parser, 'where the loop is started and the e-stop is')
    parser.set_defaults(config=None)
    parser.add_argument('--out', type=Path, metavar='DIR', required=True,
                        help='folder of all steps; must not exist, but with --from')
    parser.add_argument('--from', choices=STEPS, metavar='STEP', dest='step',
                        help='repeat from this step on, with what --out holds of those before: '
                             + ', '.join(STEPS))
    parser.add_argument('--until', choices=STEPS, metavar='STEP',
                        help='end after this step')
    limits = add_limits(parser, 'limits, in the units of the driver; asked where not given')
    limits.add_argument('--amplitude', type=float, metavar='A',
                        help='how far the first motion goes [unit of x] (default: '
                             f'{SHARE:g} of the travel)')
    limits.add_argument('--loop-duration', type=float, metavar='S', default=20.0,
                        help='length of the first loop [s] (default: %(default)g)')
    parser.add_argument('--yes', action='store_true', help='do not ask before it moves')
    parser.add_argument('--live', action='store_true',
                        help='show the first loop in the browser, with its e-stop')
    add_address(parser)


def run(arguments: argparse.Namespace) -> int:
    """Go through the steps; return 0, or 1 where one failed.

    Raises:
        RunExistsError: The folder is there already.
        ConfigurationError: A limit is missing or not allowed.
    """
    out: Path = arguments.out
    check_port(arguments)
    if arguments.step is None:
        refuse_existing(out)
    elif not out.is_dir():
        raise ConfigurationError('--out', str(out), 'must be the folder of earlier steps with '
                                 '--from')
    first = STEPS.index(arguments.step) if arguments.step else 0
    last = STEPS.index(arguments.until) if arguments.until else len(STEPS) - 1
    if last < first:
        raise ConfigurationError('--until', arguments.until, f'comes before {arguments.step}')
    if arguments.config is None:
        if arguments.step is None:
            raise ConfigurationError('CONFIG', '', 'must name the configuration of the device')
        arguments.config = str(out / GIVEN)
    c = read_configuration(arguments)
    log = StepLog(out)
    answers = _answers(arguments, c, log)       # before anything is written
    if arguments.step is None:
        out.mkdir(parents=True)
        write_parameters(c, out / GIVEN)
    page = (arguments.host, arguments.port) if arguments.live else None
    state = State(c, log, *answers, arguments.namespace, arguments.yes, arguments.loop_duration,
                  page)
    if first and (given_limits(arguments) or arguments.amplitude is not None):
        _attempt('limits', state)
    for step in STEPS[first:last + 1]:
        if not _attempt(step, state):
            print_lines(f'stopped at step {step}; once it is mended: --from {step} --out {out}')
            return STOPPED
    print_lines(f'log of the steps: {out / "commissioning.jsonl"}')
    return 0


_DO: Mapping[str, Any] = {
    'limits': lambda state: state.limits_outcome(), 'sign': sign_step, 'sensor': sensor_step,
    'identify': identify_step, 'propose': propose_step, 'check': check_step, 'loop': loop_step,
    'report': report_step}


def _attempt(step: str, state: State) -> bool:
    """Make one attempt of a step, log it, print it; return whether it was done."""
    begun = datetime.now(timezone.utc).isoformat(timespec='milliseconds')
    number, state.name = len(state.log.attempts) + 1, state.log.name(step)
    print_lines(f'--- {STEPS.index(step) + 1}/{len(STEPS)} {step}')

    def note(outcome: str, words: str, result: Mapping[str, Any]) -> None:
        folder = state.name if (state.log.folder / state.name).exists() else ''
        state.log.add(Attempt(number, step, begun, outcome, words, folder, jsonable(dict(result))))

    try:
        found: Outcome = _DO[step](state)
    except StepFailedError as failure:
        note(FAILED, str(failure), failure.result)
        print_lines(f'dz: error: {step}: {failure}', sys.stderr)
        return False
    except DzRosError as error:
        note(FAILED, ' '.join(str(error).split()), {})
        raise
    note(DONE, found.words, found.result)
    print_lines(found.words)
    return True


def _answers(arguments: argparse.Namespace, c: Configuration,
             log: StepLog) -> tuple[Limits, Plan, float]:
    """Return limits, plan and amplitude: as given, as answered before, or asked now.

    Raises:
        ConfigurationError: One is missing or not allowed.
    """
    earlier = log.newest('limits') if arguments.step not in (None, 'limits') else None
    given: dict[str, Any] = dict(earlier.result) if earlier is not None else {}
    given.update(given_limits(arguments))
    if arguments.amplitude is not None:
        given['amplitude'] = arguments.amplitude
    if arguments.loop_duration < LEAST_DURATION:
        raise ConfigurationError('--loop-duration', arguments.loop_duration,
                                 f'must be >= {LEAST_DURATION:g}')
    for name, unit in needed_limits(c).items():
        if name not in given and sys.stdin.isatty():
            given[name] = _asked(name, QUESTIONS[name], unit)
    limits, plan = build_limits(given, c)
    amplitude = given.get('amplitude', SHARE * limits.travel)
    if not (isinstance(amplitude, (int, float)) and math.isfinite(amplitude)
            and 0.0 < amplitude <= limits.travel):
        raise ConfigurationError('--amplitude', amplitude, 'must be > 0 and at most the travel, '
                                 f'{limits.travel:g}')
    return limits, plan, float(amplitude)


def _asked(name: str, question: str, unit: str) -> float:
    """Return a number that is asked for.

    Raises:
        ConfigurationError: No number comes.
    """
    answer = input(f'{question} [{unit}]? ')
    try:
        return float(answer)
    except ValueError:
        raise ConfigurationError(f'--{name}', answer, 'must be a number') from None

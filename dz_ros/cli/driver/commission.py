# SPDX-License-Identifier: Apache-2.0
"""``dz driver commission``: from a new device to a running loop, step by step.

Every step prints what it found, is recorded, and can be repeated with ``--from STEP``, or in the
page. At the terminal a step that fails ends it: exit code 1, or 2 where something that was given
is wrong, or 130 where Ctrl-C stopped it. With ``--live`` the steps are started and confirmed in
the page (`commission_page`).
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from contextlib import nullcontext
from datetime import datetime, timezone
from pathlib import Path
import sys
from typing import Any

from dz_ros.cli.driver.commission_loop import check_step, loop_step, propose_step, report_step
from dz_ros.cli.driver.commission_moves import identify_step, sensor_step, sign_step
from dz_ros.cli.driver.commission_page import PageOperator
from dz_ros.cli.driver.commission_state import (
    Answers,
    answers_of,
    Operator,
    Outcome,
    SHARE,
    State,
    StepFailedError,
)
from dz_ros.cli.driver.move_limits import add_limits, given_limits, needed_limits
from dz_ros.cli.interrupt import prompt_end
from dz_ros.cli.options import (
    add_address,
    add_configuration,
    check_address,
    read_configuration,
    refuse_existing,
)
from dz_ros.cli.output import print_lines
from dz_ros.cli.processes import check_rclpy
from dz_ros.core.configuration import Configuration
from dz_ros.errors import ConfigurationError, DzRosError
from dz_ros.files.configurations import format_parameters, write_parameters
from dz_ros.identification.commissioning import (
    Attempt,
    DONE,
    FAILED,
    LOG,
    MOVING,
    StepLog,
    STEPS,
)
from dz_ros.runs.metrics import jsonable

STOPPED = 1
QUESTIONS = {'travel': 'How far may it move from where it stands',
             'effort': 'How large may |v| be', 'speed': 'How fast may it move'}
LEAST_DURATION = 5.0
"""A shorter first loop shows nothing [s]."""
GIVEN = 'configuration.yaml'
"""File of the configuration that was given, for ``--from``; of one given later NN- before it, with
the number of the next attempt."""


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
                        help='start and confirm the steps in the browser, with an e-stop; with '
                             '--yes they go on by themselves and are shown there')
    add_address(parser)


def run(arguments: argparse.Namespace) -> int:
    """Go through the steps; return 0, or 1 where one failed.

    Raises:
        RunExistsError: The folder is there already.
        ConfigurationError: A limit is missing or not allowed.
    """
    out: Path = arguments.out
    check_address(arguments, arguments.live)
    guided = arguments.live and not arguments.yes
    if guided and arguments.until:
        raise ConfigurationError('--until', arguments.until, 'is not for --live without --yes: '
                                 'the steps are started in the page')
    if arguments.live:
        check_rclpy()
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
        arguments.config = str(_given(out))
    c = read_configuration(arguments)
    log = StepLog(out)
    answers = _answers(arguments, c, log, guided)       # before anything is written
    out.mkdir(parents=True, exist_ok=True)
    _keep(c, log)
    if not arguments.live:
        return _through(State(c, log, answers, arguments.namespace, arguments.loop_duration,
                              Operator(arguments.yes)), arguments, first, last)
    with PageOperator(arguments, c, log) as operator:
        state = State(c, log, answers, arguments.namespace, arguments.loop_duration, operator)
        if not guided:
            return _through(state, arguments, first, last)
        earlier = {} if arguments.step is None else _answered(log)
        return _guided(state, operator, {**earlier, **given_limits(arguments)})


def _given(out: Path) -> Path:
    """Return the configuration that was given last."""
    return max(out.glob(f'[0-9]*-{GIVEN}'), default=out / GIVEN,
               key=lambda path: int(path.name.partition('-')[0])
               if path.name.partition('-')[0].isdecimal() else -1)


def _keep(c: Configuration, log: StepLog) -> None:
    """Write the configuration given, beside those given before, where it is another."""
    newest = _given(log.folder)
    text = format_parameters(c)
    if not newest.exists():
        write_parameters(c, log.folder / GIVEN)
    elif newest.read_text(encoding='utf-8') != text:
        number = len(log.attempts) + 1
        while (path := log.folder / f'{number:02d}-{GIVEN}').exists():
            number += 1
        write_parameters(c, path)


def _through(state: State, arguments: argparse.Namespace, first: int, last: int) -> int:
    """Go from one step to another; return 0, or 1 where one failed."""
    if first and (given_limits(arguments) or arguments.amplitude is not None):
        _attempt('limits', state)
    for step in STEPS[first:last + 1]:
        if not _attempt(step, state):
            print_lines(f'stopped at step {step}; once it is mended: --from {step} --out '
                        f'{state.log.folder}')
            return STOPPED
    print_lines(f'log of the steps: {state.log.folder / LOG}')
    return 0


def _guided(state: State, operator: PageOperator, given: Mapping[str, Any]) -> int:
    """Make the steps that the page asks for, until it is to end; return 0 where all are done.

    Args:
        state: What the steps share.
        operator: The page.
        given: Limits and plan as given at the terminal, or answered before.
    """
    unit = state.c.make_driver().state_units[0]
    operator.offer({**needed_limits(state.c), 'amplitude': unit}, given)
    while (request := operator.next_request()) is not None:
        step, values = request
        try:
            if step == 'limits':
                plan = {name: value for name, value in given.items() if name != 'amplitude'}
                state.answers = answers_of({**plan, **values}, state.c)
            _attempt(step, state)
        except DzRosError as error:
            print_lines(f'dz: error: {step}: {error}', sys.stderr)
            operator.failed(f'{step}: {error}')
    print_lines(f'log of the steps: {state.log.folder / LOG}')
    overview = state.log.overview()
    return 0 if all(item['outcome'] == DONE and not item['stale'] for item in overview) else (
        STOPPED)


_DO: Mapping[str, Any] = {
    'limits': lambda state: state.limits_outcome(), 'sign': sign_step, 'sensor': sensor_step,
    'identify': identify_step, 'propose': propose_step, 'check': check_step, 'loop': loop_step,
    'report': report_step}


def _attempt(step: str, state: State) -> bool:
    """Make one attempt of a step, log it, print it; return whether it was done."""
    begun = datetime.now(timezone.utc).isoformat(timespec='milliseconds')
    number, state.name = len(state.log.attempts) + 1, state.log.name(step)
    print_lines(f'--- {STEPS.index(step) + 1}/{len(STEPS)} {step}')
    state.operator.begun(step)

    def note(outcome: str, words: str, result: Mapping[str, Any]) -> None:
        folder = state.name if (state.log.folder / state.name).exists() else ''
        state.log.add(Attempt(number, step, begun, outcome, words, folder, jsonable(dict(result))))
        state.operator.ended()

    try:
        with nullcontext() if step in MOVING else prompt_end(lambda: state.kept(step)):
            found: Outcome = _DO[step](state)
    except KeyboardInterrupt as end:
        note(FAILED, 'interrupted', {})
        stated, kept = str(end), state.kept(step)
        raise KeyboardInterrupt(stated if kept in stated else
                                '; '.join(filter(None, (stated, kept)))) from None
    except StepFailedError as failure:
        note(FAILED, str(failure), failure.result)
        print_lines(f'dz: error: {step}: {failure}', sys.stderr)
        return False
    except Exception as error:      # also what is a fault of ours: the page and the log show it
        note(FAILED, ' '.join(str(error).split()) or type(error).__name__, {})
        raise
    note(DONE, found.words, found.result)
    print_lines(found.words)
    return True


def _answered(log: StepLog) -> dict[str, Any]:
    """Return the limits as answered before."""
    earlier = log.newest('limits')
    return dict(earlier.result) if earlier is not None else {}


def _answers(arguments: argparse.Namespace, c: Configuration, log: StepLog,
             guided: bool) -> Answers | None:
    """Return the limits as given, as answered before, or asked now; None = the page asks.

    Raises:
        ConfigurationError: One is missing or not allowed.
    """
    given = _answered(log) if arguments.step not in (None, 'limits') else {}
    given.update(given_limits(arguments))
    if arguments.amplitude is not None:
        given['amplitude'] = arguments.amplitude
    if arguments.loop_duration < LEAST_DURATION:
        raise ConfigurationError('--loop-duration', arguments.loop_duration,
                                 f'must be >= {LEAST_DURATION:g}')
    for name, unit in needed_limits(c).items():
        if name not in given and guided:
            return None
        if name not in given and sys.stdin.isatty():
            given[name] = _asked(name, QUESTIONS[name], unit)
    return answers_of(given, c)


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

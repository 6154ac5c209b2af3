# SPDX-License-Identifier: Apache-2.0
"""The steps of a commissioning after the device is identified: proposal, check, loop, report."""

from __future__ import annotations

import math
from pathlib import Path
import signal
import sys

import numpy as np

from dz_ros.cli.check import format_findings, stability_limit
from dz_ros.cli.driver.commission_moves import last_position
from dz_ros.cli.driver.commission_state import Outcome, State, StepFailedError
from dz_ros.cli.driver.identify_output import proposal_lines
from dz_ros.cli.interrupt import INTERRUPTED
from dz_ros.cli.options import read_recording
from dz_ros.cli.output import print_lines
from dz_ros.cli.progress import stage
from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import ERROR, WARNING, worst
from dz_ros.core.design.rules import check
from dz_ros.core.schema import fields
from dz_ros.errors import ConfigurationError, RecordingError
from dz_ros.files.configurations import load_configuration, write_parameters
from dz_ros.identification.estimation.pipeline import identify_log, refine_identified
from dz_ros.identification.proposal import propose
from dz_ros.runtime.os_signals import ENDS, restore_handlers
from dz_ros.studies.tune import Proposal

PEAK = 2.46
"""Largest speed of point_to_point over distance and duration."""
USED = 0.5
"""Share of the speed limit that the first motion uses."""
SHORTEST = 1.0
"""The first motion takes this at least [s]."""
RAMP = 0.5
"""Time in which the first loop's command goes over from the safe one [s]."""
TRACKS, MOSTLY = 0.1, 0.95
"""A loop tracks where its error is at most the first share of its motion in the second share of
the last samples: a moment in which the machine stands still is no finding."""
PROPOSED = 'proposed.yaml'


def propose_step(state: State) -> Outcome:
    """Write a configuration for a small motion from where the device stands.

    Raises:
        StepFailedError: No gains keep the design rules.
    """
    if state.identified is None:
        run = read_recording(state.of('identify') / 'run')
        try:
            with stage('finding the dead-zone'):
                samples, found = identify_log(run, state.c)
                state.identified = found, refine_identified(found, samples, state.c)[0]
        except RecordingError as error:
            raise StepFailedError(str(error)) from error
    found, fitted = state.identified
    try:
        with stage('proposing gains'):
            proposal, notes = propose(first_motion(state), found, fitted)
    except ConfigurationError as error:
        raise StepFailedError(str(error)) from error
    path = state.folder / PROPOSED
    write_parameters(proposal.after, path)
    print_lines(proposal_lines(proposal, (), notes, path))
    if lacking := lacks(proposal, state.answered.amplitude):
        raise StepFailedError(lacking)
    return Outcome(f'configuration: {path}', {
        key: value for key, value in proposal.after.to_flat('controller', 'safety').items()
        if isinstance(value, (int, float, str))})


def lacks(proposal: Proposal, amplitude: float) -> str:
    """Return why the proposed loop does not follow the first motion in simulation, '' if it does.

    Args:
        proposal: The proposal with its simulated runs.
        amplitude: Of the motion [unit of x].
    """
    for name, row in proposal.rows.items():
        if not name.startswith('after'):
            continue
        if row['lost']:
            return f'the proposed loop is lost in simulation: {row["reason"]}'
        if row['error_max'] > TRACKS * amplitude:
            return (f'the proposed loop does not follow in simulation: largest error '
                    f'{row["error_max"]:.3g} of a motion of {amplitude:g}, largest |v| '
                    f'{row["v_peak_run"]:.3g}: allow more --effort, or a smaller --amplitude')
    return ''


def first_motion(state: State) -> Configuration:
    """Return the configuration given, for a first motion within the limits."""
    c, limits = state.c, state.limits
    home = state.log.number('identify', 'position') if c.plant.order > 1 else 0.0
    duration = SHORTEST
    if c.plant.order > 1:
        duration = max(duration, PEAK * state.answered.amplitude / (USED * limits.speed))
    keys = {'trajectory.kind': 'point_to_point', 'trajectory.start': home,
            'trajectory.goal': home + state.answered.amplitude, 'trajectory.t_start': 1.0,
            'trajectory.duration': duration, 'trajectory.repeat': True, 'trajectory.dwell': 1.0,
            'loop.duration': state.duration, 'safety.command_limit': limits.effort,
            'safety.error_limit': 0.5 * limits.travel,
            'safety.ramp': c.safety.ramp or RAMP}
    if c.simulated and c.plant_settings.command_limit == 0.0:
        keys['plant.command_limit'] = limits.effort
    if 'v_max' in {item.name for item in fields(type(c.law.gains))}:
        keys['controller.v_max'] = limits.effort
    sensor = state.log.newest('sensor')
    step = sensor.result.get('resolution') if sensor is not None else None
    if isinstance(step, float) and step > 0.0 and c.make_driver().resolution == 0.0:
        keys['driver.resolution'] = step
    kept = {key: value for key, value in c.to_flat().items()
            if not key.startswith('trajectory.')}
    return Configuration.from_flat({**kept, **keys})


def proposed(state: State) -> tuple[Path, Configuration]:
    """Return the newest proposal.

    Raises:
        StepFailedError: There is none.
        ConfigurationError: It cannot be read.
    """
    path = state.of('propose') / PROPOSED
    return path, load_configuration(path)


def check_step(state: State) -> Outcome:
    """Apply the design rules to the proposal.

    Raises:
        StepFailedError: One finds an error.
    """
    path, c = proposed(state)
    findings = check(c, None, stability_limit(c))
    print(format_findings(findings))
    count = {level: sum(item.level == level for item in findings) for level in (ERROR, WARNING)}
    rules = {'errors': count[ERROR], 'warnings': count[WARNING], 'rules': [
        item.rule for item in findings if item.level in (ERROR, WARNING)]}
    if worst(findings) == ERROR:
        raise StepFailedError(f'{count[ERROR]} design rules find an error in {path}', **rules)
    return Outcome(f'{path} keeps the design rules, {count[WARNING]} warnings', rules)


def loop_step(state: State) -> Outcome:
    """Close the loop for a small motion, record it, and judge whether it tracks.

    Raises:
        StepFailedError: It does not, or the loop ends in a fault.
        KeyboardInterrupt: Ctrl-C has ended the loop.
    """
    from dz_ros.cli.main import parser_of
    from dz_ros.report.verdict import judge
    from dz_ros.report.view import View

    path, c = proposed(state)
    name = f'/{state.namespace.strip("/")}/estop' if state.namespace.strip('/') else '/estop'
    amplitude = state.answered.amplitude
    state.may_move(f'the first closed loop, {amplitude:g} back and forth', c.loop.duration)
    print_lines(f'the e-stop is armed: topic {name}, dz estop, Ctrl-C')
    directory = state.folder / 'run'
    words = ['run', str(path), '--record', str(directory), '--namespace', state.namespace,
             *from_where_it_stands(state, c)]
    arguments = parser_of(words).parse_args(words)
    previous = {number: signal.getsignal(number) for number in ENDS}
    try:
        code = arguments.do(arguments)
    finally:
        restore_handlers(previous)
    sys.stdout.flush()
    if code == INTERRUPTED and not state.operator.stopped():
        raise KeyboardInterrupt('the loop has ended in order' + (
            f', its recording is {directory}' if directory.exists() else ''))
    if not directory.exists():
        raise StepFailedError(f'the loop did not start, exit code {code}')
    view = View.of(read_recording(directory))
    verdict, unit = judge(view), c.make_driver().state_units[0]
    rows = view.rows
    tail = np.abs(rows.error[rows.t >= view.metrics.window[0], 0])
    error = float(np.quantile(tail, MOSTLY)) if len(tail) else math.inf
    numbers = {'error': error, 'error_max': view.metrics.error_max, 'exit_code': code,
               'failures': list(verdict.failures)}
    if np.isfinite(rows.x[:, 0]).any():
        numbers['position'] = last_position(rows.x[:, 0])
    if code or verdict.failures:
        raise StepFailedError('; '.join(verdict.failures) or f'exit code {code}', **numbers)
    found = (f'error {error:.3g} {unit} in {MOSTLY:.0%} of the last samples, largest '
             f'{view.metrics.error_max or math.inf:.3g} {unit}, of a motion of '
             f'{amplitude:g} {unit}')
    if not error <= TRACKS * amplitude:
        raise StepFailedError(f'it does not track: {found}', **numbers)
    return Outcome(f'it tracks: {found}', numbers)


def from_where_it_stands(state: State, c: Configuration) -> list[str]:
    """Return the words by which a repeated loop begins where the device was left.

    Raises:
        StepFailedError: It is beyond the travel about where it stood when it was identified.
    """
    if c.plant.order < 2 or c.simulated:        # a simulated plant begins at its x0
        return []
    home, here = state.log.number('identify', 'position'), state.log.position()
    if here == home:
        return []
    travel, unit = state.limits.travel, c.make_driver().state_units[0]
    if abs(here - home) > 0.5 * travel:
        raise StepFailedError(f'the loop before has left the device at {here:.4g} {unit}, further '
                              f'than {0.5 * travel:.4g} from {home:.4g}, where it was identified: '
                              'bring it back and begin with --from identify')
    goal = here + math.copysign(state.answered.amplitude, home - here)
    return ['--set', f'trajectory.start={here!r}', '--set', f'trajectory.goal={goal!r}']


def report_step(state: State) -> Outcome:
    """Write the report of the newest loop."""
    from dz_ros.report.report import write_report

    run = state.of('loop') / 'run'
    data = read_recording(run)
    with stage('drawing pictures') as step:
        page = write_report(data, state.folder / 'report', title=run.parent.name, progress=step)
    return Outcome(f'report: {page}', {'page': str(page.relative_to(state.log.folder))})

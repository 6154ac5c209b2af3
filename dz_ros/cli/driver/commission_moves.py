# SPDX-License-Identifier: Apache-2.0
"""The steps of a commissioning that move the device open loop: sign, sensor, identification."""

from __future__ import annotations

import time
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dz_ros.cli.driver.commission_state import Outcome, State, StepFailedError
from dz_ros.cli.driver.identify_moves import move
from dz_ros.cli.driver.identify_output import doubts, plant_lines, result_lines, write_bounds
from dz_ros.cli.interrupt import prompt_end
from dz_ros.cli.output import print_lines
from dz_ros.errors import DriverError, RecordingError
from dz_ros.identification.estimation.pipeline import (
    find_delay,
    identify,
    refine_identified,
)
from dz_ros.identification.estimation.sensor import resolution
from dz_ros.identification.experiment.moves import Experiment
from dz_ros.identification.experiment.pulses import Pulses, SignTest
from dz_ros.identification.samples import Samples, to_run

Moves = TypeVar('Moves', bound=Experiment)
ALIKE = 0.05
"""A step is the one that the driver states where it differs by this share at most."""


def _moved(state: State, experiment: Moves, what: str) -> Samples:
    """Ask, move, keep the moves as a run, whatever comes of them.

    Raises:
        StepFailedError: The device did not do what it had to, or it was stopped.
    """
    c = state.c
    state.may_move(what, experiment.duration)
    begun = time.time_ns()
    try:
        samples = move(c, experiment, state.namespace,
                       lambda found: state.keep(to_run(found, c, begun)), state.operator.watch)
    except DriverError as error:
        raise StepFailedError(' '.join(str(error).split())) from error
    for breach in experiment.breaches:
        print_lines(f'a limit stopped it: {breach}')
    state.keep(to_run(samples, c, begun))
    return samples


def last_position(x: NDArray[np.float64]) -> float:
    """Return where the device stood last, of positions of which one at least is finite."""
    return float(x[np.isfinite(x)][-1])


def sign_step(state: State) -> Outcome:
    """Let the device just move to either side.

    Raises:
        StepFailedError: It moves the other way, or not at all.
    """
    c = state.c
    test = SignTest(state.limits, state.answered.plan, c.plant.order, c.loop.period,
                    c.safety.safe_command)
    samples = _moved(state, test, 'a small pulse to each side')
    right, left = test.sides[1], -test.sides[-1]
    return Outcome(f'the device follows the command: it began to move at v = {right:.4g} and '
                   f'{left:.4g} {c.make_driver().command_unit}',
                   {'right': right, 'left': left, 'position': last_position(samples.x[:, 0])})


def sensor_step(state: State) -> Outcome:
    """Measure resolution, noise and delay by pulses.

    Raises:
        StepFailedError: The device does not do what it has to.
    """
    c = state.c
    sides = [state.log.number('sign', name) for name in ('right', 'left')]
    pulses = Pulses(state.limits, state.answered.plan, c.plant.order, c.loop.period,
                    c.safety.safe_command, sides)
    samples = _moved(state, pulses, 'short pulses to both sides')
    shown, stated = resolution(samples.x[:, 0]), samples.resolution
    step = shown or stated
    missing = float(np.mean(~np.isfinite(samples.x[:, 0])))
    units = c.make_driver().state_units
    found = {'resolution': step, 'noise': list(pulses.noise), 'missing': missing,
             'position': last_position(samples.x[:, 0])}
    try:
        delay = find_delay(samples.without_short_holes(), c, pulses.moving)
        found['delay'] = delay
        late = f'commands act {delay} samples late'
    except RecordingError as error:
        late = f'the pulses do not show the delay ({error}), the identification will'
    noise = ', '.join(f'{value:.2g} {unit}' for value, unit in
                      zip(pulses.noise[:samples.measured], units, strict=False))
    steps = f'one step of the position is {step:.4g} {units[0]}' if step else (
        'the position shows no steps')
    if stated and not shown:
        steps += ', as the driver states'
    elif stated and abs(shown / stated - 1.0) > ALIKE:
        steps += f', the driver states {stated:.4g} {units[0]}'
    return Outcome(steps + f'; noise at rest {noise}; {late}'
                   + (f'; {100.0 * missing:.2g} % of the samples without a measurement'
                      if missing else ''), found)


def identify_step(state: State) -> Outcome:
    """Find dead-zone and plant by the moves of ``dz driver identify``.

    Raises:
        StepFailedError: The moves do not show them.
    """
    c = state.c
    experiment = Experiment(state.limits, state.answered.plan, c.plant.order, c.loop.period,
                            c.safety.safe_command)
    samples = _moved(state, experiment,
                     f'{experiment.plan.repeats} times ramps and steps both ways'
                     ).without_short_holes()
    with prompt_end(lambda: state.kept('identify')):
        try:
            found = identify(samples, c, experiment.moving)
        except RecordingError as error:
            raise StepFailedError(str(error)) from error
        fitted, problem = refine_identified(found, samples, c)
    breakaway = [v for _, v in experiment.breakaway]
    print_lines(result_lines(found, c, breakaway))
    print_lines(plant_lines(fitted, c, found.friction_counted))
    write_bounds(found, fitted, c, breakaway, state.folder)
    state.identified = found, fitted
    numbers = {name: item.value for name, item in found.bounds.items()}
    return Outcome('; '.join(('identified: ' + ', '.join(
        f'{name} = {value:.4g}' for name, value in numbers.items()),
        *doubts(found, breakaway, c), *([problem] if problem else ()))),
                   {**numbers, 'delay': found.delay, 'residual': found.residual,
                    'position': last_position(samples.x[:, 0])})

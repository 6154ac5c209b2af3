# SPDX-License-Identifier: Apache-2.0
"""The least squares of stretches of motion: which delay, and dead-zone or friction (ours).

Commands are taken to act after the whole number of samples with which the equation leaves the
least. Friction and dead-zone add up while a device is driven; only a command within the dead-zone,
or against the motion, separates them. So friction is *counted in* (`least_squares`) unless a dead-
zone beside it explains more than chance would, of a signal that is not visibly rounded: else any
share of either would be an answer, with bounds that know nothing of the others. A device that
accelerates against the command is refused; compared are

    x^(n−1)  with  −Σ a_i ∫Y_i + κ ∫v                   κ > 0
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.errors import RecordingError
from dz_ros.identification.estimation.consistency import rounding
from dz_ros.identification.estimation.least_squares import Line, residual_without_zone, solve
from dz_ros.identification.estimation.sensor import measurement_noise
from dz_ros.identification.estimation.stretches import Cutter, Stack, Stretch
from dz_ros.identification.samples import Samples

PER_STRETCH, CHANCE = 2, 9.21
"""Independent measurements that a stretch counts for at least, and the χ² of two parameters that
chance exceeds in 1 % of all cases."""
SURE = 4.0
"""Standard errors from which on a slope is not 0."""
LONGEST_DELAY, FARTHER = 10, 3
"""Delays of up to the first number of samples are tried, but none the second number of samples
behind one that leaves `CLEARLY` less."""
CLEARLY = 1.2
"""How many times as much."""
ENTERED = 0.02
"""Share of the samples of motion to either side whose command must lie inside the dead-zone, or
against the motion, to show it."""
MISFIT, WORTH = 3.0, 2.0
"""A residual of this many times the sensor's noise is that of a model that lacks something; a
dead-zone then has to make it this many times smaller."""


@dataclass(frozen=True)
class MotionFit:
    """Stretches of motion, the least squares of them, and what it took.

    Attributes:
        stretches, stack: The stretches, and their integrated equation.
        line: The constants.
        delay: Samples after which a command acts.
        by_side: Whether friction is counted in.
    """

    stretches: list[Stretch]
    stack: Stack
    line: Line
    delay: int
    by_side: bool


class WrongSignError(RecordingError):
    """The device is driven against the command, whatever the delay."""


def best_delay(samples: Samples, c: Configuration, margin: float) -> MotionFit:
    """Return the least squares for the delay with which the equation leaves the least.

    Raises:
        RecordingError: There is too little motion, or the samples contradict themselves.
    """
    cutter = Cutter(samples, c)
    best: MotionFit | None = None
    problem, blind = RecordingError('nothing to identify'), math.inf
    for delay in range(LONGEST_DELAY + 1):
        try:
            moving = cutter.moving(margin, delay)
        except RecordingError as error:
            problem = error
            continue
        try:
            found = fit_motion(moving, samples, c, delay)
        except WrongSignError:
            raise
        except RecordingError as error:
            least = residual_without_zone(_stack(moving, samples, c))
            if least < blind:
                problem, blind = error, least
            continue
        if best is None or found.line.residual < best.line.residual:
            best = found
        elif delay >= best.delay + FARTHER and found.line.residual > CLEARLY * best.line.residual:
            break
    if best is None or blind < best.line.residual:     # most likely a delay that shows nothing
        raise problem
    return best


def _stack(found: list[Stretch], samples: Samples, c: Configuration,
           without: Sequence[int] = ()) -> Stack:
    """Return the integrated equation of stretches."""
    return Stack(found, samples.period, c.plant.order - samples.measured + 1, without)


def fit_motion(found: list[Stretch], samples: Samples, c: Configuration,
               delay: int) -> MotionFit:
    """Return the constants of stretches; friction counted in where no dead-zone shows beside it.

    Args:
        found: The stretches.
        samples: Where they were cut from.
        c: Model of the plant.
        delay: Samples after which a command acts.

    Raises:
        WrongSignError: The device is driven against the command.
        RecordingError: There is no motion, or it does not distinguish the constants.
    """
    if not found:
        raise RecordingError('nothing to identify: there is no motion')
    stack = _stack(found, samples, c)
    if delay == 0:
        _check_command_sign(stack)
    friction = c.plant.friction if found[0].side else ()
    line: Line | None = None
    try:
        line = solve(stack)
    except RecordingError as error:
        problem = error
    if line is not None and (not friction or _shows_dead_zone(stack, line, samples, c)):
        return MotionFit(found, stack, line, delay, False)
    if not friction:
        raise problem
    together = _stack(found, samples, c, friction)
    counted = solve(together, by_side=True)
    if line is None and (counted.zone[0, 2:] < SURE * counted.common[2:]).any():
        raise problem
    return MotionFit(found, together, counted, delay, True)


def noise_of(samples: Samples) -> float:
    """Return the noise of what is measured last [its unit]."""
    return measurement_noise(samples.x[:, samples.measured - 1])


def _shows_dead_zone(stack: Stack, line: Line, samples: Samples, c: Configuration) -> bool:
    """Return whether a dead-zone beside friction explains more than chance would (ours).

    A command that never enters the dead-zone while the device moves shows the sum of friction and
    dead-zone alone: any share of either leaves the same. The two break points are the two
    parameters more of an F-test against none. Neighbouring samples err alike, so each counts for
    less than one: by how much the errors of stretches exceed those of white noise. Where the
    residual is not noise, the model of friction itself lacks something, which a dead-zone may
    seem to explain; then it has to explain most of the residual. Visible rounding is no noise: it
    bends a slow motion as a dead-zone does.
    """
    if line.at_limit or rounding(samples, c):
        return False
    inside = np.array([np.mean(v * side < edge * side) for side, edge in zip(
        (1.0, -1.0), line.zone[0, :2], strict=True) if len(v := stack.v[stack.side == side])])
    if inside.min(initial=1.0) < ENTERED:
        return False
    ratio = residual_without_zone(stack) / max(line.residual, 1e-300)
    if line.residual > MISFIT * noise_of(samples) and ratio < WORTH:
        return False
    alike = float(np.median(line.common / np.maximum(line.errors[0], 1e-300)))
    count = max(PER_STRETCH * stack.count, len(stack.v) / max(1.0, alike) ** 2)
    return count * (ratio * ratio - 1.0) > CHANCE


def _check_command_sign(stack: Stack) -> None:
    """Check that the device accelerates the way of the command.

    Args:
        stack: Stretches of motion.

    Raises:
        WrongSignError: It is driven the other way.
    """
    columns = np.column_stack([-stack.y, stack.integral(stack.v[:, np.newaxis])])
    scale = np.sqrt((columns * columns).sum(axis=0))
    if not (scale > 0.0).all():
        return
    columns = columns / scale
    gram = columns.T @ columns
    if np.linalg.cond(gram) > 1e12:
        return
    inverse = np.linalg.inv(gram)
    solution = inverse @ (columns.T @ stack.left)
    rest = stack.left - columns @ solution
    # Neighbouring samples of a stretch err alike: each stretch counts for a few.
    variance = float(rest @ rest) / max(1, PER_STRETCH * stack.count)
    error = math.sqrt(variance * float(inverse[-1, -1]))
    if solution[-1] < -SURE * error:
        raise WrongSignError('the device accelerates against the command: command or state has '
                             'the wrong sign')

# SPDX-License-Identifier: Apache-2.0
"""The least squares of stretches of motion: which delay, and dead-zone or friction (ours).

Commands are taken to act after the whole number of samples with which the equation leaves the
least. Friction and dead-zone add up while a device is driven; only a command within the dead-zone,
or against the motion, separates them. So friction is *counted in* (`least_squares`) unless a
dead-zone beside it explains more than chance would: else any share of either would be an answer,
with bounds that know nothing of the others. A device that accelerates against the command is
refused; compared are

    x^(n−1)  with  −Σ a_i ∫Y_i + κ ∫v                   κ > 0
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.errors import RecordingError
from dz_ros.identification.estimation.least_squares import Line, residual_without_zone, solve
from dz_ros.identification.estimation.stretches import Cutter, Stack, Stretch
from dz_ros.identification.samples import Samples

PER_STRETCH, CHANCE = 2, 9.21
"""Independent measurements that a stretch counts for at least, and the χ² of two parameters that
chance exceeds in 1 % of all cases."""
SURE = 4.0
"""Standard errors from which on a slope is not 0."""
LONGEST_DELAY = 5
"""Delays of up to this number of samples are tried."""


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
    problem = RecordingError('nothing to identify')
    for delay in range(LONGEST_DELAY + 1):
        try:
            found = fit_motion(cutter.moving(margin, delay), samples, c, delay)
        except WrongSignError:
            raise
        except RecordingError as error:
            problem = error
            continue
        if best is None or found.line.residual < best.line.residual:
            best = found
    if best is None:
        raise problem
    return best


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
    times = c.plant.order - samples.measured + 1
    stack = Stack(found, samples.period, times)
    if delay == 0:
        _check_command_sign(stack)
    friction = c.plant.friction if found[0].side else ()
    line: Line | None = None
    try:
        line = solve(stack)
    except RecordingError as error:
        problem = error
    if line is not None and (
            not friction or (not line.at_limit and _shows_dead_zone(stack, line))):
        return MotionFit(found, stack, line, delay, False)
    if not friction:
        raise problem
    together = Stack(found, samples.period, times, friction)
    counted = solve(together, by_side=True)
    if line is None and (counted.zone[0, 2:] < SURE * counted.common[2:]).any():
        raise problem
    return MotionFit(found, together, counted, delay, True)


def _shows_dead_zone(stack: Stack, line: Line) -> bool:
    """Return whether a dead-zone beside friction explains more than chance would (ours).

    A command that never enters the dead-zone while the device moves shows the sum of friction and
    dead-zone alone: any share of either leaves the same. The two break points are the two
    parameters more of an F-test against none. Neighbouring samples err alike, so each counts for
    less than one: by how much the errors of stretches exceed those of white noise.
    """
    none = residual_without_zone(stack)
    alike = float(np.median(line.common / np.maximum(line.errors[0], 1e-300)))
    count = max(PER_STRETCH * stack.count, len(stack.v) / max(1.0, alike) ** 2)
    return count * ((none / max(line.residual, 1e-300)) ** 2 - 1.0) > CHANCE


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

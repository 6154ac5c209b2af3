# SPDX-License-Identifier: Apache-2.0
"""The one estimator of plant and dead-zone, for moves and for logs (ours).

    samples ─ consistency ─ stretches ─ least squares ┬ prediction error: plant, with confidence
                                                      └ values of each repeat: bounds

`identify` finds the delay of the commands, plant and bounds from the motion in an experiment or a
log; `fit_log` finds the plant of a log alone, for the delay that is configured, rest and reversals
included where there is no friction or little motion. Both begin with the same least squares and
refine by the same prediction error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.errors import LoopError, RecordingError
from dz_ros.identification.estimation.bounds import Bound, parameter_bound
from dz_ros.identification.estimation.consistency import (
    check_log,
    check_samples,
    Doubt,
    rounding,
)
from dz_ros.identification.estimation.least_squares import (
    COUNT,
    hats,
    Line,
    solve_over_time,
    ZONE,
)
from dz_ros.identification.estimation.long_simulation import refine_by_simulation
from dz_ros.identification.estimation.motion_fit import (
    best_delay,
    fit_motion,
    LONGEST_DELAY,
    MotionFit,
    noise_of,
    WrongSignError,
)
from dz_ros.identification.estimation.physical_parameters import friction_terms
from dz_ros.identification.estimation.prediction_error import Fit, fit, Parameters
from dz_ros.identification.estimation.stretches import Cutter, Stretch
from dz_ros.identification.experiment.plan import LEAST_REPEATS
from dz_ros.identification.samples import check_length, from_run, motion_speed, Samples

Array = NDArray[np.float64]

SPARE = 1.2
"""Stretches for each unknown, where there are too few for a node in each repeat."""
ENOUGH_MOTION = 20
"""Stretches of motion from which on a plant with friction is fitted to these alone."""


@dataclass(frozen=True)
class Identified:
    """A dead-zone and its plant.

    Attributes:
        bounds: By name, in the order of `ZONE`.
        a: a_i, shape (r,).
        disturbance: Factor of the modelled disturbance; 1 where the model has none.
        residual: RMS of what the equation leaves, in the unit of what was measured last.
        times: Middle of each repeat [s], shape (R,).
        stretches: The stretches of motion.
        drift: What `ZONE` differs in each of them from its mean, shape (G, 4).
        delay: Samples after which a command acts.
        integrations: How often the equation was integrated to reach what was measured.
        friction_counted: Whether the break points count friction and constant forces in, since
            the motion does not show a dead-zone beside them.
        notes: What the samples leave open.
        noise: Of what was measured last [its unit]; a residual far above it is of the model.
    """

    bounds: dict[str, Bound]
    a: Array
    disturbance: float
    residual: float
    times: Array
    stretches: tuple[Stretch, ...]
    drift: Array
    delay: int
    integrations: int
    friction_counted: bool
    notes: tuple[str, ...] = ()
    noise: float = 0.0


def identify(samples: Samples, c: Configuration, margin: float) -> Identified:
    """Return the dead-zone that the motion shows, with bounds.

    The commands are taken to act after a whole number of samples, the one with which the equation
    leaves the least.

    Args:
        samples: Experiment or run.
        c: Model of the plant.
        margin: Speed that counts as motion.

    Raises:
        RecordingError: They do not show it, or contradict themselves.
    """
    doubt = check_samples(samples, c)
    try:
        return _bounded(best_delay(samples, c, margin), samples, c, doubt)
    except WrongSignError:
        raise
    except RecordingError as error:
        coarse = rounding(samples, c)
        hint = f'; {coarse}: record it with more digits' if coarse else ''
        raise RecordingError(f'{error}{hint}') from None


def find_delay(samples: Samples, c: Configuration, margin: float) -> int:
    """Return the number of samples after which a command acts, as `identify` finds it.

    Raises:
        RecordingError: The samples do not show it, or contradict themselves.
    """
    check_samples(samples, c)
    return best_delay(samples, c, margin).delay


def _bounded(best: MotionFit, samples: Samples, c: Configuration, doubt: Doubt) -> Identified:
    """Return the result with values of each repeat, and the bounds they and the doubt give."""
    found, period = best.stretches, samples.period
    repeats = sorted({item.repeat for item in found if item.repeat >= 0})
    if len(repeats) < LEAST_REPEATS:
        raise RecordingError(f'{len(repeats)} repeats show motion, {LEAST_REPEATS} are needed')
    middles = np.array([period * np.mean(item.rows) for item in found])
    nodes = np.array([np.mean([middle for middle, item in zip(middles, found, strict=True)
                               if item.repeat == number]) for number in repeats])
    constants = best.stack.y.shape[1]
    if len(found) <= constants + COUNT * len(nodes):
        # Too few stretches for a node in each: some have one together.
        fewer = max(LEAST_REPEATS, int((len(found) / SPARE - constants) / COUNT))
        nodes = np.array([np.mean(part) for part in np.array_split(middles, fewer)])
    line = solve_over_time(best.stack, middles, nodes, best.line, best.by_side)
    noise = np.sqrt(np.mean(line.errors ** 2, axis=0))
    if best.by_side:
        _check_constant_force(line, c)
    bounds = {name: parameter_bound(name, line.zone[:, i], float(noise[i]),
                                    float(line.common[i])) for i, name in enumerate(ZONE)}
    for name in ZONE[2:]:
        bounds[name] = bounds[name].wider(doubt.scale)
    notes = doubt.notes
    if best.delay == LONGEST_DELAY:
        notes = (*notes, f'commands act {best.delay} samples late or more, no larger delay was '
                 'tried: that is another model of the plant, or too slow a loop')
    a, _, factor = _plant(c, line, best.by_side)
    return Identified(bounds, a, factor, line.residual, nodes, tuple(found),
                      hats(middles, nodes) @ (line.zone - line.zone.mean(axis=0)), best.delay,
                      c.plant.order - samples.measured + 1, best.by_side, notes,
                      noise_of(samples))


def _check_constant_force(line: Line, c: Configuration) -> None:
    """Check that friction, counted in, holds a constant force.

    Raises:
        RecordingError: It does not: at v = 0 the device moves by itself.
    """
    b_r, b_l = line.zone[:, :2].mean(axis=0).tolist()
    if b_r < 0.0 or b_l > 0.0:
        unit, hold = c.plant.actuator_unit, 0.5 * (b_r + b_l)
        raise RecordingError(
            f'a constant force is larger than friction and dead-zone: the device is held by '
            f'v = {hold:.3g} {unit} and moves by itself without; count it out of the commands, '
            f'dz bag import --map v=…{-hold:+.3g}, and add it again behind the controller')


def _plant(c: Configuration, line: Line, by_side: bool) -> tuple[Array, Array, float]:
    """Return a_i, `ZONE` of the dead-zone proper, and the factor of the disturbance."""
    r, zone = c.plant.regressor_count, line.zone.mean(axis=0)
    kept = r - (len(c.plant.friction) if by_side else 0)
    factor = float(line.a[kept]) if len(line.a) > kept else 1.0
    if not by_side:
        return line.a[:r], zone, factor
    friction, zone = friction_terms(c.plant, zone)
    a = np.zeros(r)
    rest = [i for i in range(r) if i not in c.plant.friction]
    a[rest], a[list(c.plant.friction)] = line.a[:kept], friction
    return a, zone, factor


def fit_identified(found: Identified, samples: Samples, c: Configuration) -> Fit:
    """Return the plant of what was identified, refined by prediction error over its motion.

    The drift of the dead-zone stays as it was found; its means are refined. Where friction is
    counted in, a plant with a constant force is refined by long simulations as well.

    Raises:
        RecordingError: Too little data.
        LoopError: The search found nothing.
    """
    zone = np.array([item.value for item in found.bounds.values()])
    if found.friction_counted:
        zone = friction_terms(c.plant, zone)[1]
    start = Parameters(found.a, zone, found.disturbance)
    fitted = fit(samples, found.stretches, c, [start], found.delay, found.friction_counted,
                 None if found.friction_counted else found.drift)
    if not found.friction_counted:
        return fitted
    return refine_by_simulation(fitted, samples, c, found.delay)


def refine_identified(found: Identified, samples: Samples,
                      c: Configuration) -> tuple[Fit | None, str]:
    """Return the plant by `fit_identified`; None and why where there is none."""
    try:
        return fit_identified(found, samples, c), ''
    except (RecordingError, LoopError) as error:
        return None, f'the plant is that of least squares alone: {error}'


def fit_log(run: RunData, c: Configuration) -> Fit:
    """Return plant and dead-zone estimated from all of a run.

    Args:
        run: The run; its states and commands are used.
        c: Model, known constants, b, delay, command limit, rate.

    Raises:
        RecordingError: Too little data, or a log that contradicts itself.
        LoopError: The search found nothing.
    """
    check_log(run, c.loop.period)
    samples = from_run(run, c, c.loop.delay)
    check_samples(samples, c)
    cutter, zone = Cutter(samples, c), c.dead_zone
    everything, moving = cutter.everything(), cutter.moving(motion_speed(samples), least=0)
    starts = [Parameters(np.array(c.plant.a), np.array([
        zone.b_r, zone.b_l, c.plant.b * zone.m_r, c.plant.b * zone.m_l]), 1.0)]
    for stretches in (moving, everything):
        try:
            found = fit_motion(stretches, samples, c, 0)
        except WrongSignError:
            raise
        except RecordingError:
            continue
        a, values, _ = _plant(c, found.line, found.by_side)
        starts.append(Parameters(a, values, 1.0))
        if stretches is moving and c.plant.friction and len(moving) >= ENOUGH_MOTION:
            fitted = fit(samples, moving, c, starts[-1:], 0, found.by_side)
            return refine_by_simulation(fitted, samples, c, 0)
    fitted = fit(samples, everything, c, starts)
    return refine_by_simulation(fitted, samples, c, 0) if c.plant.friction else fitted


def identify_log(run: RunData, c: Configuration) -> tuple[Samples, Identified]:
    """Return a run as samples, and what it shows of the dead-zone.

    Raises:
        RecordingError: Too short, or as `identify`.
    """
    check_log(run, c.loop.period)
    samples = from_run(run, c)
    check_length(samples)
    return samples, identify(samples, c, motion_speed(samples))

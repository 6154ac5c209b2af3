"""From samples to a dead-zone: stretches of motion, the delay that fits best, the bounds."""

from __future__ import annotations

from dataclasses import dataclass

from dz_ros.core.configuration import Configuration
from dz_ros.errors import RecordingError
from dz_ros.identification.bounds import Identified, identify
from dz_ros.identification.regression import solve
from dz_ros.identification.session import Samples
from dz_ros.identification.stretches import Stack, Stretch, stretches

LATEST = 5
"""Delays of up to so many samples are tried."""


@dataclass(frozen=True)
class Evaluation:
    """What samples tell.

    Attributes:
        result: The dead-zone.
        found: The stretches of motion that tell.
        times: How often the plant's equation was integrated to reach what was measured.
    """

    result: Identified
    found: tuple[Stretch, ...]
    times: int


def evaluate(samples: Samples, c: Configuration, margin: float) -> Evaluation:
    """Return what samples tell of a dead-zone.

    The commands are taken to act after a whole number of samples, the one with which the equation
    leaves the least.

    Args:
        samples: Experiment or run.
        c: Model of the plant.
        margin: Speed that counts as motion.

    Raises:
        RecordingError: They do not tell.
    """
    times = c.plant.order - samples.measured + 1
    best: tuple[float, int, list[Stretch]] | None = None
    problem = RecordingError('nothing to identify')
    for delay in range(LATEST + 1):
        try:
            found = stretches(samples, c, margin, delay)
            residual = solve(Stack(found, samples.period, times)).residual
        except RecordingError as error:
            problem = error
            continue
        if best is None or residual < best[0]:
            best = (residual, delay, found)
    if best is None:
        raise problem
    _, delay, found = best
    return Evaluation(identify(found, samples.period, times, delay), tuple(found), times)

"""From repeats to bounds: what a parameter was in each repeat, and what it may be (ours).

p_j, j = 1 … R, is a break point or slope at repeat j (`drifting`). It differs from one to another
because the device drifts, because the measurement is noisy, and because of whatever acts on the
device that nobody modelled. The bounds are a tolerance interval of these values: with 95 %
confidence they hold 90 % of all the values the parameter takes while it goes on as it did,

    p̄ ± √((k s)² + (t e)²),   k = z_{0.95} √((R − 1)(1 + 1/R)/χ²_{0.05, R−1})       [howe1969]

s: standard deviation of the p_j; k for normally distributed, independent p_j; 16 repeats have
k = 2.44. e: standard error of their mean, which also holds what all repeats have in common, the
constants a_i; t = t_{0.975, R−1}.

What that means, and what not:

- A parameter that does not drift gets bounds that hold it, as wide as noise makes them.
- One that drifts with an amplitude A as a sine gets about ±1.7 A, 1.7 times its whole range 2 A:
  it is given the tails of a normal distribution, which a sine does not have. A steady drift over
  the experiment gets about 1.5 times its range. So drifts of these kinds lie within the bounds
  altogether. Noise adds to both.
- *Drift* is what happened during the experiment, from repeat to repeat. Slower drift shows in
  part, what is faster than a repeat is averaged; nothing is said of a device that changes later.
- An error that every repeat makes alike shows in no scatter: a wrong model of friction, a wrong
  time base. The bounds are about the device only as far as the plant's model is.

`noise` is the part of s that the measurement explains (the residual taken as white); what is left
of s² is attributed to drift and to disturbances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.errors import RecordingError
from dz_ros.identification.drifting import solve_drifting
from dz_ros.identification.plan import LEAST_REPEATS
from dz_ros.identification.regression import solve, ZONE
from dz_ros.identification.stretches import Stack, Stretch

Array = NDArray[np.float64]

CONTENT, CONFIDENCE = 0.9, 0.95


@dataclass(frozen=True)
class Bound:
    """One parameter of the dead-zone.

    Attributes:
        name: One of `ZONE`.
        values: p_j of each repeat, shape (R,).
        low, high: The bounds.
        spread: s, standard deviation of the values.
        noise: The part of it that the measurement's noise explains.
        common: e, standard error of what all repeats have in common.
    """

    name: str
    values: Array
    low: float
    high: float
    spread: float
    noise: float
    common: float

    @property
    def value(self) -> float:
        """Mean of the repeats."""
        return float(self.values.mean())

    @property
    def drift(self) -> float:
        """Standard deviation between repeats that noise does not explain."""
        return math.sqrt(max(0.0, self.spread ** 2 - self.noise ** 2))

    @property
    def width(self) -> float:
        """Distance of the bounds."""
        return self.high - self.low


@dataclass(frozen=True)
class Identified:
    """A dead-zone, found.

    Attributes:
        bounds: By name, in the order of `ZONE`.
        a: a_i, then the factor of the modelled disturbance, where there is one.
        residual: RMS of what the equation leaves, in the unit of what was measured last.
        times: Middle of each repeat [s], shape (R,).
        stretches: How many stretches of motion tell.
        delay: Samples after which a command acts.
    """

    bounds: dict[str, Bound]
    a: Array
    residual: float
    times: Array
    stretches: int
    delay: int


def tolerance_factor(count: int, content: float = CONTENT,
                     confidence: float = CONFIDENCE) -> float:
    """Return k of the two-sided normal tolerance interval x̄ ± k s [howe1969].

    Args:
        count: Number of values.
        content: Share of the distribution that is to lie within.
        confidence: With which probability it does.
    """
    from scipy.stats import chi2, norm

    free = count - 1
    return float(norm.ppf(0.5 * (1.0 + content))
                 * math.sqrt(free * (1.0 + 1.0 / count) / chi2.ppf(1.0 - confidence, free)))


def identify(found: Sequence[Stretch], period: float, times: int = 1,
             delay: int = 0) -> Identified:
    """Return the dead-zone that stretches of motion show.

    Args:
        found: The stretches; those of no repeat (−1) help to find a_i.
        period: T [s].
        times: How often the equation is integrated: n + 1 less the number of measured states.
        delay: Samples by which the stretches' commands were delayed; kept with the result.

    Raises:
        RecordingError: They do not tell, or there are too few repeats.
    """
    repeats = sorted({item.repeat for item in found if item.repeat >= 0})
    if len(repeats) < LEAST_REPEATS:
        raise RecordingError(f'{len(repeats)} repeats show motion, {LEAST_REPEATS} are needed')
    stack = Stack(found, period, times)
    nodes = np.array([period * np.mean([np.mean(item.rows) for item in found
                                        if item.repeat == number]) for number in repeats])
    middles = np.array([period * np.mean(item.rows) for item in found])
    pooled = solve(stack)
    line = solve_drifting(stack, middles, nodes, pooled)
    noise = np.sqrt(np.mean(line.errors ** 2, axis=0))
    return Identified({name: _bound(name, line.values[:, i], float(noise[i]),
                                    float(line.common[i])) for i, name in enumerate(ZONE)},
                      line.a, line.residual, nodes, len(found), delay)


def _bound(name: str, values: Array, noise: float, common: float) -> Bound:
    from scipy.stats import t

    count = len(values)
    spread = float(values.std(ddof=1))
    half = math.hypot(tolerance_factor(count) * spread, t.ppf(0.975, count - 1) * common)
    middle = float(values.mean())
    low, high = middle - half, middle + half
    if name == 'b_r':
        low = max(low, 0.0)
    elif name == 'b_l':
        high = min(high, 0.0)
    elif low <= 0.0:
        raise RecordingError(f'{name} is somewhere between {low:.3g} and {high:.3g}: the repeats '
                             'differ too much to say; make more and longer ones, or keep away '
                             'what disturbs the device')
    if low > high:
        raise RecordingError(f'{name} seems to be {middle:.3g}, on the wrong side of 0: the '
                             'commands recorded are not those that acted, or the model of the '
                             'plant is another one')
    return Bound(name, values, low, high, spread, noise, common)

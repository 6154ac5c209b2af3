# SPDX-License-Identifier: Apache-2.0
"""Bounds of a parameter from its values in each repeat (ours).

p_j, j = 1 … R, is a break point or slope at repeat j (`least_squares`). It differs from one to
another because the device drifts, because the measurement is noisy, and because of disturbances
that the model does not have. The bounds are a tolerance interval of these values: with 95 %
confidence they hold 90 % of all the values the parameter takes while it goes on as it did,

    p̄ ± √((k s)² + (t e)²),   k = z_{0.95} √((R − 1)(1 + 1/R)/χ²_{0.05, R−1})       [howe1969]

s: standard deviation of the p_j; k for normally distributed, independent p_j; 16 repeats have
k = 2.44. e: standard error of their mean, which also holds what all repeats have in common, the
constants a_i; t = t_{0.975, R−1}. They are at least ± `LEAST` p̄: values that agree to six digits
show no more than that, since no model of a device is that good.

What that means, and what not:

- A parameter that does not drift gets bounds that hold it, as wide as noise makes them.
- One that drifts with an amplitude A as a sine gets about ±1.7 A, 1.7 times its whole range 2 A:
  it is given the tails of a normal distribution, which a sine does not have. A steady drift over
  the experiment gets about 1.5 times its range. So drifts of these kinds lie within the bounds
  altogether. Noise adds to both.
- *Drift* is what happened during the experiment, from repeat to repeat. Slower drift shows in
  part, what is faster than a repeat is averaged; it does not hold for a device that changes later.
- An error that every repeat makes alike shows in no scatter: a wrong model of friction, a wrong
  time base. The bounds are about the device only as far as the plant's model is. A wrong factor
  shows where a signal and its rate are measured; `consistency` finds it, the bounds count it.

`noise` is the part of s that the measurement explains (the residual taken as white); what is left
of s² is attributed to drift and to disturbances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.errors import RecordingError

Array = NDArray[np.float64]

CONTENT, CONFIDENCE = 0.9, 0.95
LEAST = 1e-3
"""Share of a parameter by which its bounds are away from it at least."""


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

    def wider(self, share: float) -> Bound:
        """Return the same for values that may be too large or too small by a share, < 1."""
        return replace(self, low=self.low / (1.0 + share), high=self.high / (1.0 - share))


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


def parameter_bound(name: str, values: Array, noise: float, common: float) -> Bound:
    """Return the bounds of one parameter.

    Args:
        name: One of `ZONE`.
        values: p_j, shape (R,).
        noise: The part of their spread that noise explains.
        common: e.

    Raises:
        RecordingError: A break point on the wrong side of 0, or a slope that may be 0.
    """
    from scipy.stats import t

    count = len(values)
    spread = float(values.std(ddof=1))
    half = math.hypot(tolerance_factor(count) * spread, t.ppf(0.975, count - 1) * common)
    middle = float(values.mean())
    half = max(half, LEAST * abs(middle))
    low, high = middle - half, middle + half
    if name == 'b_r':
        low = max(low, 0.0)
    elif name == 'b_l':
        high = min(high, 0.0)
    elif low <= 0.0:
        raise RecordingError(f'{name} is somewhere between {low:.3g} and {high:.3g}: the repeats '
                             'differ too much; make more and longer ones, or keep away '
                             'what disturbs the device')
    if low > high:
        raise RecordingError(f'{name} seems to be {middle:.3g}, on the wrong side of 0: the '
                             'commands recorded are not those that acted, or the model of the '
                             'plant is another one')
    return Bound(name, values, low, high, spread, noise, common)

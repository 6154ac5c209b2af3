# SPDX-License-Identifier: Apache-2.0
"""When what a device measured is a measurement still, for every driver of one (ours).

    fresh       no older than `limit`
    absent      none of the last `safety.state_hold` samples found a fresh one: a fault
    advanced    x(t) = x(t_s) + (t - t_s) x'(t_s), over no more than `limit`

t_s is the instant that a measurement describes. What is new at all is judged before, by what the
device's messages carry: a seq and a clock (`serial`), a stamp (`joint`), contradictions
(`cia402`); what is not new is never taken, so that it grows old like silence. Times are those of a
steady clock [s].
"""

from __future__ import annotations

from dataclasses import dataclass
import math
import time
from typing import Any, TYPE_CHECKING

from dz_ros.core.schema import parameter

if TYPE_CHECKING:
    from dz_ros.core.configuration import Configuration

BASELINE = 4.0
"""Samples over which a speed that is not measured is taken, to advance the position."""
SAMPLES = 2.0
"""A measurement older than this is none, unless a parameter states another [samples]."""


def fresh_parameter(what: str) -> Any:
    """Return the parameter `fresh` of a driver.

    Args:
        what: What the device sends, with its article.
    """
    return parameter(SAMPLES, 'samples', f'an older {what} is none', minimum=0.1)


@dataclass(frozen=True)
class Freshness:
    """How old a measurement may be.

    Attributes:
        limit: An older one is none [s].
        absent: A device without a new one for longer has a fault [s]; infinite = never.
    """

    limit: float
    absent: float = math.inf

    @classmethod
    def of(cls, samples: float, configuration: Configuration) -> Freshness:
        """Return the rule for a loop.

        Args:
            samples: Longest age [samples].
            configuration: Of the loop: its period, `safety.state_hold`.
        """
        period, hold = configuration.loop.period, configuration.safety.state_hold
        return cls(samples * period, (samples + hold - 1) * period if hold else math.inf)

    def holds(self, at: float, now: float | None = None) -> bool:
        """Return whether what is of `at` is a measurement now."""
        return _age(at, now) <= self.limit

    def lost(self, at: float, now: float | None = None) -> bool:
        """Return whether there has been nothing new since `at` for too long."""
        return _age(at, now) > self.absent

    def advanced(self, x: float, speed: float, age: float) -> float:
        """Return a position brought forward by its age [s]; as it is where no speed is known.

        It is brought back to a sample that ended before: its age is negative.
        """
        return x + speed * min(max(age, -self.limit), self.limit) if math.isfinite(speed) else x


def _age(at: float, now: float | None) -> float:
    return (time.monotonic() if now is None else now) - at

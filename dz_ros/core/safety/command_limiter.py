# SPDX-License-Identifier: Apache-2.0
"""The command limiter: finite, within the limit, within the rate, ramped at the start.

    v_r = v_safe + (v − v_safe) min((t − t_start)/ramp, 1)        after the law took over
    v_d = clip(v_r, v⁻ − R Δt, v⁻ + R Δt)                         R: rate limit
    out = clip(v_d, −L, +L)                                       L: command limit

Everything that is off is skipped, so that with nothing on the output is the input, bit for bit.
What is not finite becomes the safe command. (ours)
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

from dz_ros.core.safety.settings import SafetySettings

CATCH_UP = 3.0
"""Longest interval that the rate limit counts after a pause [samples]."""


class CommandLimiter:
    """Bounds magnitude and rate of the commands at one end of the loop.

    Args:
        settings: Limits; may be replaced at any time.
        period: T [s].

    Attributes:
        settings: Limits that apply.
        output: Last output.
        limited: Number of commands changed by the rate, the ramp or the limit.
        refused: Number of commands replaced because they were not finite.
    """

    def __init__(self, settings: SafetySettings, period: float) -> None:
        self.settings = settings
        self.output = settings.safe_command
        self.limited = 0
        self.refused = 0
        self._period = period
        self._start = -math.inf
        self._t = -math.inf

    def start(self, t: float) -> None:
        """Begin at time t [s]: rate and ramp count from the safe command."""
        self._start = t
        self._t = t - self._period
        self.output = self.settings.safe_command

    def configure(self, settings: SafetySettings) -> None:
        """Use other limits from now on."""
        self.settings = settings

    def safe(self, t: float) -> float:
        """Return the safe command, at once, whatever the rate limit."""
        self._t = t
        self.output = self.settings.safe_command
        return self.output

    def limit(self, v: float, t: float) -> float:
        """Return the limited command for v at time t [s]; NaN where it is not finite."""
        given, s = v, self.settings
        if s.ramp > 0.0 and t - self._start < s.ramp:
            share = max(0.0, (t - self._start) / s.ramp)
            v = s.safe_command + (v - s.safe_command) * share
        if s.rate_limit > 0.0:
            step = s.rate_limit * min(max(t - self._t, 0.0), CATCH_UP * self._period)
            v = min(max(v, self.output - step), self.output + step)
        if s.command_limit > 0.0:
            v = min(max(v, -s.command_limit), s.command_limit)
        # The given one is checked as well: max and min hide a NaN.
        return v if math.isfinite(v) and math.isfinite(given) else math.nan

    def apply(self, v: float, t: float) -> float:
        """Return the output for a command v at time t [s]."""
        return self.send(v, self.limit(v, t), t)

    def send(self, v: float, limited: float, t: float) -> float:
        """Return the output for a command v at time t [s] that `limit` has limited."""
        if math.isnan(limited):
            self.refused += 1
            return self.safe(t)
        if limited != v:
            self.limited += 1
        self._t = t
        self.output = limited
        return limited


class CommandLimiters:
    """Command limiters of several axes, with the interface of one; commands are rows.

    Args:
        settings: Limits of each axis.
        period: T [s].
    """

    def __init__(self, settings: Sequence[SafetySettings], period: float) -> None:
        self.each = [CommandLimiter(item, period) for item in settings]

    @property
    def settings(self) -> SafetySettings:
        """Limits of the machine: the holds, which are one for all axes."""
        return self.each[0].settings

    def configure(self, settings: Sequence[SafetySettings]) -> None:
        """Use other limits from now on."""
        for limiter, item in zip(self.each, settings, strict=True):
            limiter.settings = item

    @property
    def output(self) -> tuple[float, ...]:
        """Last outputs, shape (n,)."""
        return tuple(limiter.output for limiter in self.each)

    @property
    def limited(self) -> int:
        """Number of commands changed, of all axes."""
        return sum(limiter.limited for limiter in self.each)

    def start(self, t: float) -> None:
        """Begin at time t [s]: rate and ramp count from the safe commands."""
        for limiter in self.each:
            limiter.start(t)

    def safe(self, t: float) -> tuple[float, ...]:
        """Return the safe commands, at once."""
        return tuple(limiter.safe(t) for limiter in self.each)

    def apply(self, v: Sequence[float], t: float) -> tuple[float, ...]:
        """Return the outputs for commands v at time t [s]."""
        return tuple(limiter.apply(item, t) for limiter, item in zip(self.each, v, strict=True))


def limiter_of(settings: SafetySettings | Sequence[SafetySettings], period: float) -> Any:
    """Return the command limiter of an axis, or, of a sequence of settings, of as many."""
    return (CommandLimiter(settings, period) if isinstance(settings, SafetySettings)
            else CommandLimiters(settings, period))

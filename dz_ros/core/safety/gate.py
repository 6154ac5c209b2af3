"""The one way out for commands: finite, within the limit, within the rate, ramped at the start.

    v_r = v_safe + (v − v_safe) min((t − t_start)/ramp, 1)        after the law took over
    v_d = clip(v_r, v⁻ − R Δt, v⁻ + R Δt)                         R: rate limit
    out = clip(v_d, −L, +L)                                       L: command limit

Everything that is off is skipped, so that with nothing on the very same number comes out. What is
not finite comes out as the safe command. (ours)
"""

from __future__ import annotations

import math

from dz_ros.core.safety.settings import SafetySettings

CATCH_UP = 3.0
"""After a pause the command may move by the rate of so many samples at once, not of the pause."""


class OutputGate:
    """Lets commands out of the controller, or through to an actuator.

    Args:
        settings: Limits; may be replaced at any time.
        period: T [s].

    Attributes:
        settings: Limits in force.
        output: What went out last.
        limited: Commands changed by the rate, the ramp or the limit so far.
        refused: Commands replaced because they were not finite.
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

    def safe(self, t: float) -> float:
        """Return the safe command, at once, whatever the rate limit."""
        self._t = t
        self.output = self.settings.safe_command
        return self.output

    def limit(self, v: float, t: float) -> float:
        """Return what would go out for a command v at time t [s]; NaN where it is not finite."""
        given, s = v, self.settings
        if s.ramp > 0.0 and t - self._start < s.ramp:
            share = max(0.0, (t - self._start) / s.ramp)
            v = s.safe_command + (v - s.safe_command) * share
        if s.rate_limit > 0.0:
            step = s.rate_limit * min(max(t - self._t, 0.0), CATCH_UP * self._period)
            v = min(max(v, self.output - step), self.output + step)
        if s.command_limit > 0.0:
            v = min(max(v, -s.command_limit), s.command_limit)
        # The given one is asked as well: max and min hide a NaN.
        return v if math.isfinite(v) and math.isfinite(given) else math.nan

    def let_out(self, v: float, t: float) -> float:
        """Return what goes out for a command v at time t [s]."""
        return self.send(v, self.limit(v, t), t)

    def send(self, v: float, limited: float, t: float) -> float:
        """Return what goes out for a command v at time t [s] that `limit` has limited."""
        if math.isnan(limited):
            self.refused += 1
            return self.safe(t)
        if limited != v:
            self.limited += 1
        self._t = t
        self.output = limited
        return limited

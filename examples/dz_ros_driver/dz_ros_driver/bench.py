# SPDX-License-Identifier: Apache-2.0
"""Where your hardware would be: a thruster with a dead-zone on a vehicle, moving as time does.

(13.5 + 6.36) u' + 13.7 u + 141 |u| u = D(v), thrust D(v) = v ∓ 7 N beyond ±7 N, else 0.
"""

from __future__ import annotations

import time

STEP = 0.001


class Bench:
    """A vehicle on the bench; `read` and `write` take what a serial line would take."""

    def __init__(self, delay: float = 0.0) -> None:
        self.u = 0.0
        self.v = 0.0
        self._delay = delay
        self._now = time.monotonic()

    def write(self, v: float) -> None:
        """Command a thrust [N]."""
        self._move()
        self.v = v

    def read(self) -> float:
        """Return the speed [m/s]."""
        time.sleep(self._delay)
        self._move()
        return self.u

    def _move(self) -> None:
        """Let the time pass that has passed."""
        thrust = self.v - 7.0 if self.v > 7.0 else self.v + 7.0 if self.v < -7.0 else 0.0
        now = time.monotonic()
        while self._now < now:
            h = min(STEP, now - self._now) or STEP
            self.u += h * (thrust - 13.7 * self.u - 141.0 * abs(self.u) * self.u) / 19.86
            self._now += h

# SPDX-License-Identifier: Apache-2.0
"""Runaway guard: a device that gains speed against its command, for longer than is allowed (ours).

Over an interval that begins when the command v begins to push against the motion, or when the
speed is the least since then:

    σ = sign v,  the same throughout                      command that is held
    σ x^(n−1) < 0,  |x^(n−1)| beyond its least            power of the wrong sign, speed gained
    σ (Δx^(n−1) + ∫ Σ a_i Y_i dt) ≤ −SHARE b ∫ |v| dt     beyond the model's own motion
    σ Δx^(n−1) ≤ −GAIN b ∫ |v| dt                         by more than a creep

The third line is what the model's own motion does not explain. A device whose command or
measurement has the wrong sign does all four from the first command that moves it; a healthy one
brakes, which is not the second, or is driven by its own dynamics, which is not the third. A device
that creeps, as a motor on a slope of its cogging inside the dead-zone, is the fourth: the friction
of the model would have stopped it, so that the third takes its creep for a push. At order 1,
x^(n−1) is x itself. a_i and b are those of the configuration, which a controller may know; the
dead-zone is not needed. One instance at each end of the loop.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

from dz_ros.core.plants.base import Plant

SHARE = 0.5
"""Share of the acceleration b|v| that must act against the command."""
GAIN = 0.02
"""Share of the speed ∫ b|v| dt that must be gained against the command, friction or not."""
LONGEST_GAP = 5.0
"""Samples further apart begin again [samples]."""
REASON = 'runaway'
"""Begin of the reason of its fault."""


def runaway_text(lasted: float, limit: float) -> str:
    """Return the reason of the fault."""
    return (f'{REASON}: the device has gained speed against the command for {lasted:.3g} s, '
            f'safety.runaway_time = {limit:g}: command or measurement may have the wrong sign')


class RunawayGuard:
    """Duration for which a device has gained speed against its command.

    Args:
        plant: Model, with a_i and b.
        period: T [s].

    Attributes:
        plant: The model; may be replaced at any time.
    """

    def __init__(self, plant: Plant, period: float) -> None:
        self.plant = plant
        self._period = period
        self._y = [0.0] * plant.regressor_count
        self.restart()

    def restart(self) -> None:
        """Forget the samples before."""
        self._last: tuple[float, float, Sequence[float]] | None = None
        self._own: float | None = None      # of the last sample, where it has been needed
        self._begin_at(0.0, 0.0, 0.0)

    def sample(self, t: float, v: float, x: Sequence[float]) -> float:
        """Return for how long the device has gained speed against the command [s].

        Args:
            t: Loop time of the sample [s].
            v: Command held since the sample before [actuator unit].
            x: State x … x^(n−1), shape (n,).
        """
        last, fast = self._last, x[-1]
        own_before, self._own = self._own, None
        self._last = t, fast, tuple(x)
        if last is None or not math.isfinite(fast + v):
            self._begin_at(0.0, t, fast)
            return 0.0
        dt = t - last[0]
        side = math.copysign(1.0, v) if v != 0.0 else 0.0
        if not 0.0 < dt <= LONGEST_GAP * self._period or side * fast >= 0.0:
            self._begin_at(0.0, t, fast)
            return 0.0
        if side != self._side or abs(fast) <= self._least:
            self._begin_at(side, t, fast)
            return 0.0
        # Regressors cost as much as the law: they are needed in few samples of a healthy loop.
        own = self._own = self._own_acceleration(x)
        if own_before is None:
            own_before = self._own_acceleration(last[2])
        if not math.isfinite(own + own_before):
            self._begin_at(0.0, t, fast)
            return 0.0
        self._gained += side * (fast - last[1] - 0.5 * (own + own_before) * dt)
        self._expected += self.plant.b * abs(v) * dt
        if self._gained >= 0.0:
            self._begin_at(side, t, fast)
            return 0.0
        runs_away = (self._gained <= -SHARE * self._expected
                     and abs(fast) - self._least >= GAIN * self._expected)
        return t - self._since if runs_away else 0.0

    def _begin_at(self, side: float, t: float, fast: float) -> None:
        self._side, self._since, self._least = side, t, abs(fast)
        self._gained = self._expected = 0.0

    def _own_acceleration(self, x: Sequence[float]) -> float:
        """Return −Σ a_i Y_i, the model's motion without a command [unit of x^(n)]."""
        try:
            self.plant.regressors(x, self.plant.constants, self._y)
        except (ArithmeticError, ValueError):
            return math.nan
        return -sum(a * y for a, y in zip(self.plant.a, self._y, strict=True))

# SPDX-License-Identifier: Apache-2.0
"""Numbers of the drive ↔ units of the plant (ours; objects of CiA 402).

    x  = ± (6064h − zero) u/(c g)              c counts_per_rev, g gear, u unit_per_rev
    x' = ± 606Ch u/(c_v g)                     c_v velocity_counts, c unless given
    6071h = ± 1000 v τ/τ_rated  [per mille]    τ torque_per_command      (mode torque)
    60FFh = ± v q c_v g/u                      q speed_per_command       (mode velocity)

with − where the drive is reversed. The position is a number that wraps: measurement.py.
"""

from __future__ import annotations

from dataclasses import dataclass

from dz_ros.drivers.cia402.settings import Cia402Parameters

WHOLE = 2 ** 32
"""Values of a 32-bit counter."""
_HALF = WHOLE // 2


@dataclass(frozen=True)
class Scaling:
    """Factors between both worlds.

    Attributes:
        position: Unit of x per count, with its sign.
        velocity: Unit of x' per number of 606Ch, with its sign.
        command: Numbers of the target object per command unit, with its sign.
        largest: Largest number the target object may be given.
        zero: Count at which x is 0.
        counts_per_number: Counts/s per number of 606Ch.
    """

    position: float
    velocity: float
    command: float
    largest: int
    zero: int
    counts_per_number: float = 1.0

    @classmethod
    def of(cls, p: Cia402Parameters) -> Scaling:
        """Return the factors that parameters mean."""
        sign = -1.0 if p.reverse else 1.0
        velocity_counts = p.velocity_counts or float(p.counts_per_rev)
        per_speed = sign * velocity_counts * p.gear / p.unit_per_rev
        if p.mode == 'torque':
            command = sign * 1000.0 * p.torque_per_command / p.rated_torque
            largest = int(1000.0 * p.max_torque)
        else:
            command = per_speed * p.speed_per_command
            largest = int(p.max_speed / 60.0 * velocity_counts)
        return cls(sign * p.unit_per_rev / (p.counts_per_rev * p.gear), 1.0 / per_speed, command,
                   largest, p.zero, p.counts_per_rev / velocity_counts)

    @property
    def limit(self) -> float:
        """Largest |v| that the target object can hold [command unit]."""
        return self.largest / abs(self.command)

    def x(self, counts: int) -> float:
        """Return x of a position that was unwrapped."""
        return (counts - self.zero) * self.position

    def speed(self, number: float) -> float:
        """Return x' of a velocity actual value."""
        return number * self.velocity

    def target(self, v: float) -> int:
        """Return the number of the target object for v, at most the largest either way.

        Args:
            v: Command, finite.
        """
        return min(max(round(v * self.command), -self.largest), self.largest)

    # The way back, for the simulated drive.

    def counts(self, x: float) -> int:
        """Return the position actual value of x as the 32-bit number it is sent as."""
        return wrapped(round(x / self.position) + self.zero)

    def number(self, speed: float) -> int:
        """Return the velocity actual value of x', held within its 32 bits."""
        return min(max(round(speed / self.velocity), -_HALF), _HALF - 1)

    def v(self, target: int) -> float:
        """Return the command a number of the target object means."""
        return target / self.command


def wrapped(counts: int, modulus: int = WHOLE) -> int:
    """Return a count as the signed number it wraps to, −modulus/2 ≤ number < modulus/2."""
    return (counts + modulus // 2) % modulus - modulus // 2

# SPDX-License-Identifier: Apache-2.0
"""The smoothest curve through given points, from rest to rest (ours).

Of all curves through (t_k, x_k) that start and end at rest, the one with the least
∫ (x_d^(n+1))² dt: a spline of degree 2n + 1, continuous through the derivative 2n inside and n at
both ends, n the order of the plant. Between two points alone it is the polynomial from rest to
rest; for n = 2 the curve of least jerk.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dz_ros.core.schema import parameter
from dz_ros.core.trajectories.base import Trajectory
from dz_ros.core.trajectories.spline import spline
from dz_ros.errors import ConfigurationError


@dataclass(frozen=True)
class WaypointsParameters:
    """The points; a file of them has been read before it comes here."""

    file: str = parameter('', '', 'CSV file with the columns t [s] and x, in place of times and '
                          'positions', structural=True)
    times: tuple[float, ...] = parameter((), 's', 'times t_k of the points, increasing',
                                         minimum=0.0, structural=True)
    positions: tuple[float, ...] = parameter((), 'unit of x', 'x_d at these times',
                                             structural=True)
    repeat: bool = parameter(False, '', 'start again at the end, which must be where it starts',
                             structural=True)

    def check(self, prefix: str) -> None:
        """Check that there are points, in order, and a repetition without a jump."""
        if self.file and not self.times:
            raise ConfigurationError(f'{prefix}file', self.file, 'has not been read; give '
                                     f'{prefix}times and {prefix}positions here')
        if len(self.times) < 2:
            raise ConfigurationError(f'{prefix}times', list(self.times), 'must have at least 2 '
                                     f'numbers, with as many in {prefix}positions; or give '
                                     f'{prefix}file')
        if len(self.positions) != len(self.times):
            raise ConfigurationError(f'{prefix}positions', _short(self.positions),
                                     f'must have {len(self.times)} numbers, one for each time')
        for before, after in zip(self.times, self.times[1:], strict=False):
            if after <= before:
                raise ConfigurationError(f'{prefix}times', _short(self.times), 'must increase: '
                                         f'{after:g} s follows {before:g} s')
        if self.repeat and self.positions[0] != self.positions[-1]:
            raise ConfigurationError(f'{prefix}repeat', True, 'needs the last position, '
                                     f'{self.positions[-1]:g}, to be the first, '
                                     f'{self.positions[0]:g}')


class Waypoints(Trajectory):
    """Spline through points; before the first and after the last it rests.

    Raises:
        ConfigurationError: As `WaypointsParameters.check`.
    """

    name = 'waypoints'
    summary = 'smoothest curve through points of a list or a CSV file'
    max_order = 4
    Parameters = WaypointsParameters

    def __init__(self, parameters: Any = None, order: int = 2) -> None:
        super().__init__(parameters, order)
        p = self.parameters
        p.check('trajectory.')
        pieces = spline(p.times, p.positions, order)
        self._constants = (float(len(p.times)), 2.0 * order + 2.0, 1.0 if p.repeat else 0.0,
                           *p.times, p.positions[-1], *pieces.ravel().tolist())

    @property
    def constants(self) -> tuple[float, ...]:
        """Points, coefficients of a piece, 1 if it repeats, times, last position, coefficients."""
        return self._constants

    @staticmethod
    def evaluate(t: float, p: Sequence[float], x_d: Any) -> None:
        """Write the curve and its derivatives."""
        count = int(p[0])
        width = int(p[1])
        first = p[3]
        last = p[2 + count]
        if p[2] != 0.0 and t > first:
            t = first + (t - first) % (last - first)
        for i in range(len(x_d)):
            x_d[i] = 0.0
        if t >= last:
            x_d[0] = p[3 + count]
            return
        base = 4 + count
        if t <= first:
            x_d[0] = p[base]
            return
        low, high = 0, count - 1
        while high - low > 1:
            middle = (low + high) // 2
            if p[3 + middle] <= t:
                low = middle
            else:
                high = middle
        length = p[4 + low] - p[3 + low]
        u = (t - p[3 + low]) / length
        base += low * width
        scale = 1.0
        for i in range(len(x_d)):
            total = 0.0
            for j in range(width - 1, i - 1, -1):
                factor = p[base + j]
                for k in range(i):
                    factor *= j - k
                total = total * u + factor
            x_d[i] = total * scale
            scale /= length


def _short(numbers: Sequence[float]) -> list[float | str]:
    """Return the numbers, or the first few of many, for a message of one line."""
    return [*numbers] if len(numbers) <= 6 else [*numbers[:6], '…']

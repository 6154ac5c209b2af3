# SPDX-License-Identifier: Apache-2.0
"""When a state was measured, on the host's clock (ours).

    measured = t_device + least of (arrived − t_device) of late

A state arrives late where the line, the reader's thread or the machine was; its clock shows by how
much, against the quickest state of the last one to two `WINDOW`. Only differences within that
time count, so that a device's clock that is 1 % off costs 2 ms at most. What all states take, at
least their time on the line, is not seen.
"""

from __future__ import annotations

import math

from dz_ros.drivers.serial.protocol import State

WINDOW = 0.1
"""Time after which another state becomes the quickest one [s]."""


class DeviceClock:
    """The clock of a device in one session."""

    def __init__(self) -> None:
        self._last: State | None = None
        self._passed = 0.0
        self._least = [math.inf, math.inf]
        self._until = -math.inf

    def measured(self, state: State, arrived: float) -> float:
        """Return when a state was measured [s of the host's clock], at the latest when it arrived.

        Args:
            state: The state, newer than the one before.
            arrived: When it arrived [s].
        """
        if self._last is not None:
            self._passed += between(self._last, state)
        self._last = state
        if arrived > self._until:
            self._least = [math.inf, self._least[0] if arrived < self._until + WINDOW
                           else math.inf]
            self._until = arrived + WINDOW
        self._least[0] = min(self._least[0], arrived - self._passed)
        return self._passed + min(self._least)


def between(first: State, last: State) -> float:
    """Return the time between two states by the device's clock [s]."""
    return (last.time_us - first.time_us) % 2 ** 32 * 1e-6

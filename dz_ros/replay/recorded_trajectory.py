# SPDX-License-Identifier: Apache-2.0
"""The reference of a log as a trajectory, for loops whose reference no configuration describes.

Sample k has the recorded reference meant for it, brought to k T where its stamp differs; between
samples and beyond them the nearest one is continued by its own derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.loop.controller import SNAP
from dz_ros.core.records import extrapolate, Reference
from dz_ros.core.trajectories.base import Trajectory
from dz_ros.errors import RecordingError


class RecordedTrajectory(Trajectory):
    """x_d … x_d^(n) of every sample, from a log; not for configuration files."""

    name = 'recorded'
    summary = 'the reference of a log, sample by sample'

    def __init__(self, parameters: Any, order: int, numbers: tuple[float, ...]) -> None:
        super().__init__(parameters, order)
        self._numbers = numbers

    @classmethod
    def of(cls, run: RunData, c: Configuration, origin: float) -> RecordedTrajectory:
        """Return the reference of a run.

        Args:
            run: The run.
            c: Order and rate; its trajectory's parameters are kept for show.
            origin: Stamp that becomes time 0 [s].

        Raises:
            RecordingError: The log has no references of this order.
        """
        channel = run.channels.get('reference')
        width = c.plant.order + 1
        if channel is None or not len(channel) or channel.values.shape[1] != 2 + width:
            raise RecordingError(f'the log has no references with {width} numbers: choose a '
                                 'trajectory by --set trajectory.kind=…')
        good = np.flatnonzero(np.isfinite(channel.values).all(axis=1))
        order = good[np.argsort(channel['stamp'][good], kind='stable')]
        stamps = channel['stamp'][order] - origin
        numbers = [c.loop.period]
        for k in range(c.loop.samples + 1):
            t = k * c.loop.period
            row = order[int(np.argmin(np.abs(stamps - t)))]
            own = Reference(k, float(channel['stamp'][row]) - origin,
                            tuple(channel.values[row][2:].tolist()))
            numbers += own.x_d if abs(own.stamp - t) < SNAP else own.at(t).x_d
        return cls(c.trajectory.parameters, c.plant.order, tuple(numbers))

    @property
    def constants(self) -> tuple[float, ...]:
        """T, then the samples one after the other."""
        return self._numbers

    @staticmethod
    def evaluate(t: float, p: Sequence[float], x_d: Any) -> None:
        """Write the reference."""
        width = len(x_d)
        last = (len(p) - 1) // width - 1
        k = min(max(int(t / p[0] + 0.5), 0), last)
        ahead = t - k * p[0]
        for i in range(width):
            x_d[i] = p[1 + k * width + i]
        if ahead != 0.0:
            extrapolate(x_d, ahead, x_d)

# SPDX-License-Identifier: Apache-2.0
"""What an observer is: a velocity from positions, a pure step like that of a law.

    (memory, x, x_d x_d' x_d'' at the same instant, interval)  →  (velocity, memory)

For a plant of order n of which x … x^(n−2) are measured, x^(n−2) takes the place of the position
and x_d^(n−2) … x_d^(n) that of x_d, x_d', x_d''. The first measurement after a restart is where it
begins. The numbers live in one static scalar function, used as it is online, compiled
offline.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
import math
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.design.linear_loop import LinearObserver


class Observer(ABC):
    """Observes the derivative of what is measured; subclass it to add your own.

    Args:
        omega: Its rate ω [rad/s]; may be replaced at any time.

    Attributes:
        name: Name in configurations.
        size: Numbers of memory; the first is 0 until it has begun.
        memory: Memory now.
    """

    name: ClassVar[str]
    size: ClassVar[int]

    def __init__(self, omega: float) -> None:
        self.omega = omega
        self.memory = [0.0] * self.size

    def restart(self) -> None:
        """Forget the past; the next measurement is where it begins."""
        self.memory = [0.0] * self.size

    def step(self, x: float, reference: Sequence[float], interval: float) -> float:
        """Take a measurement; return the velocity at it.

        Args:
            x: Measured position.
            reference: x_d, x_d', x_d'' at the same instant, shape (3,).
            interval: Time since the last measurement [s]; 0 = the same instant, measured again.
        """
        return float(self.kernel(self.omega, self.memory, x, reference[0], reference[1],
                                 reference[2], interval))

    @staticmethod
    @abstractmethod
    def kernel(omega: float, memory: Any, x: float, x_d: float, v_d: float, a_d: float,
               dt: float) -> float:
        """Return the velocity; change memory in place."""

    @classmethod
    def linear(cls, omega: float, period: float) -> LinearObserver | None:  # noqa: ARG003
        """Return what it is on the error; None = not linear."""
        return None


def noise_gain(observer: LinearObserver) -> float:
    """Return the standard deviation of the velocity for white noise of deviation 1 on x [1/s].

    That of the stationary state P = F P Fᵀ + g gᵀ.
    """
    f, g = observer.step, observer.gain
    size = len(g)
    covariance = np.linalg.solve(np.eye(size * size) - np.kron(f, f), np.outer(g, g).ravel())
    return math.sqrt(float(covariance.reshape(size, size)[1, 1]))


def closed(prediction: NDArray[np.float64], gain: NDArray[np.float64]) -> LinearObserver:
    """Return prediction and correction by `gain` of the first state as one step."""
    return LinearObserver((np.eye(len(gain)) - np.outer(gain, np.eye(len(gain))[0])) @ prediction,
                          gain)

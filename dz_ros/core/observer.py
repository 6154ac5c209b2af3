"""A velocity that is not measured, from positions: the discrete Luenberger observer (ours).

With the acceleration a taken for known, over the interval T between two measurements x:

    x⁻ = x̂ + T v̂ + ½ T² a        v⁻ = v̂ + T a                      prediction
    r = x − x⁻                                                      residual
    x̂ = x⁻ + (1 − z²) r          v̂ = v⁻ + ((1 − z)²/T) r            correction

which puts both poles of the error at z = e^(−ωT). a is the reference's x_d^(n): near the
reference it is right, so that the observer need not be fast, and what it leaves of the noise is
small. A bare backward difference passes √2 σ/T of a noise σ.

For a plant of order n of which x … x^(n−2) are measured, x^(n−2) takes the place of the position.
"""

from __future__ import annotations

import math

import numpy as np


class VelocityObserver:
    """Observes the derivative of what is measured.

    Args:
        omega: Double pole ω [rad/s]; may be replaced at any time.

    Attributes:
        omega: ω [rad/s].
        position: x̂.
        velocity: v̂.
    """

    def __init__(self, omega: float) -> None:
        self.omega = omega
        self.position = 0.0
        self.velocity = 0.0
        self._begun = False

    def restart(self) -> None:
        """Forget the past; the next measurement is where it begins, at rest."""
        self._begun = False

    def step(self, x: float, a: float, interval: float) -> float:
        """Take a measurement; return v̂ at it.

        Args:
            x: Measured position.
            a: Acceleration over the interval since the last measurement, as far as it is known.
            interval: That interval T [s]; 0 = it is the same instant, measured again.
        """
        if not self._begun:
            self.position, self.velocity, self._begun = x, 0.0, True
        if interval <= 0.0:
            self.position = x
            return self.velocity
        z = math.exp(-self.omega * interval)
        predicted = self.position + interval * self.velocity + 0.5 * interval * interval * a
        moving = self.velocity + interval * a
        residual = x - predicted
        self.position = predicted + (1.0 - z * z) * residual
        self.velocity = moving + (1.0 - z) ** 2 / interval * residual
        return self.velocity


def noise_gain(omega: float, period: float) -> float:
    """Return the standard deviation of v̂ for white noise of deviation 1 on x [1/s].

    That of the stationary error P = A P Aᵀ + L Lᵀ of the observer above.
    """
    z = math.exp(-omega * period)
    gain = np.array([1.0 - z * z, (1.0 - z) ** 2 / period])
    step = np.array([[1.0, period], [0.0, 1.0]])
    closed = step - np.outer(gain, step[0])
    size = np.eye(4) - np.kron(closed, closed)
    covariance = np.linalg.solve(size, np.outer(gain, gain).ravel())
    return math.sqrt(float(covariance[3]))

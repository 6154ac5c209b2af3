"""Whether an observed velocity will do for a boundary layer: the rule on ω (ours).

The observer (`dz_ros.core.observer`) at ω [rad/s] passes noise into s, and lags behind what the
reference does not say. Inside the layer the loop is linear with the slope K + Λ_v,n φ̂
(`dz_ros.core.boundary_layer`); with an observed velocity in it, s(s + ω)² + K β ω² = 0 in the
limit of fast sampling, which oscillates unless

    ω > K β/2                                      β = b m

`layer_radius` is the spectral radius of the sampled loop, delay included. The other way, noise of
standard deviation σ on the position shows in s as

    σ_s ≤ (Λ_n−1 + G(ω)) σ                         G: `noise_gain`

and should stay inside the layer: σ_s ≤ 0.75 ε. With ε = 0.05, σ = 1e-3 and the gains of [wang2004]
at 200 Hz that leaves 42 to 100 rad/s; a backward difference (G = √2/T = 283) needs ε = 0.38.
"""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.finding import Finding, INFO, WARNING
from dz_ros.core.observer import noise_gain
from dz_ros.core.tracking import error_weights

SHARE = 0.75
"""Noise may fill so much of the layer, as a standard deviation."""
_GRID = np.geomspace(1.0, 1000.0, 121)
"""Poles that are tried [rad/s]."""


def layer_radius(omega: float, period: float, gain: float, lambda_: float, order: int,
                 delay: int) -> float:
    """Return the spectral radius of the loop inside the layer; below 1 it is calm.

    Args:
        omega: ω of the observer [rad/s].
        period: T [s].
        gain: (K + Λ_v,n φ̂) β [1/s].
        lambda_: λ [1/s].
        order: n.
        delay: Loop delay d [samples].
    """
    n, size = order, order + 2 + delay
    move = np.array([[period ** (j - i) / math.factorial(j - i) if j >= i else 0.0
                      for j in range(n)] for i in range(n)])
    push = np.array([period ** (n - i) / math.factorial(n - i) for i in range(n)])
    z = math.exp(-omega * period)
    weights = np.asarray(error_weights(lambda_, n))
    # Rows of x̂, v̂ and u as functions of [x, x̂ and v̂ of the sample before, u before].
    residual = np.zeros(size)
    residual[n - 2], residual[n], residual[n + 1] = 1.0, -1.0, -period
    position, velocity = np.zeros(size), np.zeros(size)
    position[n], position[n + 1], velocity[n + 1] = 1.0, period, 1.0
    position = position + (1.0 - z * z) * residual
    velocity = velocity + (1.0 - z) ** 2 / period * residual
    command = -gain * velocity
    command[:n - 1] -= gain * weights[:-1]
    step = np.zeros((size, size))
    step[:n, :n] = move
    step[n], step[n + 1] = position, velocity
    if delay:
        step[:n, -1] = push
        step[n + 2] = command
        for i in range(1, delay):
            step[n + 2 + i, n + 1 + i] = 1.0
    else:
        step[:n] += np.outer(push, command)
    return float(max(abs(np.linalg.eigvals(step))))


def check_observer(c: Configuration, measured: int) -> Iterator[Finding]:
    """Say whether `driver.observer` suits the boundary layer.

    Args:
        c: The configuration.
        measured: How many of x, x', … the driver measures.
    """
    design, n, period = c.law.design, c.plant.order, c.loop.period
    if measured >= n or design is None or design.epsilon <= 0.0:
        return
    omega, sigma, known = c.driver_settings.observer, c.noise[n - 2], c.controller_settings
    weight = error_weights(design.lambda_, n)[-2]
    passes = weight + noise_gain(omega, period)
    room = SHARE * design.epsilon
    betas = tuple(b * m for b, m in zip(known.b_bounds, known.m_bounds, strict=True))
    low, high = (layer_radius(omega, period, (design.gain + design.lead) * beta, design.lambda_,
                              n, c.loop.delay) for beta in betas)
    calm = [float(item) for item in _GRID if layer_radius(
        float(item), period, (design.gain + design.lead) * betas[1], design.lambda_, n,
        c.loop.delay) < 1.0]
    quiet = [float(item) for item in _GRID
             if sigma * (weight + noise_gain(float(item), period)) <= room]
    numbers = {'omega': omega, 'noise_gain': passes, 'noise': sigma, 'radius': high,
               'noise_limit': room / passes}
    words = (f'the velocity is observed at {omega:g} rad/s: s shows {passes:.3g} times the noise '
             f'of x{n - 2}')
    level, change = INFO, ''
    if sigma > 0.0:
        words += f', {passes * sigma:.3g} of ε = {design.epsilon:.3g}'
    words += f'; up to {room / passes:.2g} of it leaves the layer room'
    if sigma > 0.0 and passes * sigma > room:
        level = WARNING
        change = (f'lower driver.observer to {quiet[-1]:.3g} rad/s' if quiet else
                  'measure better') + f', or widen ε to {passes * sigma / SHARE:.2g}'
    if high >= 1.0:
        level = WARNING
        words += '; the loop oscillates in the layer' + (
            ' where b m is large' if low < 1.0 else '')
        change = (f'raise driver.observer to {calm[0]:.3g} rad/s' if calm else
                  'lower K = k_d + k*/ε')
        if not calm or not quiet or calm[0] > quiet[-1]:
            change += ', and widen ε: at this K no pole is fast enough and quiet enough'
    elif calm:
        numbers['smallest'] = calm[0]
        words += f'; calm from {calm[0]:.3g} rad/s on'
    yield Finding(level, 'observer', words, numbers, change)

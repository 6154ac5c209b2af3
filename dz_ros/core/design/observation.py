# SPDX-License-Identifier: Apache-2.0
"""Whether an observed velocity will do for a boundary layer: the rules on ω (ours).

    ω = 3 K b̂                    b̂ = mean of the bounds of b; used where `driver.observer` is 0
    σ = q/√12                     noise that a position in steps of q amounts to
    σ_s ≤ (Λ_n−1 + G(ω)) σ        noise in s; G: `dz_ros.core.observers.base.noise_gain`

Whether the loop inside the layer is calm with the observer follows from the spectral radius of its
matrix (`dz_ros.core.design.linear_loop`), the law's own integral or observer and the delay
included. The noise should stay inside the layer: σ_s ≤ 0.75 ε. A backward difference (G = √2/T =
283 at 200 Hz) passes two to eight times as much.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import math
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import Finding, INFO, WARNING
from dz_ros.core.design.linear_loop import LinearObserver, spectral_radius
from dz_ros.core.laws.robust_eso_gains import OBSERVER_RATE
from dz_ros.core.observers import Observer, OBSERVERS
from dz_ros.core.observers.base import noise_gain
from dz_ros.core.tracking import error_weights
from dz_ros.core.units import Units

SHARE = 0.75
"""Noise may fill so much of the layer, as a standard deviation."""
FALLBACK = 50.0
"""ω of a law without a layer [rad/s]."""
_GRID = np.geomspace(1.0, 1000.0, 121)
"""Rates that are tried [rad/s]."""


def observer_of(c: Configuration, gain: float | None = None) -> Observer:
    """Return the configured observer of the velocity, with ω by rule where none is given.

    `gain`: K by which the rule goes [actuator unit per unit of s]; None = that of the law.
    """
    settings, design = c.driver_settings, c.law.design
    omega = settings.observer
    if omega <= 0.0:
        b = 0.5 * sum(c.controller_settings.b_bounds)
        if gain is None:
            gain = 0.0 if design is None else design.gain
        omega = OBSERVER_RATE * gain * b or FALLBACK
    return OBSERVERS[settings.observer_kind](omega)


def observed_state(c: Configuration) -> str:
    """Return as text which state the loop observes and how; '' where all are measured."""
    measured, order = c.make_driver().measured, c.plant.order
    if measured >= order:
        return ''
    observer = observer_of(c)
    return (f'{measured} of {order} states are measured, x{order - 1} is observed '
            f'({observer.name}, {observer.omega:.4g} rad/s)')


def linear_observer(c: Configuration, measured: int,
                    gain: float | None = None) -> LinearObserver | None:
    """Return the observer of the velocity as part of the loop's matrix.

    None where all states are measured, of `measured`, or the observer is not linear; `gain` as of
    `observer_of`.
    """
    if measured >= c.plant.order:
        return None
    observer = observer_of(c, gain)
    return type(observer).linear(observer.omega, c.loop.period)


def sensor_noise(c: Configuration, steps: Sequence[float]) -> float:
    """Return σ of what the velocity is observed from [unit of x^(n−2)]; as of `state_noise`."""
    return state_noise(c, steps)[c.plant.order - 2]


def measured_steps(driver: Any) -> tuple[float, ...]:
    """Return one step of each state that a driver knows of, that of x first; 0 = not known."""
    return (driver.resolution, *getattr(driver, 'derivative_resolution', ()))


def state_noise(c: Configuration, steps: Sequence[float]) -> tuple[float, ...]:
    """Return σ of each measured state, noise and steps [state units], shape (n,).

    Args:
        c: Noise.
        steps: One step of each state as it is measured [state units]; those missing are 0.
    """
    padded = (*steps, *(0.0,) * c.plant.order)
    return tuple(math.hypot(sigma, step / math.sqrt(12.0))
                 for sigma, step in zip(c.noise, padded, strict=False))


def _passed(slope: float, order: int, observer: LinearObserver) -> float:
    """Return how many times the noise of x^(n−2) is seen in s, Λ_n−1 + G."""
    return float(error_weights(slope, order)[-2] + noise_gain(observer))


def check_observer(c: Configuration, measured: int,
                   steps: Sequence[float]) -> Iterator[Finding]:
    """Check the observer against the layer.

    `measured`: number of measured states; `steps` as of `state_noise`.
    """
    design, n, period = c.law.design, c.plant.order, c.loop.period
    if measured >= n or design is None or design.epsilon <= 0.0:
        return
    known, observer = c.controller_settings, observer_of(c)
    sigma = sensor_noise(c, steps)
    omega, kind = observer.omega, type(observer)
    room = SHARE * design.epsilon
    betas = tuple(b * m for b, m in zip(known.b_bounds, known.m_bounds, strict=True))
    model, delay = c.law.layer_model(), c.loop.delay
    own = kind.linear(omega, period)
    if model is None:
        return
    if own is None:
        yield Finding(INFO, 'observer', f'the velocity is observed by {kind.name} at {omega:.4g} '
                      'rad/s, which is not linear: no rule shows whether the loop is calm with '
                      'it', {'omega': omega, 'noise': sigma})
        return

    def linear(rate: float) -> LinearObserver:
        found = kind.linear(rate, period)
        assert found is not None
        return found

    passes = _passed(design.lambda_, n, own)
    low, high = (spectral_radius(model, period, beta, delay, own) for beta in betas)
    tried = [(float(rate), linear(float(rate))) for rate in _GRID]

    def calm_with(*delays: int) -> list[float]:
        return [rate for rate, item in tried if all(
            spectral_radius(model, period, beta, late, item) < 1.0
            for beta in betas for late in delays)]

    # A rate that is calm without delay alone is none to propose: real loops have a sample of it.
    calm = calm_with(*{delay, max(delay, 1)}) or calm_with(delay)
    quiet = [rate for rate, item in tried if sigma * _passed(design.lambda_, n, item) <= room]
    numbers = {'omega': omega, 'noise_gain': passes, 'noise': sigma, 'radius': high,
               'noise_limit': room / passes}
    words = (f'the velocity is observed by {kind.name} at {omega:.4g} rad/s: s shows '
             f'{passes:.3g} times the noise of x{n - 2}')
    level, change = INFO, ''
    if sigma > 0.0:
        unit = Units.of(c.plant).behind('x^(n-1)')
        words += f', {passes * sigma:.3g} of ε = {design.epsilon:.3g}{unit}'
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
            change += ', and widen ε: at this K no rate is fast enough and quiet enough'
    elif calm:
        numbers['smallest'] = calm[0]
        words += f'; calm from {calm[0]:.3g} rad/s on'
    yield Finding(level, 'observer', words, numbers, change)

# SPDX-License-Identifier: Apache-2.0
"""The closed loop offline, in the binding order of operations (mathematics.md §3).

Plain scalar Python: one source for the loop offline and the pieces the nodes run. A disturbance
pulse pushes the plant over whole samples; in `truth` it counts as disturbance. x is measured in
steps of the sensor, where it has any, and a velocity that is not measured is observed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import dead_zone, interpolate, played, residual
from dz_ros.core.design.observation import observer_of
from dz_ros.core.loop.integration import Buffer, identity, make_advance, make_unmodelled, Numbers
from dz_ros.core.observers import OBSERVERS
from dz_ros.core.signals import STATUS, TERM_NAMES
from dz_ros.core.tracking import shown_position

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """Every sample of a closed loop, read-only arrays with one row a sample.

    Attributes:
        configuration: What was run.
        t: Time [s], shape (K + 1,).
        x, x_measured: True state and what the law saw at t_k, shape (K + 1, n).
        x_d: x_d … x_d^(n), shape (K + 1, n + 1).
        v, v_applied: Command computed at t_k, held from t_k on (delayed, clipped, rounded, behind
            the play), shape (K + 1,).
        truth: w, d, disturbance just after t_k, shape (K + 1, 3).
        terms: `dz_ros.core.signals.TERMS`, status, the law's signals, shape (K + 1, …).
    """

    configuration: Configuration
    t: Array
    x: Array
    x_measured: Array
    x_d: Array
    v: Array
    v_applied: Array
    truth: Array
    terms: Array

    def column(self, name: str) -> Array:
        """Return a term or signal of the law by name, shape (K + 1,).

        Raises:
            KeyError: The law has no such signal.
        """
        names = (*TERM_NAMES, 'status', *self.configuration.law.signal_names)
        if name not in names:
            raise KeyError(f'{name}: this law has {", ".join(names)}')
        return self.terms[:, names.index(name)]


Loop = Callable[..., None]

MEMORY = max(item.size for item in OBSERVERS.values())
"""Numbers of memory that any observer has."""


def make_loop(configuration: Configuration, jit: Callable[[Any], Any] = identity,
              outer: Callable[[Any], Any] = identity) -> Loop:
    """Return the function that runs this combination of law, plant and trajectory.

    Their numbers are arguments of it; `jit` compiles every function it calls, `outer` itself, the
    identity leaves Python.
    """
    advance = make_advance(configuration.plant.regressors, configuration.plant.disturbance, jit,
                           configuration.plant.sticking)
    regressors = jit(configuration.plant.regressors)
    unmodelled = make_unmodelled(configuration.plant, jit)
    evaluate = jit(configuration.trajectory.evaluate)
    kernel = jit(configuration.law.kernel)
    zone = jit(dead_zone)
    rest = jit(residual)
    shown = jit(shown_position)
    follow, backlash = jit(interpolate), jit(played)
    observe = jit(observer_of(configuration).kernel)

    def loop(last: int, period: float, substeps: int, delay: int, limit: float, pulse_from: int,
             pulse_to: int, pulse: float, seen: int, omega: float, grain: float, play: float,
             band: float, desired: bool, psi_at: int, steps: Numbers, schedule: Numbers,
             plant: Numbers, zone_numbers: Numbers, motion: Numbers, gains: Numbers, x: Buffer,
             y: Buffer, x_d: Buffer, memory: Buffer, new_memory: Buffer, terms: Buffer,
             measured: Buffer, k1: Buffer, k2: Buffer, k3: Buffer, stage: Buffer, watch: Buffer,
             noise: Buffer, out_x: Buffer, out_measured: Buffer, out_x_d: Buffer, out_v: Buffer,
             out_applied: Buffer, out_truth: Buffer, out_terms: Buffer) -> None:
        n = len(x)
        width = len(terms)
        h = period / substeps
        instants = len(schedule) // 2
        behind = 0.0
        for k in range(last + 1):
            t = k * period
            for i in range(n):
                out_x[k * n + i] = x[i]
                measured[i] = x[i] + noise[k * n + i]
                if steps[i] > 0.0:
                    measured[i] = math.floor(measured[i] / steps[i] + 0.5) * steps[i]
            evaluate(t, motion, x_d)
            if seen < n:
                measured[n - 1] = observe(omega, watch, measured[n - 2], x_d[n - 2], x_d[n - 1],
                                          x_d[n], t - (k - 1) * period if k > 0 else 0.0)
            for i in range(n):
                out_measured[k * n + i] = measured[i]
            if desired:
                regressors(x_d, plant, y)
            else:
                regressors(measured, plant, y)
            if band > 0.0:
                measured[0] = shown(measured[0], x_d[0], band)
            v = kernel(gains, memory, x_d, measured, y, period, new_memory, terms)
            for i in range(len(memory)):
                memory[i] = new_memory[i]
            if psi_at >= 0 and instants > 0:
                memory[psi_at] = follow(t, schedule, 0, instants, instants)
            for i in range(n + 1):
                out_x_d[k * (n + 1) + i] = x_d[i]
            for i in range(width):
                out_terms[k * width + i] = terms[i]
            out_v[k] = v
            held = out_v[k - delay] if k >= delay else 0.0
            if limit > 0.0:
                held = min(max(held, -limit), limit)
            if grain > 0.0:
                held = math.floor(held / grain + 0.5) * grain
            if play > 0.0:
                behind = backlash(held, behind, play)
                held = behind
            w = zone(held, t, zone_numbers)
            out_applied[k] = held
            out_truth[3 * k] = w
            out_truth[3 * k + 1] = rest(held, w, t, zone_numbers)
            push = pulse if pulse_from <= k < pulse_to else 0.0
            out_truth[3 * k + 2] = unmodelled(t, x, w, plant, y, push)
            if k < last:
                advance(x, held, t, h, substeps, plant, zone_numbers, y, k1, k2, k3, stage,
                        push)

    function: Loop = outer(loop)
    return function


def _seen(c: Configuration) -> tuple[int, float, float, float]:
    """Return number of measured states, observer's rate, step of v, play."""
    return (c.make_driver().measured, observer_of(c).omega, c.plant_settings.command_resolution,
            c.plant_settings.backlash)


def measurement_noise(configuration: Configuration, samples: int) -> Array:
    """Return the seeded noise of a run, shape (samples, n); zeros where none is configured."""
    order = configuration.plant.order
    sigma = np.asarray(configuration.noise)
    if not sigma.any():
        return np.zeros((samples, order))
    generator = np.random.default_rng(configuration.loop.seed)
    return np.asarray(generator.standard_normal((samples, order)) * sigma)


def simulate(configuration: Configuration, loop: Loop | None = None,
             memory: Sequence[float] | None = None) -> Run:
    """Return the closed loop of a configuration, from t = 0 to its duration.

    Args:
        configuration: What to run.
        loop: A compiled loop (`dz_ros.core.loop.compiled`), which works on arrays; None = plain
            Python, on lists.
        memory: The law's memory before the first sample; None = its initial one.

    Raises:
        ConfigurationError: It is of several axes.
        OverflowError, ValueError: The loop diverged beyond what its functions can evaluate. One
            that ends in infinities or NaN without that is returned as it is.
    """
    return prepare(configuration, loop, memory)()


def prepare(configuration: Configuration, loop: Loop | None = None,
            memory: Sequence[float] | None = None) -> Callable[[], Run]:
    """Return the function that runs `simulate`, once; what is small is made already.

    Args:
        configuration: As of `simulate`.
        loop: As of `simulate`.
        memory: As of `simulate`.

    Raises:
        ConfigurationError: It is of several axes.
    """
    c = configuration
    c.require_one()
    count = c.loop.samples + 1
    n, r = c.plant.order, c.plant.regressor_count
    width = STATUS + 1 + len(c.law.signal_names)
    memory = c.law.initial_memory() if memory is None else memory
    columns = (n, n, n + 1, None, None, 3, width)  # None: one number a sample, no row
    schedule = c.loop.schedule
    times = () if schedule is None else (*schedule.times, *schedule.values)
    numbers = (c.quanta, times, c.plant.constants, c.zone_numbers, c.trajectory.constants,
               c.law.constants, c.x0, np.zeros(r), np.zeros(n + 1), memory, np.zeros(len(memory)),
               np.zeros(width), *np.zeros((5, n)), np.zeros(MEMORY))
    known = c.controller_settings
    small = (c.loop.samples, c.loop.period, c.plant_settings.substeps, c.loop.delay,
             c.plant_settings.command_limit, *c.pulse_samples, *_seen(c), known.error_band,
             known.regressors_at == 'reference', c.law.schedule_place,
             *(np.array(item, dtype=float) for item in numbers))

    def run() -> Run:
        arguments: list[Any] = [*small, measurement_noise(c, count).ravel(),
                                *(np.empty(count * (item or 1)) for item in columns)]
        if loop is None:
            arguments = [item.tolist() if isinstance(item, np.ndarray) else item
                         for item in arguments]
        (make_loop(c) if loop is None else loop)(*arguments)
        arrays: list[Array] = [np.arange(count, dtype=np.float64) * c.loop.period]
        for item, wide in zip(arguments[-len(columns):], columns, strict=True):
            array = np.asarray(item, dtype=float)
            arrays.append(array if wide is None else array.reshape(count, wide))
        for array in arrays:
            array.flags.writeable = False
        return Run(c, *arrays)

    return run

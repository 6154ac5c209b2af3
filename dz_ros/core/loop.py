"""The closed loop off line, in the binding order of operations (mathematics.md §3).

At t_k = k T: measure x(t_k) (plus noise); v_k from the law with the memory of sample k; Euler step
of the estimates; the actuator holds v_{k−delay}, clipped to its limit (0 before the first
command), over [t_k, t_{k+1}] while the plant is integrated in continuous time. A kick, where one
is configured, pushes the plant over whole samples; in `truth` it counts as disturbance.

`simulate` is plain scalar Python: one source for the loop off line and the pieces the nodes run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import dead_zone, residual
from dz_ros.core.integration import Buffer, identity, make_advance, Numbers
from dz_ros.core.records import STATUS, TERM_NAMES

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """Every sample of a closed loop, read-only arrays with one row a sample.

    Attributes:
        configuration: What was run.
        t: Time [s], shape (K + 1,).
        x: True state at t_k, shape (K + 1, n).
        x_measured: What the law saw (= x without noise), shape (K + 1, n).
        x_d: x_d … x_d^(n), shape (K + 1, n + 1).
        v: Command computed at t_k, shape (K + 1,).
        v_applied: Command the actuator holds from t_k on (delayed, clipped), shape (K + 1,).
        truth: w, d, disturbance just after t_k, shape (K + 1, 3).
        terms: `TERM_NAMES`, status, the law's signals, shape (K + 1, 9 + …).
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


def make_loop(configuration: Configuration, jit: Callable[[Any], Any] = identity) -> Loop:
    """Return the function that runs this combination of law, plant and trajectory.

    Args:
        configuration: Decides which functions are combined; their numbers are arguments.
        jit: Compiler applied to every function; the identity leaves plain Python.
    """
    advance = make_advance(configuration.plant.regressors, configuration.plant.disturbance, jit)
    regressors = jit(configuration.plant.regressors)
    disturbance = jit(configuration.plant.disturbance)
    evaluate = jit(configuration.trajectory.evaluate)
    kernel = jit(configuration.law.kernel)
    zone = jit(dead_zone)
    rest = jit(residual)

    def loop(last: int, period: float, substeps: int, delay: int, limit: float, kick_from: int,
             kick_to: int, kick: float, plant: Numbers, zone_numbers: Numbers, motion: Numbers,
             gains: Numbers, x: Buffer, y: Buffer, x_d: Buffer, memory: Buffer, new_memory: Buffer,
             terms: Buffer, measured: Buffer, k1: Buffer, k2: Buffer, k3: Buffer,
             stage: Buffer, noise: Buffer, out_x: Buffer, out_measured: Buffer, out_x_d: Buffer,
             out_v: Buffer, out_applied: Buffer, out_truth: Buffer, out_terms: Buffer) -> None:
        n = len(x)
        width = len(terms)
        h = period / substeps
        for k in range(last + 1):
            t = k * period
            for i in range(n):
                out_x[k * n + i] = x[i]
                measured[i] = x[i] + noise[k * n + i]
                out_measured[k * n + i] = measured[i]
            evaluate(t, motion, x_d)
            regressors(measured, plant, y)
            v = kernel(gains, memory, x_d, measured, y, period, new_memory, terms)
            for i in range(len(memory)):
                memory[i] = new_memory[i]
            for i in range(n + 1):
                out_x_d[k * (n + 1) + i] = x_d[i]
            for i in range(width):
                out_terms[k * width + i] = terms[i]
            out_v[k] = v
            held = out_v[k - delay] if k >= delay else 0.0
            if limit > 0.0:
                held = min(max(held, -limit), limit)
            w = zone(held, t, zone_numbers)
            out_applied[k] = held
            out_truth[3 * k] = w
            out_truth[3 * k + 1] = rest(held, w, t, zone_numbers)
            push = kick if kick_from <= k < kick_to else 0.0
            out_truth[3 * k + 2] = disturbance(t, x, plant) - push
            if k < last:
                advance(x, held, t, h, substeps, plant, zone_numbers, y, k1, k2, k3, stage,
                        push)

    function: Loop = jit(loop)
    return function


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
        loop: A loop compiled for this combination of law, plant and trajectory (see
            `dz_ros.core.compiled`), which works on arrays; None = plain Python, on lists.
        memory: The law's memory before the first sample; None = its initial one.

    Raises:
        OverflowError, ValueError: The loop diverged beyond what its functions can evaluate. One
            that ends in infinities or NaN without that is returned as it is.
    """
    c = configuration
    count = c.loop.samples + 1
    n, r = c.plant.order, c.plant.regressor_count
    width = STATUS + 1 + len(c.law.signal_names)
    memory = c.law.initial_memory() if memory is None else memory
    columns = (n, n, n + 1, None, None, 3, width)  # None: one number a sample, no row
    numbers = (c.plant.constants, c.dead_zone.constants, c.trajectory.constants, c.law.constants,
               c.x0, np.zeros(r), np.zeros(n + 1), memory, np.zeros(len(memory)),
               np.zeros(width), *np.zeros((5, n)), measurement_noise(c, count).ravel(),
               *(np.zeros(count * (item or 1)) for item in columns))
    arguments: list[Any] = [np.array(item, dtype=float) for item in numbers]
    if loop is None:
        loop = make_loop(c)
        arguments = [item.tolist() for item in arguments]
    loop(c.loop.samples, c.loop.period, c.plant_settings.substeps, c.loop.delay,
         c.plant_settings.command_limit, *c.kick_samples, *arguments)
    arrays: list[Array] = [np.arange(count, dtype=np.float64) * c.loop.period]
    for item, wide in zip(arguments[-len(columns):], columns, strict=True):
        array = np.asarray(item, dtype=float)
        arrays.append(array if wide is None else array.reshape(count, wide))
    for array in arrays:
        array.flags.writeable = False
    return Run(c, *arrays)

# SPDX-License-Identifier: Apache-2.0
"""Loops of several axes offline: each axis by itself, or all of them where a plant couples them.

Axes that nothing couples are the scalar loops of ``core/loop/offline.py``, bit for bit. A plant
that serves several axes (``core/plants/coupled.py``) moves all of them together by classical RK4,

    x_i^(n) = f_i(t, x, w) + push_i,      w_j = D_j(v_j, t)

with the commands held and the dead-zones evaluated at every stage, as in mathematics.md §3. The
order of operations in a sample is that of the scalar loop, all axes in each of its steps. (ours)

Over 300 lines: the motion of all axes, the loop around it, and which of both ways axes go.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
from typing import Any

import numpy as np

from dz_ros.core.axes import spoken
from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import dead_zone, played, residual
from dz_ros.core.design.observation import observer_of
from dz_ros.core.loop.offline import measurement_noise, Run, simulate
from dz_ros.core.plants.coupled import coupled_regressors, CoupledPlant
from dz_ros.core.signals import STATUS
from dz_ros.core.tracking import shown_position
from dz_ros.errors import DivergedError, LoopError

Numbers = Sequence[float]
ALL = -1
"""In place of an axis: what is computed is of all axes at once."""


def knows_others(configuration: Configuration) -> bool:
    """Return whether plant or law of an axis depend on the other axes."""
    return isinstance(configuration.plant, CoupledPlant) or configuration.law.coupled


class Motion:
    """The motion of all axes, advanced together.

    Args:
        each: Configurations of the axes. If their plant serves one axis, they move independently.

    Attributes:
        x: States of the axes, shape (n,) each; written by `advance`.
    """

    def __init__(self, each: Sequence[Configuration]) -> None:
        self.x = [list(item.x0) for item in each]
        self._order = each[0].plant.order
        self._count = len(each)
        self.configure(each)

    def configure(self, each: Sequence[Configuration]) -> None:
        """Use other parameters and dead-zones from now on."""
        self._zones = [item.zone_numbers for item in each]
        self._plants = [item.plant for item in each]
        self._constants = [item.plant.constants for item in each]
        plant = each[0].plant
        self._coupled = isinstance(plant, CoupledPlant)
        self._dynamics: Any = self._apart
        self._machine: Numbers = ()
        if isinstance(plant, CoupledPlant):
            self._dynamics, self._machine = plant.dynamics, plant.machine_constants

    def outputs(self, v: Numbers, t: float) -> list[float]:
        """Return w = D(v) of every axis at time t [s]."""
        return [dead_zone(item, t, zone) for item, zone in zip(v, self._zones, strict=True)]

    def truths(self, v: Numbers, t: float, push: Numbers,
               states: Sequence[Numbers] | None = None) -> list[tuple[float, float, float]]:
        """Return w, d and disturbance of every axis for commands held at time t [s].

        Args:
            v: Commands held.
            t: Loop time [s].
            push: What pulses add to x^(n).
            states: States then; None = the present ones.
        """
        states = self.x if states is None else states
        w = self.outputs(v, t)
        found = []
        if not self._coupled:
            for i, (plant, p) in enumerate(zip(self._plants, self._constants, strict=True)):
                disturbance = plant.disturbance(t, states[i], p) - push[i]
                found.append((w[i], residual(v[i], w[i], t, self._zones[i]), disturbance))
            return found
        rates = self._rates(t, w, [item for x in states for item in x], [0.0] * self._count)
        for i in range(self._count):
            y = [0.0] * self._plants[i].regressor_count
            p = self._constants[i]
            self._plants[i].regressors(states[i], p, y)
            nominal = p[0] * w[i]
            for j in range(len(y)):
                nominal -= p[1 + j] * y[j]
            found.append((w[i], residual(v[i], w[i], t, self._zones[i]),
                          nominal - rates[i] - push[i]))
        return found

    def advance(self, v: Numbers, t: float, h: float, steps: int, push: Numbers) -> None:
        """Move the states in place from t to t + steps h [s] with the commands v held."""
        half, sixth = 0.5 * h, h / 6.0
        n, size = self._order, self._count * self._order
        x = [item for own in self.x for item in own]
        for step in range(steps):
            now = t + step * h
            k1 = self._slope(now, v, x, push)
            k2 = self._slope(now + half, v, [x[i] + half * k1[i] for i in range(size)], push)
            k3 = self._slope(now + half, v, [x[i] + half * k2[i] for i in range(size)], push)
            k4 = self._slope(now + h, v, [x[i] + h * k3[i] for i in range(size)], push)
            for i in range(size):
                x[i] += sixth * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
        for i, own in enumerate(self.x):
            own[:] = x[i * n:(i + 1) * n]

    def _slope(self, t: float, v: Numbers, x: Numbers, push: Numbers) -> list[float]:
        """Return x' of all axes at once."""
        rates = self._rates(t, self.outputs(v, t), x, push)
        n = self._order
        return [x[i + 1] if (i + 1) % n else rates[i // n] for i in range(len(x))]

    def _rates(self, t: float, w: Numbers, x: Numbers, push: Numbers) -> list[float]:
        """Return x_i^(n) of every axis."""
        out = [0.0] * self._count
        self._dynamics(t, x, w, self._machine, out)
        return [rate + more for rate, more in zip(out, push, strict=True)]

    def _apart(self, t: float, x: Numbers, w: Numbers, _p: Numbers, out: list[float]) -> None:
        """Write x_i^(n) of axes that only their law couples, as `CoupledPlant.dynamics` does."""
        n = self._order
        for i, plant in enumerate(self._plants):
            p, own = self._constants[i], x[i * n:(i + 1) * n]
            y = [0.0] * plant.regressor_count
            plant.regressors(own, p, y)
            out[i] = p[0] * w[i] - plant.disturbance(t, own, p)
            for j in range(len(y)):
                out[i] -= p[1 + j] * y[j]


def held_command(v: float, limit: float, grain: float) -> float:
    """Return the command as the actuator takes it: clipped, in steps of its converter."""
    if limit > 0.0:
        v = min(max(v, -limit), limit)
    return math.floor(v / grain + 0.5) * grain if grain > 0.0 else v


def own_first(rows: Sequence[Numbers], place: int) -> tuple[float, ...]:
    """Return the numbers of an axis and then those of the others, as coupled laws take them."""
    return (*rows[place], *(number for other, row in enumerate(rows) if other != place
                            for number in row))


def simulate_together(configuration: Configuration,
                      memories: Sequence[Sequence[float] | None] = ()) -> dict[str, Run]:
    """Return axis → its closed loop, of axes that a plant or a law couples, sample by sample.

    Args:
        configuration: What to run.
        memories: The laws' memories before the first sample; None, or none at all = the initial
            ones.

    Raises:
        DivergedError: An axis diverged beyond what its functions can evaluate, or all of them
            where they are moved together. What ends in infinities or NaN without that is returned.
    """
    at = [-1, ALL]
    try:
        return _together(configuration, memories, at)
    except (OverflowError, ValueError) as error:
        if at[0] < 0:       # before the first sample, so not of the loop
            raise
        names = configuration.axis_names
        raise DivergedError(at[0] * configuration.loop.period, spoken(
            names if at[1] == ALL else names[at[1]:at[1] + 1])) from error


def _together(configuration: Configuration, memories: Sequence[Sequence[float] | None],
              at: list[int]) -> dict[str, Run]:
    """Return what `simulate_together` does; `at` holds the sample and axis that is computed."""
    c = configuration
    each, period, count = c.each, c.loop.period, c.loop.samples + 1
    n, axes = c.plant.order, range(len(c.each))
    motion = Motion(each)
    noise = [measurement_noise(item, count) for item in each]
    observers = [observer_of(item) for item in each]
    watch = [[0.0] * item.size for item in observers]
    seen = [item.make_driver().measured for item in c.each]
    memory = [tuple(begin) if begin is not None else item.law.initial_memory()
              for item, begin in zip(each, memories or (None,) * len(each), strict=True)]
    behind = [0.0] * len(each)
    width = STATUS + 1 + len(c.law.signal_names)
    out = [{name: np.zeros((count, size)) for name, size in (
        ('x', n), ('measured', n), ('x_d', n + 1), ('v', 1), ('held', 1), ('truth', 3),
        ('terms', width))} for _ in axes]
    for k in range(count):
        t = k * period
        x_d, measured = [], []
        for i in axes:
            at[:] = k, i
            followed, item, now = [0.0] * (n + 1), each[i], list(motion.x[i])
            now = [now[j] + float(noise[i][k, j]) for j in range(n)]
            for j, quantum in enumerate(item.quanta):
                if quantum > 0.0:
                    now[j] = math.floor(now[j] / quantum + 0.5) * quantum
            item.trajectory.evaluate(t, item.trajectory.constants, followed)
            if seen[i] < n:
                now[n - 1] = observers[i].kernel(
                    observers[i].omega, watch[i], now[n - 2], followed[n - 2], followed[n - 1],
                    followed[n], t - (k - 1) * period if k > 0 else 0.0)
            x_d.append(followed)
            measured.append(now)
        after: list[tuple[float, ...]] = []
        for i in axes:
            at[1] = i
            law = each[i].law
            terms = [0.0] * width
            given: tuple[Sequence[float], Sequence[float], Sequence[float]]
            if law.coupled:
                given = own_first(memory, i), own_first(x_d, i), own_first(measured, i)
                y = coupled_regressors(each[i].plant, given[2])
            else:
                known, shown = each[i].controller_settings, measured[i]
                y = [0.0] * each[i].plant.regressor_count
                each[i].plant.regressors(x_d[i] if known.regressors_at == 'reference' else shown,
                                         each[i].plant.constants, y)
                if known.error_band > 0.0:
                    shown = [shown_position(shown[0], x_d[i][0], known.error_band), *shown[1:]]
                given = memory[i], x_d[i], shown
            new = [0.0] * len(memory[i])
            v = law.kernel(law.constants, given[0], given[1], given[2], y, period, new, terms)
            after.append(tuple(new))
            rows = out[i]
            rows['x'][k], rows['measured'][k], rows['x_d'][k] = motion.x[i], measured[i], x_d[i]
            rows['v'][k, 0], rows['terms'][k] = v, terms
        memory = [_scheduled(item, row, t) for item, row in zip(each, after, strict=True)]
        for i in axes:
            at[1] = i
            settings = each[i].plant_settings
            held = held_command(float(out[i]['v'][k - c.loop.delay, 0]) if k >= c.loop.delay
                                else 0.0, settings.command_limit, settings.command_resolution)
            behind[i] = (played(held, behind[i], settings.backlash) if settings.backlash > 0.0
                         else held)
        at[1] = ALL
        push = [_push(each[i], k) for i in axes]
        for i, truth in enumerate(motion.truths(behind, t, push)):
            out[i]['held'][k, 0], out[i]['truth'][k] = behind[i], truth
        if k < count - 1:
            at[0] = k + 1
            substeps = c.plant_settings.substeps
            motion.advance(behind, t, period / substeps, substeps, push)
    stamps = np.arange(count, dtype=np.float64) * period
    found = {}
    for i, name in enumerate(c.axis_names):
        arrays = [stamps, *(out[i][key][:, 0] if key in ('v', 'held') else out[i][key]
                            for key in ('x', 'measured', 'x_d', 'v', 'held', 'truth', 'terms'))]
        for array in arrays:
            array.flags.writeable = False
        found[name] = Run(each[i], *arrays)
    return found


def simulate_axes(configuration: Configuration, simulate_one: Callable[..., Run] = simulate,
                  memories: Sequence[Sequence[float] | None] = (),
                  simulate_all: Callable[..., dict[str, Run]] = simulate_together
                  ) -> dict[str, Run]:
    """Return axis → its closed loop, from t = 0 to the duration; one axis is called ''.

    Args:
        configuration: What to run.
        simulate_one: Called with an axis that nothing couples to others, and `memory`.
        memories: The laws' memories before the first sample; None, or none at all = the initial
            ones.
        simulate_all: Called with a machine whose axes are coupled, and `memories`.

    Raises:
        OverflowError, ValueError: As of `simulate` and `simulate_together`.
        LoopError: As of `simulate_one`, with the axis.
    """
    if configuration.axes and knows_others(configuration):
        return simulate_all(configuration, memories)
    each = configuration.axes or (('', configuration),)
    found = {}
    for (name, item), memory in zip(each, memories or (None,) * len(each), strict=True):
        try:
            found[name] = simulate_one(item, memory=memory)
        except DivergedError as error:
            raise DivergedError(error.t, spoken([name]) if name else '') from error
        except LoopError as error:
            raise LoopError(f'axis {name}: {error}' if name else str(error)) from error
    return found


def _scheduled(configuration: Configuration, memory: tuple[float, ...],
               t: float) -> tuple[float, ...]:
    """Return the memory of a law with the scheduling variable of a stamp [s] in its place."""
    place, schedule = configuration.law.schedule_place, configuration.loop.schedule
    if place < 0 or schedule is None:
        return memory
    return (*memory[:place], schedule(t), *memory[place + 1:])


def _push(configuration: Configuration, k: int) -> float:
    """Return what the pulse of an axis adds to x^(n) in sample k."""
    first, after, acceleration = configuration.pulse_samples
    return acceleration if first <= k < after else 0.0
